// SPDX-License-Identifier: GPL-3.0-or-later
// sutured_faults: injects every fault that a hand must not feel into real servers and real
// devices over DDS, in both render modes, and tells what the hand felt. `make faults`.
//
// A probe presses a block of tissue and is held still, so that every change of force is the
// fault's. What the hand felt is recorded at the device, 1000 times a second, after the SDK;
// of a device that is killed, at the server's side.
#include <signal.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <fstream>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <thread>

#include "endpoints/server.hpp"
#include "faults/felt_device.hpp"
#include "haptics/supervisor.hpp"
#include "integration/serve/raw_device.hpp"
#include "scene/scene_reader.hpp"
#include "simulation/simulation.hpp"
#include "support/client_options.hpp"
#include "support/pressed_block.hpp"
#include "support/process.hpp"
#include "support/test_session.hpp"
#include "suture/session.hpp"
#include "suture/viewer.hpp"

namespace sutured::faults {
namespace {

using suture::Render;
using testing::eventually;
using testing::PressedBlock;
using testing::Process;

constexpr std::int64_t kMs = 1'000'000;
constexpr auto kBefore = std::chrono::milliseconds(60);
constexpr auto kDuring = std::chrono::milliseconds(200);
constexpr auto kSlowStep = std::chrono::milliseconds(250);
const PressedBlock kBlock{
    .young_modulus_pa = 2.0e5, .max_force_n = 2.0, .max_force_slew_n_per_s = 150.0};
constexpr double kDepth_m = 0.001;

suture::Hand pressing_hand() {
  suture::Hand hand;
  hand.position_m = {PressedBlock::kX_m, PressedBlock::kY_m, PressedBlock::height_m(kDepth_m)};
  return hand;
}

suture::DeviceOptions device_options(const suture::ParticipantOptions& session, Render render) {
  suture::DeviceOptions options;
  options.domain = session.domain;
  options.session = session.session;
  options.tool = "probe";
  options.render = render;
  options.timeout = std::chrono::seconds(20);
  return options;
}

std::string program() {
  char path[4096];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof path);
  return {path, static_cast<std::size_t>(std::max<ssize_t>(length, 0))};
}

// ------------------------------------------------------------------ what runs in other processes

volatile std::sig_atomic_t slow_step_asked = 0;

/// Serves like `sutured serve`, but SIGUSR1 makes a step take a quarter of a second.
[[noreturn]] void serve(const std::string& path, const suture::ParticipantOptions& session) {
  std::signal(SIGUSR1, [](int) { slow_step_asked = 1; });
  endpoints::Server::Options options;
  options.session = session;
  options.watch = [](simulation::Simulation&, bool) {
    if (slow_step_asked == 0) return;
    slow_step_asked = 0;
    std::this_thread::sleep_for(kSlowStep);
  };
  const endpoints::Server server(scene::read_scene(path), options);
  std::printf("serving scene\n");
  std::fflush(stdout);
  for (;;) std::this_thread::sleep_for(std::chrono::hours(1));
}

/// Holds the tool until it is killed.
[[noreturn]] void hold(const suture::ParticipantOptions& session, Render render) {
  suture::Device device(device_options(session, render));
  device.run([](const suture::Force&, std::chrono::nanoseconds) {
    return std::optional(pressing_hand());
  });
  std::exit(1);
}

// ------------------------------------------------------------------ results

struct Result {
  std::string fault, mode;
  std::optional<double> seen_ms, zero_ms,
      recovered_ms;                              ///< after the last good sample; after its end
  double largest_step_n = 0.0;                   ///< between two samples of the hand
  double largest_slew_n_per_s = 0.0;             ///< over any 4 ms
  double largest_n = 0.0;                        ///< magnitude
  double over_slew = 0.0;                        ///< largest change over what its time allows
  double whole_n = 0.0;                          ///< before the fault
  std::vector<std::pair<double, double>> curve;  ///< ms, N
};

/// Returns the time that the slew limit gives for the change from `before` to `now`, ns: that
/// between the two readings, or between the stamps of the server's forces that they show, which
/// may come in a bunch.
std::int64_t time_to_change(const Felt& before, const Felt& now) {
  // For the clocks of a stamp, which are read one after the other.
  constexpr std::int64_t kStamps_ns = 500'000;
  std::int64_t time_ns = now.time_ns - before.asked_ns;
  if (before.stamp_ns != 0 && now.stamp_ns != 0)
    time_ns = std::max(time_ns, now.stamp_ns - before.stamp_ns + kStamps_ns);
  return time_ns;
}

/// Returns what a listener at the server's side felt by `force` just now.
Felt felt_of(const suture::v1::ToolForce& force) {
  const std::int64_t now_ns = suture::monotonic_ns();
  Felt felt{now_ns,        {}, {}, force.faults, now_ns, force.pose_sequence, force.sequence_number,
            force.stamp_ns};
  std::copy(std::begin(force.force_n), std::end(force.force_n), felt.force_n.begin());
  if (force.state == suture_v1_TOOL_RENDERING) felt.state = suture::ForceState::kRendering;
  return felt;
}

/// Notes when the server made each of its forces, by what the SDK tells of one.
class Stamps {
 public:
  explicit Stamps(const suture::Participant& participant) {
    suture::EndpointCallbacks callbacks;
    callbacks.data_available = [this] {
      if (ready_.load(std::memory_order_acquire)) take();
    };
    reader_ = suture::Reader<suture::v1::ToolForce>(participant, std::move(callbacks));
    ready_.store(true, std::memory_order_release);
  }
  void forget() {
    const std::lock_guard lock(mutex_);
    stamps_.clear();
  }
  void tell(std::vector<Felt>& felt) {
    const std::lock_guard lock(mutex_);
    for (Felt& one : felt) {
      const auto found = stamps_.find({one.hand_sequence, one.sequence});
      if (found != stamps_.end()) one.stamp_ns = found->second;
    }
  }

