// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/mesh_quality.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "geometry/topology.hpp"

namespace sutured::geometry {

namespace {

using Corners = std::array<Vec3, 4>;

// The value below which the share `fraction` of `values` lies (reorders them).
double quantile(std::vector<double>& values, double fraction) {
  const auto rank = static_cast<std::ptrdiff_t>(fraction * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[static_cast<std::size_t>(rank)];
}

Vec3 face_normal(const Corners& x, std::size_t face) {
  const auto& f = kTetFaces[face];
  const auto at = [&](std::size_t i) -> const Vec3& { return x[static_cast<std::size_t>(f[i])]; };
  return (at(1) - at(0)).cross(at(2) - at(0)).normalized();
}

}  // namespace

double radius_ratio(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const Vec3 ab = b - a;
  const Vec3 ac = c - a;
  const Vec3 ad = d - a;
  const double six_volumes = std::abs(ab.dot(ac.cross(ad)));
  const double doubled_area =
      ab.cross(ac).norm() + ac.cross(ad).norm() + ad.cross(ab).norm() + (c - b).cross(d - b).norm();
  // r = 3 V / area, R = |…| / (12 V).
  const double circumradius_times_12v =
      (ad.squaredNorm() * ab.cross(ac) + ac.squaredNorm() * ad.cross(ab) +
       ab.squaredNorm() * ac.cross(ad))
          .norm();
  if (!(doubled_area > 0.0) || !(circumradius_times_12v > 0.0)) return 0.0;
  const double inradius = six_volumes / doubled_area;
  return 3.0 * inradius * 2.0 * six_volumes / circumradius_times_12v;
}

MeshQuality mesh_quality(const TetMesh& mesh) {
  MeshQuality quality;
  if (mesh.tets.empty()) return quality;
  for (const Vec3& x : mesh.vertices_m) quality.bounds_m.extend(x);
  quality.edge_min_m = std::numeric_limits<double>::infinity();
  double largest_cosine = -1.0;
  double least_cosine = 1.0;
  double edge_sum = 0.0;
  for (const Tet& tet : mesh.tets) {
    Corners x;
    for (std::size_t i = 0; i < 4; ++i) x[i] = mesh.vertices_m[static_cast<std::size_t>(tet[i])];
    quality.volume_m3 += signed_volume(x[0], x[1], x[2], x[3]);
    quality.radius_ratio.push_back(radius_ratio(x[0], x[1], x[2], x[3]));
    for (std::size_t i = 0; i < 4; ++i) {
      for (std::size_t j = i + 1; j < 4; ++j) {
        const double edge = (x[j] - x[i]).norm();
        edge_sum += edge;
        quality.edge_min_m = std::min(quality.edge_min_m, edge);
        quality.edge_max_m = std::max(quality.edge_max_m, edge);
        // The angle inside between two faces is π less the one between their outward normals.
        const double cosine = -face_normal(x, i).dot(face_normal(x, j));
        largest_cosine = std::max(largest_cosine, cosine);
        least_cosine = std::min(least_cosine, cosine);
      }
    }
  }
  const auto degrees = [](double cosine) {
    return std::acos(std::clamp(cosine, -1.0, 1.0)) * 180.0 / std::numbers::pi;
  };
  quality.dihedral_min_deg = degrees(largest_cosine);
  quality.dihedral_max_deg = degrees(least_cosine);
  quality.edge_mean_m = edge_sum / (6.0 * static_cast<double>(mesh.tets.size()));
  std::vector<double> ratios = quality.radius_ratio;
  quality.radius_ratio_median = quantile(ratios, 0.5);
  quality.radius_ratio_p01 = quantile(ratios, 0.01);
  quality.radius_ratio_min = quantile(ratios, 0.0);
  return quality;
}

std::vector<std::int32_t> worst_tets(const MeshQuality& quality, std::size_t count) {
  std::vector<std::int32_t> order(quality.radius_ratio.size());
  std::iota(order.begin(), order.end(), 0);
  const auto end = order.begin() + static_cast<std::ptrdiff_t>(std::min(count, order.size()));
  std::partial_sort(order.begin(), end, order.end(), [&](std::int32_t a, std::int32_t b) {
    return quality.radius_ratio[static_cast<std::size_t>(a)] <
           quality.radius_ratio[static_cast<std::size_t>(b)];
  });
  order.erase(end, order.end());
  return order;
}

}  // namespace sutured::geometry
