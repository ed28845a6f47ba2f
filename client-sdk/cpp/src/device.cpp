// SPDX-License-Identifier: Apache-2.0
#include "suture/device.hpp"

#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <ctime>
#include <mutex>

#include "convert.hpp"
#include "force_guard.hpp"
#include "model_renderer.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/latency_histogram.hpp"
#include "protocol/rendezvous.hpp"
#include "protocol/snapshot.hpp"

namespace suture {
namespace {

using Clock = std::chrono::steady_clock;
constexpr int kTickPriority = 60;  // below the receive thread, which feeds it
constexpr std::int64_t kSecondNs = 1'000'000'000;
// Two forces within the limits differ by twice the largest at most: long enough to fade that.
constexpr std::int64_t kHandoverNs = 60'000'000;
// Longer than a tick is ever late: a device that asked for no force since has stopped, and let go.
constexpr std::int64_t kRestNs = 500'000'000;
constexpr std::int64_t kHandStaleNs = 15'000'000;    // where a server does not say
constexpr std::int64_t kRenderedPeriodNs = 950'000;  // at most 1 kHz, with room for jitter

/// A force and when it arrived; 0: none did.
struct Arrival {
  Force force;
  std::int64_t at_ns = 0;  // monotonic
};

/// Makes the present thread SCHED_FIFO where that is permitted, and undoes it.
class RealtimeScope {
 public:
  explicit RealtimeScope(int priority) noexcept {
    if (pthread_getschedparam(pthread_self(), &policy_, &parameters_) != 0) return;
    sched_param wanted{};
    wanted.sched_priority = priority;
    changed_ = pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted) == 0;
  }
  ~RealtimeScope() {
    if (changed_) pthread_setschedparam(pthread_self(), policy_, &parameters_);
  }
  RealtimeScope(const RealtimeScope&) = delete;
  RealtimeScope& operator=(const RealtimeScope&) = delete;

 private:
  int policy_ = 0;
  sched_param parameters_{};
  bool changed_ = false;
};

/// Wakes whoever waits for a force; costs a waker nothing while nobody waits.
class Doorbell {
 public:
  Doorbell() : fd_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
    if (fd_ < 0) {
      throw Error(ErrorCode::kNetwork, "no file descriptor left", "raise `ulimit -n`");
    }
  }
  ~Doorbell() { ::close(fd_); }
  Doorbell(const Doorbell&) = delete;
  Doorbell& operator=(const Doorbell&) = delete;

  void ring() noexcept {
    if (!awaited_.load(std::memory_order_seq_cst)) return;
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = ::write(fd_, &one, sizeof one);
  }
  /// Waits until `ready()` holds or `end` has come; says which.
  template <class Ready>
  bool wait(Ready&& ready, Clock::time_point end) noexcept {
    awaited_.store(true, std::memory_order_seq_cst);
    bool done = ready();
    while (!done) {
      const auto left = std::chrono::duration_cast<std::chrono::nanoseconds>(end - Clock::now());
      if (left.count() <= 0) break;
      pollfd waiting{fd_, POLLIN, 0};
      const timespec timeout{static_cast<time_t>(left.count() / kSecondNs),
                             static_cast<long>(left.count() % kSecondNs)};
      if (ppoll(&waiting, 1, &timeout, nullptr) > 0) {
        std::uint64_t count = 0;
        [[maybe_unused]] const ssize_t got = ::read(fd_, &count, sizeof count);
      }
      done = ready();
    }
    awaited_.store(false, std::memory_order_relaxed);
    return done;
  }

 private:
  int fd_;
  std::atomic<bool> awaited_{false};
};

Force to_force(const v1::ToolForce& wire, std::int64_t wall_ns) noexcept {
  Force force;
  force.force_n = array_of(wire.force_n);
  force.torque_nm = array_of(wire.torque_nm);
  force.state = force_state(wire.state);
  force.faults = wire.faults;
  force.touching = (wire.flags & suture_v1_FORCE_TOUCHING) != 0;
  force.holding = (wire.flags & suture_v1_FORCE_HOLDING) != 0;
  force.engaged = (wire.flags & suture_v1_FORCE_ENGAGED) != 0;
  force.sequence = wire.sequence_number;
  force.hand_sequence = wire.pose_sequence;
  force.hand_stamp_ns = wire.pose_stamp_ns;
  force.round_trip_ns = wall_ns - wire.pose_stamp_ns;
  force.model_age_us = wire.model_age_us;
  return force;
}

