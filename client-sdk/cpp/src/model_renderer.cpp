// SPDX-License-Identifier: Apache-2.0
#include "model_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace suture {
namespace {

constexpr std::int64_t kSlewWindowNs = 10'000'000;  // after a pause, no more than this at once

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

// Both maps are those of idl/suture_v1.idl, Mapping.
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

Wrench to_hand(const v1::Mapping& mapping, const Hand& hand, const Wrench& world) noexcept {
  if (hand.in_world) return world;
  Quaternion back = quaternion_of(mapping.orientation_xyzw);
  for (std::size_t i = 0; i < 3; ++i) back[i] = -back[i];
  return {scaled(mapping.force_scale, rotated(back, world.force_n)),
          scaled(mapping.force_scale / mapping.motion_scale, rotated(back, world.torque_nm))};
}

bool is_rotation(const double (&q)[4]) noexcept {
  const double squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  return std::abs(squared - 1.0) < 1e-3;
}

}  // namespace

bool receive_model(const v1::HapticModel& wire, std::int64_t arrived_ns,
                   ReceivedModel& received) noexcept {
  const std::size_t rows = wire.offset_m._length;
  if (rows > kModelRowsMax || wire.compliance_m_per_n._length != rows * (rows + 1) / 2 ||
      wire.jacobian._length != 6 * rows || wire.multiplier_n._length != rows ||
      wire.multiplier_max_n._length != rows || !is_rotation(wire.reference_orientation_xyzw) ||
      !is_rotation(wire.mapping.orientation_xyzw) ||
      !is_rotation(wire.mapping.tool_orientation_xyzw) || !(wire.mapping.motion_scale > 0.0) ||
      !(wire.max_force_n > 0.0) || !(wire.max_torque_nm > 0.0) ||
      !(wire.max_force_slew_n_per_s > 0.0) || !(wire.max_torque_slew_nm_per_s > 0.0)) {
    return false;
  }
  HapticModel& model = received.model;
  model.epoch = wire.epoch;
  model.sequence = wire.sequence_number;
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
  model.characteristic_length_m = wire.norm_length_m;
  model.radius_m = wire.radius_m;
  model.touching = (wire.flags & suture_v1_MODEL_TOUCHING) != 0;
  model.world_changed = (wire.flags & suture_v1_MODEL_WORLD_CHANGED) != 0;
  model.rows = static_cast<std::int32_t>(rows);
  model.frozen_rows = static_cast<std::int32_t>(wire.frozen_rows);
  const auto take = [](const auto& sequence, double* to) {
    const auto values = span_of(sequence);
    std::copy(values.begin(), values.end(), to);
  };
  take(wire.compliance_m_per_n, model.compliance_m_per_n.data());
  take(wire.jacobian, model.jacobian[0].data());
  take(wire.offset_m, model.offset_m.data());
  take(wire.multiplier_n, model.multiplier_n.data());
  take(wire.multiplier_max_n, model.multiplier_max_n.data());

  received.mapping = wire.mapping;
  received.blend_ns = wire.blend_ns;
  received.ramp_ns = std::max<std::int64_t>(wire.ramp_ns, 1);
  // A force that cannot end within the ramp must not begin.
  received.limits = stoppable_within({wire.max_force_n, wire.max_torque_nm,
                                      wire.max_force_slew_n_per_s, wire.max_torque_slew_nm_per_s},
                                     received.ramp_ns);
  received.engaged = (wire.flags & suture_v1_MODEL_ENGAGED) != 0;
  received.stopped = (wire.flags & suture_v1_MODEL_STOPPED) != 0;
  received.arrived_ns = arrived_ns;
  return true;
}

void ModelRenderer::receive(const v1::HapticModel& wire, std::int64_t now_ns) noexcept {
  if (receive_model(wire, now_ns, models_.back())) models_.publish();
}

Wrench ModelRenderer::model_wrench(const Hand& hand, std::int64_t now_ns) noexcept {
  // Each model with its own mapping: a clutch renews that.
  const auto evaluate_front = [&] {
    const ReceivedModel& front = models_.front();
    if (front.arrived_ns == 0) return Wrench{};
    return evaluator_.evaluate(front.model, to_world(front.mapping, hand));
  };
  if (!models_.pending()) return blend_.apply(evaluate_front(), now_ns);
  const Wrench shown = blend_.apply(evaluate_front(), now_ns);
  models_.update();
  const ReceivedModel& front = models_.front();
  const Wrench next = evaluate_front();
  blend_.swap(shown, next, now_ns, front.model.world_changed ? front.ramp_ns : front.blend_ns);
  return blend_.apply(next, now_ns);
}

double ModelRenderer::ceiling(bool allowed, std::int64_t now_ns) noexcept {
  if (!allowed && allowed_) {
    phase_at_fade_ = gain_.phase();
    fade_since_ns_ = now_ns;
  }
  allowed_ = allowed;
  const ReceivedModel& current = models_.front();
  const double fresh = freshness(now_ns - current.arrived_ns, current.model.stale_after_ns,
                                 current.model.stale_after_ns + current.ramp_ns);
  if (allowed) return fresh;
  return std::min(fresh, phase_at_fade_ * freshness(now_ns - fade_since_ns_, 0, current.ramp_ns));
}

Force ModelRenderer::render(const Hand& hand, const Force& server, std::int64_t now_ns) noexcept {
  const std::int64_t elapsed_ns =
      rendered_ns_ == 0 ? 0 : std::clamp<std::int64_t>(now_ns - rendered_ns_, 0, kSlewWindowNs);
  rendered_ns_ = now_ns;
  Force force = server;
  force.force_n = force.torque_nm = {};
  const Wrench world = model_wrench(hand, now_ns);
  const ReceivedModel& current = models_.front();
  if (current.arrived_ns == 0) return force;

  // That the server has fallen silent is for the models' age to judge.
  const bool allowed =
      current.engaged && !current.stopped &&
      (server.state == ForceState::kRendering || server.state == ForceState::kRamping ||
       server.state == ForceState::kServerSilent);
  const double gain = gain_.update(ceiling(allowed, now_ns), elapsed_ns);
  Wrench wanted = to_hand(current.mapping, hand, world);
  for (std::size_t i = 0; i < 3; ++i) {
    wanted.force_n[i] *= gain;
    wanted.torque_nm[i] *= gain;
  }
  bool limited = false;
  bool slewed = false;
  wanted = limit_magnitude(wanted, current.limits, limited);
  last_ = limit_slew(wanted, last_, elapsed_ns, current.limits, slewed);
  force.force_n = last_.force_n;
  force.torque_nm = last_.torque_nm;
  if (limited) force.faults |= suture_v1_FAULT_FORCE_LIMIT;
  if (slewed) force.faults |= suture_v1_FAULT_SLEW_LIMIT;
  if (allowed) force.state = gain < 1.0 ? ForceState::kRamping : ForceState::kRendering;
  force.model_age_us = static_cast<std::uint32_t>(
      std::clamp<std::int64_t>((now_ns - current.arrived_ns) / 1000, 0, UINT32_MAX));
  force.touching = current.model.touching;
  return force;
}

}  // namespace suture
