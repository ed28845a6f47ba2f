// SPDX-License-Identifier: Apache-2.0
#include "model_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "force_guard.hpp"
#include "protocol/finite.hpp"
#include "protocol/pose_check.hpp"
#include "protocol/virtual_coupling.hpp"

namespace suture {
namespace {

constexpr std::int64_t kLongestNs = 1'000'000'000;  // of times that a model may ask for

template <std::size_t N>
void copy(const double (&from)[N], std::array<double, N>& to) noexcept {
  std::memcpy(to.data(), from, sizeof from);
}

Wrench wrench_of(const double (&wire)[6]) noexcept {
  return {{wire[0], wire[1], wire[2]}, {wire[3], wire[4], wire[5]}};
}

Quaternion product(const Quaternion& a, const Quaternion& b) noexcept {
  return {a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
          a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
          a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
          a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]};
}

/// Returns R(q) v for a unit quaternion: v + 2 w (u × v) + 2 u × (u × v).
Vector3 rotated(const Quaternion& q, const Vector3& v) noexcept {
  const Vector3 t{2.0 * (q[1] * v[2] - q[2] * v[1]), 2.0 * (q[2] * v[0] - q[0] * v[2]),
                  2.0 * (q[0] * v[1] - q[1] * v[0])};
  return {v[0] + q[3] * t[0] + q[1] * t[2] - q[2] * t[1],
          v[1] + q[3] * t[1] + q[2] * t[0] - q[0] * t[2],
          v[2] + q[3] * t[2] + q[0] * t[1] - q[1] * t[0]};
}

Vector3 scaled(double factor, const Vector3& v) noexcept {
  return {factor * v[0], factor * v[1], factor * v[2]};
}

Quaternion quaternion_of(const double (&wire)[4]) noexcept {
  return {wire[0], wire[1], wire[2], wire[3]};
}

// As in idl/suture_v1.idl, Mapping; so is `to_world`.
Wrench to_hand(const v1::Mapping& mapping, const Hand& hand, const Wrench& world) noexcept {
  if (hand.in_world) return world;
  Quaternion back = quaternion_of(mapping.orientation_xyzw);
  for (std::size_t i = 0; i < 3; ++i) back[i] = -back[i];
  return {scaled(mapping.force_scale, rotated(back, world.force_n)),
          scaled(mapping.force_scale / mapping.motion_scale, rotated(back, world.torque_nm))};
}

Wrench times(const Wrench& wrench, double factor) noexcept {
  return {scaled(factor, wrench.force_n), scaled(factor, wrench.torque_nm)};
}

bool is_zero(const Wrench& wrench) noexcept {
  return wrench.force_n == Vector3{} && wrench.torque_nm == Vector3{};
}

bool is_rotation(const double (&q)[4]) noexcept {
  const double squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  return std::abs(squared - 1.0) < 1e-3;
}

}  // namespace

Pose to_world(const v1::Mapping& mapping, const Hand& hand) noexcept {
  if (hand.in_world) return {hand.position_m, hand.orientation_xyzw};
  const Quaternion turn = quaternion_of(mapping.orientation_xyzw);
  Pose pose;
  pose.position_m = rotated(turn, scaled(mapping.motion_scale, hand.position_m));
  for (std::size_t i = 0; i < 3; ++i) pose.position_m[i] += mapping.position_m[i];
  pose.orientation_xyzw =
      product(product(turn, hand.orientation_xyzw), quaternion_of(mapping.tool_orientation_xyzw));
  return pose;
}

