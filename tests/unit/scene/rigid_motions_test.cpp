// SPDX-License-Identifier: GPL-3.0-or-later
#include "scene/rigid_motions.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/block_mesh.hpp"

namespace sutured::scene {
namespace {

using geometry::TetMesh;

std::vector<LooseComponent> loose(const TetMesh& mesh, const std::vector<Prescribed>& prescribed) {
  return loose_components(mesh, geometry::connected_components(mesh.tets, mesh.vertices_m.size()),
                          geometry::tet_adjacency(mesh.tets), prescribed);
}

Prescribed hold(std::vector<std::int32_t> vertices, std::array<bool, 3> axes = {true, true, true}) {
  return {std::move(vertices), axes, Vec3::Zero()};
}

TEST(RigidMotions, CountsWhatEachConstraintLeavesFree) {
  const TetMesh block = testing::block_mesh(1, 1, 1);  // vertex (i, j, k) is i + 2 j + 4 k
  const auto free = [&](const std::vector<Prescribed>& prescribed) {
    const auto list = loose(block, prescribed);
    return list.empty() ? 0 : list.front().free_motions;
  };
  EXPECT_EQ(free({}), 6);
  EXPECT_EQ(free({hold({0})}), 3);
  EXPECT_EQ(free({hold({0, 1})}), 1);                                   // a hinge about x
  EXPECT_EQ(free({hold({0, 1, 2})}), 0);                                // three points not in line
  EXPECT_EQ(free({hold({0, 1}), hold({2}, {false, false, true})}), 0);  // 3 – 2 – 1
  EXPECT_EQ(free({hold({0, 1, 2, 3}, {false, false, true})}), 3);       // sliding on z = 0
  EXPECT_EQ(free({hold({0, 1, 2, 3}, {true, true, false})}), 3);        // lifting and tilting
}

TEST(RigidMotions, SymmetryPlanesHoldABlock) {
  const TetMesh block = testing::block_mesh(2, 2, 2, {0.02, 0.01, 0.03});
  std::array<std::vector<std::int32_t>, 3> plane;
  for (std::size_t v = 0; v < block.vertices_m.size(); ++v)
    for (std::size_t axis = 0; axis < 3; ++axis)
      if (block.vertices_m[v][static_cast<Eigen::Index>(axis)] == 0.0)
        plane[axis].push_back(static_cast<std::int32_t>(v));
  EXPECT_TRUE(
      loose(block, {hold(plane[0], {true, false, false}), hold(plane[1], {false, true, false}),
                    hold(plane[2], {false, false, true})})
          .empty());
}

/// A string of tets, each of which shares a corner with the next.
TetMesh string_of_tets(int count) {
  TetMesh mesh;
  mesh.vertices_m.emplace_back(0, 0, 0);
  for (int i = 0; i < count; ++i) {
    const double x = i;
    const auto first = static_cast<std::int32_t>(mesh.vertices_m.size()) - 1;
    mesh.vertices_m.insert(mesh.vertices_m.end(), {{x, 1, 0}, {x, 0, 1}, {x + 1, 0, 0}});
    mesh.tets.push_back({first, first + 3, first + 1, first + 2});
  }
  return mesh;
}

TEST(RigidMotions, OfTooManyPartsAreNotLookedFor) {
  const auto most = loose(string_of_tets(kRigidPartsMax), {});
  ASSERT_EQ(most.size(), 1U);
  EXPECT_EQ(most[0].parts, kRigidPartsMax);
  EXPECT_EQ(most[0].free_motions, 3 + 3 * kRigidPartsMax);
  const auto more = loose(string_of_tets(kRigidPartsMax + 1), {});
  ASSERT_EQ(more.size(), 1U);
  EXPECT_EQ(more[0].parts, kRigidPartsMax + 1);
  EXPECT_EQ(more[0].free_motions, 0);
}

TEST(RigidMotions, APartHeldByAnEdgeOnlyCanTurn) {
  // Two tets that share the edge (1, 2); the first is fixed.
  TetMesh mesh;
  mesh.vertices_m = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}, {2, 2, 0}};
  mesh.tets = {{0, 1, 2, 3}, {1, 2, 4, 5}};
  const auto turning = loose(mesh, {hold({0, 1, 2, 3})});
  ASSERT_EQ(turning.size(), 1U);
  EXPECT_EQ(turning[0].free_motions, 1);
  EXPECT_TRUE(loose(mesh, {hold({0, 1, 2, 3, 4})}).empty());
}

TEST(RigidMotions, NamesTheLooseComponentOfSeveral) {
  TetMesh mesh = testing::block_mesh(1, 1, 1);
  const TetMesh other = testing::block_mesh(2, 1, 1);
  for (const Vec3& x : other.vertices_m) mesh.vertices_m.push_back(x + Vec3(5, 0, 0));
  for (geometry::Tet tet : other.tets) {
    for (auto& v : tet) v += 8;
    mesh.tets.push_back(tet);
  }
  const auto list = loose(mesh, {hold({0, 1, 2, 3})});
  ASSERT_EQ(list.size(), 1U);
  EXPECT_EQ(list[0].component, 1);
  EXPECT_EQ(list[0].vertex_count, 12);
  EXPECT_EQ(list[0].free_motions, 6);
  EXPECT_EQ(list[0].centre_m, Vec3(5.5, 0.5, 0.5));
}

}  // namespace
}  // namespace sutured::scene
