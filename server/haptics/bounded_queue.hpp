// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <utility>

namespace sutured::haptics {

/// Hands values in order from one writer to one reader; neither ever waits.
///
/// It holds at most `N` values. A writer that finds it full drops its value and counts
/// it, so that a reader that hangs costs events, not steps.
/// Allocates: only what moving a `T` does.
template <class T, std::size_t N>
class BoundedQueue {
 public:
  /// Adds `value`; false, and counted, where there is no room. Writer only.
  bool push(T value) noexcept {
    const std::size_t head = head_.load(std::memory_order_relaxed);
    if (head - tail_.load(std::memory_order_acquire) == N) {
      dropped_.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    places_[head % N] = std::move(value);
    head_.store(head + 1, std::memory_order_release);
    return true;
  }
  /// Moves the oldest value into `value`; false where there is none. Reader only.
  bool pop(T& value) noexcept {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);
    if (tail == head_.load(std::memory_order_acquire)) return false;
    value = std::move(places_[tail % N]);
    tail_.store(tail + 1, std::memory_order_release);
    return true;
  }
  /// Returns how many values found no room.
  [[nodiscard]] std::uint64_t dropped() const noexcept {
    return dropped_.load(std::memory_order_relaxed);
  }

 private:
  std::array<T, N> places_{};
  alignas(64) std::atomic<std::size_t> head_{0};
  alignas(64) std::atomic<std::size_t> tail_{0};
  std::atomic<std::uint64_t> dropped_{0};
};

}  // namespace sutured::haptics
