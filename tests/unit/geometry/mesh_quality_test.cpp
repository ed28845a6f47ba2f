// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/mesh_quality.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "support/block_mesh.hpp"

namespace sutured::geometry {
namespace {

TetMesh one_tet(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  return {{a, b, c, d}, {{0, 1, 2, 3}}, {}, {0, 1, 2, 3}};
}

TEST(MeshQuality, RegularTetIsPerfect) {
  const TetMesh mesh = one_tet({1, 1, 1}, {-1, 1, -1}, {1, -1, -1}, {-1, -1, 1});
  const MeshQuality quality = mesh_quality(mesh);
  EXPECT_NEAR(quality.radius_ratio_min, 1.0, 1e-14);
  const double dihedral = std::acos(1.0 / 3.0) * 180.0 / std::numbers::pi;
  EXPECT_NEAR(quality.dihedral_min_deg, dihedral, 1e-12);
  EXPECT_NEAR(quality.dihedral_max_deg, dihedral, 1e-12);
  EXPECT_NEAR(quality.volume_m3, 8.0 / 3.0, 1e-14);
  EXPECT_NEAR(quality.edge_min_m, std::sqrt(8.0), 1e-14);
  EXPECT_NEAR(quality.edge_max_m, std::sqrt(8.0), 1e-14);
}

TEST(MeshQuality, CornerTetMatchesItsClosedForm) {
  // Legs 1: V = 1/6, area (3 + √3)/2, so r = 1/(3 + √3); R = √3/2.
  const MeshQuality quality = mesh_quality(one_tet({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}));
  EXPECT_NEAR(quality.radius_ratio_min, 3.0 / (3.0 + std::sqrt(3.0)) * 2.0 / std::sqrt(3.0), 1e-14);
  EXPECT_NEAR(quality.dihedral_max_deg, 90.0, 1e-12);
  EXPECT_NEAR(quality.dihedral_min_deg, std::acos(1.0 / std::sqrt(3.0)) * 180.0 / std::numbers::pi,
              1e-12);
}

TEST(MeshQuality, FlatTetIsWorthNothing) {
  EXPECT_EQ(radius_ratio({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}), 0.0);
  EXPECT_EQ(radius_ratio({0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}), 0.0);
}

TEST(MeshQuality, OfABlockAddsUpAndNamesTheWorst) {
  TetMesh mesh = testing::block_mesh(2, 3, 4, {0.02, 0.03, 0.04});
  mesh.vertices_m[0] += Vec3(0.008, 0.008, 0.008);  // squeezes the tets at the corner
  const MeshQuality quality = mesh_quality(mesh);
  EXPECT_LT(quality.volume_m3, 0.02 * 0.03 * 0.04);
  EXPECT_EQ(quality.bounds_m.max(), Vec3(0.02, 0.03, 0.04));
  EXPECT_LE(quality.radius_ratio_min, quality.radius_ratio_p01);
  EXPECT_LT(quality.radius_ratio_p01, quality.radius_ratio_median);
  const auto worst = worst_tets(quality, 3);
  ASSERT_EQ(worst.size(), 3U);
  EXPECT_EQ(quality.radius_ratio[static_cast<std::size_t>(worst[0])], quality.radius_ratio_min);
  EXPECT_THAT(mesh.tets[static_cast<std::size_t>(worst[0])], ::testing::Contains(0));
  EXPECT_EQ(worst_tets(quality, 1000).size(), mesh.tets.size());
}

TEST(MeshQuality, OfAnEmptyMeshIsZero) {
  EXPECT_EQ(mesh_quality({}).volume_m3, 0.0);
  EXPECT_TRUE(mesh_quality({}).radius_ratio.empty());
}

}  // namespace
}  // namespace sutured::geometry
