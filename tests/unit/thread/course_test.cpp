// SPDX-License-Identifier: GPL-3.0-or-later
#include "thread/course.hpp"

#include <gtest/gtest.h>

#include <span>
#include <vector>

#include "support/block_mesh.hpp"

namespace sutured::thread {
namespace {

/// Returns where the last stretch ends along the line, each as long as puts its point in its
/// middle.
double covered_m(const std::vector<MaterialPoint>& course, std::span<const Vec3> x,
                 const Vec3& from, const Vec3& to) {
  const Vec3 way = (to - from).normalized();
  double end_m = 0.0;
  for (const MaterialPoint& point : course)
    end_m += 2.0 * (way.dot(point.position(x) - from) - end_m);
  return end_m;
}

TEST(StraightCourse, PassesEachTetOnceInOrderAndLeavesNothingOut) {
  const geometry::TetMesh mesh = testing::block_mesh(3, 3, 3);
  // Across all of it, along no plane of the mesh.
  const Vec3 from(0.07, 0.11, 0.0), to(0.83, 0.71, 1.0);
  const auto course = straight_course(mesh.vertices_m, mesh.tets, from, to);
  ASSERT_GT(course.size(), 5U);
  double before = 0.0;
  for (const MaterialPoint& point : course) {
    EXPECT_EQ(point.count, 4);
    EXPECT_NEAR(point.weight.sum(), 1.0, 1e-12);
    EXPECT_GT(point.weight.minCoeff(), 0.0) << "inside its tet";
    const Vec3 x = point.position(mesh.vertices_m) - from;
    const double along = x.dot((to - from).normalized());
    EXPECT_LT((x - along * (to - from).normalized()).norm(), 1e-12) << "on the line";
    EXPECT_GT(along, before);
    before = along;
  }
  EXPECT_NEAR(covered_m(course, mesh.vertices_m, from, to), (to - from).norm(), 1e-9);
}

TEST(StraightCourse, IsEmptyWhereThereIsNoWayOrNoTissue) {
  const geometry::TetMesh mesh = testing::block_mesh(2, 2, 2);
  const Vec3 inside(0.3, 0.4, 0.2);
  EXPECT_TRUE(straight_course(mesh.vertices_m, mesh.tets, inside, inside).empty());
  EXPECT_TRUE(straight_course(mesh.vertices_m, mesh.tets, Vec3(2, 2, 2), Vec3(3, 2, 2)).empty());
}

TEST(MaterialPoint, MovesWithItsTissue) {
  const geometry::TetMesh mesh = testing::block_mesh(1, 1, 1);
  const MaterialPoint point = in_tet(mesh.tets[0], Eigen::Vector4d(0.1, 0.2, 0.3, 0.4));
  std::vector<Vec3> moved = mesh.vertices_m;
  Eigen::Matrix3d stretch;
  stretch << 1.2, 0.1, 0.0, -0.3, 0.9, 0.2, 0.0, 0.4, 1.1;
  for (Vec3& x : moved) x = Vec3(stretch * x + Vec3(1, 2, 3));
  const Vec3 expected = stretch * point.position(mesh.vertices_m) + Vec3(1, 2, 3);
  EXPECT_LT((point.position(moved) - expected).norm(), 1e-12);
}

}  // namespace
}  // namespace sutured::thread
