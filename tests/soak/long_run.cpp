// SPDX-License-Identifier: GPL-3.0-or-later
// The real server over DDS for minutes, with a device that sews to and fro, a viewer, and a busy
// process on another processor: what must hold however long it runs.
//
// The scene is the anastomosis with a slew limit so low that punctures meet it. Asserted is what
// does not depend on how busy the machine is: memory, limits, faults, and that poses are answered,
// but for a few. The rest is printed.
#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <regex>
#include <thread>
#include <vector>

#include "protocol/endpoint.hpp"
#include "protocol/surgeon.hpp"
#include "protocol/topics.hpp"
#include "soak/force_watcher.hpp"
#include "soak/long_session.hpp"
#include "support/process.hpp"
#include "support/process_facts.hpp"
#include "support/temporary_folder.hpp"
#include "suture/device.hpp"
#include "suture/session.hpp"
#include "suture/viewer.hpp"

namespace sutured::soak {
namespace {

// Magnitudes that this slew could not end within a ramp are lowered: below `kMaxForce_n`.
constexpr double kLowSlew_n_per_s = 5.0;
/// Of the poses; the rest is for what a busy machine holds up so long that the next overtakes it.
constexpr double kMinAnswered = 0.95;
/// What a server may grow by after its warm-up.
constexpr double kMaxDrift_kib = 1024.0;
// Of the machine (a device or a simulation held up), or of limits that do their work.
constexpr std::uint32_t kExpected = suture_v1_FAULT_POSE_STALE | suture_v1_FAULT_MODEL_STALE |
                                    suture_v1_FAULT_MODEL_PIVOTS | suture_v1_FAULT_FORCE_LIMIT |
                                    suture_v1_FAULT_SLEW_LIMIT;

std::string write_scene(const testing::TemporaryFolder& folder) {
  std::string text = testing::read_file(kFolder + "scene.toml");
  const auto replace = [&](const std::string& what, const std::string& by) {
    const std::string all = std::regex_replace(text, std::regex(what), by);
    if (all == text) throw std::runtime_error("the scene has no " + what);
    text = all;
  };
  replace("mesh = \"vessels.msh\"", "mesh = \"" + kFolder + "vessels.msh\"");
  replace("max_force_slew_n_per_s = 500.0",
          "max_force_slew_n_per_s = " + std::to_string(kLowSlew_n_per_s));
  return folder.write("scene.toml", text);
}

/// What the server said of itself.
struct Told {
  std::mutex mutex;
  suture::Status last;
  double wakeup_max_us = 0.0, step_max_us = 0.0;
  std::uint64_t frames = 0;
};

[[noreturn]] void load() {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  std::vector<double> data(1U << 20U, 1.0);  // 8 MB: it takes the caches too
  for (;;)
    for (double& x : data) x = std::sqrt(x + 1.0);
}

int run(double seconds) {
  using Clock = std::chrono::steady_clock;
  const testing::TemporaryFolder folder;
  suture::ParticipantOptions session;
  session.domain = 2U * (static_cast<std::uint32_t>(getpid()) % 100U);
  session.session = "long-run-" + std::to_string(getpid());
  setenv("CYCLONEDDS_URI", kSmallBuffers, 1);  // before there is any other thread
  testing::Process server({SUTURED_PROGRAM, "serve", write_scene(folder), "--domain",
                           std::to_string(session.domain), "--session", session.session});
  if (server.read_until("serving scene").find("serving scene") == std::string::npos)
    throw std::runtime_error("the server did not start: " + server.output());
  const testing::Process busy({"/proc/self/exe", "--load"});

  const suture::Surgeon surgeon = suture::read_surgeon(kFolder + "one_bite.csv");
  const suture::SurgeonTrack& track = surgeon.tracks.at(0);
  const double round_s = 2.0 * track.end_s();
  if (seconds < 3.0 * round_s)
    throw std::runtime_error("takes " + std::to_string(3.0 * round_s) + " s at least");
  const suture::Participant participant(session, suture::Channel::kControl);
  ForceWatcher watcher(participant, track.tool, kLowSlew_n_per_s);

  Told told;
  suture::SessionOptions viewing;
  viewing.domain = session.domain;
  viewing.session = session.session;
  {
    suture::Session commands(viewing);
    fill_history(commands);
  }
  suture::ViewerCallbacks callbacks;
  callbacks.on_frame = [&](const suture::MeshFrame&) {
    const std::lock_guard lock(told.mutex);
    ++told.frames;
  };
  callbacks.on_status = [&](const suture::Status& status) {
    const std::lock_guard lock(told.mutex);
    told.last = status;
    told.wakeup_max_us = std::max(told.wakeup_max_us, status.wakeup.max_us);
    told.step_max_us = std::max(told.step_max_us, status.step.max_us);
  };
  suture::Viewer viewer(viewing, callbacks);

  suture::DeviceOptions options;
  options.domain = session.domain;
  options.session = session.session;
  options.tool = track.tool;
  suture::Device device(options);

  const Clock::time_point begun = Clock::now();
  const auto elapsed_s = [&] {
    return std::chrono::duration<double>(Clock::now() - begun).count();
  };
  std::exception_ptr fault;
  std::atomic<bool> over{false};
  std::thread hand([&] {
    try {
      device.run(
          [&](const suture::Force&, std::chrono::nanoseconds) -> std::optional<suture::Hand> {
            const double now_s = elapsed_s();
            if (now_s > seconds) return std::nullopt;
            return to_and_fro(track, now_s);
          });
    } catch (...) {
      fault = std::current_exception();
    }
    over = true;
  });

  // Memory goes by rounds: the second is warm, and the last whole one is held against it.
  std::vector<double> round_kib(static_cast<std::size_t>(seconds / round_s), 0.0);
  while (!over) {
    std::this_thread::sleep_for(std::chrono::milliseconds(500));  // a pace, not a condition
    const auto round = static_cast<std::size_t>(elapsed_s() / round_s);
    if (round < round_kib.size())
      round_kib[round] = std::max(round_kib[round], testing::resident_kib(server.pid()));
  }
  const double warm_kib = round_kib[1], last_kib = round_kib.back();
  hand.join();
  if (fault) std::rethrow_exception(fault);
  const suture::DeviceStatistics counts = device.statistics();
  const ForceWatcher::Worst worst = watcher.worst();  // before the stop, which is a fault too
  viewer.close();
  server.send(SIGTERM);
  const int code = server.wait();

  const suture::Status& status = told.last;
  const double answered = static_cast<double>(counts.forces_received) /
                          static_cast<double>(std::max<std::uint64_t>(counts.hands_written, 1));
  const auto number = [](std::uint64_t value) { return static_cast<unsigned long long>(value); };
  std::printf("%.0f s, %llu poses, %llu forces; %llu frames to a viewer, a busy process beside\n",
              seconds, number(counts.hands_written), number(worst.forces), number(told.frames));
  std::printf("  steps          %llu, %llu overruns, longest %.1f ms\n", number(status.steps),
              number(status.overruns), 1e-3 * told.step_max_us);
  std::printf("  supervisor     %llu missed ticks, woke late by at most %.2f ms\n",
              number(status.missed_ticks), 1e-3 * told.wakeup_max_us);
  std::printf("  round trip     p50 %.0f, p99 %.0f, max %.0f us; %.2f %% answered\n",
              1e-3 * static_cast<double>(counts.round_trip_p50_ns),
              1e-3 * static_cast<double>(counts.round_trip_p99_ns),
              1e-3 * static_cast<double>(counts.round_trip_max_ns), 100.0 * answered);
  std::printf("  force          at most %.4f N, worst step %.5f N, %.2f of what the slew allows\n",
              worst.force_n, worst.step_n, worst.over_slew);
  std::printf("  oldest model   %.1f ms while the tool is served\n", 1e-3 * worst.model_age_us);
  std::printf("  faults         %s\n", suture::fault_names(worst.faults).c_str());
  std::printf("  memory         %.0f KiB in the second round, then", warm_kib);
  for (std::size_t i = 2; i < round_kib.size(); ++i) std::printf(" %+.0f", round_kib[i] - warm_kib);
  std::printf("\n");

  int failed = 0;
  const auto expect = [&](bool holds, const char* what) {
    if (!holds) std::printf("FAILED: %s\n", what);
    failed += holds ? 0 : 1;
  };
  expect(code == 0, "the server ends as it was asked to");
  expect(worst.answers > 0 && worst.felt > 0, "the tissue is felt");
  expect(answered >= kMinAnswered, "poses are answered");
  expect(worst.force_n <= kMaxForce_n, "forces are within the tool's limit");
  expect(worst.over_slew <= 1.0, "force steps are within the tool's slew limit");
  expect((worst.faults & suture_v1_FAULT_SLEW_LIMIT) != 0, "the slew limit is met at all");
  expect((worst.faults & ~kExpected) == 0, "no faults but of a busy machine and of limits");
  expect(warm_kib > 0.0 && last_kib - warm_kib <= kMaxDrift_kib, "memory grows by 1 MiB at most");
  return failed == 0 ? 0 : 1;
}

}  // namespace
}  // namespace sutured::soak

int main(int argc, char** argv) {
  CLI::App app("Serves a scene over DDS for a long time, under load, and checks what must hold");
  double seconds = 600.0;
  bool be_load = false;
  app.add_option("--seconds", seconds, "how long")->capture_default_str();
  app.add_flag("--load", be_load, "be the busy process instead");
  CLI11_PARSE(app, argc, argv);
  if (be_load) sutured::soak::load();
  try {
    return sutured::soak::run(seconds);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sutured_long_run: %s\n", error.what());
    return 1;
  }
}
