// SPDX-License-Identifier: GPL-3.0-or-later
// The guard before libgmsh: whatever the bytes, it returns a checked file or throws MeshError.
#include <cstddef>
#include <cstdint>
#include <string>

#include "geometry/mesh_file_guard.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  for (const char* path : {"a.msh", "a.vtk"}) {
    try {
      const auto file = sutured::geometry::check_mesh_bytes(path, bytes);
      // What is handed on must pass the guard itself.
      (void)sutured::geometry::check_mesh_bytes(path, file.bytes);
    } catch (const sutured::geometry::MeshError&) {
    }
  }
  return 0;
}
