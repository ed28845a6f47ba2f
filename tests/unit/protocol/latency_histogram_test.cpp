// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/latency_histogram.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace suture {
namespace {

TEST(LatencyHistogram, IsWithinItsBucketWidthOfTheSortedTruth) {
  std::mt19937_64 random(7);
  std::lognormal_distribution<double> durations(11.0, 2.0);  // microseconds to seconds
  LatencyHistogram histogram;
  std::vector<std::int64_t> all;
  for (int i = 0; i < 20'000; ++i) {
    const auto value = static_cast<std::int64_t>(durations(random));
    histogram.record(value);
    all.push_back(value);
  }
  std::sort(all.begin(), all.end());
  for (const double fraction : {0.0001, 0.1, 0.5, 0.9, 0.99, 0.999, 1.0}) {
    const auto rank = static_cast<std::size_t>(std::ceil(fraction * 20'000.0)) - 1;
    const auto truth = static_cast<double>(all[rank]);
    const auto got = static_cast<double>(histogram.percentile_ns(fraction));
    EXPECT_GE(got, truth) << fraction;
    EXPECT_LE(got, truth * (1.0 + 1.0 / 64.0) + 1.0) << fraction;
  }
  EXPECT_EQ(histogram.count(), 20'000U);
  EXPECT_EQ(histogram.max_ns(), all.back());
}

TEST(LatencyHistogram, TakesTheImpossible) {
  LatencyHistogram histogram;
  EXPECT_EQ(histogram.percentile_ns(0.5), 0);
  histogram.record(-5);  // a clock that was set back
  histogram.record(std::int64_t{1} << 60);
  EXPECT_EQ(histogram.percentile_ns(0.5), 0);
  EXPECT_EQ(histogram.max_ns(), std::int64_t{1} << 60);
  EXPECT_EQ(histogram.count(), 2U);
  histogram.clear();
  EXPECT_EQ(histogram.count(), 0U);
}

}  // namespace
}  // namespace suture
