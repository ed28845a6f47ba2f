// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/mesh_error.hpp"

#include <algorithm>

namespace sutured::geometry {

std::string MeshError::text(const std::string& path, const std::vector<MeshFault>& faults) {
  std::string text;
  const std::size_t shown = std::min(faults.size(), kShownFaults);
  for (std::size_t i = 0; i < shown; ++i) {
    const MeshFault& fault = faults[i];
    if (i > 0) text += '\n';
    text += path;
    if (fault.line > 0) text += ':' + std::to_string(fault.line);
    text += ": ";
    if (!fault.entity.empty()) text += fault.entity + ": ";
    text += fault.what;
    if (!fault.mend.empty()) text += "; " + fault.mend;
  }
  if (faults.size() > shown)
    text += '\n' + path + ": " + std::to_string(faults.size() - shown) + " more faults";
  return text;
}

}  // namespace sutured::geometry
