// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstdint>

namespace suture {

/// Counts durations in buckets of at most 1.6 % width, from a nanosecond to minutes, and
/// returns percentiles of them. Recording neither allocates nor waits. 8 kB.
/// Threads: one records, any may read meanwhile.
///
/// A bucket is a power of two cut into 64: b(v) = 64 (e − 6) + (v >> (e − 6)) for
/// v = 2^e …, the same as v itself below 64.
class LatencyHistogram {
 public:
  void record(std::int64_t duration_ns) noexcept {
    const std::uint64_t value = duration_ns > 0 ? static_cast<std::uint64_t>(duration_ns) : 0U;
    // One writer: a plain add, made of two atomic accesses for the readers' sake.
    std::atomic<std::uint32_t>& count = counts_[bucket(value)];
    count.store(count.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
    if (value > max_.load(std::memory_order_relaxed)) {
      max_.store(value, std::memory_order_relaxed);
    }
  }

  [[nodiscard]] std::uint64_t count() const noexcept {
    std::uint64_t total = 0;
    for (const auto& count : counts_) total += count.load(std::memory_order_relaxed);
    return total;
  }

  [[nodiscard]] std::int64_t max_ns() const noexcept {
    return static_cast<std::int64_t>(max_.load(std::memory_order_relaxed));
  }

  /// Returns the duration that `fraction` (0 … 1) of the recorded ones do not pass, at
  /// most 1.6 % above the truth; 0 where nothing was recorded.
  [[nodiscard]] std::int64_t percentile_ns(double fraction) const noexcept {
    const double rank = fraction * static_cast<double>(count());
    std::uint64_t below = 0;
    for (std::size_t i = 0; i < counts_.size(); ++i) {
      below += counts_[i].load(std::memory_order_relaxed);
      if (below > 0 && static_cast<double>(below) >= rank) {
        const auto bound = static_cast<std::int64_t>(upper_bound(i));
        return bound < max_ns() ? bound : max_ns();
      }
    }
    return max_ns();
  }

  /// Returns how many durations fell into bucket `index` < kBuckets since the beginning.
  [[nodiscard]] std::uint32_t count_in(std::size_t index) const noexcept {
    return counts_[index].load(std::memory_order_relaxed);
  }
  /// Returns the longest duration of that bucket (ns).
  [[nodiscard]] static constexpr std::uint64_t bucket_end_ns(std::size_t index) noexcept {
    return upper_bound(index);
  }

  /// Forgets everything. The recording thread only.
  void clear() noexcept {
    for (auto& count : counts_) count.store(0, std::memory_order_relaxed);
    max_.store(0, std::memory_order_relaxed);
  }

 private:
  static constexpr unsigned kBits = 6;     // 64 buckets a power of two
  static constexpr unsigned kTopBit = 37;  // the last power of two: 137 s

 public:
  static constexpr std::size_t kBuckets = (kTopBit - kBits + 2) << kBits;

 private:
  static constexpr std::size_t bucket(std::uint64_t value) noexcept {
    if (value < (1U << kBits)) return static_cast<std::size_t>(value);
    constexpr std::uint64_t kLimit = (std::uint64_t{1} << (kTopBit + 1)) - 1;
    if (value > kLimit) value = kLimit;
    const unsigned shift = static_cast<unsigned>(std::bit_width(value)) - 1 - kBits;
    return (std::size_t{shift} << kBits) + static_cast<std::size_t>(value >> shift);
  }
  static constexpr std::uint64_t upper_bound(std::size_t index) noexcept {
    if (index < (2U << kBits)) return index;
    const unsigned shift = static_cast<unsigned>(index >> kBits) - 1;
    const std::uint64_t mantissa = index - (std::uint64_t{shift} << kBits);
    return ((mantissa + 1) << shift) - 1;
  }

  std::array<std::atomic<std::uint32_t>, kBuckets> counts_{};
  std::atomic<std::uint64_t> max_{0};
};

}  // namespace suture
