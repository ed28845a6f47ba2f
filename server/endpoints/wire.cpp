// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/wire.hpp"

#include <algorithm>
#include <cmath>
#include <span>

#include "needle/curve.hpp"

namespace sutured::endpoints {
namespace {

constexpr int kNeedlePoints = 33;  // of its course

using haptics::Fault;
using haptics::fault_bit;
using haptics::ToolState;

static_assert(fault_bit(Fault::kPoseStale) == suture_v1_FAULT_POSE_STALE);
static_assert(fault_bit(Fault::kPoseNotFinite) == suture_v1_FAULT_POSE_NOT_FINITE);
static_assert(fault_bit(Fault::kPoseQuaternion) == suture_v1_FAULT_POSE_QUATERNION);
static_assert(fault_bit(Fault::kPoseJump) == suture_v1_FAULT_POSE_JUMP);
static_assert(fault_bit(Fault::kPoseRate) == suture_v1_FAULT_POSE_RATE);
static_assert(fault_bit(Fault::kPoseOrder) == suture_v1_FAULT_POSE_ORDER);
static_assert(fault_bit(Fault::kPoseJaw) == suture_v1_FAULT_POSE_JAW);
static_assert(fault_bit(Fault::kModelStale) == suture_v1_FAULT_MODEL_STALE);
static_assert(fault_bit(Fault::kModelNotFinite) == suture_v1_FAULT_MODEL_NOT_FINITE);
static_assert(fault_bit(Fault::kModelPivots) == suture_v1_FAULT_MODEL_PIVOTS);
static_assert(fault_bit(Fault::kForceLimit) == suture_v1_FAULT_FORCE_LIMIT);
static_assert(fault_bit(Fault::kSlewLimit) == suture_v1_FAULT_SLEW_LIMIT);
static_assert(fault_bit(Fault::kEnergy) == suture_v1_FAULT_ENERGY);
static_assert(fault_bit(Fault::kStopped) == suture_v1_FAULT_STOPPED);
static_assert(fault_bit(Fault::kToolInUse) == suture_v1_FAULT_TOOL_IN_USE);

static_assert(static_cast<int>(ToolState::kIdle) == suture_v1_TOOL_IDLE);
static_assert(static_cast<int>(ToolState::kRendering) == suture_v1_TOOL_RENDERING);
static_assert(static_cast<int>(ToolState::kRamping) == suture_v1_TOOL_RAMPING);
static_assert(static_cast<int>(ToolState::kClutched) == suture_v1_TOOL_CLUTCHED);
static_assert(static_cast<int>(ToolState::kFault) == suture_v1_TOOL_FAULT);
static_assert(static_cast<int>(ToolState::kStopped) == suture_v1_TOOL_STOPPED);
static_assert(static_cast<int>(ToolState::kPaused) == suture_v1_TOOL_PAUSED);

static_assert(static_cast<int>(simulation::ThreadEnd::kFree) == suture_v1_END_FREE);
static_assert(static_cast<int>(simulation::ThreadEnd::kSwaged) == suture_v1_END_SWAGED);
static_assert(static_cast<int>(simulation::ThreadEnd::kHeld) == suture_v1_END_HELD);
static_assert(static_cast<int>(simulation::ThreadEnd::kAnchored) == suture_v1_END_ANCHORED);

template <std::size_t N>
void copy(const std::array<double, N>& from, double (&to)[N]) noexcept {
  std::copy(from.begin(), from.end(), to);
}

void copy(const suture::Wrench& from, double (&to)[6]) noexcept {
  std::copy(from.force_n.begin(), from.force_n.end(), to);
  std::copy(from.torque_nm.begin(), from.torque_nm.end(), to + 3);
}

template <class Named>
std::string_view name_at(const std::vector<Named>& list, int index) noexcept {
  return index < 0 || static_cast<std::size_t>(index) >= list.size()
             ? std::string_view()
             : list[static_cast<std::size_t>(index)].name;
}

/// Who rules an end of a thread.
std::string_view holder_name(const scene::Scene& scene, simulation::ThreadEnd end,
                             int holder) noexcept {
  switch (end) {
    case simulation::ThreadEnd::kFree:
      return {};
    case simulation::ThreadEnd::kSwaged:
      return name_at(scene.needles, holder);
    case simulation::ThreadEnd::kHeld:
      return name_at(scene.tools, holder);
    case simulation::ThreadEnd::kAnchored:
      return name_at(scene.tissues, holder);
  }
  return {};
}

suture_v1_EventKind wire_kind(simulation::EventKind kind) noexcept {
  switch (kind) {
    case simulation::EventKind::kGrasp:
      return suture_v1_EVENT_GRASP;
    case simulation::EventKind::kRelease:
      return suture_v1_EVENT_RELEASE;
    case simulation::EventKind::kContact:
      return suture_v1_EVENT_CONTACT;
    case simulation::EventKind::kPuncture:
      return suture_v1_EVENT_PUNCTURE;
    case simulation::EventKind::kExit:
      return suture_v1_EVENT_EXIT;
    case simulation::EventKind::kGripSlip:
      return suture_v1_EVENT_GRIP_SLIP;
    case simulation::EventKind::kLimit:
      return suture_v1_EVENT_LIMIT;
    case simulation::EventKind::kSolverResidual:
    case simulation::EventKind::kInverted:
      return suture_v1_EVENT_SOLVER;
    case simulation::EventKind::kContactLost:
      return suture_v1_EVENT_CONTACT_LOST;
    case simulation::EventKind::kTaut:
      return suture_v1_EVENT_TAUT;
    case simulation::EventKind::kSlack:
      return suture_v1_EVENT_SLACK;
    case simulation::EventKind::kUnthread:
      return suture_v1_EVENT_UNTHREAD;
  }
  return suture_v1_EVENT_NOTICE;
}

/// Fills `wire`, which lends from `to`.
template <class From, class Sequence>
void set_punctures(Sequence& wire, const scene::Scene& scene, const std::vector<From>& from,
                   std::vector<suture::v1::Puncture>& to) {
  to.clear();
  for (const From& puncture : from) {
    suture::v1::Puncture& out = to.emplace_back();
    suture::set_text(out.body, name_at(scene.tissues, puncture.tissue));
    for (int i = 0; i < 3; ++i) out.position_m[i] = puncture.position_m[i];
    out.arc_length_m = puncture.arc_length_m;
    out.inward = puncture.inward;
  }
  suture::lend(wire, std::span<const suture::v1::Puncture>(to));
}

}  // namespace

haptics::PoseSample pose_sample(const suture::v1::ToolPose& wire, std::uint64_t writer) noexcept {
  haptics::PoseSample sample;
  sample.writer = writer;
  sample.sequence = wire.sequence_number;
  sample.stamp_ns = wire.stamp_ns;
  std::copy(std::begin(wire.position_m), std::end(wire.position_m), sample.pose.position_m.begin());
  std::copy(std::begin(wire.orientation_xyzw), std::end(wire.orientation_xyzw),
            sample.pose.orientation_xyzw.begin());
  sample.jaw = static_cast<double>(wire.jaw);
  sample.buttons = wire.buttons;
  sample.frame = (wire.flags & suture_v1_POSE_IN_WORLD) != 0 ? haptics::Frame::kWorld
                                                             : haptics::Frame::kDevice;
  sample.goodbye = (wire.flags & suture_v1_POSE_GOODBYE) != 0;
  sample.stop = (wire.flags & suture_v1_POSE_STOP) != 0;
  sample.renders_itself = (wire.flags & suture_v1_POSE_RENDER_DEVICE) != 0;
  return sample;
}

haptics::RenderedSample rendered_sample(const suture::v1::ToolRendered& wire) noexcept {
  haptics::RenderedSample sample;
  sample.model_sequence = wire.model_sequence;
  sample.faults = wire.faults;
  const auto copy_finite = [](const double(&from)[3], std::array<double, 3>& to) {
    for (int i = 0; i < 3; ++i) to[i] = std::isfinite(from[i]) ? from[i] : 0.0;
  };
  copy_finite(wire.force_n, sample.wrench.force_n);
  copy_finite(wire.torque_nm, sample.wrench.torque_nm);
  return sample;
}

haptics::DeviceLimits device_limits(const suture::v1::DeviceProfile& wire) noexcept {
  haptics::DeviceLimits limits;
  limits.force.max_force_n = wire.max_force_n;
  limits.force.max_torque_nm = wire.max_torque_nm;
  limits.force.max_force_slew_n_per_s = wire.max_force_slew_n_per_s;
  limits.max_stiffness_n_per_m = wire.max_stiffness_n_per_m;
  limits.max_damping_n_s_per_m = wire.max_damping_n_s_per_m;
  limits.pointer = wire.pointer;
  return limits;
}

void set_force(suture::v1::ToolForce& wire, const haptics::ForceSample& force) noexcept {
  wire.epoch = force.epoch;
  wire.sequence_number = force.sequence;
  wire.pose_sequence = force.pose_sequence;
  wire.pose_stamp_ns = force.pose_stamp_ns;
  copy(force.wrench.force_n, wire.force_n);
  copy(force.wrench.torque_nm, wire.torque_nm);
  wire.state = wire_state(force.state);
  wire.faults = force.faults;
  wire.flags = 0;
  if (force.frame == haptics::Frame::kWorld) wire.flags |= suture_v1_FORCE_IN_WORLD;
  if (force.touching) wire.flags |= suture_v1_FORCE_TOUCHING;
  if (force.holding) wire.flags |= suture_v1_FORCE_HOLDING;
  if (force.engaged) wire.flags |= suture_v1_FORCE_ENGAGED;
  if (force.renders_itself) wire.flags |= suture_v1_FORCE_RENDER_DEVICE;
  if (force.from_supervisor) wire.flags |= suture_v1_FORCE_FROM_SUPERVISOR;
  constexpr std::uint32_t kNone = UINT32_MAX;
  wire.model_age_us = force.model_age_ns < 0 ? kNone
                                             : static_cast<std::uint32_t>(std::min<std::int64_t>(
                                                   force.model_age_ns / 1000, kNone - 1));
}

suture_v1_ToolState wire_state(haptics::ToolState state) noexcept {
  return static_cast<suture_v1_ToolState>(state);
}

void set_model(suture::v1::HapticModel& wire, const haptics::PublishedModel& published,
               const suture::ForceLimits& limits, std::span<const std::string> names,
               std::array<suture::v1::ToolCoupling, suture::kModelOthersMax>& couplings) noexcept {
  const suture::HapticModel& model = published.model;
  wire.epoch = model.epoch;
  wire.sequence_number = model.sequence;
  wire.changed_sequence = model.changed_sequence;
  wire.stamp_ns = model.stamp_ns;
  wire.pose_sequence = published.pose_sequence;
  wire.simulation_time_s = published.time_s;
  wire.flags = 0;
  if (model.touching) wire.flags |= suture_v1_MODEL_TOUCHING;
  if (model.holding) wire.flags |= suture_v1_MODEL_HOLDING;
  if (published.engaged) wire.flags |= suture_v1_MODEL_ENGAGED;
  copy(model.reference.position_m, wire.reference_position_m);
  copy(model.reference.orientation_xyzw, wire.reference_orientation_xyzw);
  copy(model.wrench, wire.wrench);
  copy(model.stiffness, wire.stiffness);
  copy(model.arm_moment_nm, wire.arm_moment_nm);
  copy(model.slide_twist, wire.slide_twist);
  copy(model.slide_gradient, wire.slide_gradient);
  wire.slide_stiffness = model.slide_stiffness;
  wire.slide_friction_n = model.slide_friction_n;
  wire.slide_drag_n_s_per_m = model.slide_drag_n_s_per_m;
  copy(model.bilateral_wrench, wire.bilateral_wrench);
  copy(model.bilateral_stiffness, wire.bilateral_stiffness);
  const auto rows = static_cast<std::size_t>(model.rows);
  const auto lend = [](auto& sequence, const double* first, std::size_t count) {
    suture::lend(sequence, std::span<const double>(first, count));
  };
  lend(wire.compliance_m_per_n, model.compliance_m_per_n.data(), rows * (rows + 1) / 2);
  lend(wire.jacobian, model.jacobian[0].data(), rows * 6);
  lend(wire.offset_m, model.offset_m.data(), rows);
  lend(wire.multiplier_n, model.multiplier_n.data(), rows);
  lend(wire.multiplier_max_n, model.multiplier_max_n.data(), rows);
  suture::lend(wire.bound_row, std::span<const std::int32_t>(model.bound_row.data(), rows));
  lend(wire.bound_slope, model.bound_slope.data(), rows);
  const auto others = static_cast<std::size_t>(model.other_count);
  for (std::size_t k = 0; k < others; ++k) {
    const suture::ModelCoupling& from = model.others[k];
    suture::v1::ToolCoupling& to = couplings[k];
    suture::set_text(to.tool, names[static_cast<std::size_t>(from.tool)]);
    copy(from.reference.position_m, to.position_m);
    copy(from.reference.orientation_xyzw, to.orientation_xyzw);
    copy(from.stiffness, to.stiffness);
    copy(from.slide_gradient, to.slide_gradient);
    lend(to.jacobian, from.jacobian[0].data(), rows * 6);
  }
  suture::lend(wire.others, std::span<const suture::v1::ToolCoupling>(couplings.data(), others));
  wire.frozen_rows = static_cast<std::uint32_t>(model.frozen_rows);
  wire.radius_m = model.radius_m;
  wire.norm_length_m = model.characteristic_length_m;
  wire.max_force_n = limits.max_force_n;
  wire.max_torque_nm = limits.max_torque_nm;
  wire.max_force_slew_n_per_s = limits.max_force_slew_n_per_s;
  wire.max_torque_slew_nm_per_s = limits.max_torque_slew_nm_per_s;
  wire.stale_after_ns = model.stale_after_ns;
  wire.period_ns = model.period_ns;
  wire.blend_ns = std::min(haptics::kBlend_ns, model.period_ns);
  wire.ramp_ns = haptics::kFade_ns;
  copy(published.mapping.position_m(), wire.mapping.position_m);
  copy(published.mapping.orientation_xyzw(), wire.mapping.orientation_xyzw);
  copy(published.mapping.tool_orientation_xyzw(), wire.mapping.tool_orientation_xyzw);
  wire.mapping.motion_scale = published.mapping.motion_scale();
  wire.mapping.force_scale = published.mapping.force_scale();
}

void set_event(suture::v1::Event& wire, const simulation::Event& event) noexcept {
  wire.kind = wire_kind(event.kind);
  wire.simulation_time_s = event.time_s;
  suture::set_text(wire.subject, event.subject);
  suture::set_text(wire.object, event.object);
  for (int i = 0; i < 3; ++i) wire.position_m[i] = event.position_m[i];
  wire.value = event.force_n;
  const bool count = event.kind == simulation::EventKind::kInverted;
  suture::set_text(wire.unit, count ? "tets" : "N");
  if (count) suture::set_text(wire.text, "tets are inside out");
}

std::string_view held_name(const scene::Scene& scene, const simulation::HeldThing& held) noexcept {
  switch (held.kind) {
    case simulation::HeldKind::kNothing:
      return {};
    case simulation::HeldKind::kNeedle:
      return name_at(scene.needles, held.index);
    case simulation::HeldKind::kTissue:
      return name_at(scene.tissues, held.index);
    case simulation::HeldKind::kThread:
      return name_at(scene.threads, held.index);
  }
  return {};
}

void set_needle(suture::v1::NeedleState& wire, const scene::Scene& scene, std::size_t index,
                const simulation::NeedleState& state, std::vector<double>& course_m,
                std::vector<suture::v1::Puncture>& punctures) {
  const scene::Needle& needle = scene.needles[index];
  const needle::Curve curve = needle::Curve::of(needle);
  const scene::Pose pose{state.position_m, state.orientation};
  course_m.clear();
  for (int i = 0; i < kNeedlePoints; ++i) {
    const double from_tip = curve.length_m() * i / (kNeedlePoints - 1);
    const auto p = curve.point(pose, curve.length_m() - from_tip);
    course_m.insert(course_m.end(), {p.x(), p.y(), p.z()});
  }
  suture::set_text(wire.needle, needle.name);
  wire.shape = curve.is_arc() ? suture_v1_NEEDLE_ARC : suture_v1_NEEDLE_STRAIGHT;
  wire.radius_m = curve.radius_m();
  wire.length_m = curve.length_m();
  wire.diameter_m = needle.diameter_m;
  for (int i = 0; i < 3; ++i) wire.position_m[i] = state.position_m[i];
  for (int i = 0; i < 4; ++i) wire.orientation_xyzw[i] = state.orientation.coeffs()[i];
  suture::set_text(wire.holder, name_at(scene.tools, state.holder));
  wire.tip_inside = state.tip_inside;
  wire.tip_force_n = state.tip_force_n;
  wire.embedded_length_m = state.embedded_length_m;
  wire.active_cells = static_cast<std::uint32_t>(state.active_cells);
  suture::lend(wire.course_m, std::span<const double>(course_m));
  set_punctures(wire.punctures, scene, state.punctures, punctures);
}

void set_thread(suture::v1::ThreadState& wire, const scene::Scene& scene, std::size_t thread,
                const simulation::ThreadState& state,
                std::vector<suture::v1::Puncture>& punctures) {
  suture::set_text(wire.thread, scene.threads[thread].name);
  wire.length_m = state.length_m;
  wire.diameter_m = scene.threads[thread].diameter_m;
  wire.tension_n = state.tension_n;
  wire.slack_m = state.slack_m;
  wire.taut = state.taut;
  wire.head = static_cast<suture_v1_ThreadEnd>(state.head);
  wire.tail = static_cast<suture_v1_ThreadEnd>(state.tail);
  suture::set_text(wire.head_holder, holder_name(scene, state.head, state.head_holder));
  suture::set_text(wire.tail_holder, holder_name(scene, state.tail, state.tail_holder));
  static_assert(sizeof(simulation::Vec3) == 3 * sizeof(double));
  const double* course = state.course_m.empty() ? nullptr : state.course_m[0].data();
  suture::lend(wire.course_m, std::span<const double>(course, 3 * state.course_m.size()));
  suture::lend(wire.arc_length_m, std::span<const double>(state.arc_length_m));
  suture::lend(wire.segment_tension_n, std::span<const double>(state.segment_tension_n));
  set_punctures(wire.punctures, scene, state.punctures, punctures);
}

void set_contacts(suture::v1::ContactState& wire, const scene::Scene& scene,
                  std::span<const simulation::ContactPoint> contacts,
                  std::vector<suture::v1::ContactPoint>& points) {
  points.clear();
  for (const simulation::ContactPoint& from : contacts) {
    suture::v1::ContactPoint& to = points.emplace_back();
    for (int i = 0; i < 3; ++i) to.position_m[i] = from.position_m[i];
    for (int i = 0; i < 3; ++i) to.normal[i] = from.normal[i];
    to.force_n = from.force_n;
    to.gap_m = from.gap_m;
    suture::set_text(to.body, name_at(scene.tissues, from.tissue));
    suture::set_text(to.other, from.other_tissue >= 0 ? name_at(scene.tissues, from.other_tissue)
                                                      : name_at(scene.needles, from.needle));
  }
  suture::lend(wire.points, std::span<const suture::v1::ContactPoint>(points));
}

void set_quality(suture::v1::Quality& wire, const scene::Scene& scene, std::size_t thread,
                 const simulation::ThreadQuality& quality, std::vector<suture::v1::Bite>& bites) {
  suture::set_text(wire.thread, scene.threads[thread].name);
  wire.elapsed_s = quality.elapsed_s;
  wire.needle_path_m = quality.needle_path_m;
  wire.peak_force_n = quality.peak_force_n;
  wire.peak_principal_stress_pa = quality.peak_principal_stress_pa;
  wire.gap_start_m = quality.gap_start.max_m;
  wire.gap_m = quality.gap.max_m;
  wire.tension_n = quality.tension_n;
  wire.bite_depth_mean_m = quality.depth_m.mean;
  wire.bite_depth_spread_m = quality.depth_m.deviation;
  wire.bite_spacing_mean_m = quality.spacing_m.mean;
  wire.bite_spacing_spread_m = quality.spacing_m.deviation;
  wire.handovers = quality.handovers;
  wire.needle_drops = quality.needle_drops;
  bites.clear();
  for (const simulation::BiteFigures& from : quality.bites) {
    suture::v1::Bite& to = bites.emplace_back();
    suture::set_text(to.body, name_at(scene.tissues, from.tissue));
    for (int i = 0; i < 3; ++i) to.entry_m[i] = from.entry_m[i];
    for (int i = 0; i < 3; ++i) to.exit_m[i] = from.exit_m[i];
    to.depth_m = from.depth_m;
    to.edge_distance_m = from.edge_distance_m;
    to.spacing_m = from.spacing_m;
    to.peak_force_n = from.peak_force_n;
  }
  suture::lend(wire.bites, std::span<const suture::v1::Bite>(bites));
}

suture::v1::Percentiles percentiles(const haptics::LatencySummary& summary) noexcept {
  return {summary.count, summary.p50_us, summary.p99_us, summary.max_us};
}

}  // namespace sutured::endpoints
