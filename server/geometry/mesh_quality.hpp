// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/tet_mesh.hpp"

namespace sutured::geometry {

/// How well a mesh is shaped.
struct MeshQuality {
  double volume_m3 = 0.0;
  Eigen::AlignedBox3d bounds_m;
  /// Radius ratio of every tet, 3 r / R with r the inscribed and R the circumscribed sphere's
  /// radius: 1 for a regular tet, 0 for a flat one. Ordered as the tets are.
  std::vector<double> radius_ratio;
  double radius_ratio_min = 0.0;
  double radius_ratio_p01 = 0.0;  ///< first percentile
  double radius_ratio_median = 0.0;
  double dihedral_min_deg = 0.0;
  double dihedral_max_deg = 0.0;
  double edge_min_m = 0.0;
  double edge_mean_m = 0.0;  ///< over the edges of every tet, shared ones counted for each
  double edge_max_m = 0.0;
};

/// Measures a mesh. An empty one measures zero throughout.
[[nodiscard]] MeshQuality mesh_quality(const TetMesh& mesh);

/// Returns the `count` tets of least radius ratio, worst first.
[[nodiscard]] std::vector<std::int32_t> worst_tets(const MeshQuality& quality, std::size_t count);

/// Returns the radius ratio 3 r / R of tet (a, b, c, d), 0 where it has no volume.
[[nodiscard]] double radius_ratio(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d);

}  // namespace sutured::geometry
