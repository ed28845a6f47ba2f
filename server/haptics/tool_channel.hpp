// SPDX-License-Identifier: GPL-3.0-or-later
// Everything about one tool's force: who may move it, what it feels, and that no fault of
// a device, a network or a simulation reaches the hand as more than a smooth end of force.
//
//        receive thread: on_pose ─┐                          ┌─▶ ToolForce
//                                 ├─ token ─▶ serve, render ─┤
//     supervisor 1 kHz: supervise ┘      ▲            │      └─▶ pose for the simulation
//                                        │            ▼
//                                 models (snapshot)   report (snapshot)
//
// Who owns the force: whoever holds the token, an atomic flag taken by exchange and held
// for the microseconds of one tick. The receive thread takes it for each pose. The
// supervisor leaves a tool alone whose last pose is younger than 3 ms and serves it from
// then on, until the next pose. Neither waits for the token: a pose that comes during a
// tick of the supervisor is put aside, and served by whoever is free first.
//
// What the force does (`Stage`):
//
//     kIdle ──first pose──▶ kSettling ──20 ms of good poses──▶ kRendering
//       ▲                       ▲       and a model of them        │ fault, clutch,
//       └──lease ended──────────┴───force is zero── kFading ◀──────┘ stop, pause
//
// kRendering: gain rises to 1 within 200 ms. Its ceiling falls linearly to zero as the
// last good pose or model ages; that alone changes no stage until it reaches zero.
// kFading: the tool's pose is frozen and the gain falls to zero within 30 ms.
// kSettling: zero force. Poses move the tool again, unless clutched.
//
// A hand moves on while its tool stands still: in a fade, a clutch or a pause, or while its poses
// are lost or refused. The tool does not follow to where the hand is then, through tissue and
// against other hands, but stays, and the device engages anew with an offset. Poses in the world's
// frame say where the tool is, and have none.
//
// A device may render the models itself. The channel then serves it all the same, so that
// either side can take over at any time, but reports what the device says that it showed.
//
// Times are arguments (monotonic nanoseconds): nothing here reads a clock.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <optional>

#include "haptics/pose_board.hpp"
#include "haptics/workspace.hpp"
#include "protocol/energy_observer.hpp"
#include "protocol/force_shaping.hpp"
#include "protocol/haptic_model.hpp"
#include "protocol/snapshot.hpp"

namespace sutured::scene {
struct Tool;
}