double norm(const Vector3& v) noexcept {
  return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

}  // namespace

struct Device::State {
  explicit State(DeviceOptions chosen)
      : options(std::move(chosen)),
        id(tool_id(options.tool)),
        participant({.domain = options.domain,
                     .session = options.session,
                     .security = options.security,
                     .tool = options.tool,
                     .network = options.network},
                    Channel::kControl),
        guard(std::chrono::nanoseconds(options.silent_after).count()) {}

  void connect();
  void tell_profile(double rate_hz);
  void listen_to_models();
  [[nodiscard]] Force feel(const Hand& from, std::int64_t taken_ns, std::int64_t now_ns) noexcept;
  [[nodiscard]] Force shown(const Force& answer, const Hand& from, std::int64_t taken_ns,
                            std::int64_t now_ns) noexcept;
  [[nodiscard]] Force handed_over(const Force& force, std::int64_t now_ns) noexcept;
  void tell_rendered(const Force& force, std::int64_t now_ns) noexcept;
  void receive() noexcept;         // receive thread
  void receive_models() noexcept;  // receive thread
  void receive_poses() noexcept;   // receive thread: of other tools
  /// Counts a force; returns false for one that a newer force has overtaken on its way, to be
  /// dropped.
  bool account(const Force& force) noexcept;  // receive thread
  [[nodiscard]] std::string incompatible_policy() {
    const std::lock_guard lock(policy_mutex);
    return policy;
  }

  DeviceOptions options;
  std::uint64_t id;
  Participant participant;
  ServerInfo server;
  double max_force_n = 0.0;
  ForceLimits limits;  // the tool's and the device's

  // The receive thread's.
  std::atomic<bool> ready{false};         // writer and reader stand
  std::atomic<bool> models_ready{false};  // and that of the models
  std::uint64_t last_hand_sequence = 0;
  std::uint64_t last_force_sequence = 0;
  std::atomic<std::uint64_t> received{0}, last_answered{0}, repeated{0}, out_of_order{0};
  std::atomic<double> peak_force_n{0.0};
  LatencyHistogram round_trips;

  // From it to the caller's thread.
  Snapshot<Arrival> arrivals;
  std::atomic<std::uint64_t> epoch{0};
  std::atomic<std::int64_t> foreign_ns{0};  // last force for another device of this tool
  Doorbell doorbell;

  // The caller's.
  ForceGuard guard;
  std::unique_ptr<ModelRenderer> renderer;  // once the device has rendered; 150 kB
  Render wanted = Render::kServer, shown_by = Render::kServer;
  Force last;                // handed out
  std::int64_t last_ns = 0;  // when
  SwapBlend handover;        // from one renderer to the other
  bool handing_over = false;
  std::int64_t stop_since_ns = 0;  // the last call without a stop
  std::int64_t rendered_told_ns = 0;
  v1::ToolRendered rendered{};
  bool stop_asked = false;   // by a hand, and not yet confirmed by the server
  Hand hand;                 // last written
  std::int64_t hand_ns = 0;  // when
  v1::ToolPose pose{};
  std::atomic<bool> stopping{false};

  std::mutex policy_mutex;
  std::string policy;

  // Last: destroyed first, so that no callback outlives what it uses.
  Writer<v1::ToolPose> writer;
  Writer<v1::DeviceProfile> profile_writer;
  std::uint64_t profiles_told = 0;
  Writer<v1::ToolRendered> rendered_writer;
  Reader<v1::ToolForce> reader;
  Reader<v1::HapticModel> model_reader;
  Reader<v1::ToolPose> pose_reader;
};

