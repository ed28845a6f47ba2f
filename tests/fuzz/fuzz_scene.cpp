// SPDX-License-Identifier: GPL-3.0-or-later
// A scene's text beside a good mesh `a.msh`: a scene or a SceneError that names a fault.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "scene/scene_reader.hpp"
#include "support/temporary_folder.hpp"

namespace {

constexpr const char* kMesh =
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 2 \"base\"\n3 3 \"left\"\n"
    "$EndPhysicalNames\n$Nodes\n5\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n$EndNodes\n"
    "$Elements\n3\n4 2 2 2 1 1 3 2\n5 4 2 3 1 1 2 3 4\n6 4 2 4 2 2 3 4 5\n$EndElements\n";

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const sutured::testing::TemporaryFolder folder;
  static const std::string mesh = folder.write("a.msh", kMesh);
  try {
    (void)sutured::scene::parse_scene(std::string(reinterpret_cast<const char*>(data), size),
                                      folder.path("s.toml"));
  } catch (const sutured::scene::SceneError& error) {
    if (error.faults().empty()) std::abort();
  }
  return 0;
}
