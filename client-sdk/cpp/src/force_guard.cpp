// SPDX-License-Identifier: Apache-2.0
#include "force_guard.hpp"

#include <algorithm>
#include <cmath>

namespace suture {
namespace {

bool finite(const Vector3& v) noexcept {
  return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
}

}  // namespace

Force ForceGuard::show(const Force& last, std::int64_t arrival_ns, std::int64_t now_ns) noexcept {
  if (arrival_ns == 0) return {};
  Force shown = last;
  const std::int64_t elapsed = shown_at_ns_ == 0 ? 0 : now_ns - shown_at_ns_;
  shown_at_ns_ = now_ns;

  const std::int64_t late = now_ns - arrival_ns - silent_after_ns_;
  const double ceiling =
      1.0 - std::clamp(static_cast<double>(late) / static_cast<double>(kFadeNs), 0.0, 1.0);
  const double rise = static_cast<double>(elapsed) / static_cast<double>(kRiseNs);
  gain_ = std::min(ceiling, gain_ + std::max(rise, 0.0));
  if (gain_ < 1.0) {
    shown.state = late > 0 ? ForceState::kServerSilent : ForceState::kRamping;
  }
  // A server sends no such thing; what would reach a hand is looked at all the same.
  if (!finite(shown.force_n) || !finite(shown.torque_nm)) {
    shown.force_n = shown.torque_nm = {};
    shown.state = ForceState::kFault;
    gain_ = 0.0;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    shown.force_n[i] *= gain_;
    shown.torque_nm[i] *= gain_;
  }
  return shown;
}

}  // namespace suture
