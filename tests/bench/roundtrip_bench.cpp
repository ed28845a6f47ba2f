// SPDX-License-Identifier: GPL-3.0-or-later
// Pose in to force out between two processes: `sutured serve` with the main scene, against a
// bare echo over Cyclone DDS, in a process of its own too, with samples of the same types and the
// same settings of the middleware. Each millisecond asks both, in alternating order; what is
// compared is thus the server and nothing else.
#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <future>
#include <memory>
#include <stdexcept>

#include "bench/figures.hpp"
#include "haptics/realtime.hpp"
#include "haptics/supervisor.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/surgeon.hpp"
#include "support/process.hpp"

namespace sutured::bench {
namespace {

using suture::v1::ToolForce;
using suture::v1::ToolPose;

constexpr std::int64_t kMs = 1'000'000;
const std::string kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/";

/// Sends poses to one peer and times the first answer to each.
class Pinger {
 public:
  Pinger(const suture::ParticipantOptions& session, const std::string& tool)
      : participant_(session, suture::Channel::kControl), writer_(participant_) {
    pose_.tool_id = suture::tool_id(tool);
    suture::EndpointCallbacks callbacks;
    callbacks.data_available = [this] {
      if (ready_.load(std::memory_order_acquire)) take();
    };
    reader_ = suture::Reader<ToolForce>(participant_, std::move(callbacks));
    ready_.store(true, std::memory_order_release);
  }

  void send(const suture::SurgeonPose& at) {
    for (std::size_t i = 0; i < 3; ++i) pose_.position_m[i] = at.position_m[i];
    for (std::size_t i = 0; i < 4; ++i) pose_.orientation_xyzw[i] = at.orientation_xyzw[i];
    pose_.jaw = static_cast<float>(at.jaw);
    pose_.flags = suture_v1_POSE_IN_WORLD;
    const std::uint64_t sequence = ++pose_.sequence_number;
    pose_.stamp_ns = suture::wall_clock_ns();
    sent_ns_[sequence % kKept].store(suture::monotonic_ns(), std::memory_order_relaxed);
    writer_.write(pose_);
  }

  [[nodiscard]] std::uint64_t answered() const { return answered_.load(); }
  /// Returns how many poses were sent since `begin`.
  [[nodiscard]] std::uint64_t asked() const { return pose_.sequence_number - begun_; }
  /// Counts from here on.
  void begin() {
    begun_ = pose_.sequence_number;
    counting_.store(true);
  }
  /// Ends the counting and returns the round trips, µs.
  [[nodiscard]] std::vector<double> end() {
    counting_.store(false);
    const std::size_t count = std::min<std::size_t>(count_.load(), kCountedMax);
    return {round_trip_us_->begin(), round_trip_us_->begin() + static_cast<std::ptrdiff_t>(count)};
  }

 private:
  static constexpr std::size_t kKept = 1024, kCountedMax = 100'000;

  void take() {
    ToolForce force;
    suture::SampleInfo info;
    while (reader_.take(force, info)) {
      const std::int64_t now = suture::monotonic_ns();
      if (!info.valid || force.tool_id != pose_.tool_id ||
          force.pose_sequence <= answered_.load(std::memory_order_relaxed))
        continue;
      answered_.store(force.pose_sequence);
      if (!counting_.load()) continue;
      const std::int64_t sent = sent_ns_[force.pose_sequence % kKept].load();
      const std::size_t at = count_.fetch_add(1);
      if (at < kCountedMax) (*round_trip_us_)[at] = 1e-3 * static_cast<double>(now - sent);
    }
  }

