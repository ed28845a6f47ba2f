// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <numeric>
#include <utility>

#include "geometry/tet_mesh.hpp"

namespace sutured::testing {

/// Returns a block [0, size] of nx × ny × nz cubes, each cut into six tets around its diagonal.
/// Vertex (i, j, k) has index i + (nx + 1) (j + (ny + 1) k).
inline geometry::TetMesh block_mesh(int nx, int ny, int nz,
                                    const geometry::Vec3& size_m = {1.0, 1.0, 1.0}) {
  geometry::TetMesh mesh;
  const auto index = [&](const std::array<int, 3>& at) {
    return static_cast<std::int32_t>(at[0] + (nx + 1) * (at[1] + (ny + 1) * at[2]));
  };
  for (int k = 0; k <= nz; ++k)
    for (int j = 0; j <= ny; ++j)
      for (int i = 0; i <= nx; ++i)
        mesh.vertices_m.push_back(
            geometry::Vec3(i, j, k).cwiseQuotient(geometry::Vec3(nx, ny, nz)).cwiseProduct(size_m));
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j)
      for (int i = 0; i < nx; ++i) {
        std::array<std::size_t, 3> axes{0, 1, 2};
        do {  // one tet for each order of walking from the low corner to the high one
          std::array<int, 3> at{i, j, k};
          geometry::Tet tet{index(at)};
          for (std::size_t step = 0; step < 3; ++step) {
            ++at[axes[step]];
            tet[step + 1] = index(at);
          }
          const auto x = [&](std::size_t c) -> const geometry::Vec3& {
            return mesh.vertices_m[static_cast<std::size_t>(tet[c])];
          };
          if (geometry::signed_volume(x(0), x(1), x(2), x(3)) < 0.0) std::swap(tet[2], tet[3]);
          mesh.tets.push_back(tet);
        } while (std::next_permutation(axes.begin(), axes.end()));
      }
  mesh.file_index.resize(mesh.vertices_m.size());
  std::iota(mesh.file_index.begin(), mesh.file_index.end(), 0);
  return mesh;
}

/// Returns both meshes as one, `b` beside `a` and apart from it: no vertex is shared.
inline geometry::TetMesh side_by_side(const geometry::TetMesh& a, const geometry::TetMesh& b) {
  geometry::TetMesh mesh = a;
  const auto first = static_cast<std::int32_t>(a.vertices_m.size());
  double right_m = 0.0;
  for (const geometry::Vec3& x : a.vertices_m) right_m = std::max(right_m, x[0]);
  for (const geometry::Vec3& x : b.vertices_m)
    mesh.vertices_m.push_back(x + geometry::Vec3(right_m + 1.0, 0.0, 0.0));
  for (geometry::Tet tet : b.tets) {
    for (std::int32_t& vertex : tet) vertex += first;
    mesh.tets.push_back(tet);
  }
  return mesh;
}

}  // namespace sutured::testing