 private:
  void take() {
    suture::v1::ToolForce force;
    suture::SampleInfo info;
    while (reader_.take(force, info)) {
      if (!info.valid) continue;
      const std::lock_guard lock(mutex_);
      stamps_[{force.pose_sequence, force.sequence_number}] = force.stamp_ns;
    }
  }

  std::atomic<bool> ready_{false};
  std::mutex mutex_;
  std::map<std::pair<std::uint64_t, std::uint64_t>, std::int64_t> stamps_;
  suture::Reader<suture::v1::ToolForce> reader_;
};

bool whole(const Felt& felt) {
  return felt.state == suture::ForceState::kRendering && felt.magnitude_n() > 0.2;
}

/// Draws the figures from what was felt between `good_ns`, `end_ns` (the fault's end), and after.
Result analyse(std::string fault, Render render, const std::vector<Felt>& felt,
               std::int64_t good_ns, std::int64_t end_ns, std::optional<std::int64_t> seen_ns) {
  Result result;
  result.fault = std::move(fault);
  result.mode = render == Render::kServer ? "server" : "device";
  const auto ms = [&](std::int64_t time_ns, std::int64_t since_ns) {
    return static_cast<double>(time_ns - since_ns) / kMs;
  };
  std::int64_t felt_ns = good_ns;
  bool ended = false;
  std::size_t window = 0;
  for (std::size_t i = 0; i < felt.size(); ++i) {
    const double now_n = felt[i].magnitude_n();
    result.curve.emplace_back(ms(felt[i].time_ns, good_ns), now_n);
    const auto change_since = [&](std::size_t j) {
      double squared = 0.0;
      for (int k = 0; k < 3; ++k) squared += std::pow(felt[i].force_n[k] - felt[j].force_n[k], 2);
      return std::sqrt(squared);
    };
    const auto over_slew_since = [&](std::size_t j) {
      return change_since(j) * 1e9 /
             (kBlock.max_force_slew_n_per_s *
              static_cast<double>(std::max<std::int64_t>(time_to_change(felt[j], felt[i]), 1)));
    };
    // Not a number: more than any limit.
    result.largest_n = std::max(result.largest_n, std::isfinite(now_n) ? now_n : HUGE_VAL);
    if (i > 0) result.over_slew = std::max(result.over_slew, over_slew_since(i - 1));
    if (i > 0) result.largest_step_n = std::max(result.largest_step_n, change_since(i - 1));
    while (felt[i].time_ns - felt[window].time_ns > 4 * kMs) {
      ++window;
    }
    // Over a few forces the time is known better than over two.
    if (window > 0) result.over_slew = std::max(result.over_slew, over_slew_since(window - 1));
    if (window > 0)
      result.largest_slew_n_per_s =
          std::max(result.largest_slew_n_per_s,
                   change_since(window - 1) * 1e9 /
                       static_cast<double>(felt[i].time_ns - felt[window - 1].time_ns));
    if (felt[i].time_ns <= good_ns) {
      result.whole_n = now_n;
    } else if (felt[i].time_ns < end_ns) {
      // The first zero: a hand that stays where it jumped to is followed again from there.
      ended = ended || now_n == 0.0;
      if (!ended) felt_ns = felt[i].time_ns;
    } else if (!result.recovered_ms && whole(felt[i]) && now_n > 0.95 * result.whole_n) {
      result.recovered_ms = ms(felt[i].time_ns, end_ns);
    }
  }
  if (ended) result.zero_ms = ms(felt_ns, good_ns);
  if (seen_ns) result.seen_ms = ms(*seen_ns, good_ns);
  return result;
}

// ------------------------------------------------------------------ the bench

/// One session with a server, and what is told of it.
class Bench {
 public:
  /// `name` keeps its session apart from those of others.
  explicit Bench(const std::string& name)
      : session_(session_of(name)),
        scene_(kBlock.write(folder_)),
        listener_(session_, suture::Channel::kControl),
        stamps_(listener_) {}

