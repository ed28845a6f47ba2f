// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace sutured::geometry {

/// The mend for a file that cannot be read at all.
inline constexpr const char* kMendExport =
    "export tetrahedra as MSH 2.2 or 4.1, or as legacy .vtk (gmsh FILE -3 -o mesh.msh)";

/// One thing wrong with a mesh file.
struct MeshFault {
  int line = 0;        ///< of a text file; 0 where the fault is not in a line
  std::string entity;  ///< "tet 17", "node 4"; empty where it is the whole file
  std::string what;
  std::string mend;  ///< empty where there is nothing better than another file
};

/// A mesh file that cannot be used. `what()` has one line per fault, `path[:line]: [entity: ]what;
/// mend`, at most `kShownFaults` of them, then how many more there are.
class MeshError : public std::runtime_error {
 public:
  static constexpr std::size_t kShownFaults = 20;

  MeshError(const std::string& path, std::vector<MeshFault> faults)
      : std::runtime_error(text(path, faults)), faults_(std::move(faults)) {}

  [[nodiscard]] const std::vector<MeshFault>& faults() const noexcept { return faults_; }

 private:
  static std::string text(const std::string& path, const std::vector<MeshFault>& faults);
  std::vector<MeshFault> faults_;
};

}  // namespace sutured::geometry
