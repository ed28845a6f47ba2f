// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace sutured::geometry {

using Vec3 = Eigen::Vector3d;
using Tet = std::array<std::int32_t, 4>;
using Triangle = std::array<std::int32_t, 3>;

/// A named set of a mesh's entities: a physical group of the file.
struct PhysicalGroup {
  std::string name;                    ///< its name in the file, or its tag as decimal digits
  int dimension = 0;                   ///< 0 points, 1 curves, 2 surfaces, 3 volumes
  std::vector<std::int32_t> vertices;  ///< sorted, unique
  std::vector<Triangle> triangles;     ///< dimension 2 only, as wound in the file
  std::vector<std::int32_t> tets;      ///< dimension 3 only
};

/// A volume mesh of linear tetrahedra, in metres, at rest.
///
/// Every tet is positively oriented: (x1 − x0) · ((x2 − x0) × (x3 − x0)) > 0.
/// Every vertex belongs to at least one tet. `file_index[v]` is the zero-based
/// position of vertex v among the nodes of the file it was read from.
struct TetMesh {
  std::vector<Vec3> vertices_m;
  std::vector<Tet> tets;
  std::vector<PhysicalGroup> groups;
  std::vector<std::int32_t> file_index;

  [[nodiscard]] const PhysicalGroup* find_group(const std::string& name) const {
    for (const auto& group : groups)
      if (group.name == name) return &group;
    return nullptr;
  }
};

/// Returns the volume of tet (a, b, c, d) in m³, negative where it is inverted.
[[nodiscard]] inline double signed_volume(const Vec3& a, const Vec3& b, const Vec3& c,
                                          const Vec3& d) {
  return (b - a).dot((c - a).cross(d - a)) / 6.0;
}

}  // namespace sutured::geometry