namespace sutured::haptics {

inline constexpr std::int64_t kMillisecond_ns = 1'000'000;

inline constexpr std::int64_t kTakeover_ns = 3 * kMillisecond_ns;
inline constexpr std::int64_t kBlend_ns = 4 * kMillisecond_ns;  ///< of a swap of models
inline constexpr std::int64_t kFade_ns = 30 * kMillisecond_ns;  ///< of a fault, a change of world
inline constexpr std::int64_t kRecovery_ns = 200 * kMillisecond_ns;  ///< zero to full gain
inline constexpr std::int64_t kSettle_ns = 20 * kMillisecond_ns;     ///< of good poses
inline constexpr std::int64_t kLeaseSilence_ns = 2'000 * kMillisecond_ns;
inline constexpr std::int64_t kPosePeriodMin_ns = 250'000;  ///< 4 kHz; the rest is dropped

/// What can go wrong, in the order of the FAULT_* bits of the wire.
enum class Fault : std::uint8_t {
  kPoseStale,
  kPoseNotFinite,
  kPoseQuaternion,
  kPoseJump,
  kPoseRate,
  kPoseOrder,
  kPoseJaw,
  kModelStale,
  kModelNotFinite,
  kModelPivots,
  kForceLimit,
  kSlewLimit,
  kEnergy,
  kStopped,
  kToolInUse,
};
inline constexpr int kFaultCount = 15;

[[nodiscard]] constexpr std::uint32_t fault_bit(Fault fault) noexcept {
  return 1U << static_cast<unsigned>(fault);
}

enum class Frame : std::uint8_t { kDevice, kWorld };

/// One pose as it arrived.
struct PoseSample {
  std::uint64_t writer = 0;  ///< who sent it, unique in this process and never 0
  std::uint64_t sequence = 0;
  std::int64_t stamp_ns = 0;  ///< the device's clock, echoed and not trusted
  suture::Pose pose;          ///< in `frame`
  double jaw = 0.0;
  std::uint32_t buttons = 0;
  Frame frame = Frame::kDevice;
  bool goodbye = false;         ///< the device gives its lease back
  bool stop = false;            ///< emergency stop at the device
  bool renders_itself = false;  ///< the hand feels what the device evaluates, not our answer
};

/// What a device that renders itself says that the hand felt.
struct RenderedSample {
  std::uint64_t model_sequence = 0;
  std::uint32_t faults = 0;  ///< as the device saw them
  suture::Wrench wrench;     ///< in the frame and scale of its poses
};

/// What a device can do, told by itself. Not positive: it does not say.
struct DeviceLimits {
  suture::ForceLimits force{0.0, 0.0, 0.0, 0.0};
  double max_stiffness_n_per_m = 0.0;  ///< at the hand
  double max_damping_n_s_per_m = 0.0;  ///< likewise
  bool pointer = false;                ///< a mouse or the like: poses come seldom
};

/// How a tool's force stands; as on the wire.
enum class ToolState : std::uint8_t {
  kIdle,
  kRendering,
  kRamping,
  kClutched,
  kFault,
  kStopped,
  kPaused,
};

/// One force as it goes to the device that holds the lease.
struct ForceSample {
  std::uint64_t writer = 0;
  std::uint64_t epoch = 0;
  std::uint64_t sequence = 0;  ///< counts up by one a force
  std::int64_t time_ns = 0;    ///< of the tick, monotonic
  std::uint64_t pose_sequence = 0;
  std::int64_t pose_stamp_ns = 0;
  std::uint64_t model_sequence = 0;
  std::int64_t model_age_ns = -1;  ///< since it was published; negative: there is none
  Frame frame = Frame::kDevice;
  ToolState state = ToolState::kIdle;
  std::uint32_t faults = 0;
  bool touching = false;
  bool holding = false;
  bool engaged = false;
  bool from_supervisor = false;  ///< true: not an answer to a new pose
  bool renders_itself = false;   ///< echo: the models hold for the device
  suture::Wrench wrench;         ///< in `frame`; scaled where that is the device's
};

/// Where the simulation shall take the tool.
struct ToolTarget {
  bool present = false;
  suture::Pose pose;  ///< world
  double jaw = 0.0;
  std::uint64_t pose_sequence = 0;
  std::uint64_t writer = 0;
  Frame frame = Frame::kDevice;  ///< of the poses; in the world nothing is scaled
  Workspace mapping;             ///< in force
  std::uint64_t epoch = 0;       ///< of the model that the hand had when it moved the tool there
};

/// Where a tool stays until its hand comes: the world was replaced by one in which it is there.
struct ToolPlace {
  suture::Pose pose;  ///< world
  double jaw = 0.0;
};

/// How a tool stands, for everyone who only looks.
struct ToolReport {
  ToolState state = ToolState::kIdle;
  std::uint32_t faults = 0;
  std::uint64_t writer = 0;
  suture::Pose pose;  ///< world
  double jaw = 0.0;
  suture::Wrench wrench;  ///< world, before scaling
  double gain = 0.0;
  bool touching = false;
  bool engaged = false;
  bool renders_itself = false;      ///< and says so: the next three are the device's figures
  double shown_force_n = 0.0;       ///< magnitude at the hand
  double peak_force_n = 0.0;        ///< of the same, since construction
  double energy_to_hand_j = 0.0;    ///< since the engagement began, less what the hand put in
  double energy_debt_peak_j = 0.0;  ///< largest EnergyObserver::debt_j since construction
};

/// Counts since construction. Each only grows; a reader that finds one larger than
/// before has an event to tell.
struct ToolCounters {
  std::array<std::atomic<std::uint64_t>, kFaultCount> faults{};
  std::atomic<std::uint64_t> poses{0};
  std::atomic<std::uint64_t> poses_lost{0};     ///< gaps in the sequence
  std::atomic<std::uint64_t> poses_dropped{0};  ///< refused, too many, or out of order
  std::atomic<std::uint64_t> forces{0};
  std::atomic<std::uint64_t> takeovers{0};
  std::atomic<std::uint64_t> leases{0};
  std::atomic<std::uint64_t> returns{0};  ///< of a lease
  std::atomic<std::uint64_t> recoveries{0};

