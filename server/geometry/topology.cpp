// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/topology.hpp"

#include <algorithm>
#include <numeric>
#include <stdexcept>
#include <string>
#include <tuple>

namespace sutured::geometry {

std::vector<FaceUse> sorted_face_uses(std::span<const Tet> tets) {
  std::vector<FaceUse> uses;
  uses.reserve(4 * tets.size());
  for (std::size_t t = 0; t < tets.size(); ++t) {
    for (int face = 0; face < 4; ++face) {
      Triangle key = tet_face(tets[t], face);
      std::sort(key.begin(), key.end());
      uses.push_back({key, static_cast<std::int32_t>(t), face});
    }
  }
  std::sort(uses.begin(), uses.end(), [](const FaceUse& a, const FaceUse& b) {
    return std::tie(a.key, a.tet) < std::tie(b.key, b.tet);
  });
  return uses;
}

TetAdjacency tet_adjacency(std::span<const Tet> tets) {
  TetAdjacency adjacency(tets.size(), {-1, -1, -1, -1});
  const auto uses = sorted_face_uses(tets);
  for (std::size_t i = 0; i + 1 < uses.size(); ++i) {
    const FaceUse& a = uses[i];
    const FaceUse& b = uses[i + 1];
    if (a.key != b.key) continue;
    if (i + 2 < uses.size() && uses[i + 2].key == a.key)
      throw std::invalid_argument("tets " + std::to_string(a.tet) + ", " + std::to_string(b.tet) +
                                  " and " + std::to_string(uses[i + 2].tet) + " share one face");
    adjacency[static_cast<std::size_t>(a.tet)][static_cast<std::size_t>(a.face)] = b.tet;
    adjacency[static_cast<std::size_t>(b.tet)][static_cast<std::size_t>(b.face)] = a.tet;
  }
  return adjacency;
}

BoundarySurface boundary_surface(std::span<const Tet> tets, const TetAdjacency& adjacency) {
  BoundarySurface surface;
  for (std::size_t t = 0; t < tets.size(); ++t) {
    for (int face = 0; face < 4; ++face) {
      if (adjacency[t][static_cast<std::size_t>(face)] >= 0) continue;
      surface.triangles.push_back(tet_face(tets[t], face));
      surface.tet.push_back(static_cast<std::int32_t>(t));
      surface.tet_face.push_back(face);
    }
  }
  for (const auto& triangle : surface.triangles)
    surface.vertices.insert(surface.vertices.end(), triangle.begin(), triangle.end());
  std::sort(surface.vertices.begin(), surface.vertices.end());
  surface.vertices.erase(std::unique(surface.vertices.begin(), surface.vertices.end()),
                         surface.vertices.end());
  return surface;
}

namespace {

class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parent_(count) {
    std::iota(parent_.begin(), parent_.end(), 0);
  }
  std::int32_t find(std::int32_t i) {
    while (parent(i) != i) {
      parent(i) = parent(parent(i));
      i = parent(i);
    }
    return i;
  }
  void unite(std::int32_t a, std::int32_t b) { parent(find(a)) = find(b); }

 private:
  std::int32_t& parent(std::int32_t i) { return parent_[static_cast<std::size_t>(i)]; }
  std::vector<std::int32_t> parent_;
};

// Numbers the sets by the first tet that belongs to each.
template <typename RootOfTet>
Components number_components(std::size_t tet_count, std::size_t set_count, RootOfTet root_of_tet) {
  Components components;
  components.of_tet.reserve(tet_count);
  std::vector<std::int32_t> number(set_count, -1);
  for (std::size_t t = 0; t < tet_count; ++t) {
    auto& n = number[static_cast<std::size_t>(root_of_tet(t))];
    if (n < 0) n = components.count++;
    components.of_tet.push_back(n);
  }
  return components;
}

}  // namespace

Components connected_components(std::span<const Tet> tets, std::size_t vertex_count) {
  DisjointSets sets(vertex_count);
  for (const Tet& tet : tets)
    for (std::size_t i = 1; i < 4; ++i) sets.unite(tet[0], tet[i]);
  return number_components(tets.size(), vertex_count,
                           [&](std::size_t t) { return sets.find(tets[t][0]); });
}

Components face_connected_components(const TetAdjacency& adjacency) {
  DisjointSets sets(adjacency.size());
  for (std::size_t t = 0; t < adjacency.size(); ++t)
    for (const std::int32_t neighbour : adjacency[t])
      if (neighbour >= 0) sets.unite(static_cast<std::int32_t>(t), neighbour);
  return number_components(adjacency.size(), adjacency.size(),
                           [&](std::size_t t) { return sets.find(static_cast<std::int32_t>(t)); });
}

}  // namespace sutured::geometry