bool receive_model(const v1::HapticModel& wire, std::int64_t arrived_ns, const DeviceLimits& device,
                   ReceivedModel& received, bool in_world) noexcept {
  const std::size_t rows = wire.offset_m._length;
  if (rows > kModelRowsMax || wire.compliance_m_per_n._length != rows * (rows + 1) / 2 ||
      wire.jacobian._length != 6 * rows || wire.multiplier_n._length != rows ||
      wire.multiplier_max_n._length != rows || wire.bound_row._length != rows ||
      wire.bound_slope._length != rows || !is_rotation(wire.reference_orientation_xyzw) ||
      !is_rotation(wire.mapping.orientation_xyzw) ||
      !is_rotation(wire.mapping.tool_orientation_xyzw) || !(wire.mapping.motion_scale > 0.0) ||
      !(wire.mapping.force_scale > 0.0) || !(wire.max_force_n > 0.0) ||
      !(wire.max_torque_nm > 0.0) || !(wire.max_force_slew_n_per_s > 0.0) ||
      !(wire.max_torque_slew_nm_per_s > 0.0)) {
    return false;
  }
  for (std::size_t i = 0; i < rows; ++i) {
    const auto normal = static_cast<std::int64_t>(span_of(wire.bound_row)[i]);
    const double slope = span_of(wire.bound_slope)[i];
    if (normal < 0 || normal >= static_cast<std::int64_t>(rows) || !std::isfinite(slope) ||
        slope < 0.0 || !(span_of(wire.multiplier_max_n)[i] >= 0.0))
      return false;
  }
  HapticModel& model = received.model;
  model.epoch = wire.epoch;
  model.sequence = wire.sequence_number;
  model.changed_sequence = wire.changed_sequence;
  model.stamp_ns = wire.stamp_ns;
  model.period_ns = wire.period_ns;
  model.stale_after_ns = wire.stale_after_ns;
  copy(wire.reference_position_m, model.reference.position_m);
  copy(wire.reference_orientation_xyzw, model.reference.orientation_xyzw);
  model.wrench = wrench_of(wire.wrench);
  copy(wire.stiffness, model.stiffness);
  model.bilateral_wrench = wrench_of(wire.bilateral_wrench);
  copy(wire.bilateral_stiffness, model.bilateral_stiffness);
  copy(wire.arm_moment_nm, model.arm_moment_nm);
  copy(wire.slide_twist, model.slide_twist);
  copy(wire.slide_gradient, model.slide_gradient);
  model.slide_stiffness = wire.slide_stiffness;
  model.slide_friction_n = wire.slide_friction_n;
  model.slide_drag_n_s_per_m = wire.slide_drag_n_s_per_m;
  model.characteristic_length_m = wire.norm_length_m;
  model.radius_m = wire.radius_m;
  model.touching = (wire.flags & suture_v1_MODEL_TOUCHING) != 0;
  model.holding = (wire.flags & suture_v1_MODEL_HOLDING) != 0;
  model.rows = static_cast<std::int32_t>(rows);
  model.frozen_rows = static_cast<std::int32_t>(wire.frozen_rows);
  const auto take = [](const auto& sequence, auto* to) {
    const auto values = span_of(sequence);
    std::copy(values.begin(), values.end(), to);
  };
  take(wire.compliance_m_per_n, model.compliance_m_per_n.data());
  take(wire.jacobian, model.jacobian[0].data());
  take(wire.offset_m, model.offset_m.data());
  take(wire.multiplier_n, model.multiplier_n.data());
  take(wire.multiplier_max_n, model.multiplier_max_n.data());
  take(wire.bound_row, model.bound_row.data());
  take(wire.bound_slope, model.bound_slope.data());

  const auto others = span_of(wire.others);
  if (others.size() > kModelOthersMax) return false;
  model.other_count = static_cast<std::int32_t>(others.size());
  for (std::size_t k = 0; k < others.size(); ++k) {
    const v1::ToolCoupling& from = others[k];
    if (from.jacobian._length != 6 * rows || !is_rotation(from.orientation_xyzw)) return false;
    received.others[k] = tool_id(text_of(from.tool));
    model.others[k].tool = static_cast<std::int32_t>(k);
    copy(from.position_m, model.others[k].reference.position_m);
    copy(from.orientation_xyzw, model.others[k].reference.orientation_xyzw);
    copy(from.stiffness, model.others[k].stiffness);
    copy(from.slide_gradient, model.others[k].slide_gradient);
    take(from.jacobian, model.others[k].jacobian[0].data());
  }

  if (!is_sound(model) || !all_finite(wire.mapping.position_m)) return false;
  received.mapping = wire.mapping;
  received.blend_ns = std::clamp<std::int64_t>(wire.blend_ns, 0, kLongestNs);
  received.ramp_ns = std::clamp<std::int64_t>(wire.ramp_ns, 1, kLongestNs);
  received.stale_after_ns = std::clamp<std::int64_t>(wire.stale_after_ns, 0, kLongestNs);
  received.zero_after_ns = model_zero_after_ns(received.stale_after_ns);
  // A force that cannot end within the shortest ramp must not begin.
  received.limits = stoppable_within(
      smaller_of({wire.max_force_n, wire.max_torque_nm, wire.max_force_slew_n_per_s,
                  wire.max_torque_slew_nm_per_s},
                 {device.max_force_n, device.max_torque_nm, device.max_force_slew_n_per_s, 0.0}),
      std::min(received.ramp_ns, received.zero_after_ns - received.stale_after_ns));
  const double scale = in_world ? 1.0 : wire.mapping.force_scale * wire.mapping.motion_scale;
  limit_damping(model, device.max_damping_n_s_per_m / scale);
  couple_model(model, device.max_stiffness_n_per_m / scale);
  received.engaged = (wire.flags & suture_v1_MODEL_ENGAGED) != 0;
  received.stopped = (wire.flags & suture_v1_MODEL_STOPPED) != 0;
  received.arrived_ns = arrived_ns;
  return true;
}