  [[nodiscard]] std::uint64_t of(Fault fault) const noexcept {
    return faults[static_cast<unsigned>(fault)].load(std::memory_order_relaxed);
  }
};

/// Returns how long a model of this step period may stay without a successor before the
/// force fades: three periods, between 20 and 38 ms, so that there is time left for a
/// ramp that ends before 50 ms.
[[nodiscard]] constexpr std::int64_t model_stale_after_ns(std::int64_t period_ns) noexcept {
  const std::int64_t three = 3 * period_ns;
  return three < 20 * kMillisecond_ns   ? 20 * kMillisecond_ns
         : three > 38 * kMillisecond_ns ? 38 * kMillisecond_ns
                                        : three;
}

/// Serves one tool. See the head of this file.
///
/// Threads: `on_pose` the receive thread, `supervise` the supervisor, `publish_model` and
/// `target` the simulation, `report` one thread that looks; the rest any. All of it is
/// noexcept, and allocates, locks and waits for nothing.
class ToolChannel {
 public:
  /// `model_period_ns` is the simulation's. Limits that the slew could not end in time
  /// are lowered: `limits()` says what stands.
  ToolChannel(const scene::Tool& tool, std::int64_t model_period_ns);

  /// Tells the other tools of `board` where this one, its `tool`, is, and feels them through its
  /// models. Call before any thread starts; the board outlives the channel.
  void join(PoseBoard& board, std::size_t tool) noexcept {
    board_ = &board;
    tool_ = tool;
  }

  /// Takes a pose and returns the force that answers it; none where the pose is not
  /// ours to answer (another's lease, too early, out of order) or another thread will.
  std::optional<ForceSample> on_pose(const PoseSample& sample, std::int64_t now_ns) noexcept;

  /// The supervisor's tick: returns a force where the device's poses do not ask for one.
  std::optional<ForceSample> supervise(std::int64_t now_ns) noexcept;

  /// Makes `model`, stepped from the targets that `target` gave at `taken_ns`, the one in
  /// force. One that is not sound (suture::is_sound) is counted and refused: false.
  ///
  /// With `place`, the first model of an epoch puts the tool there: as after a clutch the device
  /// engages with an offset, at zero force, and its jaw counts once it is as far closed. A device
  /// whose poses are in the world has no offset: its tool jumps to the hand.
  bool publish_model(const suture::HapticModel& model, std::int64_t taken_ns, std::int64_t now_ns,
                     const std::optional<ToolPlace>& place = std::nullopt) noexcept;
  /// Returns the newest target.
  const ToolTarget& target() noexcept;
  /// Returns the newest report.
  const ToolReport& report() noexcept;

  /// Returns the largest age that a rendered model had since the last call.
  std::int64_t take_model_age_max_ns() noexcept {
    return model_age_max_ns_.exchange(0, std::memory_order_relaxed);
  }

  /// Takes what a device that renders itself showed. Receive thread; the caller has seen to it
  /// that it comes from the lease's holder.
  void on_rendered(const RenderedSample& sample, std::int64_t now_ns) noexcept;

  /// Makes the limits of the device that holds the lease hold beside the scene's: the smaller
  /// one of each, from the next tick and model on. {} for a device that told none. Any one
  /// thread.
  void set_device_limits(const DeviceLimits& device) noexcept;

