// SPDX-License-Identifier: Apache-2.0
// What a pose must be before a force may follow it. The server checks each pose that it is
// sent, the SDK each hand that it renders itself: one rule for both.
#pragma once

#include <cstdint>

#include "protocol/haptic_model.hpp"

namespace suture {

/// No coordinate of a position is beyond this, in the device's frame or the world: squares and
/// products of what lies farther off need not be finite.
inline constexpr double kPositionMax_m = 1e3;

/// What is wrong with a pose.
enum class PoseFault : std::uint8_t {
  kNone,
  kNotFinite,   ///< NaN, infinity, or a position beyond kPositionMax_m
  kQuaternion,  ///< not of unit length
  kJaw,         ///< outside 0 … 1
  kJump,        ///< farther from the last one than the tool can have moved
};

/// Returns what is wrong with `pose` and `jaw` by themselves; never kJump.
[[nodiscard]] PoseFault pose_fault(const Pose& pose, double jaw) noexcept;

/// Says whether a hand cannot have come from `before` to `now` within `elapsed_ns`, with 5 ms
/// of slack because poses a millisecond apart may arrive together. Turning: at most 60 rad/s.
[[nodiscard]] bool pose_jumps(const Pose& before, const Pose& now, std::int64_t elapsed_ns,
                              double max_speed_m_per_s) noexcept;

}  // namespace suture
