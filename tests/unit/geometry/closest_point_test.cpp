// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/closest_point.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <random>

namespace sutured::geometry {
namespace {

Vec3 random_point(std::mt19937_64& random, double size) {
  std::uniform_real_distribution<double> coordinate(-size, size);
  const double x = coordinate(random);
  const double y = coordinate(random);
  return {x, y, coordinate(random)};
}

// The oracle: q is the closest point of a convex set exactly if no corner lies further along
// p − q than q does, (corner − q) · (p − q) ≤ 0 for each corner.
TEST(ClosestPoint, MeetsTheVariationalInequalityOfAConvexSet) {
  std::mt19937_64 random(1);
  for (int i = 0; i < 20000; ++i) {
    const std::array<Vec3, 3> x{random_point(random, 1.0), random_point(random, 1.0),
                                random_point(random, 1.0)};
    const Vec3 p = random_point(random, 2.0);
    const ClosestPoint closest = closest_point_on_triangle(p, x[0], x[1], x[2]);
    EXPECT_GE(closest.barycentric.minCoeff(), 0.0);
    EXPECT_NEAR(closest.barycentric.sum(), 1.0, 1e-12);
    const Vec3 rebuilt = closest.barycentric[0] * x[0] + closest.barycentric[1] * x[1] +
                         closest.barycentric[2] * x[2];
    // Slivers of the sample lose about five digits in their barycentric coordinates.
    EXPECT_LT((rebuilt - closest.point_m).norm(), 1e-9);
    EXPECT_DOUBLE_EQ(closest.squared_distance_m2, (p - closest.point_m).squaredNorm());
    for (const Vec3& corner : x)
      EXPECT_LT((corner - closest.point_m).dot(p - closest.point_m), 1e-9);
  }
}

TEST(ClosestPoint, NamesTheFeature) {
  const Vec3 a(0, 0, 0), b(1, 0, 0), c(0, 1, 0);
  const auto feature = [&](double x, double y) {
    return closest_point_on_triangle({x, y, 0.5}, a, b, c).feature;
  };
  EXPECT_EQ(feature(0.2, 0.2), TriangleFeature::kFace);
  EXPECT_EQ(feature(-1, -1), TriangleFeature::kVertex0);
  EXPECT_EQ(feature(2, -0.5), TriangleFeature::kVertex1);
  EXPECT_EQ(feature(-0.5, 2), TriangleFeature::kVertex2);
  EXPECT_EQ(feature(0.5, -1), TriangleFeature::kEdge0);
  EXPECT_EQ(feature(1, 1), TriangleFeature::kEdge1);
  EXPECT_EQ(feature(-1, 0.5), TriangleFeature::kEdge2);
}

TEST(ClosestPoint, TakesATriangleWithoutAreaAsItsEdges) {
  const ClosestPoint on_line =
      closest_point_on_triangle({0.7, 1, 0}, {0, 0, 0}, {1, 0, 0}, {0.5, 0, 0});
  EXPECT_LT((on_line.point_m - Vec3(0.7, 0, 0)).norm(), 1e-15);
  const Vec3 spot(0.1, 0.2, 0.3);
  const ClosestPoint on_spot = closest_point_on_triangle({1, 0, 0}, spot, spot, spot);
  EXPECT_EQ(on_spot.point_m, spot);
  EXPECT_EQ(on_spot.feature, TriangleFeature::kVertex0);
}

}  // namespace
}  // namespace sutured::geometry
