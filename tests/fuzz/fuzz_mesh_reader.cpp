// SPDX-License-Identifier: GPL-3.0-or-later
// A mesh file all the way through libgmsh: a mesh or a MeshError.
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <string>

#include "geometry/mesh_reader.hpp"
#include "support/temporary_folder.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const sutured::testing::TemporaryFolder folder;
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  const std::string path = folder.write(size > 0 && data[0] == '#' ? "a.vtk" : "a.msh", bytes);
  try {
    (void)sutured::geometry::read_mesh(path, 1.0);
  } catch (const sutured::geometry::MeshError&) {
  }
  return 0;
}
