// SPDX-License-Identifier: Apache-2.0
#include "sample_facts.hpp"

#include <bit>
#include <cstring>

namespace suture::cli {
namespace {

static_assert(std::endian::native == std::endian::little);

/// Takes values off a sample, each aligned to its size. What is not there reads as zero, and
/// `good` turns false.
class CdrSource {
 public:
  explicit CdrSource(std::span<const std::byte> sample) noexcept {
    constexpr std::byte kXcdr1LittleEndian{1};
    good_ = sample.size() >= 4 && sample[0] == std::byte{0} && sample[1] == kXcdr1LittleEndian;
    if (good_) bytes_ = sample.subspan(4);
  }

  template <class T>
  T get() noexcept {
    static_assert(std::is_arithmetic_v<T>);
    at_ = (at_ + sizeof(T) - 1) / sizeof(T) * sizeof(T);
    T value{};
    if (const std::byte* place = take(sizeof value)) std::memcpy(&value, place, sizeof value);
    return value;
  }
  template <class T, std::size_t N>
  std::array<T, N> get_array() noexcept {
    std::array<T, N> values{};
    for (T& value : values) value = get<T>();
    return values;
  }
  /// A text's length counts the zero at its end.
  std::string_view text() noexcept {
    const auto length = get<std::uint32_t>();
    const std::byte* place = take(length);
    if (place == nullptr || length == 0) return {};
    return {reinterpret_cast<const char*>(place), length - 1};
  }
  void skip(std::size_t count) noexcept { take(count); }
  [[nodiscard]] bool good() const noexcept { return good_; }

 private:
  const std::byte* take(std::size_t count) noexcept {
    if (!good_ || at_ > bytes_.size() || count > bytes_.size() - at_) {
      good_ = false;
      return nullptr;
    }
    const std::byte* place = bytes_.data() + at_;
    at_ += count;
    return place;
  }

  std::span<const std::byte> bytes_;
  std::size_t at_ = 0;
  bool good_ = false;
};

// What comes before epoch and sequence number.
enum class Lead : std::uint8_t { kNothing, kToolId, kToolIdAndGuid, kName, kNameAndGuid };

struct HeadLayout {
  const TopicSpec* topic;
  Lead lead;
  bool counts;  // the sequence number, by one a sample of one key
  bool keyed;   // so that each key has a count of its own
};

const HeadLayout* layout_of(const TopicSpec& spec) noexcept {
  static const HeadLayout kLayouts[] = {
      {&topic<v1::ToolPose>(), Lead::kToolId, true, true},
      {&topic<v1::ToolForce>(), Lead::kToolIdAndGuid, true, true},
      {&topic<v1::HapticModel>(), Lead::kNameAndGuid, true, true},
      {&topic<v1::ToolRendered>(), Lead::kToolId, true, true},
      {&topic<v1::DeviceProfile>(), Lead::kName, false, true},
      {&topic<v1::Event>(), Lead::kNothing, true, false},
      {&topic<v1::ServerStatus>(), Lead::kNothing, true, false},
      {&topic<v1::MeshTopology>(), Lead::kName, false, true},
      {&topic<v1::MeshFrame>(), Lead::kName, true, true},
      {&topic<v1::ToolView>(), Lead::kName, true, true},
      {&topic<v1::NeedleState>(), Lead::kName, true, true},
      {&topic<v1::ThreadState>(), Lead::kName, true, true},
      {&topic<v1::ContactState>(), Lead::kNothing, true, false},
      {&topic<v1::Quality>(), Lead::kName, true, false},
  };
  for (const HeadLayout& layout : kLayouts)
    if (layout.topic == &spec) return &layout;
  return nullptr;  // commands and their replies count by requester
}

constexpr std::size_t kGuid = sizeof(Guid);

}  // namespace

std::optional<SampleHead> sample_head(const TopicSpec& topic,
                                      std::span<const std::byte> bytes) noexcept {
  const HeadLayout* layout = layout_of(topic);
  if (layout == nullptr) return std::nullopt;
  CdrSource source(bytes);
  SampleHead head;
  head.counts = layout->counts;
  std::uint64_t key = 0;
  if (layout->lead == Lead::kToolId || layout->lead == Lead::kToolIdAndGuid) {
    key = source.get<std::uint64_t>();
  } else if (layout->lead != Lead::kNothing) {
    key = tool_id(source.text());
  }
  if (layout->keyed) head.key = key;
  if (layout->lead == Lead::kToolIdAndGuid || layout->lead == Lead::kNameAndGuid) {
    source.skip(kGuid);
  }
  head.epoch = source.get<std::uint64_t>();
  head.sequence = source.get<std::uint64_t>();
  if (!source.good()) return std::nullopt;
  return head;
}

std::optional<ServerFacts> server_facts(std::span<const std::byte> bytes) {
  CdrSource source(bytes);
  ServerFacts facts;
  facts.epoch = source.get<std::uint64_t>();
  source.get<std::uint64_t>();  // sequence_number
  source.get<std::int64_t>();   // stamp_ns
  source.get<std::uint32_t>();  // protocol_version
  facts.version = source.text();
  source.skip(kGuid);  // server
  facts.session = source.text();
  facts.host = source.text();
  facts.pid = source.get<std::int32_t>();
  facts.started_ns = source.get<std::int64_t>();
  facts.leaving = source.get<std::uint32_t>() == suture_v1_SERVER_LEAVING;
  source.text();  // state_reason
  facts.scene = source.text();
  source.get<double>();         // simulation_time_s
  source.get<std::uint64_t>();  // steps
  facts.rate_hz = source.get<double>();
  if (!source.good() || facts.epoch == 0) return std::nullopt;  // 0: it does not serve yet
  return facts;
}

std::optional<StepFacts> step_facts(std::span<const std::byte> bytes) {
  CdrSource source(bytes);
  StepFacts facts;
  facts.tool = source.text();
  source.skip(kGuid);  // device
  facts.epoch = source.get<std::uint64_t>();
  facts.step = source.get<std::uint64_t>();
  source.get<std::uint64_t>();  // changed_sequence
  source.get<std::int64_t>();   // stamp_ns
  source.get<std::int64_t>();   // period_ns
  facts.pose_sequence = source.get<std::uint64_t>();
  facts.simulation_time_s = source.get<double>();
  facts.engaged = (source.get<std::uint32_t>() & suture_v1_MODEL_ENGAGED) != 0;
  facts.position_m = source.get_array<double, 3>();
  facts.orientation_xyzw = source.get_array<double, 4>();
  if (!source.good()) return std::nullopt;
  return facts;
}

std::optional<JawFacts> jaw_facts(std::span<const std::byte> bytes) noexcept {
  CdrSource source(bytes);
  JawFacts facts;
  facts.tool_id = source.get<std::uint64_t>();
  source.get<std::uint64_t>();  // epoch
  facts.sequence = source.get<std::uint64_t>();
  source.get<std::int64_t>();         // stamp_ns
  source.get_array<double, 3 + 4>();  // position_m, orientation_xyzw
  source.get_array<float, 3 + 3>();   // velocities
  facts.jaw = static_cast<double>(source.get<float>());
  if (!source.good()) return std::nullopt;
  return facts;
}

}  // namespace suture::cli