void Device::State::connect() {
  const Clock::time_point end = Clock::now() + options.timeout;
  const auto left = [&] {
    return std::max<std::chrono::nanoseconds>(end - Clock::now(), std::chrono::milliseconds(1));
  };
  // A device that has just left may still stand in the last status: wait for the next.
  server = await_server(participant, left(), [&](const ServerInfo& info) {
    const ServerTool* tool = info.tool(options.tool);
    return tool == nullptr || !tool->leased;
  });
  const ServerTool* tool = server.tool(options.tool);
  if (tool == nullptr) {
    std::string known;
    for (const ServerTool& other : server.tools) known += (known.empty() ? "" : ", ") + other.name;
    throw Error(ErrorCode::kUnknownTool,
                "the scene \"" + server.scene + "\" has no tool \"" + options.tool + "\"",
                known.empty() ? "add it to the scene file" : "it has " + known);
  }
  if (tool->leased) {
    throw Error(ErrorCode::kToolInUse,
                "the tool \"" + options.tool + "\" is held by another device",
                "end that device first, or take another tool");
  }
  max_force_n = tool->limits.max_force_n;
  // A server that tells none leaves those of the device. A force that cannot end within a fade must
  // not begin.
  constexpr double kNone = 1e9;
  limits = stoppable_within(smaller_of(smaller_of({kNone, kNone, kNone, kNone}, tool->limits),
                                       {options.limits.max_force_n, options.limits.max_torque_nm,
                                        options.limits.max_force_slew_n_per_s, 0.0}),
                            ForceGuard::kFadeNs);
  epoch = server.epoch;

  const auto note_policy = [this](const std::string& name) {
    const std::lock_guard lock(policy_mutex);
    policy = name;
  };
  EndpointCallbacks from_writer;
  from_writer.matched = [this](int) { doorbell.ring(); };
  from_writer.incompatible_qos = note_policy;
  writer = Writer<v1::ToolPose>(participant, std::move(from_writer));
  EndpointCallbacks from_reader;
  from_reader.data_available = [this] { receive(); };
  from_reader.matched = [this](int) { doorbell.ring(); };
  from_reader.incompatible_qos = note_policy;
  reader = Reader<v1::ToolForce>(participant, std::move(from_reader));
  profile_writer = Writer<v1::DeviceProfile>(participant);
  tell_profile(0.0);  // not known before `run`
  if (options.render == Render::kDevice) listen_to_models();
  wanted = shown_by = options.render;
  ready.store(true, std::memory_order_release);

  if (!doorbell.wait([&] { return writer.matched() > 0 && reader.matched() > 0; }, end)) {
    const std::string wrong = incompatible_policy();
    if (!wrong.empty()) {
      throw Error(ErrorCode::kIncompatibleQos,
                  "the server and this client disagree on the QoS policy \"" + wrong + "\"",
                  "use versions of sutured and this SDK that belong together");
    }
    throw Error(ErrorCode::kNoServer,
                "the server's status was heard, but it does not take part in poses and forces",
                "see the server's log; with DDS Security, check this device's permissions");
  }
}

// First before any pose, so that it is there when the lease begins; once more by `run`, which knows
// the rate.
void Device::State::tell_profile(double rate_hz) {
  v1::DeviceProfile profile{};
  set_text(profile.tool, options.tool);
  profile.epoch = epoch.load(std::memory_order_relaxed);
  profile.sequence_number = ++profiles_told;
  profile.stamp_ns = wall_clock_ns();
  set_guid(profile.device, writer.guid());
  set_text(profile.model, options.model);
  profile.rate_hz = rate_hz;
  profile.max_force_n = options.limits.max_force_n;
  profile.max_torque_nm = options.limits.max_torque_nm;
  profile.max_stiffness_n_per_m = options.limits.max_stiffness_n_per_m;
  profile.max_damping_n_s_per_m = options.limits.max_damping_n_s_per_m;
  profile.max_force_slew_n_per_s = options.limits.max_force_slew_n_per_s;
  profile_writer.write(profile);
}

void Device::State::listen_to_models() {
  if (!renderer) {
    const ServerTool* tool = server.tool(options.tool);  // there, or `connect` had thrown
    renderer = std::make_unique<ModelRenderer>(
        options.limits, options.max_speed_m_per_s,
        tool->stale_after_ms > 0.0 ? std::llround(1e6 * tool->stale_after_ms) : kHandStaleNs);
    rendered_writer = Writer<v1::ToolRendered>(participant);
    rendered.tool_id = id;
  }
  EndpointCallbacks from_models;
  from_models.data_available = [this] { receive_models(); };
  from_models.incompatible_qos = [this](const std::string& name) {
    const std::lock_guard lock(policy_mutex);
    policy = name;
  };
  EndpointCallbacks from_poses;
  from_poses.data_available = [this] { receive_poses(); };
  from_poses.incompatible_qos = from_models.incompatible_qos;
  models_ready.store(false, std::memory_order_release);
  model_reader = Reader<v1::HapticModel>(participant, std::move(from_models));
  pose_reader = Reader<v1::ToolPose>(participant, std::move(from_poses));
  models_ready.store(true, std::memory_order_release);
}

