// SPDX-License-Identifier: GPL-3.0-or-later
// What stands between a mesh file of unknown origin and libgmsh.
//
// libgmsh chooses a reader by the file's extension, then by its first line, and takes everything
// that is left for a .geo script, which may run shell commands. It also merges options from
// FILE.opt, unpacks FILE.gz through a shell, and its readers trust the counts in a file. So the
// guard reads a file once, walks its whole structure by itself, checks each count and index, and
// hands on only the sections that describe the mesh. libgmsh never opens the file itself.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "geometry/mesh_error.hpp"

namespace sutured::geometry {

enum class MeshFormat : std::uint8_t { kMsh1, kMsh2, kMsh4, kVtk };

/// A mesh file whose structure holds: what libgmsh may read.
struct CheckedMeshFile {
  MeshFormat format = MeshFormat::kMsh2;
  bool binary = false;
  std::string version;                   ///< as written in the header
  std::string bytes;                     ///< a well-formed file with the mesh's sections only
  std::vector<std::uint64_t> node_tags;  ///< in the order of the file
  std::size_t tets = 0, triangles = 0;   ///< elements of these types
  std::vector<std::string> left_out;     ///< names of sections that were not handed on
};

/// Largest file that is read.
inline constexpr std::uint64_t kMeshFileBytesMax = std::uint64_t{1} << 30;

/// Reads and checks the file at `path`: MSH 1, 2.2, 4.1 (text or binary) or legacy VTK (text or
/// binary, unstructured grid). Throws MeshError; never blocks on a pipe or a device.
[[nodiscard]] CheckedMeshFile check_mesh_file(const std::string& path);

/// Checks `bytes` as if read from `path`, whose extension must match the content.
[[nodiscard]] CheckedMeshFile check_mesh_bytes(const std::string& path, std::string bytes);

}  // namespace sutured::geometry
