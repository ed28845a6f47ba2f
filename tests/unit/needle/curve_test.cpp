// SPDX-License-Identifier: GPL-3.0-or-later
#include "needle/curve.hpp"

#include <gtest/gtest.h>

#include <numbers>
#include <random>

namespace sutured::needle {
namespace {

Pose random_pose(std::mt19937_64& random) {
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  Pose pose;
  pose.position_m = 0.02 * Vec3(uniform(random), uniform(random), uniform(random));
  pose.orientation =
      Eigen::Quaterniond(uniform(random), uniform(random), uniform(random), uniform(random))
          .normalized();
  return pose;
}

const std::array<Curve, 2> kCurves{Curve::straight(0.025), Curve::arc(0.008, std::numbers::pi)};

TEST(Curve, ASlideMovesEveryPointAlongTheAxis) {
  std::mt19937_64 random(1);
  for (const Curve& curve : kCurves)
    for (int i = 0; i < 50; ++i) {
      const Pose pose = random_pose(random);
      const double slide = 1e-3 * i - 0.02;
      const Pose slid = curve.slid(pose, slide);
      for (const double s : {0.0, 0.004, curve.length_m()})
        EXPECT_LT((curve.point(slid, s) - curve.point(pose, s + slide)).norm(), 1e-16 + 1e-14);
    }
}

TEST(Curve, TheSlideTwistIsTheTangentMotion) {
  std::mt19937_64 random(2);
  for (const Curve& curve : kCurves) {
    const Pose pose = random_pose(random);
    const Vec6 twist = curve.slide_twist(pose);
    for (const double s : {0.0, 0.01, 0.02}) {
      const Vec3 velocity =
          twist.head<3>() + twist.tail<3>().cross(curve.point(pose, s) - pose.position_m);
      EXPECT_LT((velocity - curve.tangent(pose, s)).norm(), 1e-13);
    }
  }
}

TEST(Curve, LeavesAHalfSpaceWhereSamplingSaysSo) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  int crossings = 0;
  for (const Curve& curve : kCurves)
    for (int i = 0; i < 400; ++i) {
      const Pose pose = random_pose(random);
      const Vec3 n = Vec3(uniform(random), uniform(random), uniform(random)).normalized();
      const double offset = n.dot(pose.position_m) + 0.006 * uniform(random);
      const auto distance = [&](double s) { return n.dot(curve.point(pose, s)) - offset; };
      const auto s = curve.leaves_half_space(pose, Vec3::Zero(), n, offset, 0.0);
      double first = -1.0;
      constexpr double kStep = 2e-6;
      if (distance(0.0) >= 0.0 && distance(kStep) > distance(0.0)) first = 0.0;
      for (double t = 0.0; t < curve.length_m() && first < 0; t += kStep)
        if (distance(t) < 0.0 && distance(t + kStep) >= 0.0) first = t + kStep;
      if (first < 0) {
        EXPECT_TRUE(!s || *s > curve.length_m() - 2 * kStep);
      } else {
        ASSERT_TRUE(s);
        EXPECT_NEAR(*s, first, 2 * kStep);
        ++crossings;
      }
    }
  EXPECT_GT(crossings, 200);
}

TEST(Curve, TheNearestPointIsNearerThanItsNeighbours) {
  std::mt19937_64 random(4);
  for (const Curve& curve : kCurves)
    for (int i = 0; i < 200; ++i) {
      const Pose pose = random_pose(random);
      const Vec3 p = random_pose(random).position_m;
      const double best = (curve.point(pose, curve.nearest(pose, p)) - p).norm();
      for (int k = 0; k <= 100; ++k)
        EXPECT_LE(best, (curve.point(pose, curve.length_m() * k / 100) - p).norm() + 1e-12);
    }
}

TEST(Curve, LeastSquaresSlideRecoversAPureSlide) {
  std::mt19937_64 random(5);
  const std::array<double, 4> s{0.001, 0.003, 0.011, 0.02}, w{1, 2, 0.5, 1};
  for (const Curve& curve : kCurves) {
    const Pose pose = random_pose(random);
    EXPECT_NEAR(slide_least_squares(curve, pose, curve.slid(pose, 0.0031), s, w), 0.0031, 1e-15);
  }
}

TEST(Curve, RotationVectorInvertsMoved) {
  std::mt19937_64 random(6);
  for (int i = 0; i < 50; ++i) {
    const Pose pose = random_pose(random);
    Vec6 twist;
    twist << 0.1, 0.2, 0.3, 0.03 * i, -0.02 * i, 0.5;
    const Pose to = moved(pose, twist);
    EXPECT_LT(
        (rotation_vector(to.orientation * pose.orientation.conjugate()) - twist.tail<3>()).norm(),
        1e-12);
  }
}

}  // namespace
}  // namespace sutured::needle