void Device::State::receive() noexcept {
  // The reader's construction may deliver forces for other devices before it is assigned.
  if (!ready.load(std::memory_order_acquire)) return;
  v1::ToolForce wire;
  SampleInfo info;
  while (reader.take(wire, info)) {
    if (!info.valid) continue;
    if (wire.tool_id != id) {
      if (models_ready.load(std::memory_order_acquire)) renderer->others().receive(wire);
      continue;
    }
    const Guid device = guid_of(wire.device);
    if (device != writer.guid()) {
      if (device != kNobody) foreign_ns.store(monotonic_ns(), std::memory_order_relaxed);
      continue;
    }
    const Force force = to_force(wire, wall_clock_ns());
    // A server that restarted or was reset counts anew.
    if (wire.epoch != epoch.load(std::memory_order_relaxed)) last_force_sequence = 0;
    epoch.store(wire.epoch, std::memory_order_relaxed);
    if (!account(force)) continue;
    arrivals.publish({force, monotonic_ns()});
    doorbell.ring();
    if (options.on_force) options.on_force(force);
  }
}

void Device::State::receive_models() noexcept {
  // As above; the models to come bring this one along.
  if (!models_ready.load(std::memory_order_acquire)) return;
  model_reader.take_each([&](const v1::HapticModel& wire, const SampleInfo& info) {
    if (!info.valid) return;
    if (text_of(wire.tool) != options.tool) {
      renderer->others().receive(wire);
      return;
    }
    if (guid_of(wire.device) == writer.guid()) renderer->receive(wire, monotonic_ns());
  });
}

void Device::State::receive_poses() noexcept {
  if (!models_ready.load(std::memory_order_acquire)) return;
  v1::ToolPose wire;
  SampleInfo info;
  while (pose_reader.take(wire, info))
    if (info.valid && wire.tool_id != id) renderer->others().receive(wire);
}

bool Device::State::account(const Force& force) noexcept {
  const auto add = [](std::atomic<std::uint64_t>& counter) {
    counter.store(counter.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
  };
  if (force.sequence < last_force_sequence) {
    add(out_of_order);
    return false;
  }
  if (force.hand_sequence > last_hand_sequence) {
    last_hand_sequence = force.hand_sequence;
    last_answered.store(last_hand_sequence, std::memory_order_relaxed);
    add(received);
    round_trips.record(force.round_trip_ns);
  } else {
    add(repeated);
  }
  last_force_sequence = force.sequence;
  const double magnitude = norm(force.force_n);
  if (magnitude > peak_force_n.load(std::memory_order_relaxed)) {
    peak_force_n.store(magnitude, std::memory_order_relaxed);
  }
  return true;
}

Device::Device(DeviceOptions options) : state_(std::make_unique<State>(std::move(options))) {
  state_->connect();
  state_->pose.tool_id = state_->id;
  state_->pose.orientation_xyzw[3] = 1.0;
}

Device::~Device() {
  if (!state_ || state_->pose.sequence_number == 0) return;
  v1::ToolPose& pose = state_->pose;
  ++pose.sequence_number;
  pose.stamp_ns = wall_clock_ns();
  pose.flags |= suture_v1_POSE_GOODBYE;
  state_->writer.write(pose);
  state_->writer.leave(pose);
}

Device::Device(Device&&) noexcept = default;
Device& Device::operator=(Device&&) noexcept = default;

void Device::run(const Tick& tick, double rate_hz) {
  if (!(rate_hz > 0.0 && rate_hz <= 4000.0)) {
    throw Error(ErrorCode::kBadInput, "a device cannot run at this rate", "take 1 to 4000 Hz");
  }
  State& state = *state_;
  state.tell_profile(rate_hz);
  const RealtimeScope realtime(kTickPriority);
  const auto period_ns = static_cast<std::int64_t>(std::llround(1e9 / rate_hz));
  const std::int64_t give_up_ns = std::chrono::nanoseconds(state.options.give_up_after).count();
  const std::int64_t begun_ns = monotonic_ns();
  std::int64_t next_ns = begun_ns;
  std::int64_t last_ns = begun_ns;
  state.stopping = false;
  while (!state.stopping) {
    const timespec wake{static_cast<time_t>(next_ns / kSecondNs),
                        static_cast<long>(next_ns % kSecondNs)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &wake, nullptr) != 0 &&
           !state.stopping) {
    }
    const std::int64_t now_ns = monotonic_ns();
    const std::optional<Hand> hand = tick(read(), std::chrono::nanoseconds(now_ns - last_ns));
    last_ns = now_ns;
    if (!hand) return;
    write(*hand);

    const std::int64_t heard_ns = std::max(state.arrivals.latest().at_ns, begun_ns);
    if (tool_in_use()) {
      throw Error(ErrorCode::kToolInUse,
                  "another device holds the tool \"" + state.options.tool + "\" by now",
                  "end that device first, or take another tool");
    }
    if (give_up_ns > 0 && now_ns - heard_ns > give_up_ns) {
      throw Error(ErrorCode::kNoServer,
                  "the server has not answered for " +
                      std::to_string(state.options.give_up_after.count()) + " ms",
                  "see whether it still runs (`suture top`)");
    }
    next_ns += period_ns;
    const std::int64_t behind_ns = monotonic_ns() - next_ns;
    if (behind_ns > 0) next_ns += (behind_ns / period_ns + 1) * period_ns;
  }
}

