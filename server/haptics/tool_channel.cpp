// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/tool_channel.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "protocol/pose_check.hpp"
#include "protocol/virtual_coupling.hpp"
#include "scene/scene.hpp"

namespace sutured::haptics {
namespace {

constexpr double kHalfClosed = 0.5;
// A ramp ends before the promised 50 ms, so that a late tick does not break it.
constexpr std::int64_t kZeroAfterStale_ns = 30 * kMillisecond_ns;
// A mouse or a browser sends 60 to 125 poses a second, not evenly: zero by 150 ms.
constexpr std::int64_t kPointerStaleAfter_ns = 100 * kMillisecond_ns;

// A device that was held up sends what it missed at once; so many poses may come early.
constexpr std::int64_t kBurst_ns = 8 * kPosePeriodMin_ns;
// What a device renders is reported until it has been silent about it for so long.
constexpr std::int64_t kRenderedStale_ns = 100 * kMillisecond_ns;
// After a pause of the ticks themselves the force moves as if only so much time had gone.
constexpr std::int64_t kSlewWindow_ns = 4 * kMillisecond_ns;

void count(std::atomic<std::uint64_t>& counter) noexcept {
  counter.fetch_add(1, std::memory_order_relaxed);
}

double magnitude(const std::array<double, 3>& v) noexcept { return std::hypot(v[0], v[1], v[2]); }

suture::Wrench scaled(const suture::Wrench& w, double factor) noexcept {
  suture::Wrench result = w;
  for (int i = 0; i < 3; ++i) {
    result.force_n[i] *= factor;
    result.torque_nm[i] *= factor;
  }
  return result;
}

std::int64_t milliseconds(double ms) noexcept {
  return static_cast<std::int64_t>(ms * static_cast<double>(kMillisecond_ns));
}

}  // namespace

ToolChannel::ToolChannel(const scene::Tool& tool, std::int64_t model_period_ns)
    : pose_stale_after_ns_(milliseconds(tool.stale_after_ms)),
      model_stale_after_ns_(haptics::model_stale_after_ns(model_period_ns)),
      model_zero_after_ns_(suture::model_zero_after_ns(model_stale_after_ns_)),
      max_speed_m_per_s_(tool.max_speed_m_per_s),
      clutch_mask_(tool.workspace.clutch_button < 0 || tool.workspace.clutch_button > 31
                       ? 0U
                       : 1U << static_cast<unsigned>(tool.workspace.clutch_button)),
      hand_over_tool_stiffness_(tool.workspace.force_scale * tool.workspace.motion_scale),
      workspace_(tool.workspace) {
  scene_limits_ = {
      .max_force_n = tool.max_force_n,
      .max_torque_nm = tool.max_torque_nm,
      .max_force_slew_n_per_s = tool.max_force_slew_n_per_s,
      .max_torque_slew_nm_per_s = tool.max_torque_slew_nm_per_s,
  };
  set_device_limits({});
}

// ------------------------------------------------------------------ receive thread

// A device that was told to let go, and has not opened its jaw since.
bool ToolChannel::stays_released(const PoseSample& sample, std::int64_t now_ns) noexcept {
  if (std::exchange(released_heard_, sample.writer) != sample.writer) {
    released_jaw_closed_ = false;
    released_heard_ns_ = 0;
  }
  const std::int64_t heard_ns =
      std::max(released_heard_ns_, last_arrival_ns_.load(std::memory_order_relaxed));
  const bool anew = sample.goodbye || now_ns - heard_ns > kLeaseSilence_ns;
  const bool opens = released_jaw_closed_ && sample.jaw < kHalfClosed;
  released_jaw_closed_ |= sample.jaw >= kHalfClosed;
  released_heard_ns_ = now_ns;
  if (!anew && !opens) return true;
  released_.store(0, std::memory_order_release);
  released_jaw_closed_ = false;
  return false;
}

bool ToolChannel::admit(const PoseSample& sample, std::int64_t now_ns) noexcept {
  if (sample.writer == released_.load(std::memory_order_acquire) &&
      stays_released(sample, now_ns)) {
    count(counters_.poses_dropped);
    return false;
  }
  std::uint64_t holder = lease_.load(std::memory_order_acquire);
  if (holder == 0 && !sample.goodbye &&
      lease_.compare_exchange_strong(holder, sample.writer, std::memory_order_acq_rel)) {
    holder = sample.writer;
    count(counters_.leases);
  }
  if (holder != sample.writer) {
    count(counters_.poses_dropped);
    // One event a rival, not one a pose; a goodbye of who has no lease asks for nothing.
    if (sample.goodbye) return false;
    if (!was_refused_) count(counters_.faults[static_cast<unsigned>(Fault::kToolInUse)]);
    was_refused_ = true;
    return false;
  }
  if (sample.goodbye) {
    end_lease(sample.writer);
    admitted_writer_ = 0;
    return false;
  }
  count(counters_.poses);
  if (sample.stop) set_stopped(true);

  // A new engagement, or one that was silent, begins a new count.
  const bool fresh = admitted_writer_ != sample.writer ||
                     now_ns - last_arrival_ns_.load(std::memory_order_relaxed) > kSettle_ns;
  if (fresh) {
    was_refused_ = false;
    due_ns_ = now_ns;
  } else if (sample.sequence <= admitted_sequence_) {
    count(counters_.poses_dropped);
    count(counters_.faults[static_cast<unsigned>(Fault::kPoseOrder)]);
    return false;
  } else if (now_ns < due_ns_ - kBurst_ns) {
    count(counters_.poses_dropped);
    count(counters_.faults[static_cast<unsigned>(Fault::kPoseRate)]);
    return false;
  }
  if (admitted_writer_ == sample.writer && sample.sequence > admitted_sequence_ + 1)
    counters_.poses_lost.fetch_add(sample.sequence - admitted_sequence_ - 1,
                                   std::memory_order_relaxed);
  due_ns_ = std::max(due_ns_, now_ns) + kPosePeriodMin_ns;
  admitted_writer_ = sample.writer;
  admitted_sequence_ = sample.sequence;
  last_arrival_ns_.store(now_ns, std::memory_order_release);
  return true;
}

std::optional<ForceSample> ToolChannel::on_pose(const PoseSample& sample,
                                                std::int64_t now_ns) noexcept {
  if (!admit(sample, now_ns)) return std::nullopt;
  if (!try_hold()) {
    // The supervisor is in its tick. Put the pose aside; it looks there after letting
    // go, and we look whether it has let go, so that one of us serves it; at the latest
    // its next tick does.
    pending_.publish({sample, now_ns});
    if (!try_hold()) return std::nullopt;
    std::optional<ForceSample> force = serve_pending(now_ns);
    let_go();
    return force;
  }
  const ForceSample force = serve(sample, now_ns);
  let_go();
  return force;
}

void ToolChannel::on_rendered(const RenderedSample& sample, std::int64_t now_ns) noexcept {
  // What the server cannot see by itself; faults of poses it counts as they come.
  constexpr std::uint32_t kOnlyThere =
      fault_bit(Fault::kModelStale) | fault_bit(Fault::kModelNotFinite) |
      fault_bit(Fault::kModelPivots) | fault_bit(Fault::kForceLimit) |
      fault_bit(Fault::kSlewLimit) | fault_bit(Fault::kEnergy);
  // In a pause no models come, and that is no fault; nor is it until the next one is there.
  constexpr std::uint32_t kStale = fault_bit(Fault::kModelStale);
  if (paused_.load(std::memory_order_relaxed)) {
    rendered_in_pause_ = true;
  } else if ((sample.faults & kStale) == 0) {
    rendered_in_pause_ = false;
  }
  const std::uint32_t told = rendered_in_pause_ ? sample.faults & ~kStale : sample.faults;
  const std::uint32_t begun = told & ~rendered_faults_ & kOnlyThere;
  for (int i = 0; i < kFaultCount; ++i)
    if ((begun >> i & 1U) != 0) count(counters_.faults[i]);
  rendered_faults_ = told;
  rendered_.publish({sample, now_ns});
}

// ------------------------------------------------------------------ supervisor

std::optional<ForceSample> ToolChannel::supervise(std::int64_t now_ns) noexcept {
  const std::int64_t silence_ns = now_ns - last_arrival_ns_.load(std::memory_order_acquire);
  const std::uint64_t holder = lease();
  if (holder != 0 && silence_ns > kLeaseSilence_ns) end_lease(holder);
  if (silence_ns < kTakeover_ns && !pending_.pending()) return std::nullopt;
  if (!try_hold()) return std::nullopt;

  std::optional<ForceSample> force = serve_pending(now_ns);
  if (!force && silence_ns >= kTakeover_ns && stage_ != Stage::kIdle) {
    if (!supervised_) count(counters_.takeovers);
    supervised_ = true;
    force = render(now_ns, true);
  }
  let_go();
  // A pose may have been put aside since; the newer answer replaces ours.
  if (pending_.pending() && try_hold()) {
    if (std::optional<ForceSample> newer = serve_pending(now_ns)) force = newer;
    let_go();
  }
  return force;
}

// ------------------------------------------------------------------ simulation, others

bool ToolChannel::publish_model(const suture::HapticModel& model, std::int64_t taken_ns,
                                std::int64_t now_ns,
                                const std::optional<ToolPlace>& place) noexcept {
  if (!suture::is_sound(model)) {
    count(counters_.faults[static_cast<unsigned>(Fault::kModelNotFinite)]);
    return false;
  }
  StampedModel& to = models_.back();
  to.model = model;
  const double scale = targets_.front().frame == Frame::kDevice ? hand_over_tool_stiffness_ : 1.0;
  suture::limit_damping(to.model, max_damping_n_s_per_m() / scale);
  suture::couple_model(to.model, max_stiffness_n_per_m() / scale);
  to.taken_ns = taken_ns;
  to.published_ns = now_ns;
  to.place = place;
  models_.publish();
  return true;
}

void ToolChannel::set_device_limits(const DeviceLimits& device) noexcept {
  const suture::ForceLimits allowed =
      suture::stoppable_within(suture::smaller_of(scene_limits_, device.force),
                               std::min(kFade_ns, model_zero_after_ns_ - model_stale_after_ns_));
  max_force_n_.store(allowed.max_force_n, std::memory_order_relaxed);
  max_torque_nm_.store(allowed.max_torque_nm, std::memory_order_relaxed);
  max_force_slew_n_per_s_.store(allowed.max_force_slew_n_per_s, std::memory_order_relaxed);
  max_torque_slew_nm_per_s_.store(allowed.max_torque_slew_nm_per_s, std::memory_order_relaxed);
  const auto or_none = [](double limit) { return limit > 0.0 ? limit : 0.0; };
  max_stiffness_n_per_m_.store(or_none(device.max_stiffness_n_per_m), std::memory_order_relaxed);
  max_damping_n_s_per_m_.store(or_none(device.max_damping_n_s_per_m), std::memory_order_relaxed);
  pointer_.store(device.pointer, std::memory_order_relaxed);
}

std::int64_t ToolChannel::pose_stale_after_ns() const noexcept {
  return pointer_.load(std::memory_order_relaxed)
             ? std::max(pose_stale_after_ns_, kPointerStaleAfter_ns)
             : pose_stale_after_ns_;
}

std::int64_t ToolChannel::pose_zero_after_ns() const noexcept {
  return pose_stale_after_ns() + kZeroAfterStale_ns;
}

suture::ForceLimits ToolChannel::limits() const noexcept {
  return {max_force_n_.load(std::memory_order_relaxed),
          max_torque_nm_.load(std::memory_order_relaxed),
          max_force_slew_n_per_s_.load(std::memory_order_relaxed),
          max_torque_slew_nm_per_s_.load(std::memory_order_relaxed)};
}

const ToolTarget& ToolChannel::target() noexcept {
  targets_.update();
  return targets_.front();
}

const ToolReport& ToolChannel::report() noexcept {
  reports_.update();
  return reports_.front();
}

void ToolChannel::end_lease(std::uint64_t writer) noexcept {
  if (writer != 0 && lease_.compare_exchange_strong(writer, 0, std::memory_order_acq_rel))
    count(counters_.returns);
}

bool ToolChannel::release() noexcept {
  const std::uint64_t holder = lease();
  if (holder == 0) return false;
  released_.store(holder, std::memory_order_release);  // before its next pose finds the tool free
  end_lease(holder);
  return true;
}

// ------------------------------------------------------------------ holder of the token

void ToolChannel::note(Fault fault) noexcept {
  latched_ |= fault_bit(fault);
  count(counters_.faults[static_cast<unsigned>(fault)]);
}

void ToolChannel::note_while(Fault fault, bool present) noexcept {
  const std::uint32_t bit = fault_bit(fault);
  if (present && (ongoing_ & bit) == 0) count(counters_.faults[static_cast<unsigned>(fault)]);
  ongoing_ = present ? ongoing_ | bit : ongoing_ & ~bit;
}

std::optional<ForceSample> ToolChannel::serve_pending(std::int64_t now_ns) noexcept {
  if (!pending_.update()) return std::nullopt;
  const Arrival& arrival = pending_.front();
  // Overtaken by a pose that found the token free.
  if (arrival.sample.writer == writer_ && arrival.sample.sequence <= served_sequence_ &&
      arrival.arrived_ns <= good_ns_)
    return std::nullopt;
  return serve(arrival.sample, now_ns);
}

std::optional<Fault> ToolChannel::fault_of(const PoseSample& sample,
                                           std::int64_t now_ns) const noexcept {
  switch (suture::pose_fault(sample.pose, sample.jaw)) {
    case suture::PoseFault::kNotFinite:
      return Fault::kPoseNotFinite;
    case suture::PoseFault::kQuaternion:
      return Fault::kPoseQuaternion;
    case suture::PoseFault::kJaw:
      return Fault::kPoseJaw;
    case suture::PoseFault::kJump:
    case suture::PoseFault::kNone:
      break;
  }
  if (has_previous_ &&
      (sample.frame != frame_ ||
       suture::pose_jumps(device_pose_, sample.pose, now_ns - good_ns_, max_speed_m_per_s_)))
    return Fault::kPoseJump;
  return std::nullopt;
}

ForceSample ToolChannel::serve(const PoseSample& sample, std::int64_t now_ns) noexcept {
  if (sample.writer != writer_) {
    // Another hand: nothing of what the last one felt belongs to it.
    writer_ = sample.writer;
    stage_ = Stage::kSettling;
    has_previous_ = clutched_ = apart_ = jaw_waits_ = false;
    good_since_ns_ = now_ns;
    latched_ = 0;
    last_ = {};
    gain_.clear();
    workspace_.reset();
    stay_where_placed();
  }
  supervised_ = false;
  served_sequence_ = sample.sequence;
  renders_itself_ = sample.renders_itself;
  pose_stamp_ns_ = sample.stamp_ns;

  const std::optional<Fault> fault = fault_of(sample, now_ns);
  if (fault) {
    note(*fault);
    begin_fading(now_ns);
    good_since_ns_ = now_ns;
    apart_ |= has_previous_;
  }
  // A jump is a good pose in itself: the next ones are measured from there.
  if (!fault || *fault == Fault::kPoseJump) accept(sample, now_ns);
  return render(now_ns, false);
}

void ToolChannel::accept(const PoseSample& sample, std::int64_t now_ns) noexcept {
  if (has_previous_ && now_ns - good_ns_ >= pose_zero_after_ns()) {
    good_since_ns_ = now_ns;
    apart_ = true;
  }
  if (sample.frame != frame_ && stage_ == Stage::kSettling) workspace_.reset();
  device_pose_ = sample.pose;
  good_ns_ = now_ns;
  const bool first = !std::exchange(has_previous_, true);

  // During a pause, too, a hand may move away: the tool is where it was when the world goes on.
  const bool clutch =
      sample.frame == Frame::kDevice &&
      ((sample.buttons & clutch_mask_) != 0 || (!first && paused_.load(std::memory_order_acquire)));
  if (clutch && !clutched_) begin_fading(now_ns);
  if (stage_ == Stage::kFading) {
    // The tool stays where it is until the hand feels nothing.
    clutched_ |= clutch;
    apart_ = true;
    return;
  }
  if (clutch) {
    clutched_ = apart_ = true;
    return;
  }
  frame_ = sample.frame;
  clutched_ = false;
  if (std::exchange(apart_, false)) {
    workspace_.engage(sample.pose, pose_);
    good_since_ns_ = now_ns;
  }
  pose_ = sample.frame == Frame::kDevice ? workspace_.to_world(sample.pose) : sample.pose;
  const double jaw = std::clamp(sample.jaw, 0.0, 1.0);
  jaw_waits_ = jaw_waits_ && (jaw < kHalfClosed) != (jaw_ < kHalfClosed);
  if (!jaw_waits_) jaw_ = jaw;
  publish_target();
}

// Where the world was replaced, and the hand has not come yet.
void ToolChannel::stay_where_placed() noexcept {
  const std::optional<ToolPlace>& place = models_.front().place;
  if (!place) return;
  pose_ = place->pose;
  jaw_ = place->jaw;
  clutched_ = apart_ = jaw_waits_ = true;
}

void ToolChannel::publish_target() noexcept {
  targets_.publish(
      {stage_ != Stage::kIdle, pose_, jaw_, served_sequence_, writer_, frame_, workspace_, epoch_});
  if (board_ != nullptr) board_->publish(tool_, pose_);
}

void ToolChannel::begin_fading(std::int64_t now_ns) noexcept {
  if (stage_ == Stage::kRendering) {
    stage_ = Stage::kFading;
    fade_since_ns_ = now_ns;
  }
}

// Moves between stages where time, or somebody else, asks for it.
void ToolChannel::leave_or_stay(std::int64_t now_ns) noexcept {
  const bool stopped = stopped_.load(std::memory_order_acquire);
  const bool paused = paused_.load(std::memory_order_acquire);
  const bool leased = lease() == writer_ && writer_ != 0;
  note_while(Fault::kStopped, stopped);
  if (stopped || paused || !leased) begin_fading(now_ns);

  if (stage_ == Stage::kRendering || stage_ == Stage::kFading) {
    if (gain_.phase() > 0.0 || magnitude(last_.force_n) > 0.0 || magnitude(last_.torque_nm) > 0.0)
      return;
    // Zero since the last tick: a fade, or staleness, is complete.
    const bool stale = ceiling(now_ns) == 0.0;
    if (stage_ == Stage::kFading || stale) {
      stage_ = Stage::kSettling;
      good_since_ns_ = std::max(good_since_ns_, now_ns);
      blend_.clear();
    }
    return;
  }
  if (stage_ != Stage::kSettling) return;
  if (!leased) {
    stage_ = Stage::kIdle;
    writer_ = 0;
    latched_ = 0;
    publish_target();
    return;
  }
  const StampedModel& current = models_.front();
  const bool good_poses = has_previous_ && good_ns_ - good_since_ns_ >= kSettle_ns &&
                          now_ns - good_ns_ < pose_stale_after_ns();
  const bool good_model = has_model_ && current.taken_ns >= good_since_ns_ &&
                          now_ns - current.published_ns < model_stale_after_ns_;
  if (good_poses && good_model && !clutched_ && !stopped && !paused) {
    stage_ = Stage::kRendering;
    gain_.clear();
    blend_.clear();
    energy_.restart();
  }
}

// What the model in force gives at the pose in force and at those of the other tools.
suture::Wrench ToolChannel::evaluate_model(std::int64_t now_ns) noexcept {
  const suture::HapticModel& model = models_.front().model;
  std::array<suture::Pose, suture::kModelOthersMax> others;
  for (int k = 0; k < model.other_count; ++k) {
    const suture::ModelCoupling& coupling = model.others[k];
    const suture::Pose* now =
        board_ != nullptr ? board_->pose(static_cast<std::size_t>(coupling.tool), tool_) : nullptr;
    others[k] = now != nullptr ? *now : coupling.reference;
  }
  return evaluator_.evaluate(model, pose_,
                             {others.data(), static_cast<std::size_t>(model.other_count)}, now_ns);
}

// What the model gives at the pose in force, without a step where the model is new.
suture::Wrench ToolChannel::model_wrench(std::int64_t now_ns) noexcept {
  const bool renders = stage_ == Stage::kRendering || stage_ == Stage::kFading;
  if (stage_ != Stage::kFading) old_world_.reset();
  const auto present = [&] {
    if (!renders || !has_model_) return suture::Wrench{};
    return old_world_ ? old_world_->world : blend_.apply(evaluate_model(now_ns), now_ns);
  };
  if (!models_.pending()) return present();
  // The old model is asked once more, before its place goes back to the writer.
  const suture::Wrench shown = present();
  const std::uint64_t before = models_.front().model.sequence;
  models_.update();
  const suture::HapticModel& model = models_.front().model;
  const bool other_world = model.epoch != epoch_;
  if (has_model_ && other_world) {
    // What was felt of the old one goes to zero as it was: the new one may push harder.
    begin_fading(now_ns);
    if (gain_.gain() > 0.0 && !old_world_) old_world_ = OldWorld{shown, last_, gain_.gain()};
  }
  epoch_ = model.epoch;
  has_model_ = true;
  if (other_world) stay_where_placed();
  if (!renders) return {};
  if (old_world_) return old_world_->world;
  const suture::Wrench next = evaluate_model(now_ns);
  const std::int64_t period_ns = std::max<std::int64_t>(model.period_ns, kMillisecond_ns);
  blend_.swap(shown, next, now_ns,
              model.changed_sequence > before ? kFade_ns : std::min(kBlend_ns, period_ns));
  return blend_.apply(next, now_ns);
}

double ToolChannel::ceiling(std::int64_t now_ns) noexcept {
  if (stage_ == Stage::kIdle || stage_ == Stage::kSettling) return 0.0;
  const double pose =
      suture::freshness(now_ns - good_ns_, pose_stale_after_ns(), pose_zero_after_ns());
  const double model = suture::freshness(now_ns - models_.front().published_ns,
                                         model_stale_after_ns_, model_zero_after_ns_);
  double result = std::min(pose, model);
  if (stage_ == Stage::kFading)
    result =
        std::min({result, gain_.phase(), suture::freshness(now_ns - fade_since_ns_, 0, kFade_ns)});
  return result;
}

ToolState ToolChannel::state() const noexcept {
  if (stage_ == Stage::kIdle) return ToolState::kIdle;
  if (stopped_.load(std::memory_order_relaxed)) return ToolState::kStopped;
  if (paused_.load(std::memory_order_relaxed)) return ToolState::kPaused;
  if (clutched_) return ToolState::kClutched;
  if (stage_ == Stage::kRendering)
    return gain_.phase() < 1.0 ? ToolState::kRamping : ToolState::kRendering;
  return latched_ != 0 ? ToolState::kFault : ToolState::kRamping;
}

// Of what the hand feels, in its own frame and scale. A frozen pose does no work: a fade is
// not looked at. A device that renders itself watches itself (its forces are not ours, and
// come late): what it says to have shown is added up, but ends nothing here.
void ToolChannel::observe_energy(const suture::Wrench& world, const suture::Wrench& shown,
                                 std::int64_t now_ns, std::int64_t elapsed_ns) noexcept {
  if (stage_ != Stage::kRendering || !has_previous_) return;
  const double to_hand =
      frame_ == Frame::kDevice ? workspace_.force_scale() / workspace_.motion_scale() : 1.0;
  const double stored_j = to_hand * suture::recoverable_energy_j(models_.front().model, world);
  if (energy_.update(shown, device_pose_, stored_j, elapsed_ns) || renders_itself_) return;
  note(Fault::kEnergy);
  begin_fading(now_ns);
}

// Of a device that has left no pose is missed.
void ToolChannel::look_for_staleness(std::int64_t now_ns) noexcept {
  const bool pose_stale = lease() == writer_ && now_ns - good_ns_ > pose_stale_after_ns();
  // After a pause the next model has its time, too.
  if (paused_.load(std::memory_order_relaxed)) paused_ns_ = now_ns;
  const bool model_stale =
      has_model_ &&
      now_ns - std::max(models_.front().published_ns, paused_ns_) > model_stale_after_ns_;
  if (pose_stale) latched_ |= fault_bit(Fault::kPoseStale);
  if (model_stale) latched_ |= fault_bit(Fault::kModelStale);
  note_while(Fault::kPoseStale, pose_stale_.update(pose_stale, now_ns));
  note_while(Fault::kModelStale, model_stale_.update(model_stale, now_ns));
}

// What the hand is to feel under `gain`, within the limits, in its own frame. The limits stand
// before the gain, or a force far beyond them would stay at them for most of a ramp; and after
// it, because they stand last.
suture::Wrench ToolChannel::wanted(const suture::Wrench& world, double gain,
                                   bool& limited) const noexcept {
  const suture::ForceLimits limits = this->limits();
  if (old_world_) {
    return suture::limit_magnitude(scaled(old_world_->shown, gain / old_world_->gain), limits,
                                   limited);
  }
  const suture::Wrench hand = suture::limit_magnitude(
      frame_ == Frame::kDevice ? workspace_.to_device(world) : world, limits, limited);
  return suture::limit_magnitude(scaled(hand, gain), limits, limited);
}

ForceSample ToolChannel::render(std::int64_t now_ns, bool from_supervisor) noexcept {
  // Two threads may tick with times taken in the other order.
  now_ns = std::max(now_ns, rendered_ns_);
  const std::int64_t elapsed_ns = std::min(now_ns - rendered_ns_, kSlewWindow_ns);
  rendered_ns_ = now_ns;

  leave_or_stay(now_ns);
  const suture::Wrench world = model_wrench(now_ns);
  const bool engaged = stage_ != Stage::kIdle;
  if (engaged && has_previous_) look_for_staleness(now_ns);
  note_while(Fault::kModelPivots, evaluator_.fallbacks() != last_fallbacks_);
  last_fallbacks_ = evaluator_.fallbacks();

  const double gain = gain_.update(ceiling(now_ns), elapsed_ns);
  // A fade begins at full gain: that is no recovery.
  if (latched_ != 0 && stage_ == Stage::kRendering && gain_.phase() >= 1.0 &&
      !pose_stale_.lasts() && !model_stale_.lasts()) {
    latched_ = 0;
    count(counters_.recoveries);
  }
  const suture::Wrench felt = scaled(world, gain);
  const suture::ForceLimits limits = this->limits();
  bool too_strong = false, too_fast = false;
  last_ = suture::limit_slew(wanted(world, gain, too_strong), last_, elapsed_ns, limits, too_fast);

  rendered_.update();
  const Rendered& rendered = rendered_.front();
  const bool told = renders_itself_ && rendered.arrived_ns != 0 &&
                    now_ns - rendered.arrived_ns < kRenderedStale_ns;
  const suture::Wrench& shown = told ? rendered.sample.wrench : last_;
  observe_energy(world, shown, now_ns, elapsed_ns);
  note_while(Fault::kForceLimit, too_strong && !renders_itself_);
  note_while(Fault::kSlewLimit, too_fast && !renders_itself_);

  ForceSample force;
  force.writer = writer_;
  force.epoch = epoch_;
  force.sequence = ++sequence_;
  force.time_ns = now_ns;
  force.pose_sequence = served_sequence_;
  force.pose_stamp_ns = pose_stamp_ns_;
  force.model_sequence = has_model_ ? models_.front().model.sequence : 0;
  force.model_age_ns = has_model_ ? now_ns - models_.front().published_ns : -1;
  force.frame = frame_;
  force.state = state();
  force.faults = latched_ | ongoing_;
  force.touching = has_model_ && models_.front().model.touching;
  force.holding = has_model_ && models_.front().model.holding;
  force.engaged = engaged && !clutched_ && stage_ != Stage::kFading;
  force.from_supervisor = from_supervisor;
  force.renders_itself = renders_itself_;
  force.wrench = last_;
  count(counters_.forces);
  // A summary taken in between may lose one tick's age; the next tick brings it back.
  if (force.model_age_ns > model_age_max_ns_.load(std::memory_order_relaxed))
    model_age_max_ns_.store(force.model_age_ns, std::memory_order_relaxed);

  const double shown_n = magnitude(shown.force_n);
  silent_.store(magnitude(last_.force_n) == 0.0 && magnitude(last_.torque_nm) == 0.0,
                std::memory_order_release);
  peak_force_n_ = std::max(peak_force_n_, shown_n);
  ToolReport& report = reports_.back();
  report.state = force.state;
  report.faults = force.faults | (told ? rendered.sample.faults : 0U);
  report.renders_itself = renders_itself_;
  report.writer = writer_;
  report.pose = pose_;
  report.jaw = jaw_;
  report.wrench = felt;
  report.gain = gain;
  report.touching = force.touching;
  report.engaged = force.engaged;
  report.shown_force_n = shown_n;
  report.peak_force_n = peak_force_n_;
  report.energy_to_hand_j = energy_.given_j();
  report.energy_debt_peak_j = energy_.peak_debt_j();
  reports_.publish();
  return force;
}

}  // namespace sutured::haptics
