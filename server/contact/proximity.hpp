// SPDX-License-Identifier: GPL-3.0-or-later
// The gap of a vertex over a face, and of two edges that cross, with what a contact row needs.
//
//     gap = n · Σ cᵢ xᵢ                    c sums to zero
//
//   vertex–face   n the face's outward normal, c = (1, −β₀, −β₁, −β₂), β of the projection
//   edge–edge     n = ± e × f / |e × f|, outward of e, c = (−(1 − α), −α, 1 − β, β)
//
// α and β are those of the nearest points of the two lines; beyond 0 … 1 they lie outside.
#pragma once

#include <array>

#include "geometry/tet_mesh.hpp"

namespace sutured::contact {

using geometry::Vec3;

/// Where two features come closest. Positive gap: apart.
struct Proximity {
  bool valid = false;  ///< false: parallel edges, or a triangle without area
  Vec3 normal = Vec3::UnitZ();
  double gap_m = 0.0;
  std::array<double, 4> coefficient{};  ///< c
  /// How far inside its feature the nearest point lies, as a share of the feature: the smallest
  /// barycentric coordinate; negative outside.
  double margin = 0.0;
};

/// Proximity of vertex `v` over the triangle (a, b, c), by projection. Order of c: v, a, b, c.
[[nodiscard]] Proximity vertex_face(const Vec3& v, const Vec3& a, const Vec3& b, const Vec3& c);

/// Proximity of the edges (a, b) and (c, d); `outward` points from the body of the first to that
/// of the second. Invalid where the sine of their angle is below `sine_min`.
[[nodiscard]] Proximity edge_edge(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d,
                                  const Vec3& outward, double sine_min);

}  // namespace sutured::contact
