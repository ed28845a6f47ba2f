// SPDX-License-Identifier: Apache-2.0
// The records of an MCAP file (https://mcap.dev/spec) as values, and their bytes: little
// endian, without padding, texts and lists behind a length.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace suture::mcap {

static_assert(std::endian::native == std::endian::little);

inline constexpr std::array<std::uint8_t, 8> kMagic{0x89, 'M', 'C', 'A', 'P', '0', '\r', '\n'};

/// First byte of each record; a length of 8 bytes follows, then so many of content.
enum class Opcode : std::uint8_t {
  kHeader = 1,
  kFooter = 2,
  kSchema = 3,
  kChannel = 4,
  kMessage = 5,
  kChunk = 6,
  kMessageIndex = 7,
  kChunkIndex = 8,
  kAttachment = 9,
  kAttachmentIndex = 10,
  kStatistics = 11,
  kMetadata = 12,
  kMetadataIndex = 13,
  kSummaryOffset = 14,
  kDataEnd = 15,
};
inline constexpr std::size_t kRecordHead = 9;

using Text = std::map<std::string, std::string>;

/// How the messages of a channel are laid out.
struct Schema {
  std::uint16_t id = 0;  ///< from 1
  std::string name;      ///< of the type
  std::string encoding;  ///< of `data`
  std::string data;
};

/// The messages of one topic.
struct Channel {
  std::uint16_t id = 0;
  std::uint16_t schema = 0;
  std::string topic;
  std::string encoding;  ///< of the messages
  Text metadata;
};

/// One message; times in ns since the Unix epoch.
struct Message {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;         ///< the publisher's, or 0
  std::uint64_t log_time_ns = 0;      ///< when it was recorded
  std::uint64_t publish_time_ns = 0;  ///< when it was sent
  std::span<const std::byte> data;
};

/// Named texts about the recording.
struct Metadata {
  std::string name;
  Text values;
};

/// Appends values to a buffer.
class ByteSink {
 public:
  explicit ByteSink(std::vector<std::byte>& bytes) : bytes_(bytes) {}

  template <class T>
  void put(T value) {
    static_assert(std::is_integral_v<T>);
    bytes({reinterpret_cast<const std::byte*>(&value), sizeof value});
  }
  void put(Opcode opcode) { bytes_.push_back(static_cast<std::byte>(opcode)); }
  void bytes(std::span<const std::byte> more) {
    bytes_.insert(bytes_.end(), more.begin(), more.end());
  }
  void text(std::string_view text) {
    put(static_cast<std::uint32_t>(text.size()));
    bytes(std::as_bytes(std::span(text)));
  }
  void texts(const Text& texts) {
    const std::size_t length_at = bytes_.size();
    put(std::uint32_t{0});
    for (const auto& [key, value] : texts) {
      text(key);
      text(value);
    }
    const auto length =
        static_cast<std::uint32_t>(bytes_.size() - length_at - sizeof(std::uint32_t));
    std::memcpy(bytes_.data() + length_at, &length, sizeof length);
  }
  /// Appends a record whose content `fill()` appends.
  template <class Fill>
  void record(Opcode opcode, Fill&& fill) {
    put(opcode);
    const std::size_t length_at = bytes_.size();
    put(std::uint64_t{0});
    fill();
    const std::uint64_t length = bytes_.size() - length_at - sizeof length;
    std::memcpy(bytes_.data() + length_at, &length, sizeof length);
  }
  [[nodiscard]] std::size_t size() const { return bytes_.size(); }

 private:
  std::vector<std::byte>& bytes_;
};

/// Takes values off bytes. What is not there reads as zero or empty, and `good` turns false.
class ByteSource {
 public:
  explicit ByteSource(std::span<const std::byte> bytes) : bytes_(bytes) {}

  template <class T>
  T get() {
    static_assert(std::is_integral_v<T>);
    T value{};
    const std::span<const std::byte> taken = take(sizeof value);
    if (good_) std::memcpy(&value, taken.data(), sizeof value);
    return value;
  }
  std::span<const std::byte> take(std::uint64_t count) {
    if (count > bytes_.size()) {
      good_ = false;
      count = bytes_.size();
    }
    const std::span<const std::byte> taken = bytes_.first(static_cast<std::size_t>(count));
    bytes_ = bytes_.subspan(taken.size());
    return taken;
  }
  std::string text() {
    const std::span<const std::byte> taken = take(get<std::uint32_t>());
    return {reinterpret_cast<const char*>(taken.data()), taken.size()};
  }
  Text texts() {
    Text texts;
    ByteSource inner(take(get<std::uint32_t>()));
    while (inner.good_ && !inner.bytes_.empty()) {
      std::string key = inner.text();
      texts[std::move(key)] = inner.text();
    }
    good_ = good_ && inner.good_;
    return texts;
  }
  [[nodiscard]] bool good() const { return good_; }
  [[nodiscard]] bool empty() const { return bytes_.empty(); }
  [[nodiscard]] std::span<const std::byte> rest() const { return bytes_; }

 private:
  std::span<const std::byte> bytes_;
  bool good_ = true;
};

}  // namespace suture::mcap
