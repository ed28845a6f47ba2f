// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/topology.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <stdexcept>

#include "support/block_mesh.hpp"

namespace sutured::geometry {
namespace {

using ::testing::ElementsAre;

std::set<std::int32_t> face_set(const Tet& tet, int face) {
  std::set<std::int32_t> vertices(tet.begin(), tet.end());
  vertices.erase(tet[static_cast<std::size_t>(face)]);
  return vertices;
}

// The oracle: every pair of tets, compared face by face.
TetAdjacency adjacency_by_all_pairs(const std::vector<Tet>& tets) {
  TetAdjacency adjacency(tets.size(), {-1, -1, -1, -1});
  for (std::size_t a = 0; a < tets.size(); ++a)
    for (std::size_t b = 0; b < tets.size(); ++b)
      for (int fa = 0; fa < 4; ++fa)
        for (int fb = 0; fb < 4; ++fb)
          if (a != b && face_set(tets[a], fa) == face_set(tets[b], fb))
            adjacency[a][static_cast<std::size_t>(fa)] = static_cast<std::int32_t>(b);
  return adjacency;
}

TEST(Topology, AdjacencyMatchesComparisonOfAllPairs) {
  const TetMesh mesh = testing::block_mesh(3, 2, 2);
  EXPECT_EQ(tet_adjacency(mesh.tets), adjacency_by_all_pairs(mesh.tets));
}

TEST(Topology, ThreeTetsOnOneFaceAreRefused) {
  const std::vector<Tet> tets{{0, 1, 2, 3}, {0, 2, 1, 4}, {0, 1, 2, 5}};
  EXPECT_THROW((void)tet_adjacency(tets), std::invalid_argument);
}

TEST(Topology, FacesOfAPositiveTetWindOutward) {
  const std::array<Vec3, 4> x{Vec3(0, 0, 0), Vec3(1, 0, 0), Vec3(0, 1, 0), Vec3(0, 0, 1)};
  for (int face = 0; face < 4; ++face) {
    const Triangle f = tet_face({0, 1, 2, 3}, face);
    const auto at = [&](std::size_t i) { return x[static_cast<std::size_t>(f[i])]; };
    const Vec3 normal = (at(1) - at(0)).cross(at(2) - at(0));
    EXPECT_LT(normal.dot(x[static_cast<std::size_t>(face)] - at(0)), 0.0) << "face " << face;
  }
}

TEST(Topology, BoundaryOfABlockIsItsSixSidesWoundOutward) {
  const TetMesh mesh = testing::block_mesh(3, 4, 2, {0.3, 0.4, 0.2});
  const auto adjacency = tet_adjacency(mesh.tets);
  const BoundarySurface surface = boundary_surface(mesh.tets, adjacency);
  EXPECT_EQ(surface.triangles.size(), 2U * 2U * (3 * 4 + 4 * 2 + 3 * 2));
  EXPECT_EQ(surface.vertices.size(), mesh.vertices_m.size() - 2U * 3U * 1U);
  double volume = 0.0;  // divergence theorem: outward faces span the block's volume
  Vec3 vector_area = Vec3::Zero();
  for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
    const auto x = [&](std::size_t i) {
      return mesh.vertices_m[static_cast<std::size_t>(surface.triangles[t][i])];
    };
    volume += x(0).dot(x(1).cross(x(2))) / 6.0;
    vector_area += (x(1) - x(0)).cross(x(2) - x(0)) / 2.0;
    const auto tet = static_cast<std::size_t>(surface.tet[t]);
    EXPECT_EQ(tet_face(mesh.tets[tet], surface.tet_face[t]), surface.triangles[t]);
    EXPECT_EQ(adjacency[tet][static_cast<std::size_t>(surface.tet_face[t])], -1);
  }
  EXPECT_NEAR(volume, 0.3 * 0.4 * 0.2, 1e-15);
  EXPECT_LT(vector_area.norm(), 1e-15);  // closed
}

TEST(Topology, EveryEdgeOfAClosedBoundaryIsWalkedOnceEachWay) {
  const TetMesh mesh = testing::block_mesh(2, 2, 3);
  std::multiset<std::pair<std::int32_t, std::int32_t>> edges;
  for (const auto& t : boundary_surface(mesh.tets, tet_adjacency(mesh.tets)).triangles)
    for (std::size_t i = 0; i < 3; ++i) edges.insert({t[i], t[(i + 1) % 3]});
  for (const auto& [a, b] : edges) {
    EXPECT_EQ(edges.count({a, b}), 1U);
    EXPECT_EQ(edges.count({b, a}), 1U);
  }
}

TEST(Topology, ComponentsByVerticesAndByFacesDifferAtAHinge) {
  // 0 and 1 share a face; 2 hangs on 1 by one edge (3, 4); 3 stands alone.
  const std::vector<Tet> tets{{0, 1, 2, 3}, {1, 2, 3, 4}, {3, 4, 5, 6}, {7, 8, 9, 10}};
  const Components by_vertices = connected_components(tets, 11);
  EXPECT_EQ(by_vertices.count, 2);
  EXPECT_THAT(by_vertices.of_tet, ElementsAre(0, 0, 0, 1));
  const Components by_faces = face_connected_components(tet_adjacency(tets));
  EXPECT_EQ(by_faces.count, 3);
  EXPECT_THAT(by_faces.of_tet, ElementsAre(0, 0, 1, 2));
}

}  // namespace
}  // namespace sutured::geometry
