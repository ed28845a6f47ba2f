// SPDX-License-Identifier: GPL-3.0-or-later
// What `sutured check` has to say of a mesh: measured once, told as text or as JSON.
#pragma once

#include <iosfwd>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "geometry/mesh_quality.hpp"
#include "geometry/tet_mesh.hpp"
#include "scene/scene.hpp"

namespace sutured::commands {

struct WorstTet {
  int tet = 0;  ///< index in the order of the file
  double radius_ratio = 0.0;
  geometry::Vec3 centre_m = geometry::Vec3::Zero();
};

struct MeshReport {
  std::size_t vertices = 0;
  std::size_t tets = 0;
  std::size_t boundary_faces = 0;
  int components = 0;
  geometry::MeshQuality quality;
  std::vector<WorstTet> worst;
};

/// Measures a mesh.
[[nodiscard]] MeshReport report_mesh(const geometry::TetMesh& mesh);

/// Prints size, extent, quality, components and groups, indented under a heading.
void print_mesh(std::ostream& out, const geometry::TetMesh& mesh, const MeshReport& report);

/// Prints what the mesh would measure if its file were in millimetres, centimetres, … A file of
/// `scale` metres per unit was read.
void print_units(std::ostream& out, const MeshReport& report, double scale);

[[nodiscard]] nlohmann::json mesh_json(const geometry::TetMesh& mesh, const MeshReport& report);

/// Returns a length with the unit it reads best in, three digits: "12.3 mm".
[[nodiscard]] std::string length_text(double length_m);

}  // namespace sutured::commands
