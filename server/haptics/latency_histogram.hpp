// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstdint>

namespace sutured::haptics {

/// Percentiles of what was recorded in one period.
struct LatencySummary {
  std::uint64_t count = 0;
  double p50_us = 0.0, p99_us = 0.0, p999_us = 0.0, max_us = 0.0;
};

/// Counts durations in buckets whose width is 1/32 of their value (within 3 %).
///
/// Threads: one records, wait-free; one asks for summaries. Allocates: nothing.
class LatencyHistogram {
 public:
  void record(std::int64_t duration_ns) noexcept {
    auto& bucket =
        buckets_[index_of(duration_ns < 0 ? 0 : static_cast<std::uint64_t>(duration_ns))];
    bucket.store(bucket.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
  }

  /// Returns the percentiles of what was recorded since the last call.
  LatencySummary take() noexcept {
    std::array<std::uint64_t, kBuckets> fresh;
    LatencySummary summary;
    for (int i = 0; i < kBuckets; ++i) {
      const std::uint64_t now = buckets_[i].load(std::memory_order_relaxed);
      fresh[i] = now - taken_[i];
      taken_[i] = now;
      summary.count += fresh[i];
    }
    std::uint64_t seen = 0;
    for (int i = 0; i < kBuckets; ++i) {
      if (fresh[i] == 0) continue;
      const double upper_us = static_cast<double>(upper_edge_ns(i)) * 1e-3;
      const auto passes = [&](double share) {
        const double rank = share * static_cast<double>(summary.count);
        return static_cast<double>(seen) < rank && static_cast<double>(seen + fresh[i]) >= rank;
      };
      if (passes(0.5)) summary.p50_us = upper_us;
      if (passes(0.99)) summary.p99_us = upper_us;
      if (passes(0.999)) summary.p999_us = upper_us;
      seen += fresh[i];
      summary.max_us = upper_us;
    }
    return summary;
  }

 private:
  static constexpr int kSub = 32, kSubBits = 5;
  static constexpr int kBuckets = kSub * 36;  // up to 2^40 ns, eighteen minutes

  static int index_of(std::uint64_t ns) noexcept {
    if (ns < kSub) return static_cast<int>(ns);
    const int shift = std::bit_width(ns) - 1 - kSubBits;
    const int index = kSub * (shift + 1) + static_cast<int>((ns >> shift) - kSub);
    return index < kBuckets ? index : kBuckets - 1;
  }
  static std::uint64_t upper_edge_ns(int index) noexcept {
    if (index < kSub) return static_cast<std::uint64_t>(index);
    const int shift = index / kSub - 1;
    return ((static_cast<std::uint64_t>(index % kSub) + kSub + 1) << shift) - 1;
  }

  std::array<std::atomic<std::uint64_t>, kBuckets> buckets_{};
  std::array<std::uint64_t, kBuckets> taken_{};
};

}  // namespace sutured::haptics