  suture::Participant participant_;
  suture::Writer<ToolPose> writer_;
  ToolPose pose_{};
  std::uint64_t begun_ = 0;
  std::array<std::atomic<std::int64_t>, kKept> sent_ns_{};
  std::atomic<std::uint64_t> answered_{0};
  std::atomic<std::size_t> count_{0};
  std::atomic<bool> ready_{false}, counting_{false};
  std::unique_ptr<std::array<double, kCountedMax>> round_trip_us_ =
      std::make_unique<std::array<double, kCountedMax>>();
  suture::Reader<ToolForce> reader_;  // last: no callback outlives what it uses
};

/// Lets both answer 1000 poses a second: until both do, for half a second more, and through the
/// track, which is what counts.
void play(const suture::SurgeonTrack& track, Pinger& ours, Pinger& theirs) {
  haptics::enter_realtime(60);
  std::int64_t due_ns = suture::monotonic_ns();
  std::int64_t beat = 0;
  const auto ask_both = [&](double time_s) {
    const suture::SurgeonPose pose = track.at(time_s);
    Pinger& first = beat % 2 == 0 ? ours : theirs;
    Pinger& second = beat % 2 == 0 ? theirs : ours;
    ++beat;
    first.send(pose);
    haptics::sleep_until(due_ns + kMs / 2);
    second.send(pose);
    due_ns = haptics::next_tick(due_ns, suture::monotonic_ns(), kMs).at_ns;
    haptics::sleep_until(due_ns);
  };
  constexpr std::int64_t kMeeting = 30'000, kSettling = 500;
  while (ours.answered() == 0 || theirs.answered() == 0) {
    ask_both(0.0);
    if (beat > kMeeting)
      throw std::runtime_error(
          "no answer in 30 s from " +
          std::string(ours.answered() == 0 ? "sutured serve" : "the echo") +
          ": run `suture doctor` to see what is wrong with DDS on this machine");
  }
  for (std::int64_t i = 0; i < kSettling; ++i) ask_both(0.0);
  ours.begin();
  theirs.begin();
  const auto beats = static_cast<std::int64_t>(1e3 * track.end_s());
  for (std::int64_t i = 0; i < beats; ++i) ask_both(1e-3 * static_cast<double>(i));
}

}  // namespace

[[noreturn]] void echo(std::uint32_t domain, const std::string& session) {
  const suture::Participant participant({domain, session, {}}, suture::Channel::kControl);
  suture::Writer<ToolForce> writer(participant);
  std::atomic<bool> ready{false};
  suture::Reader<ToolPose> reader;
  suture::EndpointCallbacks callbacks;
  callbacks.data_available = [&] {
    if (!ready.load(std::memory_order_acquire)) return;
    ToolPose pose;
    suture::SampleInfo info;
    while (reader.take(pose, info)) {
      if (!info.valid) continue;
      ToolForce force{};
      force.tool_id = pose.tool_id;
      force.pose_sequence = pose.sequence_number;
      force.pose_stamp_ns = pose.stamp_ns;
      writer.write(force);
    }
  };
  reader = suture::Reader<ToolPose>(participant, std::move(callbacks));
  ready.store(true, std::memory_order_release);
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // we are our parent's tool and go with it
  for (;;) pause();
}

void measure_roundtrip(Figures& figures) {
  suture::ParticipantOptions served, echoed;
  served.domain = 4U * (static_cast<std::uint32_t>(getpid()) % 50U);
  echoed.domain = served.domain + 2;
  served.session = echoed.session = "bench-" + std::to_string(getpid());
  const testing::Process server({SUTURED_PROGRAM, "serve", kScene + "scene.toml", "--domain",
                                 std::to_string(served.domain), "--session", served.session});
  const testing::Process bare(
      {"/proc/self/exe", "--echo", std::to_string(echoed.domain), "--session", echoed.session});
  const suture::Surgeon surgeon = suture::read_surgeon(kScene + "one_bite.csv");
  const suture::SurgeonTrack& track = surgeon.tracks.at(0);

  Pinger ours(served, track.tool), theirs(echoed, track.tool);
  // On a thread of its own, which takes its priority with it.
  std::async(std::launch::async, [&] { play(track, ours, theirs); }).get();
  std::vector<double> ours_us = ours.end(), theirs_us = theirs.end();
  if (ours_us.empty() || theirs_us.empty()) throw std::runtime_error("no pose was answered");

  const auto share = [](const std::vector<double>& got, std::uint64_t sent) {
    return 100.0 * static_cast<double>(got.size()) / static_cast<double>(sent);
  };
  figures.add("roundtrip_answered_percent", share(ours_us, ours.asked()), "%");
  figures.add("bare_echo_answered_percent", share(theirs_us, theirs.asked()), "%");
  const double p50 = quantile(ours_us, 0.5), p99 = quantile(ours_us, 0.99);
  const double echo_p50 = quantile(theirs_us, 0.5), echo_p99 = quantile(theirs_us, 0.99);
  figures.add("roundtrip_us.p50", p50, "us");
  figures.add("roundtrip_us.p99", p99, "us");
  figures.add("bare_echo_us.p50", echo_p50, "us");
  figures.add("bare_echo_us.p99", echo_p99, "us");
  figures.add("roundtrip_over_bare_echo.p50", p50 / echo_p50, "x", 1.5);
  figures.add("roundtrip_over_bare_echo.p99", p99 / echo_p99, "x");
}

}  // namespace sutured::bench