void ModelRenderer::receive(const v1::HapticModel& wire, std::int64_t now_ns) noexcept {
  if (receive_model(wire, now_ns, device_, models_.back(),
                    in_world_.load(std::memory_order_relaxed))) {
    models_.publish();
  } else {
    refused_ns_.store(now_ns, std::memory_order_relaxed);
  }
}

// Looks at a hand before anything follows it.
void ModelRenderer::heed(const Hand& hand, std::int64_t taken_ns) noexcept {
  if (taken_ns == 0 || (has_previous_ && taken_ns <= good_ns_)) return;  // none, or seen before
  const Pose pose{hand.position_m, hand.orientation_xyzw};
  std::uint32_t fault = 0;
  switch (pose_fault(pose, hand.jaw)) {
    case PoseFault::kNotFinite:
      fault = suture_v1_FAULT_POSE_NOT_FINITE;
      break;
    case PoseFault::kQuaternion:
      fault = suture_v1_FAULT_POSE_QUATERNION;
      break;
    case PoseFault::kJaw:
      fault = suture_v1_FAULT_POSE_JAW;
      break;
    case PoseFault::kJump:
    case PoseFault::kNone:
      break;
  }
  const bool pose_is_good = fault == 0;
  if (pose_is_good && has_previous_ &&
      (hand.in_world != previous_.in_world ||
       pose_jumps({previous_.position_m, previous_.orientation_xyzw}, pose, taken_ns - good_ns_,
                  max_speed_m_per_s_))) {
    fault = suture_v1_FAULT_POSE_JUMP;
  }
  if (fault != 0) {
    latched_ |= fault;
    good_since_ns_ = taken_ns;
  }
  // A jump is a good hand in itself: the next ones are measured from there.
  if (!pose_is_good) return;
  if (!has_previous_) good_since_ns_ = taken_ns - kSettleNs;  // the server settles before it allows
  if (has_previous_ && taken_ns - good_ns_ >= hand_stale_ns_ + kHandFadeNs)
    good_since_ns_ = taken_ns;  // was gone
  previous_ = hand;
  in_world_.store(hand.in_world, std::memory_order_relaxed);
  good_ns_ = taken_ns;
  has_previous_ = true;
}

