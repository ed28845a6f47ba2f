// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <utility>

#include "geometry/tet_mesh.hpp"

namespace sutured::testing {

/// A tube about the z axis, and into how many cells it is cut.
struct TubeShape {
  double inner_radius_m = 0.0;
  double outer_radius_m = 0.0;
  double bottom_m = 0.0;
  double top_m = 0.0;
  int around = 8;  ///< a multiple of 4 puts vertices on the axes x and y
  int across = 1;
  int along = 1;
};

/// Returns a structured mesh of a tube, each of its cells cut into six tets around its diagonal.
/// Vertex (i around, j across, k along) has index i + around (j + (across + 1) k).
inline geometry::TetMesh tube_mesh(const TubeShape& shape) {
  geometry::TetMesh mesh;
  const auto index = [&](const std::array<int, 3>& at) {
    return static_cast<std::int32_t>(at[0] % shape.around +
                                     shape.around * (at[1] + (shape.across + 1) * at[2]));
  };
  for (int k = 0; k <= shape.along; ++k)
    for (int j = 0; j <= shape.across; ++j)
      for (int i = 0; i < shape.around; ++i) {
        const double angle = 2.0 * EIGEN_PI * i / shape.around;
        const double radius = std::lerp(shape.inner_radius_m, shape.outer_radius_m,
                                        static_cast<double>(j) / shape.across);
        mesh.vertices_m.emplace_back(
            radius * std::cos(angle), radius * std::sin(angle),
            std::lerp(shape.bottom_m, shape.top_m, static_cast<double>(k) / shape.along));
      }
  for (int k = 0; k < shape.along; ++k)
    for (int j = 0; j < shape.across; ++j)
      for (int i = 0; i < shape.around; ++i) {
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

}  // namespace sutured::testing