void Device::stop() noexcept { state_->stopping = true; }

std::uint64_t Device::write(const Hand& hand) noexcept {
  State& state = *state_;
  v1::ToolPose& pose = state.pose;
  ++pose.sequence_number;
  pose.epoch = state.epoch.load(std::memory_order_relaxed);
  std::copy(hand.position_m.begin(), hand.position_m.end(), pose.position_m);
  std::copy(hand.orientation_xyzw.begin(), hand.orientation_xyzw.end(), pose.orientation_xyzw);
  for (std::size_t i = 0; i < 3; ++i) {
    pose.linear_velocity_m_per_s[i] = static_cast<float>(hand.linear_velocity_m_per_s[i]);
    pose.angular_velocity_rad_per_s[i] = static_cast<float>(hand.angular_velocity_rad_per_s[i]);
  }
  pose.jaw = static_cast<float>(hand.jaw);
  pose.buttons = hand.buttons;
  pose.flags =
      (hand.in_world ? std::uint32_t{suture_v1_POSE_IN_WORLD} : 0U) |
      (state.shown_by == Render::kDevice ? std::uint32_t{suture_v1_POSE_RENDER_DEVICE} : 0U);
  if (hand.stop) state.stop_asked = true;
  // Poses may be lost: a stop is asked for until the server says that it holds.
  if (state.stop_asked) pose.flags |= suture_v1_POSE_STOP;
  state.hand = hand;
  state.hand_ns = monotonic_ns();
  pose.stamp_ns = wall_clock_ns();
  state.writer.write(pose);
  return pose.sequence_number;
}

void Device::set_render(Render render) {
  State& state = *state_;
  if (render == state.wanted) return;
  if (render == Render::kDevice) {
    state.listen_to_models();
  } else {
    state.model_reader = {};
    state.pose_reader = {};
  }
  state.wanted = render;
}

Render Device::renders() const noexcept { return state_->shown_by; }

Force Device::read() noexcept {
  return state_->feel(state_->hand, state_->hand_ns, monotonic_ns());
}

Force Device::feel(const Hand& hand) noexcept {
  const std::int64_t now_ns = monotonic_ns();
  return state_->feel(hand, now_ns, now_ns);
}

Force Device::State::feel(const Hand& from, std::int64_t taken_ns, std::int64_t now_ns) noexcept {
  const Arrival& newest = arrivals.latest();
  if (from.stop) stop_asked = true;
  if (newest.force.state == ForceState::kStopped && !from.stop) stop_asked = false;
  if (!stop_asked) stop_since_ns = now_ns;
  // Who asked for no force so long shows none.
  if (now_ns - last_ns > kRestNs) last = {};
  const Force answer = guard.show(newest.force, newest.at_ns, stop_asked, now_ns);
  const Force force =
      kept_within(limits, handed_over(shown(answer, from, taken_ns, now_ns), now_ns), last,
                  std::clamp<std::int64_t>(now_ns - last_ns, 0, kSlewWindowNs));
  if (shown_by == Render::kDevice) tell_rendered(force, now_ns);
  last = force;
  last_ns = now_ns;
  return force;
}

