// SPDX-License-Identifier: GPL-3.0-or-later
#include "force_guard.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "protocol/types.hpp"

namespace suture {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kSilentAfter = 15 * kMs;

Force force_of(double newtons) {
  Force force;
  force.force_n = {newtons, 0.0, 0.0};
  force.torque_nm = {0.0, 0.1 * newtons, 0.0};
  force.state = ForceState::kRendering;
  force.sequence = 1;
  return force;
}

TEST(ForceGuard, ShowsFreshForcesUnchanged) {
  ForceGuard guard(kSilentAfter);
  for (std::int64_t t = 1; t <= 100; ++t) {
    const Force shown = guard.show(force_of(2.0), t * kMs, false, t * kMs);
    ASSERT_EQ(shown.force_n[0], 2.0);
    ASSERT_EQ(shown.state, ForceState::kRendering);
  }
}

TEST(ForceGuard, ShowsNothingBeforeTheFirstForce) {
  ForceGuard guard(kSilentAfter);
  const Force shown = guard.show(force_of(2.0), 0, false, 5 * kMs);
  EXPECT_EQ(shown.force_n[0], 0.0);
  EXPECT_EQ(shown.state, ForceState::kIdle);
}

TEST(ForceGuard, IsAtZeroWithin50MsOfTheLastForceAndNeverSteps) {
  ForceGuard guard(kSilentAfter);
  double last = 2.0;
  for (std::int64_t age = 0; age <= 60; ++age) {
    const Force shown = guard.show(force_of(2.0), 1000 * kMs, false, (1000 + age) * kMs);
    EXPECT_LE(std::abs(shown.force_n[0] - last), 1.5 * 2.0 / 30.0 + 1e-12) << age;  // 30 ms of fade
    EXPECT_NEAR(shown.torque_nm[1], 0.1 * shown.force_n[0], 1e-12);
    last = shown.force_n[0];
    if (age > 15) {
      EXPECT_EQ(shown.state, ForceState::kServerSilent);
    }
    if (age >= 45) {
      EXPECT_EQ(shown.force_n[0], 0.0);
    }
  }
}

TEST(ForceGuard, ComesBackByARamp) {
  ForceGuard guard(kSilentAfter);
  static_cast<void>(guard.show(force_of(2.0), 1 * kMs, false, 1 * kMs));
  static_cast<void>(guard.show(force_of(2.0), 1 * kMs, false, 200 * kMs));  // silent
  double last = 0.0;
  for (std::int64_t t = 201; t <= 260; ++t) {
    const Force shown = guard.show(force_of(2.0), t * kMs, false, t * kMs);
    EXPECT_LE(shown.force_n[0] - last, 1.5 * 2.0 / 50.0 + 1e-12);
    EXPECT_GE(shown.force_n[0], last);
    last = shown.force_n[0];
  }
  EXPECT_EQ(last, 2.0);
}

/// A server that exceeds, forces that come at once after a gap, one that is no number.
TEST(KeptWithin, LeavesTheHandWhatTheLimitsAllow) {
  const ForceLimits limits{3.0, 0.1, 200.0, 6.0};
  Force last = force_of(1.0);
  const auto shown = [&](double newtons) {
    return kept_within(limits, force_of(newtons), last, kMs);
  };
  EXPECT_EQ(shown(0.9).force_n[0], 0.9);
  EXPECT_EQ(shown(0.9).faults, 0U);
  EXPECT_NEAR(shown(2.5).force_n[0], 1.2, 1e-12) << "200 N/s for 1 ms";
  EXPECT_NEAR(shown(2.5).torque_nm[1], 0.1, 1e-12) << "the largest";
  EXPECT_NEAR(shown(0.0).force_n[0], 0.8, 1e-12);
  EXPECT_NEAR(shown(0.0).torque_nm[1], 0.094, 1e-12);
  for (int i = 0; i < 1000; ++i) last = shown(1e6);
  EXPECT_NEAR(last.force_n[0], 3.0, 1e-12);
  EXPECT_NE(last.faults & suture_v1_FAULT_FORCE_LIMIT, 0U);
}

TEST(ForceGuard, LetsNothingThroughThatIsNotFinite) {
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    ForceGuard guard(kSilentAfter);
    static_cast<void>(guard.show(force_of(1.0), 1 * kMs, false, 1 * kMs));
    Force shown = guard.show(force_of(bad), 2 * kMs, false, 2 * kMs);
    EXPECT_EQ(shown.force_n, Vector3{});
    EXPECT_EQ(shown.torque_nm, Vector3{});
    EXPECT_EQ(shown.state, ForceState::kFault);
    shown = guard.show(force_of(1.0), 3 * kMs, false, 3 * kMs);
    EXPECT_LE(shown.force_n[0], 1.5 * 1.0 / 50.0 + 1e-12);  // and back by the ramp
  }
}

}  // namespace
}  // namespace suture
