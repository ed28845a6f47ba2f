// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

namespace sutured::haptics {

inline constexpr int kSupervisorPriority = 68;  ///< below the receive thread's

/// What this process may do about its own timing, and what is missing and why.
struct RealtimeReport {
  bool sched_fifo = false;     ///< the force threads run under SCHED_FIFO
  bool memory_locked = false;  ///< pages once touched stay
  std::string note;            ///< what is missing, and the mend; empty: nothing
};

/// Locks memory where that is safe, and finds out whether SCHED_FIFO is permitted.
///
/// With a finite RLIMIT_MEMLOCK and without CAP_IPC_LOCK memory is not locked: later
/// allocations beyond the limit would fail. Call before other threads start.
[[nodiscard]] RealtimeReport prepare_realtime();

/// Puts the calling thread under SCHED_FIFO; false where not permitted.
bool enter_realtime(int priority) noexcept;

/// Lets the calling thread go before ordinary ones (nice −10) where that is permitted. For
/// the simulation, which may use a whole core and so must not be SCHED_FIFO.
void go_before_ordinary_threads() noexcept;

/// Lets the calling thread go behind ordinary ones (nice 10): for what may come late.
void go_behind_ordinary_threads() noexcept;

/// Names the calling thread, for debuggers and `top -H` (15 characters).
void name_thread(const char* name) noexcept;

}  // namespace sutured::haptics
