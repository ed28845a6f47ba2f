// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/closest_point.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstddef>

namespace sutured::geometry {

namespace {

// The closest point of the edge from corner i to corner (i + 1) % 3.
ClosestPoint closest_point_on_edge(const Vec3& p, const std::array<const Vec3*, 3>& corners,
                                   int i) noexcept {
  const int j = (i + 1) % 3;
  const Vec3& start = *corners[static_cast<std::size_t>(i)];
  const Vec3 along = *corners[static_cast<std::size_t>(j)] - start;
  const double squared_length = along.squaredNorm();
  const double t =
      squared_length > 0.0 ? std::clamp((p - start).dot(along) / squared_length, 0.0, 1.0) : 0.0;
  ClosestPoint closest;
  closest.barycentric[i] = 1.0 - t;
  closest.barycentric[j] = t;
  closest.point_m = start + t * along;
  closest.squared_distance_m2 = (p - closest.point_m).squaredNorm();
  const int feature = t == 0.0 ? i : t == 1.0 ? j : 3 + i;
  closest.feature = static_cast<TriangleFeature>(feature);
  return closest;
}

}  // namespace

ClosestPoint closest_point_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b,
                                       const Vec3& c) noexcept {
  const Vec3 ab = b - a;
  const Vec3 ac = c - a;
  const Vec3 normal = ab.cross(ac);
  const double squared_area = normal.squaredNorm();
  const Vec3 ap = p - a;
  // Barycentric coordinates of the projection on the plane, times `squared_area`.
  const double scaled_b = ap.cross(ac).dot(normal);
  const double scaled_c = ab.cross(ap).dot(normal);
  const double scaled_a = squared_area - scaled_b - scaled_c;
  const double longest = std::max({ab.squaredNorm(), ac.squaredNorm(), (c - b).squaredNorm()});
  const bool has_area = squared_area > 1e-24 * longest * longest;
  if (has_area && scaled_a > 0.0 && scaled_b > 0.0 && scaled_c > 0.0) {
    ClosestPoint closest;
    closest.barycentric = Vec3(scaled_a, scaled_b, scaled_c) / squared_area;
    closest.point_m = a + closest.barycentric[1] * ab + closest.barycentric[2] * ac;
    closest.squared_distance_m2 = (p - closest.point_m).squaredNorm();
    closest.feature = TriangleFeature::kFace;
    return closest;
  }
  const std::array<const Vec3*, 3> corners{&a, &b, &c};
  ClosestPoint closest = closest_point_on_edge(p, corners, 0);
  for (int edge = 1; edge < 3; ++edge) {
    const ClosestPoint candidate = closest_point_on_edge(p, corners, edge);
    if (candidate.squared_distance_m2 < closest.squared_distance_m2) closest = candidate;
  }
  return closest;
}

}  // namespace sutured::geometry
