// SPDX-License-Identifier: GPL-3.0-or-later
#include "contact/features.hpp"

#include <algorithm>
#include <tuple>

namespace sutured::contact {

SurfaceFeatures::SurfaceFeatures(std::span<const geometry::Triangle> triangles,
                                 std::size_t vertex_count)
    : first_(vertex_count + 1, 0), triangle_edges_(triangles.size(), {-1, -1, -1}) {
  for (const auto& triangle : triangles)
    for (const auto v : triangle) ++first_[static_cast<std::size_t>(v) + 1];
  for (std::size_t v = 0; v < vertex_count; ++v) {
    if (first_[v + 1] > 0) vertices_.push_back(static_cast<std::int32_t>(v));
    first_[v + 1] += first_[v];
  }
  triangle_at_.resize(3 * triangles.size());
  std::vector<std::int32_t> next(first_.begin(), first_.end() - 1);
  struct Use {
    std::array<std::int32_t, 2> key;
    std::int32_t triangle, corner;
  };
  std::vector<Use> uses;
  for (std::size_t t = 0; t < triangles.size(); ++t)
    for (std::size_t i = 0; i < 3; ++i) {
      const auto v = triangles[t][i], w = triangles[t][(i + 1) % 3];
      triangle_at_[static_cast<std::size_t>(next[static_cast<std::size_t>(v)]++)] =
          static_cast<std::int32_t>(t);
      uses.push_back({{std::min(v, w), std::max(v, w)},
                      static_cast<std::int32_t>(t),
                      static_cast<std::int32_t>(i)});
    }
  std::sort(uses.begin(), uses.end(), [](const Use& a, const Use& b) {
    return std::tie(a.key, a.triangle) < std::tie(b.key, b.triangle);
  });
  for (std::size_t i = 0; i < uses.size();) {
    SurfaceEdge edge;
    edge.vertices = uses[i].key;
    for (std::size_t k = 0; k < 2 && i < uses.size() && uses[i].key == edge.vertices; ++k, ++i) {
      const auto& triangle = triangles[static_cast<std::size_t>(uses[i].triangle)];
      edge.triangles[k] = uses[i].triangle;
      edge.opposite[k] = triangle[static_cast<std::size_t>((uses[i].corner + 2) % 3)];
      triangle_edges_[static_cast<std::size_t>(uses[i].triangle)]
                     [static_cast<std::size_t>(uses[i].corner)] =
                         static_cast<std::int32_t>(edges_.size());
    }
    edges_.push_back(edge);
  }
}

}  // namespace sutured::contact
