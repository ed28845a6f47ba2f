// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>

#include "protocol/latency_histogram.hpp"

namespace sutured::haptics {

/// Percentiles of what was recorded in one period.
struct LatencySummary {
  std::uint64_t count = 0;
  double p50_us = 0.0, p99_us = 0.0, p999_us = 0.0, max_us = 0.0;
};

/// Counts durations, and summarises those of each period.
///
/// Threads: one records, wait-free; one asks for summaries. Allocates: nothing.
class PeriodLatency {
 public:
  void record(std::int64_t duration_ns) noexcept { all_.record(duration_ns); }

  /// Returns the percentiles of what was recorded since the last call.
  LatencySummary take() noexcept {
    std::array<std::uint32_t, kBuckets> fresh;
    LatencySummary summary;
    for (std::size_t i = 0; i < kBuckets; ++i) {
      const std::uint32_t now = all_.count_in(i);
      fresh[i] = now - taken_[i];  // modulo 2³², as the counts
      taken_[i] = now;
      summary.count += fresh[i];
    }
    std::uint64_t seen = 0;
    for (std::size_t i = 0; i < kBuckets; ++i) {
      if (fresh[i] == 0) continue;
      const double end_us = static_cast<double>(suture::LatencyHistogram::bucket_end_ns(i)) * 1e-3;
      const auto holds_rank_of = [&](double share) {
        const double rank = share * static_cast<double>(summary.count);
        return static_cast<double>(seen) < rank && static_cast<double>(seen + fresh[i]) >= rank;
      };
      if (holds_rank_of(0.5)) summary.p50_us = end_us;
      if (holds_rank_of(0.99)) summary.p99_us = end_us;
      if (holds_rank_of(0.999)) summary.p999_us = end_us;
      seen += fresh[i];
      summary.max_us = end_us;
    }
    return summary;
  }

 private:
  static constexpr std::size_t kBuckets = suture::LatencyHistogram::kBuckets;

  suture::LatencyHistogram all_;
  std::array<std::uint32_t, kBuckets> taken_{};
};

}  // namespace sutured::haptics
