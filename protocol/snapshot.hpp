// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <type_traits>

namespace suture {

/// Hands the latest value from one writer to one reader; neither ever waits or allocates.
///
/// A triple buffer: the writer owns one place, the reader another, the third lies between
/// and is exchanged atomically with its mark "newer than what the reader has".
template <class T>
class Snapshot {
  static_assert(std::is_trivially_copyable_v<T>, "a snapshot holds plain values");

 public:
  /// Makes `value` the latest. Writer only.
  void publish(const T& value) noexcept {
    places_[back_] = value;
    back_ = middle_.exchange(static_cast<std::uint8_t>(back_ | kNew), std::memory_order_acq_rel) &
            kIndex;
  }

  /// Returns the latest value, a default-made one before the first. Reader only; the
  /// reference holds until the next call.
  [[nodiscard]] const T& latest() noexcept {
    if ((middle_.load(std::memory_order_relaxed) & kNew) != 0) {
      front_ = middle_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    }
    return places_[front_];
  }

 private:
  static constexpr std::uint8_t kIndex = 3;
  static constexpr std::uint8_t kNew = 4;

  std::array<T, 3> places_{};
  alignas(64) std::uint8_t back_ = 0;
  alignas(64) std::atomic<std::uint8_t> middle_{1};
  alignas(64) std::uint8_t front_ = 2;
};

}  // namespace suture
