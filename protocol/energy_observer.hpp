// SPDX-License-Identifier: Apache-2.0
// Watches that a rendered force is passive: that a hand does not get more energy out of the
// tissue than hand and tissue have put in.
#pragma once

#include <cstdint>

#include "protocol/haptic_model.hpp"

namespace suture {

/// How much energy a hand may be given that it did not put in.
struct EnergyBound {
  /// At once (J). A tenth of a watt for a tenth of a second: nudges a hand, moves none.
  double energy_j = 0.010;
  /// In the long run (W): what the tissue may put in, moved by other tools or at a change of
  /// the world, without being taken for a fault.
  double power_w = 0.010;
};

/// Adds up the work of a force on a hand, from the beginning of an engagement.
///
///     ΔE = ½ (f_a + f_b) · Δp + ½ (τ_a + τ_b) · Δθ         given to the hand in a tick
///     D  ← max(D + ΔE − P Δt [D > 0],  −(2 R + B))           the hand's debt
///     passive while D ≤ B
///
///   D  what the hand was given beyond what it had put in; negative: its credit
///   R  what is stored in the model now and can be got back; see `recoverable_energy_j`
///   B  EnergyBound::energy_j           P  EnergyBound::power_w
///
/// The trapezoid is exact for a force linear along the tick, so a closed loop in a symmetric
/// model adds nothing; holding the force over a tick, which every sampled device does, is not
/// counted here: it costs k T / 2 of the device's own damping, which is what the device's
/// stiffness limit is for (protocol/virtual_coupling.hpp).
///
/// Why the floor: work that the tissue has eaten (friction, a puncture) must not stay to the
/// hand's credit, or an hour of honest sewing would hide a minute of instability. Only what
/// the tissue can still give back stays; twice of it, because R is an estimate from one
/// tangent, and B once more for what the estimate leaves out.
///
/// So whatever came before, an active force is found before it has given 2 R + 2 B + P t.
///
/// Thread: one at a time. Allocates: nothing. Cost: a few dozen flops.
class EnergyObserver {
 public:
  EnergyObserver() = default;
  explicit EnergyObserver(EnergyBound bound) noexcept : bound_(bound) {}

  /// Begins an engagement: nothing is owed, nothing was given.
  void restart() noexcept;

  /// Adds a tick: `wrench` is what the hand feels at `pose`, both in the hand's frame and
  /// scale, `stored_j` what it could get back there. Returns false once the bound is passed,
  /// until `restart`.
  bool update(const Wrench& wrench, const Pose& pose, double stored_j,
              std::int64_t elapsed_ns) noexcept;

  /// Returns the energy given to the hand since `restart` (J), less what it put in.
  [[nodiscard]] double given_j() const noexcept { return given_j_; }
  /// Returns D (J).
  [[nodiscard]] double debt_j() const noexcept { return debt_j_; }
  /// Returns the largest D since construction (J).
  [[nodiscard]] double peak_debt_j() const noexcept { return peak_debt_j_; }
  [[nodiscard]] const EnergyBound& bound() const noexcept { return bound_; }

 private:
  EnergyBound bound_;
  bool begun_ = false, passed_ = false;
  Pose pose_;
  Wrench wrench_;
  double given_j_ = 0.0, debt_j_ = 0.0, peak_debt_j_ = 0.0;
};

/// Returns what a hand that feels `wrench` (world, before scaling) can get back by letting go
/// along it (J):
///
///     R = |f|² / (2 k_f),   k_f = f̂ᵀ A f̂ of the model's stiffness, at least 10 N/m
///
/// and the same for the torque, at least 1e-3 N·m/rad. Softer than that is no spring: friction
/// along a slide.
[[nodiscard]] double recoverable_energy_j(const HapticModel& model, const Wrench& wrench) noexcept;

}  // namespace suture
