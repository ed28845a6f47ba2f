// SPDX-License-Identifier: GPL-3.0-or-later
// A block of soft tissue, held at its bottom, and a probe above it: the smallest scene in which
// a hand feels something.
#pragma once

#include <fstream>
#include <iomanip>
#include <sstream>
#include <string>

#include "support/block_mesh.hpp"
#include "support/temporary_folder.hpp"

namespace sutured::testing {

struct PressedBlock {
  double young_modulus_pa = 2.0e4;
  double max_force_n = 0.5;
  double max_force_slew_n_per_s = 40.0;  ///< low enough to be seen

  static constexpr double kSurface_m = 0.01, kProbeRadius_m = 0.002;
  static constexpr double kX_m = 0.011, kY_m = 0.009;  ///< where to press
  /// Height of a probe that presses `depth_m` deep.
  static constexpr double height_m(double depth_m) { return kSurface_m + kProbeRadius_m - depth_m; }

  /// Writes mesh and scene; returns the scene's path. Its tool is "probe".
  [[nodiscard]] std::string write(const TemporaryFolder& folder) const {
    const geometry::TetMesh mesh = block_mesh(4, 4, 3, {0.02, 0.02, kSurface_m});
    std::ofstream vtk(folder.path("block.vtk"));
    vtk << std::setprecision(17) << "# vtk DataFile Version 3.0\nblock\nASCII\nDATASET "
        << "UNSTRUCTURED_GRID\nPOINTS " << mesh.vertices_m.size() << " double\n";
    for (const auto& v : mesh.vertices_m) vtk << v.x() << ' ' << v.y() << ' ' << v.z() << '\n';
    vtk << "CELLS " << mesh.tets.size() << ' ' << 5 * mesh.tets.size() << '\n';
    for (const auto& t : mesh.tets)
      vtk << "4 " << t[0] << ' ' << t[1] << ' ' << t[2] << ' ' << t[3] << '\n';
    vtk << "CELL_TYPES " << mesh.tets.size() << '\n';
    for (std::size_t i = 0; i < mesh.tets.size(); ++i) vtk << "10\n";
    vtk.close();
    std::ostringstream scene;
    scene << R"(
name = "block"
rate_hz = 250
[[tissue]]
name = "block"
mesh = "block.vtk"
poisson_ratio = 0.4
fixed = [{ box = { min_m = [-1, -1, -1], max_m = [1, 1, 1e-6] } }]
)"
          << "young_modulus_pa = " << young_modulus_pa << R"(
[[tool]]
name = "probe"
kind = "probe"
)"
          << "probe_radius_m = " << kProbeRadius_m << "\nmax_force_n = " << max_force_n
          << "\nmax_force_slew_n_per_s = " << max_force_slew_n_per_s << '\n';
    return folder.write("scene.toml", scene.str());
  }
};

}  // namespace sutured::testing
