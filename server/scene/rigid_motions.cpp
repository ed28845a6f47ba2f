// SPDX-License-Identifier: GPL-3.0-or-later
#include "scene/rigid_motions.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cstddef>
#include <map>
#include <utility>

namespace sutured::scene {

namespace {

// Eigenvalues of the rows' Gram matrix below this share of the largest are motions left free. A
// tissue held by points 1e-4 of its size apart still counts as held.
constexpr double kFreeShare = 1e-10;

// Maps the twist (t, ω · size) of a part to the displacement of x.
Eigen::Matrix<double, 3, 6> rigid_displacement(const Vec3& x, const Vec3& centre, double size) {
  const Vec3 r = (x - centre) / size;
  Eigen::Matrix<double, 3, 6> map;
  map << 1, 0, 0, 0, r.z(), -r.y(),  //
      0, 1, 0, -r.z(), 0, r.x(),     //
      0, 0, 1, r.y(), -r.x(), 0;
  return map;
}

}  // namespace

std::vector<LooseComponent> loose_components(const geometry::TetMesh& mesh,
                                             const geometry::Components& components,
                                             const geometry::TetAdjacency& adjacency,
                                             std::span<const Prescribed> prescribed) {
  const std::size_t vertex_count = mesh.vertices_m.size();
  std::vector<std::array<bool, 3>> held(vertex_count, {false, false, false});
  for (const Prescribed& entry : prescribed)
    for (const std::int32_t v : entry.vertices)
      for (std::size_t axis = 0; axis < 3; ++axis)
        held[static_cast<std::size_t>(v)][axis] |= entry.axes[axis];

  // The rigid parts that each vertex belongs to; more than one at a hinge only.
  const geometry::Components parts = geometry::face_connected_components(adjacency);
  std::vector<std::vector<std::int32_t>> parts_of(vertex_count);
  std::vector<std::int32_t> component_of_vertex(vertex_count, 0);
  std::vector<std::int32_t> component_of_part(static_cast<std::size_t>(parts.count), 0);
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    const std::int32_t part = parts.of_tet[t];
    component_of_part[static_cast<std::size_t>(part)] = components.of_tet[t];
    for (const std::int32_t v : mesh.tets[t]) {
      auto& list = parts_of[static_cast<std::size_t>(v)];
      if (std::find(list.begin(), list.end(), part) == list.end()) list.push_back(part);
      component_of_vertex[static_cast<std::size_t>(v)] = components.of_tet[t];
    }
  }

  std::vector<LooseComponent> loose;
  for (int c = 0; c < components.count; ++c) {
    Eigen::AlignedBox3d box;
    int count = 0;
    for (std::size_t v = 0; v < vertex_count; ++v)
      if (component_of_vertex[v] == c) {
        box.extend(mesh.vertices_m[v]);
        ++count;
      }
    std::map<std::int32_t, Eigen::Index> block;  // of each part of this component
    for (std::int32_t part = 0; part < parts.count; ++part)
      if (component_of_part[static_cast<std::size_t>(part)] == c)
        block.emplace(part, 6 * static_cast<Eigen::Index>(block.size()));
    const int part_count = static_cast<int>(block.size());
    if (part_count > kRigidPartsMax) {
      loose.push_back({c, count, box.center(), 0, part_count});
      continue;
    }
    const auto size = 6 * static_cast<Eigen::Index>(block.size());
    Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(size, size);
    const double scale = 0.5 * box.diagonal().norm();
    for (std::size_t v = 0; v < vertex_count; ++v) {
      if (component_of_vertex[v] != c) continue;
      const auto map = rigid_displacement(mesh.vertices_m[v], box.center(), scale);
      const Eigen::Index first = block.at(parts_of[v].front());
      for (Eigen::Index axis = 0; axis < 3; ++axis)
        if (held[v][static_cast<std::size_t>(axis)])
          gram.block<6, 6>(first, first) += map.row(axis).transpose() * map.row(axis);
      for (std::size_t k = 1; k < parts_of[v].size(); ++k) {
        const Eigen::Index other = block.at(parts_of[v][k]);
        const Eigen::Matrix<double, 6, 6> shared = map.transpose() * map;
        gram.block<6, 6>(first, first) += shared;
        gram.block<6, 6>(other, other) += shared;
        gram.block<6, 6>(first, other) -= shared;
        gram.block<6, 6>(other, first) -= shared;
      }
    }
    const Eigen::VectorXd values =
        Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(gram, Eigen::EigenvaluesOnly).eigenvalues();
    const double limit = kFreeShare * std::max(values.maxCoeff(), 1e-300);
    const auto free = static_cast<int>((values.array() <= limit).count());
    if (free > 0) loose.push_back({c, count, box.center(), free, part_count});
  }
  return loose;
}

}  // namespace sutured::scene