  void start_server(bool slow_steps = false) {
    const std::string domain = std::to_string(session_.domain);
    server_.emplace(slow_steps
                        ? std::vector<std::string>{program(), "--serve", scene_, "--domain", domain,
                                                   "--session", session_.session}
                        : std::vector<std::string>{SUTURED_PROGRAM, "serve", scene_, "--domain",
                                                   domain, "--session", session_.session});
    if (server_->read_until("serving scene").find("serving scene") == std::string::npos)
      throw std::runtime_error("the server does not start: " + server_->output());
    suture::ViewerCallbacks callbacks;
    callbacks.on_event = [this](const suture::Event& event) {
      const std::lock_guard lock(mutex_);
      events_.push_back({suture::monotonic_ns(), event.faults});
    };
    viewer_.reset();
    viewer_.emplace(viewer_options(), callbacks);
  }
  void start_device(Render render) {
    device_.reset();
    device_ = std::make_unique<FeltDevice>(device_options(session_, render), pressing_hand());
  }
  void end_device() { device_.reset(); }
  Process& server() { return *server_; }
  FeltDevice& device() { return *device_; }
  [[nodiscard]] const suture::ParticipantOptions& session() const { return session_; }
  [[nodiscard]] suture::SessionOptions viewer_options() const {
    return testing::client_options(session_);
  }
  void await_whole() {
    if (!eventually([this] { return whole(device_->last()); }))
      throw std::runtime_error("no force: " + server_->output());
    // Past the last of the ramp, so that what is compared with later is the whole force.
    std::this_thread::sleep_for(kBefore);
  }

  /// Injects a fault into a hand at rest. `inject` returns the time of the last good sample;
  /// `fault`: its FAULT bits; `state`: by which the device can tell it too.
  Result measure(const std::string& name, Render render, std::uint32_t fault,
                 std::optional<suture::ForceState> state,
                 const std::function<std::int64_t()>& inject, const std::function<void()>& end) {
    await_whole();
    device_->forget();
    stamps_.forget();
    {
      const std::lock_guard lock(mutex_);
      events_.clear();
    }
    std::this_thread::sleep_for(kBefore);
    const std::int64_t good_ns = inject();
    std::this_thread::sleep_for(kDuring);
    const std::int64_t end_ns = suture::monotonic_ns();
    end();
    await_whole();
    std::vector<Felt> felt = device_->felt();
    if (render == Render::kServer) stamps_.tell(felt);
    std::optional<std::int64_t> seen_ns;
    const auto see = [&](std::int64_t time_ns) {
      if (time_ns > good_ns && (!seen_ns || time_ns < *seen_ns)) seen_ns = time_ns;
    };
    for (const Felt& one : felt)
      if ((one.faults & fault) != 0 || (state && one.state == *state)) see(one.time_ns);
    const std::lock_guard lock(mutex_);
    for (const Told& event : events_)
      if ((event.faults & fault) != 0) see(event.time_ns);
    return analyse(name, render, felt, good_ns, end_ns, seen_ns);
  }

