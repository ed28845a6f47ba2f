// SPDX-License-Identifier: GPL-3.0-or-later
// Counts heap allocations and locks, so that a test can claim "this allocates nothing and
// locks nothing".
//
// Link `sutured_heap_guard` into the test: it puts counting versions of malloc and
// its relatives before those of the C library, so that operator new and the C code of
// libraries (Cyclone DDS, CHOLMOD) count too. Sanitizers bring their own malloc: the
// counters then stay at zero and `HeapGuard::active()` says so; skip the claim there.
//
//     HeapGuard guard;
//     hot_call();
//     EXPECT_EQ(guard.allocations(), 0U);
//     EXPECT_EQ(guard.locks(), 0U);
#pragma once

#include <cstdint>

namespace sutured::testing {

/// Counts allocations (malloc, calloc, realloc, aligned ones) since its construction.
/// Costs a thread-local and an atomic increment an allocation.
class HeapGuard {
 public:
  HeapGuard() noexcept;

  /// Returns how often the present thread allocated. Call on the constructing thread.
  [[nodiscard]] std::uint64_t allocations() const noexcept;
  /// Returns how often any thread of the process allocated.
  [[nodiscard]] std::uint64_t allocations_of_process() const noexcept;
  /// Returns how often the present thread freed memory.
  [[nodiscard]] std::uint64_t frees() const noexcept;

  /// Returns how often the present thread locked, or tried to, a mutex or a read-write lock
  /// of pthreads: what std::mutex and its relatives come down to. Unlike with malloc, only calls
  /// that the dynamic linker binds are seen, of this program and its libraries.
  [[nodiscard]] std::uint64_t locks() const noexcept;

  /// False in builds with a sanitizer, where nothing is counted.
  [[nodiscard]] static bool active() noexcept;

  /// Aborts the process at the next allocation of this thread, for a stack in a
  /// debugger; `false` ends that.
  static void abort_on_allocation(bool on) noexcept;

 private:
  std::uint64_t thread_start_;
  std::uint64_t process_start_;
  std::uint64_t frees_start_;
  std::uint64_t locks_start_;
};

}  // namespace sutured::testing