// Returns the force of whoever renders now, and changes that where it is time.
Force Device::State::shown(const Force& answer, const Hand& from, std::int64_t taken_ns,
                           std::int64_t now_ns) noexcept {
  const auto change_to = [&](Render next, const Force& theirs) {
    shown_by = next;
    handing_over = true;
    handover.swap({last.force_n, last.torque_nm}, {theirs.force_n, theirs.torque_nm}, now_ns,
                  kHandoverNs);
  };
  if (wanted == Render::kServer && shown_by == Render::kServer) return answer;
  const Force own = renderer->render(from, taken_ns, answer, stop_asked, now_ns);
  if (wanted == Render::kServer) {
    change_to(Render::kServer, answer);
    return answer;
  }
  if (shown_by == Render::kDevice) return own;
  // The server's until ours is whole, or both are zero.
  const bool both_silent = norm(answer.force_n) + norm(answer.torque_nm) == 0.0 &&
                           norm(own.force_n) + norm(own.torque_nm) == 0.0 &&
                           renderer->current().arrived_ns != 0;
  if (!renderer->whole() && !both_silent) return answer;
  change_to(Render::kDevice, own);
  return own;
}

// Takes the step out of a change of renderer: the difference fades, and under a stop as soon as any
// force.
Force Device::State::handed_over(const Force& force, std::int64_t now_ns) noexcept {
  if (!handing_over) return force;
  Wrench eased_to = handover.apply({force.force_n, force.torque_nm}, now_ns);
  const double kept = smoothstep(freshness(now_ns - stop_since_ns, 0, ForceGuard::kFadeNs));
  for (std::size_t i = 0; i < 3; ++i) {
    eased_to.force_n[i] = force.force_n[i] + kept * (eased_to.force_n[i] - force.force_n[i]);
    eased_to.torque_nm[i] =
        force.torque_nm[i] + kept * (eased_to.torque_nm[i] - force.torque_nm[i]);
  }
  handing_over = !handover.over(now_ns);
  Force result = force;
  result.force_n = eased_to.force_n;
  result.torque_nm = eased_to.torque_nm;
  return result;
}

void Device::State::tell_rendered(const Force& force, std::int64_t now_ns) noexcept {
  if (now_ns - rendered_told_ns < kRenderedPeriodNs) return;
  rendered_told_ns = now_ns;
  rendered.epoch = renderer->current().model.epoch;
  ++rendered.sequence_number;
  rendered.stamp_ns = wall_clock_ns();
  rendered.pose_sequence = pose.sequence_number;
  rendered.model_sequence = renderer->current().model.sequence;
  rendered.faults = renderer->faults();
  rendered.flags = suture_v1_FORCE_RENDER_DEVICE |
                   (hand.in_world ? std::uint32_t{suture_v1_FORCE_IN_WORLD} : 0U) |
                   (force.touching ? std::uint32_t{suture_v1_FORCE_TOUCHING} : 0U) |
                   (force.holding ? std::uint32_t{suture_v1_FORCE_HOLDING} : 0U) |
                   (force.engaged ? std::uint32_t{suture_v1_FORCE_ENGAGED} : 0U);
  std::copy(force.force_n.begin(), force.force_n.end(), rendered.force_n);
  std::copy(force.torque_nm.begin(), force.torque_nm.end(), rendered.torque_nm);
  rendered_writer.write(rendered);
}

std::optional<Force> Device::read_after(std::uint64_t sequence,
                                        std::chrono::nanoseconds timeout) noexcept {
  State& state = *state_;
  const bool there = state.doorbell.wait(
      [&] {
        const Arrival& last = state.arrivals.latest();
        return last.at_ns != 0 && last.force.hand_sequence >= sequence;
      },
      Clock::now() + timeout);
  if (!there) return std::nullopt;
  return read();
}

bool Device::tool_in_use() const noexcept {
  constexpr std::int64_t kRecentNs = 200'000'000;
  const std::int64_t now_ns = monotonic_ns();
  const std::int64_t foreign_ns = state_->foreign_ns.load(std::memory_order_relaxed);
  return foreign_ns != 0 && now_ns - foreign_ns < kRecentNs &&
         now_ns - state_->arrivals.latest().at_ns > kRecentNs;
}

double Device::max_force_n() const noexcept { return state_->max_force_n; }
const std::string& Device::scene() const noexcept { return state_->server.scene; }

DeviceStatistics Device::statistics() const {
  const State& state = *state_;
  DeviceStatistics result;
  result.hands_written = state.pose.sequence_number;
  result.forces_received = state.received;
  result.hands_unanswered = state.last_answered - result.forces_received;
  result.repeated = state.repeated;
  result.out_of_order = state.out_of_order;
  result.peak_force_n = state.peak_force_n;
  result.round_trip_p50_ns = state.round_trips.percentile_ns(0.5);
  result.round_trip_p99_ns = state.round_trips.percentile_ns(0.99);
  result.round_trip_max_ns = state.round_trips.max_ns();
  return result;
}

}  // namespace suture
