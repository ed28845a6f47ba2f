// SPDX-License-Identifier: Apache-2.0
#include "protocol/pose_check.hpp"

#include <algorithm>
#include <cmath>

#include "protocol/finite.hpp"

namespace suture {
namespace {

constexpr std::int64_t kJitter_ns = 5'000'000;
constexpr double kMaxSpin_rad_per_s = 60.0;
constexpr double kQuaternionTolerance = 1e-3;
constexpr double kJawTolerance = 1e-3;

}  // namespace

PoseFault pose_fault(const Pose& pose, double jaw) noexcept {
  const auto& q = pose.orientation_xyzw;
  const auto& p = pose.position_m;
  const bool near =
      std::all_of(p.begin(), p.end(), [](double x) { return std::abs(x) <= kPositionMax_m; });
  if (!near || !all_finite(q) || !std::isfinite(jaw)) return PoseFault::kNotFinite;
  const double norm = std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3]));
  if (!(std::abs(norm - 1.0) <= kQuaternionTolerance)) return PoseFault::kQuaternion;
  if (jaw < -kJawTolerance || jaw > 1.0 + kJawTolerance) return PoseFault::kJaw;
  return PoseFault::kNone;
}

bool pose_jumps(const Pose& before, const Pose& now, std::int64_t elapsed_ns,
                double max_speed_m_per_s) noexcept {
  const double elapsed_s =
      static_cast<double>(std::max<std::int64_t>(elapsed_ns, 0) + kJitter_ns) * 1e-9;
  const Twist xi = motion_between(before, now);
  return std::hypot(xi[0], xi[1], xi[2]) > max_speed_m_per_s * elapsed_s ||
         std::hypot(xi[3], xi[4], xi[5]) > kMaxSpin_rad_per_s * elapsed_s;
}

}  // namespace suture
