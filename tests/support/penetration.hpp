// SPDX-License-Identifier: GPL-3.0-or-later
// An oracle for contact: how deep tissues reach into each other and into themselves.
#pragma once

#include <span>

#include "geometry/tet_mesh.hpp"

namespace sutured::testing {

/// How deep, and how much of, the surface lies inside tissue.
struct Penetration {
  double vertex_depth_m = 0.0;  ///< of the deepest surface vertex
  double edge_depth_m = 0.0;    ///< of the deepest point of any surface edge
  int vertices = 0;             ///< surface vertices inside
  int edges = 0;                ///< surface edges with a part inside
};

/// Measures how deep the surface of `tets` at `positions_m` lies inside tissue, its own or another.
///
/// A tissue is a part that hangs together through shared vertices; its surface S the faces that one
/// tet uses. For a point p of a surface vertex or edge, inside a tet of tissue T that shares no
/// vertex with it,
///
///     depth(p) = min |p − s|     over the triangles s of S_T that share no vertex with it
///
/// so that the tissue next to the point, on which it lies, is not in question. Among two tissues
/// nothing is left out and the depth is exact. Within one, the triangles around the point are, and
/// a depth beyond their size is found as their size at least.
///
/// The depth of an edge is the largest over its part inside T: that part is cut out tet by tet, and
/// the maximum found by bisection between bounds (the depth changes by at most the length gone, and
/// the distance to one triangle is convex along the edge), to 1e-6 of the edge.
/// Thus an edge counts that crosses a surface with both its ends outside. Where two surfaces
/// meet, an edge of one crosses a face of the other, so nothing reaches in unseen.
///
/// Less than 1e-9 of the model's diagonal is touching, not inside. Orientation does not matter: a
/// tet that is inside out holds what lies in it all the same; a flat one holds nothing.
///
/// Shares no code with the contact search: own boundary, own grid, own distances.
/// Throws std::invalid_argument where a position is not finite.
[[nodiscard]] Penetration measure_penetration(std::span<const geometry::Vec3> positions_m,
                                              std::span<const geometry::Tet> tets);

}  // namespace sutured::testing
