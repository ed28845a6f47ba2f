// SPDX-License-Identifier: GPL-3.0-or-later
// The haptic model of a spring, as it travels.
#pragma once

#include <cstdint>
#include <limits>

#include "protocol/types.hpp"

namespace sutured::testing {

/// A spring to the world's origin, the same in all directions, of the tool "driver": engaged,
/// unscaled, with limits of 3 N, 0.1 N m, 500 N/s and 15 N m/s.
inline suture::v1::HapticModel spring_model(double stiffness_n_per_m, std::uint64_t sequence = 1) {
  constexpr std::int64_t kMillisecond_ns = 1'000'000;
  suture::v1::HapticModel wire{};
  suture::set_text(wire.tool, "driver");
  wire.epoch = 1;
  wire.sequence_number = sequence;
  wire.flags = suture_v1_MODEL_TOUCHING | suture_v1_MODEL_ENGAGED;
  wire.reference_orientation_xyzw[3] = 1.0;
  for (int i = 0; i < 3; ++i)
    wire.stiffness[7 * i] = wire.bilateral_stiffness[7 * i] = stiffness_n_per_m;
  wire.radius_m = std::numeric_limits<double>::infinity();
  wire.norm_length_m = 0.01;
  wire.max_force_n = 3.0;
  wire.max_torque_nm = 0.1;
  wire.max_force_slew_n_per_s = 500.0;
  wire.max_torque_slew_nm_per_s = 15.0;
  wire.stale_after_ns = 20 * kMillisecond_ns;
  wire.blend_ns = 4 * kMillisecond_ns;
  wire.ramp_ns = 30 * kMillisecond_ns;
  wire.mapping.orientation_xyzw[3] = wire.mapping.tool_orientation_xyzw[3] = 1.0;
  wire.mapping.motion_scale = wire.mapping.force_scale = 1.0;
  return wire;
}

}  // namespace sutured::testing
