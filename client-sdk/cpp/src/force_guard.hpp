// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "protocol/force_shaping.hpp"
#include "suture/types.hpp"

namespace suture {

/// Keeps the force at the hand safe from what may happen on the way: silence and nonsense.
///
///     shown = gain × last force,   gain: 1 while forces arrive,
///                                  1 → 0 within 30 ms from `silent_after_ns` on,
///                                  0 → 1 within 50 ms once they arrive again,
///                                  and 1 → 0 within 30 ms while the device asks for a stop
///
/// The gain is a smoothstep, whose steepest slope is 1.5 times its mean.
///
/// The server sees to its own faults; this sees to a server, a network or a process that is gone.
/// What is not finite counts as zero: `kept_within`, which stands last, takes the step out of it.
/// Nothing here reads a clock. Thread: one. Allocates: nothing.
class ForceGuard {
 public:
  static constexpr std::int64_t kFadeNs = 30'000'000;
  static constexpr std::int64_t kRiseNs = 50'000'000;

  explicit ForceGuard(std::int64_t silent_after_ns) noexcept;

  /// Returns what to show at `now_ns`, when `last` arrived at `arrival_ns` (0: never). `stop`:
  /// the device's own stop, which waits for no server.
  [[nodiscard]] Force show(const Force& last, std::int64_t arrival_ns, bool stop,
                           std::int64_t now_ns) noexcept;

 private:
  std::int64_t silent_after_ns_;
  std::int64_t shown_at_ns_ = 0;
  std::int64_t stop_since_ns_ = 0;  // 0: no stop
  RampedGain gain_{kRiseNs};
};

/// After a pause of the ticks a force moves no farther at once than within so long.
inline constexpr std::int64_t kSlewWindowNs = 10'000'000;

/// Returns `force`, `elapsed_ns` after `last`, within `limits` in magnitude and slew: what stands
/// last before the hand, whoever rendered. The server keeps to them too; what a network does to its
/// forces (a gap, several at once), and a server that fails to, must not reach the hand.
[[nodiscard]] Force kept_within(const ForceLimits& limits, Force force, const Force& last,
                                std::int64_t elapsed_ns) noexcept;

}  // namespace suture
