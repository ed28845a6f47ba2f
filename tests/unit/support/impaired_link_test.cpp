// SPDX-License-Identifier: GPL-3.0-or-later
#include "support/impaired_link.hpp"

#include <gtest/gtest.h>

#include <vector>

namespace sutured::testing {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr int kPackets = 100'000;

/// What becomes of packets that come a millisecond apart.
std::vector<std::optional<std::int64_t>> fates(ImpairedLink& link) {
  std::vector<std::optional<std::int64_t>> all;
  for (int i = 0; i < kPackets; ++i) all.push_back(link.departure_ns(i * kMs));
  return all;
}

TEST(ImpairedLink, LetsEverythingPassAtOnceByDefault) {
  ImpairedLink link({});
  const auto all = fates(link);
  for (int i = 0; i < kPackets; ++i) ASSERT_EQ(all[i], i * kMs);
}

TEST(ImpairedLink, RepeatsItselfFromItsSeed) {
  Impairment impairment{20 * kMs, 5 * kMs, 0.01, 0.02, 3 * kMs, 7};
  ImpairedLink first(impairment), second(impairment);
  const auto all = fates(first);
  EXPECT_EQ(all, fates(second));
  impairment.seed = 8;
  ImpairedLink other(impairment);
  EXPECT_NE(all, fates(other));
}

TEST(ImpairedLink, LosesTheShareThatIsAsked) {
  ImpairedLink link({.loss = 0.01});
  fates(link);
  EXPECT_EQ(link.lost() + link.passed(), static_cast<std::uint64_t>(kPackets));
  // 1000 expected, standard deviation 31: six of them.
  EXPECT_NEAR(static_cast<double>(link.lost()), 1000.0, 190.0);
}

TEST(ImpairedLink, KeepsTheOrderUnderJitterAndStaysWithinIt) {
  ImpairedLink link({.delay_ns = 20 * kMs, .jitter_ns = 5 * kMs});
  const auto all = fates(link);
  std::int64_t least = INT64_MAX, most = 0, before = 0;
  for (int i = 0; i < kPackets; ++i) {
    ASSERT_GE(*all[i], before);
    before = *all[i];
    least = std::min(least, before - i * kMs);
    most = std::max(most, before - i * kMs);
  }
  EXPECT_GE(least, 15 * kMs);
  EXPECT_LE(most, 25 * kMs);
  // Packets a millisecond apart wait behind slower ones; those that need not fill the range.
  EXPECT_LT(least, 17 * kMs);
  EXPECT_GT(most, 24 * kMs);
}

TEST(ImpairedLink, LetsOnlyPacketsThatAreHeldBackBeOvertaken) {
  ImpairedLink link({.delay_ns = 5 * kMs, .reordering = 0.02});
  const auto all = fates(link);
  std::uint64_t overtaken = 0;
  for (int i = 0; i + 1 < kPackets; ++i) {
    const std::int64_t delay = *all[i] - i * kMs;
    ASSERT_TRUE(delay == 5 * kMs || delay == 8 * kMs);
    overtaken += *all[i] > *all[i + 1];
  }
  EXPECT_NEAR(static_cast<double>(link.held_back()), 2000.0, 270.0);  // six deviations
  // Not overtaken: where the next one is held back as well.
  EXPECT_GT(overtaken, link.held_back() * 9 / 10);
}

}  // namespace
}  // namespace sutured::testing
