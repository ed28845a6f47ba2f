// SPDX-License-Identifier: GPL-3.0-or-later
// A tissue view that owns what it looks at, for tests of the needle.
#pragma once

#include "geometry/topology.hpp"
#include "geometry/triangle_tree.hpp"
#include "needle/path.hpp"

namespace sutured::testing {

struct OwnedTissue {
  explicit OwnedTissue(geometry::TetMesh m)
      : mesh(std::move(m)),
        adjacency(geometry::tet_adjacency(mesh.tets)),
        surface(geometry::boundary_surface(mesh.tets, adjacency)),
        tree(surface.triangles, mesh.vertices_m),
        triangle_of_face(4 * mesh.tets.size(), -1) {
    for (std::size_t i = 0; i < surface.triangles.size(); ++i)
      triangle_of_face[static_cast<std::size_t>(4 * surface.tet[i] + surface.tet_face[i])] =
          static_cast<std::int32_t>(i);
  }
  [[nodiscard]] needle::TissueView view() const {
    return {mesh.vertices_m, mesh.tets, &adjacency, &surface, &tree, triangle_of_face};
  }
  geometry::TetMesh mesh;
  geometry::TetAdjacency adjacency;
  geometry::BoundarySurface surface;
  geometry::TriangleTree tree;
  std::vector<std::int32_t> triangle_of_face;
};

}  // namespace sutured::testing
