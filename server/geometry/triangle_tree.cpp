// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/triangle_tree.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

namespace sutured::geometry {

TriangleTree::TriangleTree(std::span<const Triangle> triangles, std::span<const Vec3> vertices_m)
    : triangles_(triangles.begin(), triangles.end()),
      order_(triangles.size()),
      boxes_(triangles.size()) {
  if (triangles_.empty()) return;
  std::vector<Vec3> centroids_m;
  centroids_m.reserve(triangles_.size());
  for (const Triangle& triangle : triangles_) {
    Vec3 centroid = Vec3::Zero();
    for (const std::int32_t v : triangle) {
      if (v < 0 || static_cast<std::size_t>(v) >= vertices_m.size())
        throw std::invalid_argument("a triangle refers to a vertex that does not exist");
      centroid += vertices_m[static_cast<std::size_t>(v)] / 3.0;
    }
    centroids_m.push_back(centroid);
  }
  std::iota(order_.begin(), order_.end(), 0);
  nodes_.reserve(triangles_.size());
  build(0, static_cast<std::int32_t>(triangles_.size()), centroids_m);
  refit(vertices_m);
}

std::int32_t TriangleTree::build(std::int32_t first, std::int32_t last,
                                 std::span<const Vec3> centroids_m) {
  const auto index = static_cast<std::int32_t>(nodes_.size());
  nodes_.emplace_back();
  if (last - first <= kLeafSize) {
    nodes_.back().first = first;
    nodes_.back().count = last - first;
    return index;
  }
  const auto centroid = [&](std::int32_t triangle) -> const Vec3& {
    return centroids_m[static_cast<std::size_t>(triangle)];
  };
  Box spread;
  for (std::int32_t i = first; i < last; ++i)
    spread.extend(centroid(order_[static_cast<std::size_t>(i)]));
  Eigen::Index axis = 0;
  spread.sizes().maxCoeff(&axis);
  const std::int32_t middle = first + (last - first) / 2;
  std::nth_element(order_.begin() + first, order_.begin() + middle, order_.begin() + last,
                   [&](std::int32_t a, std::int32_t b) {
                     const double xa = centroid(a)[axis];
                     const double xb = centroid(b)[axis];
                     return xa < xb || (xa == xb && a < b);
                   });
  build(first, middle, centroids_m);
  const std::int32_t right = build(middle, last, centroids_m);
  nodes_[static_cast<std::size_t>(index)].right = right;
  return index;
}

void TriangleTree::refit(std::span<const Vec3> vertices_m) noexcept {
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    Box& box = boxes_[t];
    box.setEmpty();
    for (const std::int32_t v : triangles_[t]) box.extend(vertices_m[static_cast<std::size_t>(v)]);
  }
  for (std::size_t n = nodes_.size(); n-- > 0;) {
    Node& node = nodes_[n];
    if (node.right != 0) {
      node.box = nodes_[n + 1].box.merged(nodes_[static_cast<std::size_t>(node.right)].box);
      continue;
    }
    node.box.setEmpty();
    for (std::int32_t i = node.first; i < node.first + node.count; ++i)
      node.box.extend(boxes_[static_cast<std::size_t>(order_[static_cast<std::size_t>(i)])]);
  }
}

DirectionCone DirectionCone::merged(const DirectionCone& a, const DirectionCone& b) {
  DirectionCone out;
  out.all = a.all || b.all;
  const Vec3 sum = a.axis + b.axis;
  const double norm = sum.norm();
  if (out.all || norm < kNoMean) {
    out.all = true;
    return out;
  }
  out.axis = sum / norm;
  for (const DirectionCone* part : {&a, &b}) {
    // cos and sin of the angle to the part's axis and the part's own, together.
    const double cosine = std::min(1.0, out.axis.dot(part->axis));
    const double sine = std::sqrt(std::max(0.0, 1.0 - cosine * cosine));
    const double far_cosine = cosine * part->cosine - sine * part->sine;
    if (far_cosine >= out.cosine) continue;
    out.cosine = far_cosine;
    out.sine = sine * part->cosine + cosine * part->sine;
  }
  out.all = out.cosine <= 0.0;
  return out;
}

