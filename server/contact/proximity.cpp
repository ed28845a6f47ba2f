// SPDX-License-Identifier: GPL-3.0-or-later
#include "contact/proximity.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace sutured::contact {

Proximity vertex_face(const Vec3& v, const Vec3& a, const Vec3& b, const Vec3& c) {
  Proximity out;
  const Vec3 area = (b - a).cross(c - a);
  const double squared = area.squaredNorm();
  if (squared <= 0.0) return out;
  out.valid = true;
  out.normal = area / std::sqrt(squared);
  const Vec3 d = v - a;
  out.gap_m = out.normal.dot(d);
  const double wb = d.cross(c - a).dot(area) / squared, wc = (b - a).cross(d).dot(area) / squared;
  const double wa = 1.0 - wb - wc;
  out.coefficient = {1.0, -wa, -wb, -wc};
  out.margin = std::min({wa, wb, wc});
  return out;
}

Proximity edge_edge(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, const Vec3& outward,
                    double sine_min) {
  Proximity out;
  const Vec3 e = b - a, f = d - c;
  const Vec3 cross = e.cross(f);
  const double squared = cross.squaredNorm(), scale = e.squaredNorm() * f.squaredNorm();
  if (squared <= sine_min * sine_min * scale || squared <= 0.0) return out;
  out.valid = true;
  out.normal = cross / std::sqrt(squared);
  if (out.normal.dot(outward) < 0.0) out.normal = -out.normal;
  const Vec3 r = c - a;
  const double alpha = r.cross(f).dot(cross) / squared, beta = r.cross(e).dot(cross) / squared;
  out.gap_m = out.normal.dot(r);
  out.coefficient = {alpha - 1.0, -alpha, 1.0 - beta, beta};
  out.margin = std::min({alpha, 1.0 - alpha, beta, 1.0 - beta});
  return out;
}

}  // namespace sutured::contact
