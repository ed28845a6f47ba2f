// SPDX-License-Identifier: GPL-3.0-or-later
#include "thread/course.hpp"

#include <algorithm>
#include <utility>

namespace sutured::thread {
namespace {

constexpr double kStretchMin_m = 1e-6;

}  // namespace

MaterialPoint on_surface(const geometry::BoundarySurface& surface,
                         const needle::BoundaryPoint& at) {
  MaterialPoint point;
  point.count = 3;
  const auto& triangle = surface.triangles[static_cast<std::size_t>(at.triangle)];
  for (std::size_t i = 0; i < 3; ++i) {
    point.vertices[i] = triangle[i];
    point.weight[static_cast<Eigen::Index>(i)] = at.barycentric[static_cast<Eigen::Index>(i)];
  }
  return point;
}

MaterialPoint in_tet(const geometry::Tet& tet, const Eigen::Vector4d& barycentric) {
  MaterialPoint point;
  point.count = 4;
  point.weight = barycentric;
  std::copy(tet.begin(), tet.end(), point.vertices.begin());
  return point;
}

std::vector<MaterialPoint> straight_course(std::span<const Vec3> vertices_m,
                                           std::span<const geometry::Tet> tets, const Vec3& entry,
                                           const Vec3& exit) {
  std::vector<std::pair<double, MaterialPoint>> found;
  const double length = (exit - entry).norm();
  if (length < kStretchMin_m) return {};
  for (const geometry::Tet& tet : tets) {
    std::array<Vec3, 4> x;
    for (std::size_t a = 0; a < 4; ++a) x[a] = vertices_m[static_cast<std::size_t>(tet[a])];
    // Barycentric coordinates are affine along the line: clip it where one becomes negative.
    const Eigen::Vector4d from = fem::barycentric(x, entry), to = fem::barycentric(x, exit);
    double low = 0.0, high = 1.0;
    for (Eigen::Index a = 0; a < 4; ++a) {
      const double slope = to[a] - from[a];
      if (slope == 0.0) {
        if (from[a] < 0.0) high = -1.0;
        continue;
      }
      const double crossing = -from[a] / slope;
      if (slope > 0.0) {
        low = std::max(low, crossing);
      } else {
        high = std::min(high, crossing);
      }
    }
    if ((high - low) * length < kStretchMin_m) continue;
    const double middle = 0.5 * (low + high);
    found.emplace_back(middle, in_tet(tet, from + middle * (to - from)));
  }
  std::sort(found.begin(), found.end(),
            [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<MaterialPoint> course;
  for (auto& [share, point] : found) course.push_back(point);
  return course;
}

}  // namespace sutured::thread