 private:
  struct Told {
    std::int64_t time_ns;
    std::uint32_t faults;
  };
  static suture::ParticipantOptions session_of(const std::string& name) {
    suture::ParticipantOptions session = testing::own_session();
    session.session += name;
    return session;
  }

  suture::ParticipantOptions session_;
  testing::TemporaryFolder folder_;
  std::string scene_;
  suture::Participant listener_;
  Stamps stamps_;
  std::optional<Process> server_;
  std::mutex mutex_;
  std::vector<Told> events_;
  std::optional<suture::Viewer> viewer_;
  std::unique_ptr<FeltDevice> device_;
};

struct BadHand {
  const char* name;
  std::uint32_t fault;
  FeltDevice::Spoil spoil;
};

std::vector<BadHand> bad_hands() {
  const auto each = [](auto&& change) {
    return [change](const suture::Hand& good) {
      suture::Hand hand = good;
      change(hand);
      return std::vector{hand};
    };
  };
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const auto turn = std::make_shared<int>(0);
  return {
      {"hand not a number", suture_v1_FAULT_POSE_NOT_FINITE,
       each([](suture::Hand& hand) { hand.position_m[0] = kNan; })},
      {"quaternion not of unit length", suture_v1_FAULT_POSE_QUATERNION,
       each([](suture::Hand& hand) { hand.orientation_xyzw[3] = 2.0; })},
      {"jaw outside 0 ... 1", suture_v1_FAULT_POSE_JAW,
       each([](suture::Hand& hand) { hand.jaw = 1.5; })},
      {"hand jumps 3 cm to and fro", suture_v1_FAULT_POSE_JUMP, each([turn](suture::Hand& hand) {
         if (++*turn % 2 != 0) hand.position_m[2] -= 0.03;
       })},
      {"hand jumps 2 cm away, once", suture_v1_FAULT_POSE_JUMP,
       each([](suture::Hand& hand) { hand.position_m[2] += 0.02; })},
      {"hands stop coming", suture_v1_FAULT_POSE_STALE,
       [](const suture::Hand&) { return std::vector<suture::Hand>{}; }},
      {"twelve hands a millisecond", suture_v1_FAULT_POSE_RATE,
       [](const suture::Hand& good) { return std::vector<suture::Hand>(12, good); }},
  };
}

/// The fault of a device that is not there any more, seen at the server's side.
Result measure_killed_device(Bench& bench, Render render) {
  bench.end_device();
  const suture::Participant participant(bench.session(), suture::Channel::kControl);
  std::mutex mutex;
  std::vector<Felt> felt;
  std::atomic<bool> ready{false};
  std::int64_t good_ns = 0;
  suture::Reader<suture::v1::ToolForce> reader;
  suture::EndpointCallbacks callbacks;
  callbacks.data_available = [&] {
    if (!ready) return;
    suture::v1::ToolForce force;
    suture::SampleInfo info;
    while (reader.take(force, info)) {
      if (!info.valid) continue;
      const Felt one = felt_of(force);
      const std::lock_guard lock(mutex);
      felt.push_back(one);
      if ((force.flags & suture_v1_FORCE_FROM_SUPERVISOR) == 0) good_ns = one.time_ns;
    }
  };
  reader = suture::Reader<suture::v1::ToolForce>(participant, std::move(callbacks));
  ready = true;
  const auto start = [&] {
    return std::make_unique<Process>(std::vector<std::string>{
        program(), "--hold", render == Render::kServer ? "server" : "device", "--domain",
        std::to_string(bench.session().domain), "--session", bench.session().session});
  };
  const auto await_whole = [&] {
    if (!eventually([&] {
          const std::lock_guard lock(mutex);
          return !felt.empty() && whole(felt.back());
        }))
      throw std::runtime_error("a device in a process of its own feels nothing");
    std::this_thread::sleep_for(kBefore);
  };
  auto holder = start();
  await_whole();
  {
    const std::lock_guard lock(mutex);
    felt.clear();
  }
  std::this_thread::sleep_for(kBefore);
  holder->send(SIGKILL);
  std::this_thread::sleep_for(kDuring);
  const std::int64_t last_good_ns = [&] {
    const std::lock_guard lock(mutex);
    return good_ns;
  }();
  const std::int64_t end_ns = suture::monotonic_ns();
  holder = start();
  await_whole();
  const std::lock_guard lock(mutex);
  std::optional<std::int64_t> seen_ns;
  for (const Felt& one : felt)
    if (!seen_ns && one.time_ns > last_good_ns && (one.faults & suture_v1_FAULT_POSE_STALE) != 0)
      seen_ns = one.time_ns;
  return analyse("device killed (SIGKILL)", render, felt, last_good_ns, end_ns, seen_ns);
}

/// Poses out of order, which the SDK cannot send: a device without its care.
Result measure_order(Bench& bench) {
  bench.end_device();
  const suture::Hand hand = pressing_hand();
  testing::RawDevice device(bench.session(), "probe");
  device.move_to(hand.position_m[0], hand.position_m[1], hand.position_m[2]);
  std::mutex mutex;
  std::vector<Felt> felt;
  std::optional<std::int64_t> seen_ns;
  suture::ViewerCallbacks callbacks;
  std::atomic<bool> spoilt{false};
  callbacks.on_event = [&](const suture::Event& event) {
    const std::lock_guard lock(mutex);
    if (spoilt && !seen_ns && (event.faults & suture_v1_FAULT_POSE_ORDER) != 0)
      seen_ns = suture::monotonic_ns();
  };
  suture::Viewer viewer(bench.viewer_options(), callbacks);
  const suture::Participant participant(bench.session(), suture::Channel::kControl);
  suture::Reader<suture::v1::ToolForce> reader(participant);
  const auto listen = [&](std::chrono::milliseconds time) {
    const auto until = std::chrono::steady_clock::now() + time;
    suture::v1::ToolForce force;
    suture::SampleInfo info;
    while (std::chrono::steady_clock::now() < until) {
      while (reader.take(force, info)) {
        if (!info.valid) continue;
        felt.push_back(felt_of(force));
      }
      std::this_thread::sleep_for(std::chrono::microseconds(200));
    }
  };
  do listen(kBefore);
  while (felt.empty() || !whole(felt.back()));
  listen(kBefore);
  felt.clear();
  listen(kBefore);
  const std::int64_t good_ns = suture::monotonic_ns();
  spoilt = true;
  device.spoil([](suture::v1::ToolPose& pose) {
    if (pose.sequence_number % 2 == 0) pose.sequence_number -= 5;
  });
  listen(kDuring);
  const std::int64_t end_ns = suture::monotonic_ns();
  device.spoil(nullptr);
  listen(kDuring);
  const std::lock_guard lock(mutex);
  return analyse("every other pose out of order", Render::kServer, felt, good_ns, end_ns, seen_ns);
}

std::vector<Result> measure_all(Render render) {
  std::vector<Result> results;
  const auto keep = [&](Result result) {
    std::printf(
        "%-34s %-7s seen %7.1f ms   zero %7.1f ms   step %.4f N   slew %6.1f N/s   "
        "back %7.1f ms\n",
        result.fault.c_str(), result.mode.c_str(), result.seen_ms.value_or(-1),
        result.zero_ms.value_or(-1), result.largest_step_n, result.largest_slew_n_per_s,
        result.recovered_ms.value_or(-1));
    std::fflush(stdout);
    results.push_back(std::move(result));
  };
  const auto now = [] { return suture::monotonic_ns(); };
  const std::optional<suture::ForceState> none;
  {
    Bench slow("-slow");
    slow.start_server(true);
    slow.start_device(render);
    keep(slow.measure(
        "simulation step of 250 ms", render, suture_v1_FAULT_MODEL_STALE, none,
        [&] {
          const std::int64_t good_ns = now();
          slow.server().send(SIGUSR1);
          return good_ns;
        },
        [] {}));
  }
  Bench bench(render == Render::kServer ? "-server" : "-device");
  bench.start_server();
  bench.start_device(render);
  for (const BadHand& bad : bad_hands())
    keep(bench.measure(
        bad.name, render, bad.fault, none, [&] { return bench.device().spoil(bad.spoil); },
        [&] { bench.device().spoil(nullptr); }));

  suture::Session commands(bench.viewer_options());
  keep(bench.measure(
      "stop command", render, suture_v1_FAULT_STOPPED, suture::ForceState::kStopped,
      [&] {
        const std::int64_t good_ns = now();
        commands.command(suture::CommandKind::kStop);
        return good_ns;
      },
      [&] { commands.command(suture::CommandKind::kResume); }));
  keep(bench.measure(
      "stop button at the device", render, suture_v1_FAULT_STOPPED, suture::ForceState::kStopped,
      [&] {
        return bench.device().spoil([pressed = false](const suture::Hand& good) mutable {
          suture::Hand hand = good;
          hand.stop = !std::exchange(pressed, true);  // one hand only
          return std::vector{hand};
        });
      },
      [&] {
        bench.device().spoil(nullptr);
        commands.command(suture::CommandKind::kResume);
      }));
  keep(bench.measure(
      "pause command", render, 0, suture::ForceState::kPaused,
      [&] {
        const std::int64_t good_ns = now();
        commands.command(suture::CommandKind::kPause);
        return good_ns;
      },
      [&] { commands.command(suture::CommandKind::kResume); }));
  {
    std::optional<testing::RawDevice> rival;
    keep(bench.measure(
        "another device wants the tool", render, suture_v1_FAULT_TOOL_IN_USE, none,
        [&] {
          rival.emplace(bench.session(), "probe");
          return now();
        },
        [&] { rival.reset(); }));
  }
  const suture::ForceState silent = suture::ForceState::kServerSilent;
  keep(bench.measure(
      "server stalled (SIGSTOP)", render, suture_v1_FAULT_MODEL_STALE, silent,
      [&] {
        const std::int64_t good_ns = now();
        bench.server().send(SIGSTOP);
        return good_ns;
      },
      [&] { bench.server().send(SIGCONT); }));
  keep(bench.measure(
      "server killed (SIGKILL), next one", render, suture_v1_FAULT_MODEL_STALE, silent,
      [&] {
        const std::int64_t good_ns = now();
        bench.server().send(SIGKILL);
        return good_ns;
      },
      [&] { bench.start_server(); }));
  keep(measure_killed_device(bench, render));
  if (render == Render::kServer) keep(measure_order(bench));
  return results;
}

// ------------------------------------------------------------------ what is written

std::string cell(std::optional<double> value, const char* none) {
  if (!value) return none;
  char text[32];
  std::snprintf(text, sizeof text, "%.0f", *value);
  return text;
}

void write_table(const std::string& path, const std::vector<Result>& results,
                 const std::string& commit) {
  std::ofstream file(path);
  char limits[160];
  std::snprintf(limits, sizeof limits, "%g N and %g N/s", kBlock.max_force_n,
                kBlock.max_force_slew_n_per_s);
  file << "# Faults, injected\n\n"
       << "`make faults` writes this page and its plot: real servers, real devices of the SDK in "
          "both render modes, DDS between\nprocesses. A probe presses a block of tissue and is "
          "held still, so that every change of force is the fault's; what\nthe hand feels is "
          "recorded at the device, 1000 times a second, after the SDK (of a killed device, at "
          "the server).\n\n"
       << "Preset `" SUTURED_PRESET "`, commit " << commit << ", limits " << limits
       << ". Promise: zero within 50 ms of the last good sample, no change\nfaster than the "
          "slew limit. Times are those of a shared machine, and hold its hiccups.\n\n"
       << "- *seen*: until the device or the event stream says what it is, after the last good "
          "sample\n- *zero*: until the force is gone; “stays” where the fault is dropped and "
          "counted, and the force is not touched\n- *slew*: steepest change of force over any "
          "4 ms, of the whole record\n- *back*: from the fault's end to the whole force\n\n"
       << "| Fault | Rendered by | Seen, ms | Zero, ms | Largest step, N in 1 ms | Slew, N/s | "
          "Back, ms |\n|---|---|---|---|---|---|---|\n";
  for (const Result& result : results) {
    char step[64];
    std::snprintf(step, sizeof step, "%.3f | %.0f", result.largest_step_n,
                  result.largest_slew_n_per_s);
    file << "| " << result.fault << " | " << result.mode << " | " << cell(result.seen_ms, "–")
         << " | " << cell(result.zero_ms, "stays") << " | " << step << " | "
         << (result.zero_ms ? cell(result.recovered_ms, "no") : "–") << " |\n";
  }
  file << "\n![Force at the hand around each fault](../images/faults.png)\n\n"
       << "Other faults last 200 ms, the slow step 250: its *back* holds the 50.\n";
}

void write_curves(const std::string& path, const std::vector<Result>& results) {
  std::ofstream file(path);
  file << "fault,mode,time_ms,force_n\n";
  for (const Result& result : results)
    for (const auto& [time_ms, force_n] : result.curve) {
      if (time_ms < -30.0 || time_ms > 700.0) continue;
      char line[64];
      std::snprintf(line, sizeof line, "%.2f,%.5f\n", time_ms, force_n);
      file << '"' << result.fault << "\"," << result.mode << ',' << line;
    }
}

/// A promise of docs/results/faults.md that was not kept; "" for none.
std::string broken(const Result& result) {
  constexpr double kRounding = 1.0 + 1e-6;
  const auto told = [](const char* format, double value) {
    char text[80];
    std::snprintf(text, sizeof text, format, value);
    return std::string(text);
  };
  if (!(result.largest_n <= kBlock.max_force_n * kRounding))
    return told("a force of %.4f N is beyond the limit", result.largest_n);
  if (!(result.over_slew <= kRounding))
    return told("the force changes %.2f times as fast as the slew limit allows", result.over_slew);
  if (result.zero_ms && *result.zero_ms > 50.0) return "zero too late";
  if (result.zero_ms && !result.recovered_ms) return "did not come back";
  if (!result.seen_ms) return "not seen";
  return "";
}

}  // namespace
}  // namespace sutured::faults