Wrench ModelRenderer::model_wrench(std::int64_t now_ns) noexcept {
  // Each model with its own mapping: a clutch renews that.
  const auto evaluate_front = [&] {
    const ReceivedModel& front = models_.front();
    if (front.arrived_ns == 0) return Wrench{};
    std::array<Pose, kModelOthersMax> others;
    for (int k = 0; k < front.model.other_count; ++k) {
      const auto i = static_cast<std::size_t>(k);
      others[i] = others_.pose(front.others[i], front.model.others[i].reference);
    }
    return evaluator_.evaluate(front.model, to_world(front.mapping, hand_),
                               {others.data(), static_cast<std::size_t>(front.model.other_count)},
                               now_ns);
  };
  if (!models_.pending()) return blend_.apply(evaluate_front(), now_ns);
  const Wrench shown = blend_.apply(evaluate_front(), now_ns);
  const bool felt = models_.front().arrived_ns != 0 && gain_.gain() > 0.0;
  const std::uint64_t epoch = models_.front().model.epoch, before = models_.front().model.sequence;
  models_.update();
  const ReceivedModel& front = models_.front();
  // What was felt of the old world goes to zero as it was: the new one may push harder.
  if (felt && front.model.epoch != epoch && !old_world_)
    old_world_ = FeltWorld{last_, gain_.gain()};
  const Wrench next = evaluate_front();
  if (old_world_) return next;
  const bool changed = front.model.changed_sequence > before;
  blend_.swap(shown, next, now_ns, changed ? front.ramp_ns : front.blend_ns);
  return blend_.apply(next, now_ns);
}

// What the hand is to feel under `gain`, within the limits, in its own frame. The limits stand
// before the gain, or a force far beyond them would stay at them for most of a ramp; and after
// it, because they stand last.
Wrench ModelRenderer::wanted(const Wrench& world, double gain, bool& limited) const noexcept {
  const ReceivedModel& current = models_.front();
  if (old_world_)
    return limit_magnitude(times(old_world_->shown, gain / old_world_->gain), current.limits,
                           limited);
  const Wrench hand =
      limit_magnitude(to_hand(current.mapping, hand_, world), current.limits, limited);
  return limit_magnitude(times(hand, gain), current.limits, limited);
}

double ModelRenderer::ceiling(bool allowed, std::int64_t now_ns) noexcept {
  if (!allowed && allowed_) {
    phase_at_fade_ = gain_.phase();
    fade_since_ns_ = now_ns;
  }
  const ReceivedModel& current = models_.front();
  const double fresh =
      freshness(now_ns - current.arrived_ns, current.stale_after_ns, current.zero_after_ns);
  if (allowed)
    return std::min(fresh,
                    freshness(now_ns - good_ns_, hand_stale_ns_, hand_stale_ns_ + kHandFadeNs));
  return std::min(fresh, phase_at_fade_ * freshness(now_ns - fade_since_ns_, 0, current.ramp_ns));
}

