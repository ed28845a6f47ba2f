// SPDX-License-Identifier: GPL-3.0-or-later
// Pose in to force out between two processes: `sutured serve` with the main scene, against a
// bare echo over Cyclone DDS, in a process of its own too, with samples of the same types and the
// same settings of the middleware. Each millisecond asks both, in alternating order; what is
// compared is thus the server and nothing else.
#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <future>
#include <stdexcept>

#include "bench/figures.hpp"
#include "bench/pinger.hpp"
#include "haptics/realtime.hpp"
#include "haptics/supervisor.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/surgeon.hpp"
#include "support/process.hpp"
#include "support/temporary_folder.hpp"

namespace sutured::bench {
namespace {

using suture::v1::ToolForce;
using suture::v1::ToolPose;

constexpr std::int64_t kMs = 1'000'000;
const std::string kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/";

/// The first pose to each that counts.
struct Counted {
  std::uint64_t ours, theirs;
};

/// Lets both answer 1000 poses a second: until both do, for half a second more, and through the
/// track, which is what counts.
Counted play(const suture::SurgeonTrack& track, Pinger& ours, Pinger& theirs) {
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
  const Counted counted{ours.sent() + 1, theirs.sent() + 1};
  const auto beats = static_cast<std::int64_t>(1e3 * track.end_s());
  for (std::int64_t i = 0; i < beats; ++i) ask_both(1e-3 * static_cast<double>(i));
  return counted;
}

}  // namespace

[[noreturn]] void echo(std::uint32_t domain, const std::string& session,
                       const std::string& security) {
  const suture::Participant participant({domain, session, security}, suture::Channel::kControl);
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
  const Counted first =
      std::async(std::launch::async, [&] { return play(track, ours, theirs); }).get();
  std::vector<double> ours_us = ours.round_trips_us(first.ours, ours.sent());
  std::vector<double> theirs_us = theirs.round_trips_us(first.theirs, theirs.sent());
  if (ours_us.empty() || theirs_us.empty()) throw std::runtime_error("no pose was answered");

  const auto share = [](const std::vector<double>& got, std::uint64_t sent) {
    return 100.0 * static_cast<double>(got.size()) / static_cast<double>(sent);
  };
  figures.add("roundtrip_answered_percent", share(ours_us, ours.sent() + 1 - first.ours), "%");
  figures.add("bare_echo_answered_percent", share(theirs_us, theirs.sent() + 1 - first.theirs),
              "%");
  const double p50 = quantile(ours_us, 0.5), p99 = quantile(ours_us, 0.99);
  const double echo_p50 = quantile(theirs_us, 0.5), echo_p99 = quantile(theirs_us, 0.99);
  figures.add("roundtrip_us.p50", p50, "us");
  figures.add("roundtrip_us.p99", p99, "us");
  figures.add("bare_echo_us.p50", echo_p50, "us");
  figures.add("bare_echo_us.p99", echo_p99, "us");
  figures.add("roundtrip_over_bare_echo.p50", p50 / echo_p50, "x", 1.5);
  figures.add("roundtrip_over_bare_echo.p99", p99 / echo_p99, "x");
}

// Two servers of the same scene, one of which writes a checkpoint a second: each millisecond asks
// both, so that what else a machine does falls on both alike.
void measure_with_checkpoints(Figures& figures) {
  suture::ParticipantOptions with, without;
  with.domain = 4U * (static_cast<std::uint32_t>(getpid()) % 50U);
  without.domain = with.domain + 2;
  with.session = without.session = "bench-checkpoints-" + std::to_string(getpid());
  const auto command = [](const suture::ParticipantOptions& session) {
    return std::vector<std::string>{SUTURED_PROGRAM,
                                    "serve",
                                    kScene + "scene.toml",
                                    "--domain",
                                    std::to_string(session.domain),
                                    "--session",
                                    session.session};
  };
  const testing::TemporaryFolder folder;
  std::vector<std::string> keeping = command(with);
  keeping.insert(keeping.end(), {"--checkpoints", folder.path("kept")});
  const testing::Process keeper(keeping), other(command(without));
  const suture::Surgeon surgeon = suture::read_surgeon(kScene + "one_bite.csv");
  const suture::SurgeonTrack& track = surgeon.tracks.at(0);
  Pinger kept(with, track.tool), bare(without, track.tool);
  const Counted first =
      std::async(std::launch::async, [&] { return play(track, kept, bare); }).get();
  if (std::filesystem::is_empty(folder.path("kept")))
    throw std::runtime_error("no checkpoint was written: nothing to compare");
  std::vector<double> with_us = kept.round_trips_us(first.ours, kept.sent());
  std::vector<double> without_us = bare.round_trips_us(first.theirs, bare.sent());
  if (with_us.empty() || without_us.empty()) throw std::runtime_error("no pose was answered");
  const double with_p99 = quantile(with_us, 0.99), without_p99 = quantile(without_us, 0.99);
  figures.add("roundtrip_with_checkpoints_us.p99", with_p99, "us");
  figures.add("roundtrip_without_checkpoints_us.p99", without_p99, "us");
  figures.add("roundtrip_with_checkpoints_over_without.p50",
              quantile(with_us, 0.5) / quantile(without_us, 0.5), "x");
  figures.add("roundtrip_with_checkpoints_over_without.p99", with_p99 / without_p99, "x");
}

}  // namespace sutured::bench
