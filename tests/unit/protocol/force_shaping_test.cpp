// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/force_shaping.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace suture {
namespace {

constexpr std::int64_t kMs = 1'000'000;

double norm(const std::array<double, 3>& v) { return std::hypot(v[0], v[1], v[2]); }

TEST(LimitMagnitude, ShortensWithoutTurning) {
  const ForceLimits limits{.max_force_n = 2.0, .max_torque_nm = 0.1};
  bool limited = false;
  const Wrench w = limit_magnitude({{3.0, 0.0, 4.0}, {0.0, 0.05, 0.0}}, limits, limited);
  EXPECT_TRUE(limited);
  EXPECT_NEAR(w.force_n[0], 1.2, 1e-15);
  EXPECT_NEAR(w.force_n[2], 1.6, 1e-15);
  EXPECT_EQ(w.torque_nm[1], 0.05);
}

TEST(LimitMagnitude, MakesZeroOfWhatIsNotANumber) {
  bool limited = false;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  const Wrench w = limit_magnitude({{nan, 1.0, 0.0}, {0.0, inf, 0.0}}, {}, limited);
  EXPECT_TRUE(limited);
  EXPECT_EQ(norm(w.force_n), 0.0);
  EXPECT_EQ(norm(w.torque_nm), 0.0);
}

TEST(LimitSlew, StepsStraightTowardsWhatIsWanted) {
  const ForceLimits limits{.max_force_slew_n_per_s = 500.0, .max_torque_slew_nm_per_s = 10.0};
  bool limited = false;
  const Wrench w = limit_slew({{3.0, 4.0, 0.0}, {0.0, 0.0, 0.1}}, {}, kMs, limits, limited);
  EXPECT_TRUE(limited);
  EXPECT_NEAR(w.force_n[0], 0.3, 1e-12);
  EXPECT_NEAR(w.force_n[1], 0.4, 1e-12);
  EXPECT_NEAR(w.torque_nm[2], 0.01, 1e-12);
  EXPECT_EQ(norm(limit_slew({{3, 0, 0}, {}}, {}, -kMs, limits, limited).force_n), 0.0);
}

TEST(StoppableWithin, LowersAForceThatItsSlewCouldNotEndInTime) {
  const ForceLimits slow{.max_force_n = 3.3, .max_force_slew_n_per_s = 50.0};
  const ForceLimits limits = stoppable_within(slow, 30 * kMs);
  EXPECT_NEAR(limits.max_force_n, 1.0, 1e-12);
  EXPECT_EQ(limits.max_torque_nm, slow.max_torque_nm);
}

TEST(SwapBlend, LetsASlowFadeGoOnThroughTheSwapsThatFollow) {
  // A change of the world fades within 15 ms; models of 4 ms come meanwhile, each a little off.
  SwapBlend blend;
  const Wrench before{{1.0, 0.0, 0.0}, {}};
  double model = 0.0;
  blend.swap(before, {}, 0, 15 * kMs);
  double last = 1.0;
  for (int ms = 1; ms <= 40; ++ms) {
    if (ms % 4 == 0 && ms < 20) {
      const Wrench shown = blend.apply({{model, 0.0, 0.0}, {}}, ms * kMs);
      model += 0.01;
      blend.swap(shown, {{model, 0.0, 0.0}, {}}, ms * kMs, 4 * kMs);
      EXPECT_NEAR(blend.apply({{model, 0.0, 0.0}, {}}, ms * kMs).force_n[0], shown.force_n[0],
                  1e-15);
    }
    const double now = blend.apply({{model, 0.0, 0.0}, {}}, ms * kMs).force_n[0];
    EXPECT_LE(std::abs(now - last), 1.5 / 15.0 + 0.01 * 1.5 / 4.0);
    last = now;
  }
  EXPECT_EQ(last, model);
  EXPECT_TRUE(blend.over(19 * kMs + 4 * kMs));
  EXPECT_FALSE(blend.over(14 * kMs));
}

TEST(SwapBlend, LeavesNoStepAndAddsNoLag) {
  SwapBlend blend;
  const Wrench before{{1.0, 0.0, 0.0}, {0.0, 0.01, 0.0}};
  const Wrench after{{0.4, 0.2, 0.0}, {}};
  blend.swap(before, after, 100 * kMs, 4 * kMs);
  const Wrench start = blend.apply(after, 100 * kMs);
  EXPECT_NEAR(start.force_n[0], 1.0, 1e-15);
  EXPECT_NEAR(start.force_n[1], 0.0, 1e-15);
  EXPECT_NEAR(start.torque_nm[1], 0.01, 1e-15);
  // What the hand's motion adds meanwhile passes whole.
  const Wrench still = blend.apply(after, 102 * kMs);
  const Wrench pushed = blend.apply({{0.9, 0.2, 0.0}, {}}, 102 * kMs);
  EXPECT_NEAR(pushed.force_n[0] - still.force_n[0], 0.5, 1e-15);
  EXPECT_EQ(blend.apply(after, 104 * kMs).force_n[0], 0.4);
}

TEST(RampedGain, FallsAtOnceAndRisesByItsRamp) {
  RampedGain gain(200 * kMs);
  double last = 0.0;
  for (int i = 0; i < 200; ++i) {
    const double now = gain.update(1.0, kMs);
    EXPECT_GE(now, last);
    EXPECT_LE(now - last, 1.5 / 200 + 1e-12);
    last = now;
  }
  EXPECT_NEAR(last, 1.0, 1e-12);
  EXPECT_EQ(gain.update(0.0, kMs), 0.0);
  EXPECT_LT(gain.update(1.0, kMs), 1e-3);
}

TEST(Freshness, HoldsThenFallsToZeroInTime) {
  EXPECT_EQ(freshness(15 * kMs, 15 * kMs, 45 * kMs), 1.0);
  EXPECT_NEAR(freshness(30 * kMs, 15 * kMs, 45 * kMs), 0.5, 1e-12);
  EXPECT_EQ(freshness(45 * kMs, 15 * kMs, 45 * kMs), 0.0);
}

}  // namespace
}  // namespace suture
