// SPDX-License-Identifier: GPL-3.0-or-later
// The vertices, edges and faces of a boundary, and who is whose neighbour: integers only.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/topology.hpp"

namespace sutured::contact {

using geometry::Vec3;

/// One edge of a boundary with the two triangles at it. Where more than two meet (two parts that
/// touch along an edge), the edge stands once for each pair in the order of the triangles.
struct SurfaceEdge {
  std::array<std::int32_t, 2> vertices{-1, -1};
  std::array<std::int32_t, 2> triangles{-1, -1};  ///< the second is −1 at an open border
  std::array<std::int32_t, 2> opposite{-1, -1};   ///< the third vertex of each triangle
};

/// Neighbourhoods of a boundary. Immutable.
class SurfaceFeatures {
 public:
  SurfaceFeatures() = default;
  /// `vertex_count`: of the mesh whose indices the triangles use.
  SurfaceFeatures(std::span<const geometry::Triangle> triangles, std::size_t vertex_count);

  [[nodiscard]] std::span<const SurfaceEdge> edges() const { return edges_; }
  /// Vertices that the boundary uses, sorted.
  [[nodiscard]] std::span<const std::int32_t> vertices() const { return vertices_; }
  /// Triangles at vertex v; empty inside the body.
  [[nodiscard]] std::span<const std::int32_t> triangles_at(std::int32_t v) const {
    const auto i = static_cast<std::size_t>(v);
    return {triangle_at_.data() + first_[i], static_cast<std::size_t>(first_[i + 1] - first_[i])};
  }
  /// The edges of a triangle, as indices into edges().
  [[nodiscard]] const std::array<std::int32_t, 3>& edges_of(std::int32_t triangle) const {
    return triangle_edges_[static_cast<std::size_t>(triangle)];
  }

 private:
  std::vector<SurfaceEdge> edges_;
  std::vector<std::int32_t> vertices_, first_, triangle_at_;
  std::vector<std::array<std::int32_t, 3>> triangle_edges_;
};

}  // namespace sutured::contact
