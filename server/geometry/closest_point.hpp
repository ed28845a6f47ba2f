// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>

#include "geometry/tet_mesh.hpp"

namespace sutured::geometry {

/// The part of a triangle that a closest point lies on. Edge i joins vertices i and (i + 1) % 3.
enum class TriangleFeature : std::uint8_t {
  kVertex0,
  kVertex1,
  kVertex2,
  kEdge0,
  kEdge1,
  kEdge2,
  kFace
};

struct ClosestPoint {
  Vec3 point_m = Vec3::Zero();
  Vec3 barycentric = Vec3::Zero();  ///< of the triangle's vertices; none negative, sum 1
  TriangleFeature feature = TriangleFeature::kFace;
  double squared_distance_m2 = 0.0;
};

/// Returns the point of triangle (a, b, c) closest to `p`, by the Voronoi regions of its features.
///
/// A triangle without area (squared sine of every corner below about 1e-24) is taken as its edges.
/// Allocates: never.
[[nodiscard]] ClosestPoint closest_point_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b,
                                                     const Vec3& c) noexcept;

}  // namespace sutured::geometry