OpposingDirections::OpposingDirections(const DirectionCone& own, double cosine_max) : own_(own) {
  const double limit_sine = std::sqrt(std::max(0.0, 1.0 - cosine_max * cosine_max));
  cosine_ = cosine_max * own.cosine + limit_sine * own.sine;
  sine_ = limit_sine * own.cosine - cosine_max * own.sine;
}

void TriangleTree::fit_cones(std::span<const Vec3> normals,
                             std::vector<DirectionCone>& cones) const {
  cones.resize(nodes_.size());
  for (std::size_t n = nodes_.size(); n-- > 0;) {
    const Node& node = nodes_[n];
    if (node.right != 0) {
      cones[n] = DirectionCone::merged(cones[n + 1], cones[static_cast<std::size_t>(node.right)]);
      continue;
    }
    const std::int32_t* triangle = order_.data() + node.first;
    cones[n] = DirectionCone::around(static_cast<std::size_t>(node.count),
                                     [&](std::size_t i) -> const Vec3& {
                                       return normals[static_cast<std::size_t>(triangle[i])];
                                     });
  }
}

namespace {

/// Returns up to what a squared distance is the same but for rounding.
double with_ties(double squared_m2) noexcept { return squared_m2 * (1.0 + 1e-9) + 1e-30; }

/// Returns the squared distance, along the triangle's normal, that `d` spans; 0 without an area.
double squared_plane_distance(const Vec3& d, const Vec3& a, const Vec3& b, const Vec3& c) noexcept {
  const Vec3 normal = (b - a).cross(c - a);
  const double squared_length = normal.squaredNorm(), along = normal.dot(d);
  return squared_length > 0.0 ? along * along / squared_length : 0.0;
}

}  // namespace

std::optional<SurfacePoint> TriangleTree::nearest(const Vec3& p, double radius_m,
                                                  std::span<const Vec3> vertices_m) const noexcept {
  if (nodes_.empty()) return std::nullopt;
  struct Pending {
    std::int32_t node;
    double squared_distance;
  };
  const auto squared_distance = [&](std::int32_t n) {
    return nodes_[static_cast<std::size_t>(n)].box.squaredExteriorDistance(p);
  };
  std::array<Pending, kStackSize> stack;
  std::size_t depth = 0;
  stack[depth++] = {0, squared_distance(0)};
  SurfacePoint best;
  double best_squared = radius_m * radius_m, best_facing = 0.0;
  while (depth > 0) {
    const Pending pending = stack[--depth];
    if (pending.squared_distance > with_ties(best_squared)) continue;
    const Node& node = nodes_[static_cast<std::size_t>(pending.node)];
    if (node.right != 0) {
      Pending near{pending.node + 1, squared_distance(pending.node + 1)};
      Pending far{node.right, squared_distance(node.right)};
      if (far.squared_distance < near.squared_distance) std::swap(near, far);
      stack[depth++] = far;
      stack[depth++] = near;
      continue;
    }
    for (std::int32_t i = node.first; i < node.first + node.count; ++i) {
      const std::int32_t t = order_[static_cast<std::size_t>(i)];
      if (boxes_[static_cast<std::size_t>(t)].squaredExteriorDistance(p) > with_ties(best_squared))
        continue;
      const Triangle& triangle = triangles_[static_cast<std::size_t>(t)];
      const Vec3& a = vertices_m[static_cast<std::size_t>(triangle[0])];
      const Vec3& b = vertices_m[static_cast<std::size_t>(triangle[1])];
      const Vec3& c = vertices_m[static_cast<std::size_t>(triangle[2])];
      const ClosestPoint closest = closest_point_on_triangle(p, a, b, c);
      const double squared = closest.squared_distance_m2;
      if (squared > (best.triangle < 0 ? best_squared : with_ties(best_squared))) continue;
      const double facing = squared_plane_distance(p - closest.point_m, a, b, c);
      const bool ties = best.triangle >= 0 && with_ties(squared) >= best_squared;
      if (ties) {
        const bool faces_alike =
            facing <= with_ties(best_facing) && best_facing <= with_ties(facing);
        if (faces_alike ? t > best.triangle : facing < best_facing) {
          best_squared = std::min(best_squared, squared);
          continue;
        }
      }
      best = {t, closest};
      best_squared = ties ? std::min(best_squared, squared) : squared;
      best_facing = facing;
    }
  }
  if (best.triangle < 0) return std::nullopt;
  return best;
}

}  // namespace sutured::geometry
