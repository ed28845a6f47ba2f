// SPDX-License-Identifier: Apache-2.0
#include "protocol/force_shaping.hpp"

#include <algorithm>
#include <cmath>

namespace suture {
namespace {

using Array3 = std::array<double, 3>;

double length(const Array3& v) noexcept { return std::hypot(v[0], v[1], v[2]); }

Array3 shortened(const Array3& v, double max, bool& limited) noexcept {
  const double size = length(v);
  if (!std::isfinite(size)) {
    limited = true;
    return {};
  }
  if (size <= max) return v;
  limited = true;
  const double scale = max / size;
  return {v[0] * scale, v[1] * scale, v[2] * scale};
}

Array3 towards(const Array3& wanted, const Array3& last, double max_step, bool& limited) noexcept {
  const Array3 step{wanted[0] - last[0], wanted[1] - last[1], wanted[2] - last[2]};
  const double size = length(step);
  if (size <= max_step) return wanted;
  limited = true;
  const double scale = max_step / size;
  return {last[0] + step[0] * scale, last[1] + step[1] * scale, last[2] + step[2] * scale};
}

}  // namespace

ForceLimits stoppable_within(const ForceLimits& limits, std::int64_t ramp_ns) noexcept {
  constexpr double kSteepest = 1.5;
  const double reach_s = static_cast<double>(ramp_ns) * 1e-9 / kSteepest;
  ForceLimits result = limits;
  result.max_force_n = std::min(limits.max_force_n, limits.max_force_slew_n_per_s * reach_s);
  result.max_torque_nm = std::min(limits.max_torque_nm, limits.max_torque_slew_nm_per_s * reach_s);
  return result;
}

ForceLimits smaller_of(const ForceLimits& limits, const ForceLimits& other) noexcept {
  const auto smaller = [](double ours, double theirs) noexcept {
    return theirs > 0.0 ? std::min(ours, theirs) : ours;  // NaN is no limit
  };
  return {smaller(limits.max_force_n, other.max_force_n),
          smaller(limits.max_torque_nm, other.max_torque_nm),
          smaller(limits.max_force_slew_n_per_s, other.max_force_slew_n_per_s),
          smaller(limits.max_torque_slew_nm_per_s, other.max_torque_slew_nm_per_s)};
}

Wrench limit_magnitude(const Wrench& wrench, const ForceLimits& limits, bool& limited) noexcept {
  return {shortened(wrench.force_n, limits.max_force_n, limited),
          shortened(wrench.torque_nm, limits.max_torque_nm, limited)};
}

Wrench limit_slew(const Wrench& wanted, const Wrench& last, std::int64_t elapsed_ns,
                  const ForceLimits& limits, bool& limited) noexcept {
  const double elapsed_s = static_cast<double>(std::max<std::int64_t>(elapsed_ns, 0)) * 1e-9;
  return {towards(wanted.force_n, last.force_n, limits.max_force_slew_n_per_s * elapsed_s, limited),
          towards(wanted.torque_nm, last.torque_nm, limits.max_torque_slew_nm_per_s * elapsed_s,
                  limited)};
}

void SwapBlend::Fade::add_to(Wrench& wrench, std::int64_t now_ns, double sign) const noexcept {
  const double left = freshness(now_ns, start_ns, end_ns);
  if (left == 0.0) return;
  const double beta = sign * smoothstep(left);
  for (int i = 0; i < 3; ++i) {
    wrench.force_n[i] += beta * offset.force_n[i];
    wrench.torque_nm[i] += beta * offset.torque_nm[i];
  }
}

void SwapBlend::swap(const Wrench& shown, const Wrench& next, std::int64_t now_ns,
                     std::int64_t duration_ns) noexcept {
  Wrench difference;
  for (int i = 0; i < 3; ++i) {
    difference.force_n[i] = shown.force_n[i] - next.force_n[i];
    difference.torque_nm[i] = shown.torque_nm[i] - next.torque_nm[i];
  }
  const std::int64_t end_ns = now_ns + duration_ns;
  if (slow_.end_ns > end_ns) {
    slow_.add_to(difference, now_ns, -1.0);
    quick_ = {difference, now_ns, end_ns};
  } else {
    slow_ = {difference, now_ns, end_ns};
    quick_ = {};
  }
}

Wrench SwapBlend::apply(const Wrench& wrench, std::int64_t now_ns) const noexcept {
  Wrench result = wrench;
  slow_.add_to(result, now_ns, 1.0);
  quick_.add_to(result, now_ns, 1.0);
  return result;
}

double freshness(std::int64_t age_ns, std::int64_t hold_ns, std::int64_t zero_ns) noexcept {
  if (age_ns <= hold_ns) return 1.0;
  if (age_ns >= zero_ns) return 0.0;
  return static_cast<double>(zero_ns - age_ns) / static_cast<double>(zero_ns - hold_ns);
}

double RampedGain::update(double ceiling, std::int64_t elapsed_ns) noexcept {
  const double rise =
      static_cast<double>(std::max<std::int64_t>(elapsed_ns, 0)) / static_cast<double>(rise_ns_);
  phase_ = std::clamp(std::min(phase_ + rise, ceiling), 0.0, 1.0);
  return gain();
}

}  // namespace suture
