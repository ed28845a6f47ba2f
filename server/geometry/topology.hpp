// SPDX-License-Identifier: GPL-3.0-or-later
// What a list of tets implies: neighbours, boundary, components. Integers only.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/tet_mesh.hpp"

namespace sutured::geometry {

/// The vertices of the face opposite vertex i of a positively oriented tet, wound outward.
inline constexpr std::array<std::array<int, 3>, 4> kTetFaces{
    {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}};

/// Returns the face of `tet` opposite its vertex `face`, wound outward.
[[nodiscard]] inline Triangle tet_face(const Tet& tet, int face) {
  const auto& corners = kTetFaces[static_cast<std::size_t>(face)];
  return {tet[static_cast<std::size_t>(corners[0])], tet[static_cast<std::size_t>(corners[1])],
          tet[static_cast<std::size_t>(corners[2])]};
}

/// One tet's claim to a face.
struct FaceUse {
  Triangle key;  ///< the face's vertices in ascending order
  std::int32_t tet = 0;
  std::int32_t face = 0;  ///< index of the opposite vertex in the tet
};

/// Returns all 4 × tets.size() face uses, ordered by key, then tet: equal keys lie side by side.
[[nodiscard]] std::vector<FaceUse> sorted_face_uses(std::span<const Tet> tets);

/// For each tet the tet behind the face opposite its vertex i, or −1 at the boundary.
using TetAdjacency = std::vector<std::array<std::int32_t, 4>>;

/// Returns the neighbour of every tet across each of its faces.
///
/// Throws std::invalid_argument if more than two tets share a face (`read_mesh` lets none through).
[[nodiscard]] TetAdjacency tet_adjacency(std::span<const Tet> tets);

/// The boundary of a tet mesh: the faces that belong to one tet only.
struct BoundarySurface {
  std::vector<Triangle> triangles;     ///< wound outward, vertex indices of the mesh
  std::vector<std::int32_t> tet;       ///< the tet behind each triangle
  std::vector<std::int32_t> tet_face;  ///< which of its faces it is: the index opposite
  std::vector<std::int32_t> vertices;  ///< used by `triangles`, sorted, unique
};

/// Returns the boundary, ordered by tet, then face.
[[nodiscard]] BoundarySurface boundary_surface(std::span<const Tet> tets,
                                               const TetAdjacency& adjacency);

/// A partition of tets into connected parts.
struct Components {
  int count = 0;
  std::vector<std::int32_t> of_tet;  ///< component of each tet, numbered by first appearance
};

/// Returns the parts that hang together through shared vertices.
[[nodiscard]] Components connected_components(std::span<const Tet> tets, std::size_t vertex_count);

/// Returns the parts that hang together through shared faces: each moves as one rigid body at
/// zero energy, where parts joined in a vertex or an edge only can still turn about it.
[[nodiscard]] Components face_connected_components(const TetAdjacency& adjacency);

}  // namespace sutured::geometry
