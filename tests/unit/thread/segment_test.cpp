// SPDX-License-Identifier: GPL-3.0-or-later
#include "thread/segment.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <array>

namespace sutured::thread {
namespace {

// Short and long, near the border on both sides, and far from it.
constexpr std::array kLengths_m = {1e-7, 3e-5, 0.999e-4, 1.001e-4, 2e-3, 0.1};

Eigen::Matrix3d curvature_of(const Vec3& d_m) {
  const SegmentLength at = segment_length(d_m);
  Eigen::Matrix3d across = Eigen::Matrix3d::Identity();
  if (!at.is_short) across -= at.gradient * at.gradient.transpose();
  return at.curvature_per_m * across;
}

TEST(Segment, CountsItsLengthAndHalfOfTheShortOneWhereItVanishes) {
  const Vec3 way = Vec3(1.0, -2.0, 2.0) / 3.0;
  EXPECT_DOUBLE_EQ(segment_length(2e-3 * way).length_m, 2e-3);
  EXPECT_DOUBLE_EQ(segment_length(Vec3::Zero()).length_m, 0.5 * kShortSegment_m);
  EXPECT_EQ(segment_length(Vec3::Zero()).gradient, Vec3::Zero());
}

TEST(Segment, IsContinuousToItsFirstDerivativeWhereItBecomesShort) {
  const Vec3 way = Vec3(1.0, -2.0, 2.0) / 3.0;
  const SegmentLength below = segment_length((1.0 - 1e-12) * kShortSegment_m * way),
                      above = segment_length((1.0 + 1e-12) * kShortSegment_m * way);
  EXPECT_TRUE(below.is_short);
  EXPECT_FALSE(above.is_short);
  EXPECT_NEAR(below.length_m, above.length_m, 1e-11 * kShortSegment_m);
  EXPECT_LT((below.gradient - above.gradient).norm(), 1e-11);
}

TEST(Segment, TellsTheDerivativesOfItsLength) {
  const Vec3 way = Vec3(2.0, 1.0, -2.0) / 3.0;
  for (const double length_m : kLengths_m) {
    const Vec3 d = length_m * way;
    const double h = 1e-5 * length_m;
    const Eigen::Matrix3d curvature = curvature_of(d);
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3 step = h * Vec3::Unit(axis);
      const SegmentLength after = segment_length(d + step), before = segment_length(d - step);
      EXPECT_NEAR((after.length_m - before.length_m) / (2.0 * h), segment_length(d).gradient[axis],
                  1e-8)
          << length_m;
      const Vec3 turned = (after.gradient - before.gradient) / (2.0 * h);
      EXPECT_LT((turned - curvature.col(axis)).norm(), 1e-8 * curvature.norm()) << length_m;
    }
  }
}

/// A pull never exceeds the tension, and a tighter one never lets the piece grow.
TEST(Segment, PullsWithNoMoreThanTheTensionAndIsConvex) {
  const Vec3 way = Vec3(2.0, 1.0, -2.0) / 3.0;
  for (const double length_m : kLengths_m) {
    const Vec3 d = length_m * way;
    EXPECT_LE(segment_length(d).gradient.norm(), 1.0 + 1e-15);
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> modes(curvature_of(d));
    EXPECT_GE(modes.eigenvalues().minCoeff(), -1e-9 * modes.eigenvalues().maxCoeff());
  }
}

}  // namespace
}  // namespace sutured::thread
