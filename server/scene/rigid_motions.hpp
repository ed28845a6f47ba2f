// SPDX-License-Identifier: GPL-3.0-or-later
// Whether the constraints of a tissue hold it: K is singular exactly if they do not.
//
// The energy of linear tetrahedra vanishes for the rigid motions of each part that hangs together
// by faces, and for nothing else. A part i moves by u(x) = t_i + ω_i × (x − c_i); a prescribed axis
// e of a vertex asks e · u(x) = 0, a vertex that two parts share asks u_i(x) = u_j(x). What these
// rows leave free is K's null space.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "geometry/topology.hpp"
#include "scene/scene.hpp"

namespace sutured::scene {

/// Most parts of a component whose motions are looked for: their matrix is dense.
inline constexpr int kRigidPartsMax = 200;

/// A component (by shared vertices) of a tissue that its constraints do not hold.
struct LooseComponent {
  int component = 0;  ///< numbered as in `connected_components`
  int vertex_count = 0;
  Vec3 centre_m = Vec3::Zero();
  int free_motions = 0;  ///< independent rigid motions left, 6 where nothing is fixed
  int parts = 1;         ///< more than `kRigidPartsMax`: its motions were not looked for
};

/// Returns the components that can still move rigidly or have too many parts, or an empty list
/// where K is regular.
[[nodiscard]] std::vector<LooseComponent> loose_components(const geometry::TetMesh& mesh,
                                                           const geometry::Components& components,
                                                           const geometry::TetAdjacency& adjacency,
                                                           std::span<const Prescribed> prescribed);

}  // namespace sutured::scene