  /// Ends the lease if `writer` holds it: it left.
  void end_lease(std::uint64_t writer) noexcept;
  /// Takes the tool from whoever holds it. That device gets it back once its jaw has opened (was
  /// closed and is open), or when it has been silent for as long as ends a lease; any other
  /// device may have it at once. False where nobody holds it.
  bool release() noexcept;
  /// Returns who holds the lease, 0 for nobody.
  [[nodiscard]] std::uint64_t lease() const noexcept {
    return lease_.load(std::memory_order_acquire);
  }
  /// Zero force until `set_stopped(false)`; wins over everything.
  void set_stopped(bool stopped) noexcept { stopped_.store(stopped, std::memory_order_release); }
  [[nodiscard]] bool stopped() const noexcept { return stopped_.load(std::memory_order_acquire); }
  /// Returns whether the last force sent was zero.
  [[nodiscard]] bool silent() const noexcept { return silent_.load(std::memory_order_acquire); }
  /// Zero force while the simulation stands still.
  void set_paused(bool paused) noexcept { paused_.store(paused, std::memory_order_release); }

  [[nodiscard]] const ToolCounters& counters() const noexcept { return counters_; }
  /// Returns what a force keeps to now: the scene's limits and the device's. Any thread.
  [[nodiscard]] suture::ForceLimits limits() const noexcept;
  /// Returns how stiff models may be at the hand (N/m); 0: the device sets no limit.
  [[nodiscard]] double max_stiffness_n_per_m() const noexcept {
    return max_stiffness_n_per_m_.load(std::memory_order_relaxed);
  }
  /// Returns how strongly models may damp the hand (N s/m); 0: the device sets no limit.
  [[nodiscard]] double max_damping_n_s_per_m() const noexcept {
    return max_damping_n_s_per_m_.load(std::memory_order_relaxed);
  }
  /// Returns how old a pose may be before the force fades: the scene's time, and longer for
  /// a pointer. Any thread.
  [[nodiscard]] std::int64_t pose_stale_after_ns() const noexcept;

 private:
  enum class Stage : std::uint8_t { kIdle, kSettling, kRendering, kFading };
  struct StampedModel {
    suture::HapticModel model;
    std::int64_t taken_ns = 0;
    std::int64_t published_ns = 0;
    std::optional<ToolPlace> place;
  };

  bool try_hold() noexcept { return !held_.exchange(true, std::memory_order_seq_cst); }
  void let_go() noexcept { held_.store(false, std::memory_order_seq_cst); }

  [[nodiscard]] std::int64_t pose_zero_after_ns() const noexcept;

  // Receive thread only.
  bool admit(const PoseSample& sample, std::int64_t now_ns) noexcept;
  bool stays_released(const PoseSample& sample, std::int64_t now_ns) noexcept;

  // Holder of the token only.
  ForceSample serve(const PoseSample& sample, std::int64_t now_ns) noexcept;
  std::optional<ForceSample> serve_pending(std::int64_t now_ns) noexcept;
  std::optional<Fault> fault_of(const PoseSample& sample, std::int64_t now_ns) const noexcept;
  void accept(const PoseSample& sample, std::int64_t now_ns) noexcept;
  void stay_where_placed() noexcept;
  void begin_fading(std::int64_t now_ns) noexcept;
  void leave_or_stay(std::int64_t now_ns) noexcept;
  ForceSample render(std::int64_t now_ns, bool from_supervisor) noexcept;
  suture::Wrench model_wrench(std::int64_t now_ns) noexcept;
  suture::Wrench wanted(const suture::Wrench& world, double gain, bool& limited) const noexcept;
  void look_for_staleness(std::int64_t now_ns) noexcept;
  suture::Wrench evaluate_model(std::int64_t now_ns) noexcept;
  double ceiling(std::int64_t now_ns) noexcept;
  void observe_energy(const suture::Wrench& world, const suture::Wrench& shown, std::int64_t now_ns,
                      std::int64_t elapsed_ns) noexcept;
  void note(Fault fault) noexcept;
  void note_while(Fault fault, bool present) noexcept;
  void publish_target() noexcept;
  ToolState state() const noexcept;

  // Fixed at construction.
  suture::ForceLimits scene_limits_;
  std::int64_t pose_stale_after_ns_;
  std::int64_t model_stale_after_ns_, model_zero_after_ns_;
  double max_speed_m_per_s_;
  std::uint32_t clutch_mask_;
  double hand_over_tool_stiffness_;  // in the device's frame: force_scale × motion_scale
  PoseBoard* board_ = nullptr;
  std::size_t tool_ = 0;  // on the board

