// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/energy_observer.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

namespace suture {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr double kSpring_n_per_m = 200.0;

Pose at(double x, double y = 0.0) { return {{x, y, 0.0}, {0.0, 0.0, 0.0, 1.0}}; }

double stored_j(double x, double y = 0.0) { return 0.5 * kSpring_n_per_m * (x * x + y * y); }

/// Moves a hand along `path` for `ticks` milliseconds under `force`; returns whether the
/// observer stayed content.
bool play(EnergyObserver& observer, int ticks, const std::function<Pose(int)>& path,
          const std::function<Wrench(const Pose&, const Pose& before)>& force) {
  bool passive = true;
  Pose before = path(0);
  for (int i = 0; i < ticks; ++i) {
    const Pose pose = path(i);
    const auto& p = pose.position_m;
    passive = observer.update(force(pose, before), pose, stored_j(p[0], p[1]), kMs);
    before = pose;
    if (!passive) return false;
  }
  return passive;
}

Wrench spring(const Pose& pose, const Pose& /*before*/) {
  return {{-kSpring_n_per_m * pose.position_m[0], -kSpring_n_per_m * pose.position_m[1], 0.0}, {}};
}

Pose circle(int i) { return at(0.01 * std::cos(0.01 * i), 0.01 * std::sin(0.01 * i)); }

TEST(EnergyObserver, GivesBackWhatASpringHasStored) {
  EnergyObserver observer;
  // Pressed 2 cm deep and let go, again and again: 40 mJ each way, four times the bound.
  EXPECT_TRUE(play(
      observer, 100'000, [](int i) { return at(0.01 * (1.0 - std::cos(0.01 * i))); }, spring));
  EXPECT_LE(observer.peak_debt_j(), 1e-9);
  EXPECT_NEAR(observer.given_j(), -stored_j(0.01 * (1.0 - std::cos(0.01 * 99'999))), 1e-12);
}

TEST(EnergyObserver, FindsASkewSpringOnAClosedPath) {
  EnergyObserver observer;
  int ticks = 0;
  EXPECT_FALSE(play(observer, 10'000, circle, [&](const Pose& pose, const Pose& before) {
    ++ticks;
    Wrench w = spring(pose, before);
    w.force_n[0] -= 20.0 * pose.position_m[1];  // a tenth of the spring, turned
    w.force_n[1] += 20.0 * pose.position_m[0];
    return w;
  }));
  // 20 N/m × 2 π r² = 12.6 mJ a loop of 628 ms, of which 10 mW may pass: 10 mJ more in a second.
  EXPECT_LT(ticks, 1100);
  EXPECT_LE(observer.debt_j(), observer.bound().energy_j + 1e-4);
}

TEST(EnergyObserver, FindsANegativeDamper) {
  EnergyObserver observer;
  // 2 N s/m pushing along at up to 0.1 m/s: 10 mW on average would pass, 20 mW does not.
  const auto push = [](double n_s_per_m) {
    return [n_s_per_m](const Pose& pose, const Pose& before) {
      const double v = (pose.position_m[0] - before.position_m[0]) * 1e3;
      return Wrench{{n_s_per_m * v, 0.0, 0.0}, {}};
    };
  };
  const auto sway = [](int i) { return at(0.01 * std::sin(0.01 * i)); };
  EXPECT_FALSE(play(observer, 20'000, sway, push(8.0)));
  EnergyObserver other;
  EXPECT_TRUE(play(other, 20'000, sway, push(-8.0))) << "a damper takes";
  EXPECT_LT(other.given_j(), -0.1);
}

TEST(EnergyObserver, DoesNotHoldWhatTissueAteToTheHandsCredit) {
  EnergyObserver observer;
  // Ten seconds of friction: joules gone.
  EXPECT_TRUE(play(observer, 10'000, circle, [](const Pose& pose, const Pose& before) {
    const double vx = (pose.position_m[0] - before.position_m[0]) * 1e3;
    const double vy = (pose.position_m[1] - before.position_m[1]) * 1e3;
    return Wrench{{-5.0 * vx, -5.0 * vy, 0.0}, {}};
  }));
  EXPECT_LT(observer.given_j(), -0.3);
  // What comes after is found all the same, within 2 R + 2 B.
  const double before_j = observer.given_j();
  EXPECT_FALSE(play(observer, 10'000, circle, [](const Pose& pose, const Pose&) {
    return Wrench{{-100.0 * pose.position_m[1], 100.0 * pose.position_m[0], 0.0}, {}};
  }));
  EXPECT_LT(observer.given_j() - before_j,
            2.0 * stored_j(0.01) + 2.0 * observer.bound().energy_j + 2e-3);
}

TEST(EnergyObserver, SaysNoUntilItBeginsAnew) {
  EnergyObserver observer({.energy_j = 1e-3, .power_w = 0.0});
  const Wrench push{{1.0, 0.0, 0.0}, {}};
  EXPECT_TRUE(observer.update(push, at(0.0), 0.0, kMs));
  EXPECT_FALSE(observer.update(push, at(0.002), 0.0, kMs));
  EXPECT_FALSE(observer.update({}, at(0.002), 0.0, kMs));
  observer.restart();
  EXPECT_TRUE(observer.update(push, at(0.0), 0.0, kMs));
  EXPECT_EQ(observer.given_j(), 0.0);
}

TEST(EnergyObserver, CountsTheWorkOfTorques) {
  EnergyObserver observer;
  const Wrench twist{{}, {0.0, 0.0, 0.02}};
  static_cast<void>(observer.update(twist, at(0.0), 0.0, kMs));
  Pose turned = at(0.0);
  turned.orientation_xyzw = {0.0, 0.0, std::sin(0.05), std::cos(0.05)};
  static_cast<void>(observer.update(twist, turned, 0.0, kMs));
  EXPECT_NEAR(observer.given_j(), 0.02 * 0.1, 1e-12);
}

TEST(RecoverableEnergy, IsThatOfTheSpringAlongTheForce) {
  HapticModel model;
  model.stiffness[0] = 100.0;
  model.stiffness[7] = 400.0;
  model.stiffness[21] = 0.5;
  EXPECT_NEAR(recoverable_energy_j(model, {{1.0, 0.0, 0.0}, {}}), 0.5 / 100.0, 1e-15);
  EXPECT_NEAR(recoverable_energy_j(model, {{0.0, 2.0, 0.0}, {0.01, 0.0, 0.0}}),
              0.5 * 4.0 / 400.0 + 0.5 * 1e-4 / 0.5, 1e-15);
  EXPECT_EQ(recoverable_energy_j(model, {}), 0.0);
  EXPECT_NEAR(recoverable_energy_j(model, {{0.0, 0.0, 0.1}, {}}), 0.5 * 0.01 / 10.0, 1e-15)
      << "friction is no spring";
}

}  // namespace
}  // namespace suture
