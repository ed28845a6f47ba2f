// SPDX-License-Identifier: Apache-2.0
// From a model's wrench to one that may be sent to a hand. Both ends use it: the server
// for ToolForce, the SDK where it renders on the device's own machine.
//
//     wrench of the model ─▶ blend at a swap ─▶ × gain ─▶ limits: magnitude, then slew ─▶ hand
//
// The limits stand last, always, so that nothing before them has to be right for a hand
// to be safe. Nothing here reads a clock.
#pragma once

#include <cstdint>

#include "protocol/haptic_model.hpp"

namespace suture {

/// The most a device may show, in magnitude and in change. All positive.
struct ForceLimits {
  double max_force_n = 3.3;
  double max_torque_nm = 0.1;
  double max_force_slew_n_per_s = 500.0;
  double max_torque_slew_nm_per_s = 15.0;
};

/// Returns `limits` with the magnitudes lowered, where the slew asks for it, to what the
/// slew can take to zero in a ramp of `ramp_ns`: a force that cannot end in time must not
/// begin. The ramp's steepest slope is 1.5 times its mean.
[[nodiscard]] ForceLimits stoppable_within(const ForceLimits& limits,
                                           std::int64_t ramp_ns) noexcept;

/// Returns `wrench` shortened, without turning, to the magnitudes of `limits`. A part that
/// is not finite becomes zero. Sets `limited` where it changed anything; else leaves it.
[[nodiscard]] Wrench limit_magnitude(const Wrench& wrench, const ForceLimits& limits,
                                     bool& limited) noexcept;

/// Returns the wrench nearest `wanted` on the straight way from `last` that the slew
/// limits allow after `elapsed_ns`. Between two wrenches within the magnitudes it stays
/// within them.
[[nodiscard]] Wrench limit_slew(const Wrench& wanted, const Wrench& last, std::int64_t elapsed_ns,
                                const ForceLimits& limits, bool& limited) noexcept;

/// Returns 3 x² − 2 x³, for x ∈ [0, 1]: a ramp that starts and ends without a kink.
[[nodiscard]] constexpr double smoothstep(double x) noexcept { return x * x * (3.0 - 2.0 * x); }

/// Takes the step out of a change of model: at the swap the difference between the two
/// models at the same pose is kept, and fades within a few milliseconds.
///
///     w(t) = w_new(ξ) + β(t) (w_shown − w_new)(ξ_swap),   β: 1 → 0
///
/// The hand's own motion goes through w_new at once: no filter, no lag. A change of the world
/// takes longer than the time to the next model; its fade then goes on as it began, and the
/// next swap adds only its own difference.
class SwapBlend {
 public:
  /// Starts a blend from `shown` (this blend's last result, renewed for the present pose)
  /// to `next` at the same pose.
  void swap(const Wrench& shown, const Wrench& next, std::int64_t now_ns,
            std::int64_t duration_ns) noexcept;
  [[nodiscard]] Wrench apply(const Wrench& wrench, std::int64_t now_ns) const noexcept;
  /// Says whether nothing of the difference is left.
  [[nodiscard]] bool over(std::int64_t now_ns) const noexcept {
    return now_ns >= slow_.end_ns && now_ns >= quick_.end_ns;
  }
  void clear() noexcept { *this = {}; }

 private:
  struct Fade {
    Wrench offset;
    std::int64_t start_ns = 0, end_ns = 0;
    void add_to(Wrench& wrench, std::int64_t now_ns, double sign) const noexcept;
  };
  Fade slow_, quick_;  // the one that ends last, and what came meanwhile
};

/// Returns how much of the gain a source of age `age_ns` still allows: 1 until it is
/// `hold_ns` old, 0 from `zero_ns` on, linear between.
[[nodiscard]] double freshness(std::int64_t age_ns, std::int64_t hold_ns,
                               std::int64_t zero_ns) noexcept;

/// Returns at which age a model that goes stale at `stale_after_ns` gives no force any more:
/// 45 ms, so that a tick that comes late does not break the promised 50, and 9 ms of ramp at
/// least.
[[nodiscard]] constexpr std::int64_t model_zero_after_ns(std::int64_t stale_after_ns) noexcept {
  constexpr std::int64_t kZeroAfter_ns = 45'000'000, kRampMin_ns = 9'000'000;
  return stale_after_ns + kRampMin_ns > kZeroAfter_ns ? stale_after_ns + kRampMin_ns
                                                      : kZeroAfter_ns;
}

/// Returns the smaller of two limits, where `other` has one: not positive means none.
[[nodiscard]] ForceLimits smaller_of(const ForceLimits& limits, const ForceLimits& other) noexcept;

/// A gain that falls with its ceiling and rises by a ramp of its own.
///
/// `phase` runs linearly in [0, 1]; the gain is its smoothstep.
class RampedGain {
 public:
  explicit RampedGain(std::int64_t rise_ns) noexcept : rise_ns_(rise_ns) {}

  /// Moves on by `elapsed_ns` under `ceiling` ∈ [0, 1] and returns the gain.
  double update(double ceiling, std::int64_t elapsed_ns) noexcept;
  [[nodiscard]] double phase() const noexcept { return phase_; }
  [[nodiscard]] double gain() const noexcept { return smoothstep(phase_); }
  void clear() noexcept { phase_ = 0.0; }

 private:
  std::int64_t rise_ns_;
  double phase_ = 0.0;
};

/// A condition that ends only when it has not held for a while. One that holds every other moment,
/// as the age of what comes just in time or just late, is one condition and not a hundred.
class LastingCondition {
 public:
  explicit LastingCondition(std::int64_t quiet_ns) noexcept : quiet_ns_(quiet_ns) {}

  /// Takes in whether it holds now, and returns whether it lasts.
  bool update(bool holds, std::int64_t now_ns) noexcept {
    if (holds) until_ns_ = now_ns + quiet_ns_;
    return lasts_ = holds || now_ns < until_ns_;
  }
  /// As of the last update.
  [[nodiscard]] bool lasts() const noexcept { return lasts_; }

 private:
  std::int64_t quiet_ns_, until_ns_ = 0;
  bool lasts_ = false;
};

}  // namespace suture