  // Shared.
  std::atomic<bool> held_{false};
  std::atomic<bool> stopped_{false}, paused_{false}, silent_{true};
  std::atomic<std::uint64_t> lease_{0};
  std::atomic<std::uint64_t> released_{0};  // the writer that was told to let go
  std::atomic<std::int64_t> last_arrival_ns_{0};
  std::atomic<std::int64_t> model_age_max_ns_{0};
  // Each by itself: a tick may see one changed and the next not yet; slew takes what steps.
  std::atomic<double> max_force_n_, max_torque_nm_, max_force_slew_n_per_s_,
      max_torque_slew_nm_per_s_, max_stiffness_n_per_m_{0.0}, max_damping_n_s_per_m_{0.0};
  std::atomic<bool> pointer_{false};
  ToolCounters counters_;
  struct Arrival {
    PoseSample sample;
    std::int64_t arrived_ns = 0;
  };
  suture::Snapshot<Arrival> pending_;      // receive thread → holder
  suture::Snapshot<StampedModel> models_;  // simulation → holder
  suture::Snapshot<ToolTarget> targets_;   // holder → simulation
  suture::Snapshot<ToolReport> reports_;   // holder → whoever looks
  struct Rendered {
    RenderedSample sample;
    std::int64_t arrived_ns = 0;
  };
  suture::Snapshot<Rendered> rendered_;  // receive thread → holder

  // Receive thread only.
  std::uint64_t admitted_writer_ = 0, admitted_sequence_ = 0;
  std::int64_t due_ns_ = 0;
  bool was_refused_ = false;
  std::uint64_t released_heard_ = 0;    // the writer of the device that was told to let go,
  bool released_jaw_closed_ = false;    // whether its jaw was closed since,
  std::int64_t released_heard_ns_ = 0;  // and when it last sent a pose
  std::uint32_t rendered_faults_ = 0;   // the device's last
  bool rendered_in_pause_ = false;      // it has had no model since a pause

  // Holder of the token only.
  Workspace workspace_;
  suture::ModelEvaluator evaluator_;
  suture::SwapBlend blend_;
  suture::RampedGain gain_{kRecovery_ns};
  suture::EnergyObserver energy_;
  bool renders_itself_ = false;
  Stage stage_ = Stage::kIdle;
  std::uint64_t writer_ = 0;  // of the engagement
  std::uint64_t served_sequence_ = 0;
  std::int64_t pose_stamp_ns_ = 0;
  Frame frame_ = Frame::kDevice;
  suture::Pose pose_;         // world, in force
  suture::Pose device_pose_;  // last good one, as sent
  double jaw_ = 0.0;
  bool has_previous_ = false;  // device_pose_ and good_ns_ are of this engagement
  bool clutched_ = false;
  bool apart_ = false;              // hand and tool: the next pose that moves it sets an offset
  bool jaw_waits_ = false;          // jaw_ is that of a place, until the hand's is on the same side
  bool supervised_ = false;         // the last tick was the supervisor's
  std::int64_t good_ns_ = 0;        // when the last good pose came
  std::int64_t good_since_ns_ = 0;  // when the run of good poses began
  std::int64_t paused_ns_ = 0;      // the last tick within a pause
  std::int64_t fade_since_ns_ = 0;
  std::int64_t rendered_ns_ = 0;
  std::uint64_t epoch_ = 0;
  bool has_model_ = false;
  struct OldWorld {
    suture::Wrench world;  // of its model
    suture::Wrench shown;  // at the hand
    double gain = 1.0;     // of it
  };
  std::optional<OldWorld> old_world_;  // what fades, of a world that is gone
  suture::LastingCondition pose_stale_{kRecovery_ns}, model_stale_{kRecovery_ns};
  std::uint32_t latched_ = 0;  // faults since the last recovery
  std::uint32_t ongoing_ = 0;  // conditions that hold now
  std::uint64_t sequence_ = 0;
  std::uint64_t last_fallbacks_ = 0;
  suture::Wrench last_;  // at the hand
  double peak_force_n_ = 0.0;
};

}  // namespace sutured::haptics
