// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <thread>

#include "haptics/period_latency.hpp"

namespace sutured::haptics {

/// Where a tick on an absolute clock begins next, and how many were missed.
struct NextTick {
  std::int64_t at_ns;
  std::uint64_t missed;
};

/// Returns the tick after the one due at `due_ns`, for a thread that is ready at
/// `now_ns`. Overrun policy: ticks whose time has passed are skipped and counted, never
/// caught up in a burst; the grid of the clock stays where it was.
[[nodiscard]] constexpr NextTick next_tick(std::int64_t due_ns, std::int64_t now_ns,
                                           std::int64_t period_ns) noexcept {
  const std::int64_t next_ns = due_ns + period_ns;
  if (now_ns < next_ns) return {next_ns, 0};
  const std::int64_t missed = (now_ns - next_ns) / period_ns + 1;
  return {next_ns + missed * period_ns, static_cast<std::uint64_t>(missed)};
}

/// Sleeps until the monotonic clock shows `time_ns`.
void sleep_until(std::int64_t time_ns) noexcept;

/// Calls a tick at 1 kHz by an absolute clock, on a thread of its own, in real time
/// where permitted.
///
/// The tick gets the monotonic time and must not throw, allocate, lock or wait.
class Supervisor {
 public:
  static constexpr std::int64_t kPeriod_ns = 1'000'000;

  explicit Supervisor(std::function<void(std::int64_t now_ns)> tick);
  ~Supervisor();  ///< stops it
  Supervisor(const Supervisor&) = delete;
  Supervisor& operator=(const Supervisor&) = delete;

  /// Returns how late it woke since the last call. One caller.
  LatencySummary take_wakeup() noexcept { return wakeup_.take(); }
  [[nodiscard]] std::uint64_t missed_ticks() const noexcept {
    return missed_.load(std::memory_order_relaxed);
  }
  /// Returns how many ticks were done.
  [[nodiscard]] std::uint64_t ticks() const noexcept {
    return ticks_.load(std::memory_order_relaxed);
  }
  /// True where the thread runs under SCHED_FIFO.
  [[nodiscard]] bool realtime() const noexcept { return realtime_.load(std::memory_order_relaxed); }

 private:
  void run() noexcept;

  std::function<void(std::int64_t)> tick_;
  PeriodLatency wakeup_;
  std::atomic<std::uint64_t> ticks_{0}, missed_{0};
  std::atomic<bool> realtime_{false}, stop_{false};
  std::thread thread_;
};

}  // namespace sutured::haptics
