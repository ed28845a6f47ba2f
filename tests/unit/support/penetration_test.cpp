// SPDX-License-Identifier: GPL-3.0-or-later
#include "support/penetration.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <set>
#include <stdexcept>

#include "geometry/closest_point.hpp"
#include "geometry/topology.hpp"
#include "support/block_mesh.hpp"
#include "support/tube_mesh.hpp"

namespace sutured::testing {
namespace {

using geometry::Tet;
using geometry::Vec3;

/// Meshes side by side in one numbering.
struct Bodies {
  std::vector<Vec3> x;
  std::vector<Tet> tets;
  void add(const geometry::TetMesh& mesh, const Eigen::Isometry3d& pose) {
    const auto first = static_cast<std::int32_t>(x.size());
    for (const Vec3& p : mesh.vertices_m) x.push_back(pose * p);
    for (Tet tet : mesh.tets) {
      for (auto& v : tet) v += first;
      tets.push_back(tet);
    }
  }
  void add(const geometry::TetMesh& mesh, const Vec3& shift = Vec3::Zero()) {
    add(mesh, Eigen::Isometry3d(Eigen::Translation3d(shift)));
  }
  [[nodiscard]] Penetration measure() const { return measure_penetration(x, tets); }
};

/// A wedge: the edge from a to b, and the edge from c to d.
geometry::TetMesh tet(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  geometry::TetMesh mesh;
  mesh.vertices_m = {a, b, c, d};
  mesh.tets = {{0, 1, 2, 3}};
  return mesh;
}

void expect_nothing(const Penetration& found) {
  EXPECT_EQ(found.vertices, 0);
  EXPECT_EQ(found.edges, 0);
  EXPECT_EQ(found.vertex_depth_m, 0.0);
  EXPECT_EQ(found.edge_depth_m, 0.0);
}

constexpr double kRounding = 1e-12;  // lengths here are about one
constexpr double kEdge = 2e-6;       // the deepest point of an edge is found to 1e-6 of its length

TEST(Penetration, BodiesApartDoNotPenetrate) {
  Bodies bodies;
  expect_nothing(bodies.measure());
  bodies.add(block_mesh(3, 3, 3));
  expect_nothing(bodies.measure());
  bodies.add(block_mesh(2, 2, 2), Vec3(0.2, 0.3, 1.001));
  expect_nothing(bodies.measure());
}

TEST(Penetration, TouchingIsNotPenetrating) {
  for (const Vec3& shift : {Vec3(0, 0, 1), Vec3(0.21, 0.37, 1), Vec3(1, 1, 0), Vec3(1, 1, 1)}) {
    Bodies bodies;  // on a face, grid on grid and across; on an edge; on a corner
    bodies.add(block_mesh(3, 3, 3));
    bodies.add(block_mesh(3, 3, 3), shift);
    expect_nothing(bodies.measure());
  }
  Bodies bodies;  // a corner that stands on a face
  bodies.add(block_mesh(3, 3, 3));
  bodies.add(tet({0.4, 0.4, 1}, {0.3, 0.4, 2}, {0.5, 0.5, 2}, {0.5, 0.3, 2}));
  expect_nothing(bodies.measure());
}

TEST(Penetration, OverlappingBlocksAreAsDeepAsTheyOverlap) {
  for (const double depth_m : {1e-6, 0.02, 0.1}) {
    Bodies bodies;  // grid on grid: corners lie on the faces between tets of the other
    bodies.add(block_mesh(4, 4, 4));
    bodies.add(block_mesh(2, 2, 2), Vec3(0, 0, 1 - depth_m));
    // Only the middle of the upper bottom is off the sides; of the lower top, its nine.
    Penetration found = bodies.measure();
    EXPECT_NEAR(found.vertex_depth_m, depth_m, kRounding);
    EXPECT_NEAR(found.edge_depth_m, depth_m, kEdge);
    EXPECT_EQ(found.vertices, 1 + 9);

    bodies = {};  // a small block on a large one: all of its bottom is in
    bodies.add(block_mesh(4, 4, 4));
    bodies.add(block_mesh(2, 2, 2, Vec3(0.5, 0.5, 0.5)), Vec3(0.22, 0.21, 1 - depth_m));
    found = bodies.measure();
    EXPECT_NEAR(found.vertex_depth_m, depth_m, kRounding);
    EXPECT_NEAR(found.edge_depth_m, depth_m, kEdge);
    EXPECT_GE(found.vertices, 9);
    EXPECT_GE(found.edges, 16);  // the edges of the bottom alone
  }
}

TEST(Penetration, ABodyWithinAnotherIsAsDeepAsItsDeepestPoint) {
  Bodies bodies;
  bodies.add(block_mesh(5, 5, 5));
  bodies.add(block_mesh(1, 1, 1, Vec3(0.2, 0.2, 0.2)), Vec3(0.3, 0.4, 0.7));
  const Penetration found = bodies.measure();
  EXPECT_EQ(found.vertices, 8);
  EXPECT_EQ(found.edges, 18);
  EXPECT_NEAR(found.vertex_depth_m, 0.3, kRounding);
  EXPECT_NEAR(found.edge_depth_m, 0.3, kEdge);
}

/// No vertex is inside: a roof's ridge along x, and above it a keel along y that reaches d lower.
TEST(Penetration, AnEdgeAcrossAnEdgeIsSeen) {
  for (const double d : {1e-5, 0.01, 0.2}) {
    Bodies bodies;
    bodies.add(tet({-1, 0, d / 2}, {1, 0, d / 2}, {0, -1, -1}, {0, 1, -1}));
    bodies.add(tet({0, -1, -d / 2}, {0, 1, -d / 2}, {-1, 0, 1}, {1, 0, 1}));
    const Penetration found = bodies.measure();
    EXPECT_EQ(found.vertices, 0);
    EXPECT_EQ(found.vertex_depth_m, 0.0);
    EXPECT_EQ(found.edges, 2);
    // The middle of the ridge from the keel's sides, which rise 1 + d/2 over 1.
    EXPECT_NEAR(found.edge_depth_m, d / std::hypot(1.0, 1.0 + d / 2), kEdge);
  }
}

TEST(Penetration, ASpikeThroughAPlateIsHalfAPlateDeep) {
  Bodies bodies;
  bodies.add(block_mesh(10, 10, 2, Vec3(1, 1, 0.05)));
  bodies.add(tet({0.52, 0.47, -1}, {0.521, 0.47, 1}, {0.521, 0.471, 1}, {0.52, 0.471, 1}));
  const Penetration found = bodies.measure();
  EXPECT_EQ(found.vertices, 0);
  EXPECT_EQ(found.edges, 3);
  EXPECT_NEAR(found.edge_depth_m, 0.025, kEdge);
}

/// A clasp, bent shut until its upper arm is d inside the lower one.
TEST(Penetration, AFoldedBodyPenetratesItself) {
  constexpr int kAlong = 8, kAcross = 4;
  constexpr double kCell_m = 0.125;
  geometry::TetMesh mesh =
      block_mesh(kAlong, kAcross, 3, Vec3(kAlong * kCell_m, kAcross * kCell_m, 3 * kCell_m));
  const auto slit = [&](const Tet& t) {
    Vec3 centre = Vec3::Zero();
    for (const auto v : t) centre += 0.25 * mesh.vertices_m[static_cast<std::size_t>(v)];
    return centre[0] < (kAlong - 1) * kCell_m && centre[2] > kCell_m && centre[2] < 2 * kCell_m;
  };
  std::erase_if(mesh.tets, slit);
  Bodies open;
  open.add(mesh);
  expect_nothing(open.measure());
  for (const double d : {-1e-3, 0.0, 1e-4, 0.05}) {
    Bodies bodies;
    bodies.add(mesh);
    for (Vec3& x : bodies.x)
      if (x[2] > 1.99 * kCell_m && x[0] < (kAlong - 1.5) * kCell_m) x[2] -= kCell_m + d;
    const Penetration found = bodies.measure();
    if (d <= 0.0) {
      expect_nothing(found);
      continue;
    }
    EXPECT_NEAR(found.vertex_depth_m, d, kRounding);
    EXPECT_NEAR(found.edge_depth_m, d, kEdge * kCell_m);
    // Those of both arms that face each other, but for the rows on the sides: seven by three,
    // twice.
    EXPECT_GE(found.vertices, 2 * 6 * 3);
    EXPECT_LE(found.vertices, 2 * 7 * 3);
  }
}

TEST(Penetration, AnInvertedTetHoldsWhatLiesInIt) {
  Bodies bodies;
  bodies.add(tet({0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {0, 0, 1}));
  bodies.add(tet({0.1, 0.1, 0.1}, {2, 2, 2}, {2, 2, 3}, {2, 3, 2}));
  const Penetration found = bodies.measure();
  EXPECT_EQ(found.vertices, 1);
  EXPECT_NEAR(found.vertex_depth_m, 0.1, kRounding);
  EXPECT_EQ(measure_penetration(bodies.x, std::vector<Tet>{{0, 1, 2, 2}}).vertices, 0);  // flat
}

TEST(Penetration, APositionThatIsNotFiniteIsRefused) {
  Bodies bodies;
  bodies.add(block_mesh(1, 1, 1));
  bodies.x[3][1] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW((void)bodies.measure(), std::invalid_argument);
}

/// Two rings linked at random, against every tet and every triangle, and edges by a thousand
/// points.
TEST(Penetration, AgreesWithTryingEverything) {
  std::mt19937_64 random(23);
  std::normal_distribution<double> normal;
  int inside = 0;
  for (int trial = 0; trial < 4; ++trial) {
    TubeShape shape{0.7, 1.0, -0.2, 0.2, 12, 2, 2};
    Bodies bodies;
    for (int ring = 0; ring < 2; ++ring) {
      Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
      pose.translate(0.5 * Vec3(normal(random), normal(random), normal(random)));
      pose.rotate(Eigen::Quaterniond(normal(random), normal(random), normal(random), normal(random))
                      .normalized());
      bodies.add(tube_mesh(shape), pose);
    }
    const auto surface =
        geometry::boundary_surface(bodies.tets, geometry::tet_adjacency(bodies.tets));
    const auto half = static_cast<std::int32_t>(bodies.x.size() / 2);
    // The depth of a point of ring `own` in the other one.
    const auto depth = [&](const Vec3& p, bool second) {
      const auto other = [&](std::int32_t v) { return (v >= half) != second; };
      const bool in = std::any_of(bodies.tets.begin(), bodies.tets.end(), [&](const Tet& t) {
        if (!other(t[0])) return false;
        const auto x = [&](int i) { return bodies.x[static_cast<std::size_t>(t[i])]; };
        return geometry::signed_volume(p, x(1), x(2), x(3)) >= 0 &&
               geometry::signed_volume(x(0), p, x(2), x(3)) >= 0 &&
               geometry::signed_volume(x(0), x(1), p, x(3)) >= 0 &&
               geometry::signed_volume(x(0), x(1), x(2), p) >= 0;
      });
      if (!in) return 0.0;
      double nearest2 = std::numeric_limits<double>::infinity();
      for (const auto& t : surface.triangles)
        if (other(t[0])) {
          const auto x = [&](int i) { return bodies.x[static_cast<std::size_t>(t[i])]; };
          nearest2 = std::min(
              nearest2,
              geometry::closest_point_on_triangle(p, x(0), x(1), x(2)).squared_distance_m2);
        }
      return std::sqrt(nearest2);
    };
    Penetration expected;
    for (const std::int32_t v : surface.vertices) {
      const double d = depth(bodies.x[static_cast<std::size_t>(v)], v >= half);
      expected.vertices += d > 0.0;
      expected.vertex_depth_m = std::max(expected.vertex_depth_m, d);
    }
    std::set<std::pair<std::int32_t, std::int32_t>> edges;
    for (const auto& t : surface.triangles)
      for (std::size_t i = 0; i < 3; ++i) edges.insert(std::minmax(t[i], t[(i + 1) % 3]));
    constexpr int kPoints = 25;
    double spacing_m = 0.0;
    for (const auto& [a, b] : edges) {
      const Vec3 &p = bodies.x[static_cast<std::size_t>(a)],
                 &q = bodies.x[static_cast<std::size_t>(b)];
      bool in = false;
      for (int i = 0; i <= kPoints; ++i) {
        const double d = depth(p + (q - p) * i / kPoints, a >= half);
        in = in || d > 0.0;
        expected.edge_depth_m = std::max(expected.edge_depth_m, d);
      }
      expected.edges += in;
      spacing_m = std::max(spacing_m, (q - p).norm() / kPoints);
    }
    const Penetration found = bodies.measure();
    EXPECT_EQ(found.vertices, expected.vertices);
    EXPECT_NEAR(found.vertex_depth_m, expected.vertex_depth_m, kRounding);
    EXPECT_GE(found.edges, expected.edges);
    EXPECT_LE(found.edges, expected.edges + expected.edges / 10 + 2);  // between two points
    EXPECT_GE(found.edge_depth_m, expected.edge_depth_m - kEdge);
    EXPECT_LE(found.edge_depth_m, expected.edge_depth_m + spacing_m / 2);
    inside += found.vertices;
  }
  EXPECT_GT(inside, 10) << "too little overlap for this test to mean anything";
}

}  // namespace
}  // namespace sutured::testing
