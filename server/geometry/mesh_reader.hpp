// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <span>
#include <string>
#include <vector>

#include "geometry/mesh_error.hpp"
#include "geometry/tet_mesh.hpp"

namespace sutured::geometry {

/// A mesh, and what its reading has to say about the file.
struct MeshReading {
  TetMesh mesh;
  std::string format;              ///< "MSH 2.2, text"
  std::vector<std::string> notes;  ///< what was changed or left out, a sentence each
};

/// Reads the tetrahedra of a mesh file: MSH 1, 2.2 or 4.1, or legacy VTK.
///
/// Coordinates are multiplied by `scale` (metres per unit of the file). Only the tets of the
/// physical volumes named in `volumes` are read, all of them where it is empty. Elements of lower
/// dimension matter as groups only; nodes without a tet are dropped and noted. A file whose tets
/// are all left-handed is turned round and noted.
///
/// Throws MeshError with every fault found: structure, node numbers, coordinates that are not
/// finite, inverted, flat or doubled tets, faces with more than two tets, unknown volumes.
///
/// Safety: the file's structure is checked before libgmsh sees it (mesh_file_guard.hpp).
/// Thread: any; libgmsh is a singleton, so that calls wait for each other.
[[nodiscard]] MeshReading read_mesh(const std::string& path, double scale,
                                    std::span<const std::string> volumes = {});

}  // namespace sutured::geometry
