// SPDX-License-Identifier: Apache-2.0
#include "protocol/energy_observer.hpp"

#include <algorithm>
#include <array>

namespace suture {
namespace {

constexpr double kSoftest_n_per_m = 10.0;
constexpr double kSoftest_nm_per_rad = 1e-3;

// |v|² / (2 k) along v, with k from the diagonal block of A that begins at `first`.
double released_j(const HapticModel& model, const std::array<double, 3>& v, int first,
                  double softest) noexcept {
  double squared = 0.0, along = 0.0;
  for (int i = 0; i < 3; ++i) {
    squared += v[i] * v[i];
    for (int j = 0; j < 3; ++j) along += v[i] * model.stiffness[6 * (first + i) + first + j] * v[j];
  }
  if (!(squared > 0.0)) return 0.0;
  return 0.5 * squared / std::max(along / squared, softest);
}

}  // namespace

void EnergyObserver::restart() noexcept {
  begun_ = passed_ = false;
  given_j_ = debt_j_ = 0.0;
}

bool EnergyObserver::update(const Wrench& wrench, const Pose& pose, double stored_j,
                            std::int64_t elapsed_ns) noexcept {
  if (begun_) {
    const Twist moved = motion_between(pose_, pose);
    double work_j = 0.0;
    for (int i = 0; i < 3; ++i) {
      work_j += 0.5 * (wrench_.force_n[i] + wrench.force_n[i]) * moved[i];
      work_j += 0.5 * (wrench_.torque_nm[i] + wrench.torque_nm[i]) * moved[i + 3];
    }
    given_j_ += work_j;
    debt_j_ += work_j;
    const double elapsed_s = static_cast<double>(std::max<std::int64_t>(elapsed_ns, 0)) * 1e-9;
    if (debt_j_ > 0.0) debt_j_ = std::max(debt_j_ - bound_.power_w * elapsed_s, 0.0);
    debt_j_ = std::max(debt_j_, -(2.0 * stored_j + bound_.energy_j));
    peak_debt_j_ = std::max(peak_debt_j_, debt_j_);
    passed_ |= debt_j_ > bound_.energy_j;
  }
  begun_ = true;
  pose_ = pose;
  wrench_ = wrench;
  return !passed_;
}

double recoverable_energy_j(const HapticModel& model, const Wrench& wrench) noexcept {
  return released_j(model, wrench.force_n, 0, kSoftest_n_per_m) +
         released_j(model, wrench.torque_nm, 3, kSoftest_nm_per_rad);
}

}  // namespace suture
