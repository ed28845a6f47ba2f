// SPDX-License-Identifier: Apache-2.0
#include "force_guard.hpp"

#include <algorithm>

#include "protocol/finite.hpp"
#include "protocol/types.hpp"

namespace suture {

ForceGuard::ForceGuard(std::int64_t silent_after_ns) noexcept : silent_after_ns_(silent_after_ns) {
  gain_.update(1.0, kRiseNs);  // the server has its own ramp for a beginning
}

Force ForceGuard::show(const Force& last, std::int64_t arrival_ns, bool stop,
                       std::int64_t now_ns) noexcept {
  if (!stop) {
    stop_since_ns_ = 0;
  } else if (stop_since_ns_ == 0) {
    stop_since_ns_ = now_ns;
  }
  if (arrival_ns == 0) return {};
  Force shown = last;
  const std::int64_t elapsed_ns = shown_at_ns_ == 0 ? 0 : now_ns - shown_at_ns_;
  shown_at_ns_ = now_ns;

  const std::int64_t age_ns = now_ns - arrival_ns;
  double ceiling = freshness(age_ns, silent_after_ns_, silent_after_ns_ + kFadeNs);
  if (stop) ceiling = std::min(ceiling, freshness(now_ns - stop_since_ns_, 0, kFadeNs));
  const double gain = gain_.update(ceiling, elapsed_ns);
  if (stop) {
    shown.state = ForceState::kStopped;
  } else if (age_ns > silent_after_ns_) {
    shown.state = ForceState::kServerSilent;
  } else if (gain < 1.0) {
    shown.state = ForceState::kRamping;
  }
  // A server sends no such thing; what would reach a hand is looked at all the same.
  if (!all_finite(shown.force_n) || !all_finite(shown.torque_nm)) {
    shown.force_n = shown.torque_nm = {};
    shown.state = ForceState::kFault;
    gain_.clear();
  }
  for (std::size_t i = 0; i < 3; ++i) {
    shown.force_n[i] *= gain;
    shown.torque_nm[i] *= gain;
  }
  return shown;
}

Force kept_within(const ForceLimits& limits, Force force, const Force& last,
                  std::int64_t elapsed_ns) noexcept {
  bool limited = false, slewed = false;
  const Wrench allowed =
      limit_slew(limit_magnitude({force.force_n, force.torque_nm}, limits, limited),
                 {last.force_n, last.torque_nm}, elapsed_ns, limits, slewed);
  force.force_n = allowed.force_n;
  force.torque_nm = allowed.torque_nm;
  if (limited) force.faults |= suture_v1_FAULT_FORCE_LIMIT;
  return force;
}

}  // namespace suture
