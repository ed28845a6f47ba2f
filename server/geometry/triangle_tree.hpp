// SPDX-License-Identifier: GPL-3.0-or-later
// A bounding-box tree over the triangles of a deforming surface.
//
// The shape of the tree is fixed when it is built; `refit` moves its boxes along with the
// vertices in one pass from the leaves up. Tissue deforms moderately, so the boxes stay tight.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "geometry/closest_point.hpp"
#include "geometry/tet_mesh.hpp"

namespace sutured::geometry {

using Box = Eigen::AlignedBox3d;

/// A point of a surface: where `TriangleTree::nearest` found it.
struct SurfacePoint {
  std::int32_t triangle = -1;  ///< index into the tree's triangles
  ClosestPoint closest;
};

/// Directions within `angle` of `axis`; an angle over a right one holds all directions.
struct DirectionCone {
  Vec3 axis = Vec3::UnitZ();
  double cosine = 1.0, sine = 0.0;  ///< of the angle
  bool all = false;
  /// Directions whose sum is shorter than this have no mean.
  static constexpr double kNoMean = 1e-6;

  /// Returns the cone around the mean of `direction(i)`, i < `count`, each of length one; that of
  /// all directions where one is zero.
  template <typename Direction>
  [[nodiscard]] static DirectionCone around(std::size_t count, Direction&& direction);
  /// Returns a cone that holds both.
  [[nodiscard]] static DirectionCone merged(const DirectionCone& a, const DirectionCone& b);
};

/// The directions that enclose an angle with a cosine below `cosine_max` ≤ 0 with some direction of
/// a cone.
class OpposingDirections {
 public:
  OpposingDirections(const DirectionCone& own, double cosine_max);
  /// Whether `other` may hold one of them. Where it says no, it does not.
  [[nodiscard]] bool may_be_in(const DirectionCone& other) const {
    if (own_.all || other.all || sine_ * other.cosine - cosine_ * other.sine <= 0.0) return true;
    return own_.axis.dot(other.axis) < cosine_ * other.cosine + sine_ * other.sine;
  }

 private:
  // The widest angle between the two cones is that of the axes, α, and both half angles, β and γ.
  // It stays under the limit θ ≥ 90° where α < θ − β − γ.
  DirectionCone own_;
  double cosine_, sine_;  // of θ − β
};

/// Finds the triangles near something. Queries: any number of threads while nobody refits.
class TriangleTree {
 public:
  TriangleTree() = default;

  /// Builds the tree over `triangles` (copied) at `vertices_m`, O(n log n). Neither may be empty
  /// of what the other refers to. Throws std::invalid_argument for an index out of range.
  TriangleTree(std::span<const Triangle> triangles, std::span<const Vec3> vertices_m);

  /// Fits every box to the vertices where they are now. `vertices_m` is indexed as at
  /// construction. Allocates: never.
  void refit(std::span<const Vec3> vertices_m) noexcept;

  /// Calls `visit(triangle)` for each triangle whose box meets `box` (touching counts), each once.
  /// Allocates: never.
  template <typename Visit>
  void for_each_overlap(const Box& box, Visit&& visit) const;

  /// Fits a cone around the normals below each node into `cones`, one a node. `normals`: one a
  /// triangle, of length one (or zero for a triangle without area: its cones hold all directions).
  void fit_cones(std::span<const Vec3> normals, std::vector<DirectionCone>& cones) const;

  /// Calls `visit(triangle)` as `for_each_overlap` does, but passes over triangles whose normals,
  /// by `cones`, are not among `opposing`. Of those that it visits, some are not either.
  /// Allocates: never.
  template <typename Visit>
  void for_each_opposing(const Box& box, std::span<const DirectionCone> cones,
                         const OpposingDirections& opposing, Visit&& visit) const;