Force ModelRenderer::render(const Hand& hand, std::int64_t taken_ns, const Force& server, bool stop,
                            std::int64_t now_ns) noexcept {
  const std::int64_t elapsed_ns =
      rendered_ns_ == 0 ? 0 : std::clamp<std::int64_t>(now_ns - rendered_ns_, 0, kSlewWindowNs);
  rendered_ns_ = now_ns;
  heed(hand, taken_ns);
  const bool good_hand = has_previous_ && good_ns_ - good_since_ns_ >= kSettleNs;

  // That the server has fallen silent is for the models' age to judge.
  const auto permitted = [&](const ReceivedModel& model) {
    return model.engaged && !model.stopped && !stop && good_hand &&
           (latched_ & suture_v1_FAULT_ENERGY) == 0 &&
           (server.state == ForceState::kRendering || server.state == ForceState::kRamping ||
            server.state == ForceState::kServerSilent);
  };
  const bool at_zero = gain_.phase() == 0.0 && is_zero(last_);
  if (at_zero) {
    old_world_.reset();
    blend_.clear();
  }
  // A hand that is not to be followed is frozen until the force is at zero.
  if (at_zero || (allowed_ && permitted(models_.front()))) hand_ = previous_;
  Force force = server;
  force.force_n = force.torque_nm = {};
  const Wrench world = model_wrench(now_ns);
  const ReceivedModel& current = models_.front();
  if (current.arrived_ns == 0) return force;

  // What has begun to fade fades to the end.
  const bool allowed = permitted(current) && !old_world_ && (allowed_ || at_zero);
  const double top = ceiling(allowed, now_ns);
  if (allowed && !allowed_) energy_.restart();
  allowed_ = allowed;
  const double gain = gain_.update(top, elapsed_ns);
  if (allowed && gain_.phase() >= 1.0) latched_ = 0;
  // Over once the force was at zero and the hand has settled; then the ramp.
  if (!allowed && gain_.phase() == 0.0 && good_hand) {
    latched_ &= ~std::uint32_t{suture_v1_FAULT_ENERGY};
  }
  bool limited = false;
  bool slewed = false;
  last_ = limit_slew(wanted(world, gain, limited), last_, elapsed_ns, current.limits, slewed);
  force.force_n = last_.force_n;
  force.torque_nm = last_.torque_nm;

  if (allowed) {
    const double scale =
        hand_.in_world ? 1.0 : current.mapping.force_scale / current.mapping.motion_scale;
    if (!energy_.update(last_, {hand_.position_m, hand_.orientation_xyzw},
                        scale * recoverable_energy_j(current.model, world), elapsed_ns)) {
      latched_ |= suture_v1_FAULT_ENERGY;
    }
  }
  // It settles at zero before it begins again.
  if ((latched_ & suture_v1_FAULT_ENERGY) != 0 && gain_.phase() > 0.0) good_since_ns_ = now_ns;
  ongoing_ = 0;
  if (limited) ongoing_ |= suture_v1_FAULT_FORCE_LIMIT;
  if (slewed) ongoing_ |= suture_v1_FAULT_SLEW_LIMIT;
  if (hand_stale_.update(now_ns - good_ns_ > hand_stale_ns_, now_ns))
    ongoing_ |= suture_v1_FAULT_POSE_STALE;
  if (model_stale_.update(now_ns - current.arrived_ns > current.stale_after_ns, now_ns))
    ongoing_ |= suture_v1_FAULT_MODEL_STALE;
  if (refused_ns_.load(std::memory_order_relaxed) > current.arrived_ns)
    ongoing_ |= suture_v1_FAULT_MODEL_NOT_FINITE;
  if (evaluator_.fallbacks() != last_fallbacks_) ongoing_ |= suture_v1_FAULT_MODEL_PIVOTS;
  last_fallbacks_ = evaluator_.fallbacks();

  force.faults |= faults();
  if (allowed && server.state == ForceState::kServerSilent && top < 1.0) {
    force.state = ForceState::kServerSilent;
  } else if (allowed) {
    force.state = gain < 1.0 ? ForceState::kRamping : ForceState::kRendering;
  } else if (stop) {
    force.state = ForceState::kStopped;
    force.faults |= suture_v1_FAULT_STOPPED;
  } else if (old_world_ && server.state == ForceState::kRendering) {
    force.state = ForceState::kRamping;
  } else if (latched_ != 0 &&
             (server.state == ForceState::kRendering || server.state == ForceState::kRamping)) {
    force.state = ForceState::kFault;
  }
  force.model_age_us = static_cast<std::uint32_t>(
      std::clamp<std::int64_t>((now_ns - current.arrived_ns) / 1000, 0, UINT32_MAX));
  force.touching = current.model.touching;
  force.holding = current.model.holding;
  return force;
}

}  // namespace suture