int main(int argc, char** argv) {
  using namespace sutured::faults;
  CLI::App app("Injects every fault into servers and devices over DDS and tells what a hand felt");
  std::string table = "faults.md", curves = "faults.csv", commit = "unknown", scene, holds;
  suture::ParticipantOptions session;
  app.add_option("--table", table, "Markdown file to write");
  app.add_option("--curves", curves, "CSV file to write: force over time");
  app.add_option("--commit", commit, "What was built, for the record");
  app.add_option("--serve", scene, "Be a server whose steps SIGUSR1 slows down instead");
  app.add_option("--hold", holds, "Be a device instead: server or device");
  app.add_option("--domain", session.domain, "Of the server or the device");
  app.add_option("--session", session.session, "Of the server or the device");
  CLI11_PARSE(app, argc, argv);
  try {
    if (!scene.empty()) serve(scene, session);
    if (!holds.empty()) hold(session, holds == "device" ? Render::kDevice : Render::kServer);
    // Both modes of a fault beside each other; those that only one has, at the end.
    const std::vector<Result> server = measure_all(Render::kServer);
    std::vector<Result> device = measure_all(Render::kDevice);
    std::vector<Result> results;
    for (const Result& result : server) {
      results.push_back(result);
      const auto twin = std::find_if(device.begin(), device.end(), [&](const Result& other) {
        return other.fault == result.fault;
      });
      if (twin != device.end()) results.push_back(*twin);
    }
    write_table(table, results, commit);
    write_curves(curves, results);
    int failures = 0;
    for (const Result& result : results) {
      const std::string what = broken(result);
      if (what.empty()) continue;
      std::printf("PROMISE BROKEN  %s, %s: %s\n", result.fault.c_str(), result.mode.c_str(),
                  what.c_str());
      ++failures;
    }
    return failures == 0 ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sutured_faults: %s\n", error.what());
    return 1;
  }
}