  /// Returns the surface's point nearest to `p` if one lies within `radius_m`. Of the triangles
  /// that share an edge or a vertex nearest to `p`, it is the one whose plane is farthest from it:
  /// its side of the plane tells inside from outside, and its plane's distance is closest to that
  /// of the point. The lower index wins where these are equal too. Distances that differ by
  /// rounding only, 1e-9 of their squares, are equal. `vertices_m` are those of the last refit.
  /// Allocates: never.
  [[nodiscard]] std::optional<SurfacePoint> nearest(
      const Vec3& p, double radius_m, std::span<const Vec3> vertices_m) const noexcept;

  [[nodiscard]] std::span<const Triangle> triangles() const noexcept { return triangles_; }
  /// Returns the box of the whole surface; empty for a tree without triangles.
  [[nodiscard]] Box bounds() const noexcept { return nodes_.empty() ? Box() : nodes_[0].box; }

 private:
  // Children stand behind their parent, the left one right behind it.
  struct Node {
    Box box;
    std::int32_t right = 0;  // index of the right child; 0 for a leaf
    std::int32_t first = 0;  // of a leaf: its range of `order_`
    std::int32_t count = 0;
  };
  // Halving keeps the depth below 32 for any number of triangles an int32 can count, and a
  // depth-first walk keeps at most one pending node a level.
  static constexpr std::size_t kStackSize = 64;
  static constexpr std::int32_t kLeafSize = 4;

  template <typename Where, typename Visit>
  void for_each_overlap_where(const Box& box, Where&& where, Visit&& visit) const;
  std::int32_t build(std::int32_t first, std::int32_t last, std::span<const Vec3> centroids_m);

  std::vector<Triangle> triangles_;
  std::vector<std::int32_t> order_;  // triangle indices, leaf by leaf
  std::vector<Box> boxes_;           // of each triangle
  std::vector<Node> nodes_;
};

template <typename Visit>
void TriangleTree::for_each_overlap(const Box& box, Visit&& visit) const {
  for_each_overlap_where(
      box, [](std::int32_t) { return true; }, visit);
}

template <typename Direction>
DirectionCone DirectionCone::around(std::size_t count, Direction&& direction) {
  DirectionCone out;
  Vec3 sum = Vec3::Zero();
  for (std::size_t i = 0; i < count; ++i) sum += direction(i);
  const double norm = sum.norm();
  if (norm < kNoMean) {
    out.all = true;
    return out;
  }
  out.axis = sum / norm;
  for (std::size_t i = 0; i < count; ++i)
    out.cosine = std::min(out.cosine, out.axis.dot(direction(i)));
  out.sine = std::sqrt(std::max(0.0, 1.0 - out.cosine * out.cosine));
  out.all = out.cosine <= 0.0;
  return out;
}

template <typename Visit>
void TriangleTree::for_each_opposing(const Box& box, std::span<const DirectionCone> cones,
                                     const OpposingDirections& opposing, Visit&& visit) const {
  for_each_overlap_where(
      box,
      [&](std::int32_t node) { return opposing.may_be_in(cones[static_cast<std::size_t>(node)]); },
      visit);
}

template <typename Where, typename Visit>
void TriangleTree::for_each_overlap_where(const Box& box, Where&& where, Visit&& visit) const {
  if (nodes_.empty()) return;
  std::array<std::int32_t, kStackSize> stack;
  std::size_t depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const std::int32_t index = stack[--depth];
    const Node& node = nodes_[static_cast<std::size_t>(index)];
    if (!node.box.intersects(box) || !where(index)) continue;
    if (node.right != 0) {
      stack[depth++] = node.right;
      stack[depth++] = index + 1;
      continue;
    }
    for (std::int32_t i = node.first; i < node.first + node.count; ++i) {
      const std::int32_t triangle = order_[static_cast<std::size_t>(i)];
      if (boxes_[static_cast<std::size_t>(triangle)].intersects(box)) visit(triangle);
    }
  }
}

}  // namespace sutured::geometry
