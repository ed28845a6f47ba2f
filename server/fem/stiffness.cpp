// SPDX-License-Identifier: GPL-3.0-or-later
#include "fem/stiffness.hpp"

#include <algorithm>
#include <cstddef>

namespace sutured::fem {
namespace {

std::array<Vec3, 4> corners(const Model& model, const Tet& tet) {
  std::array<Vec3, 4> x;
  for (std::size_t a = 0; a < 4; ++a) x[a] = model.vertices_m[static_cast<std::size_t>(tet[a])];
  return x;
}

/// The vertices that share a tet with each vertex, itself included, sorted.
std::vector<std::vector<std::int32_t>> vertex_neighbours(const Model& model) {
  std::vector<std::vector<std::int32_t>> neighbours(model.vertices_m.size());
  for (const Tet& tet : model.tets)
    for (const auto a : tet)
      for (const auto b : tet) neighbours[static_cast<std::size_t>(a)].push_back(b);
  for (auto& list : neighbours) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }
  return neighbours;
}

}  // namespace

LinearSystem assemble(const Model& model) {
  LinearSystem system;
  const std::size_t n = model.vertices_m.size();
  system.vertex_count = static_cast<std::int32_t>(n);
  system.free_index.assign(3 * n, -1);
  std::int32_t free_count = 0;
  for (std::size_t dof = 0; dof < 3 * n; ++dof)
    if (!model.prescribed[dof]) system.free_index[dof] = free_count++;
  system.right_hand_side_n.assign(static_cast<std::size_t>(free_count), 0.0);
  for (std::size_t dof = 0; dof < 3 * n; ++dof)
    if (system.free_index[dof] >= 0)
      system.right_hand_side_n[static_cast<std::size_t>(system.free_index[dof])] =
          model.load_n[dof];

  const auto neighbours = vertex_neighbours(model);
  system.column_start.push_back(0);
  for (std::size_t v = 0; v < n; ++v)
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::int32_t column = system.free_index[3 * v + axis];
      if (column < 0) continue;
      for (const auto w : neighbours[v])
        for (std::size_t other = 0; other < 3; ++other) {
          const std::int32_t row = system.free_index[3 * static_cast<std::size_t>(w) + other];
          if (row >= column) system.row.push_back(row);
        }
      system.column_start.push_back(static_cast<std::int64_t>(system.row.size()));
    }
  system.value.assign(system.row.size(), 0.0);

  for (std::size_t t = 0; t < model.tets.size(); ++t) {
    const Tet& tet = model.tets[t];
    const TetShape shape = tet_shape(corners(model, tet));
    const Material& material = model.materials[static_cast<std::size_t>(model.material_of_tet[t])];
    for (std::size_t a = 0; a < 4; ++a)
      for (std::size_t b = 0; b < 4; ++b) {
        const Mat3 block =
            stiffness_block(shape, material, static_cast<int>(a), static_cast<int>(b));
        for (std::size_t i = 0; i < 3; ++i) {
          const std::size_t row_dof = 3 * static_cast<std::size_t>(tet[a]) + i;
          const std::int32_t row = system.free_index[row_dof];
          if (row < 0) continue;
          for (std::size_t j = 0; j < 3; ++j) {
            const std::size_t column_dof = 3 * static_cast<std::size_t>(tet[b]) + j;
            const std::int32_t column = system.free_index[column_dof];
            const double k = block(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
            if (column < 0) {
              system.right_hand_side_n[static_cast<std::size_t>(row)] -=
                  k * model.prescribed_m[column_dof];
            } else if (row >= column) {
              const auto begin =
                  system.row.begin() + system.column_start[static_cast<std::size_t>(column)];
              const auto end =
                  system.row.begin() + system.column_start[static_cast<std::size_t>(column) + 1];
              const auto at = std::lower_bound(begin, end, row);
              system.value[static_cast<std::size_t>(at - system.row.begin())] += k;
            }
          }
        }
      }
  }
  return system;
}

std::vector<double> internal_forces_n(const Model& model, std::span<const double> u_m) {
  std::vector<double> force(3 * model.vertices_m.size(), 0.0);
  for (std::size_t t = 0; t < model.tets.size(); ++t) {
    const Tet& tet = model.tets[t];
    const TetShape shape = tet_shape(corners(model, tet));
    const Material& material = model.materials[static_cast<std::size_t>(model.material_of_tet[t])];
    for (std::size_t a = 0; a < 4; ++a) {
      Vec3 sum = Vec3::Zero();
      for (std::size_t b = 0; b < 4; ++b) {
        const std::size_t at = 3 * static_cast<std::size_t>(tet[b]);
        sum += stiffness_block(shape, material, static_cast<int>(a), static_cast<int>(b)) *
               Vec3(u_m[at], u_m[at + 1], u_m[at + 2]);
      }
      for (std::size_t i = 0; i < 3; ++i)
        force[3 * static_cast<std::size_t>(tet[a]) + i] += sum[static_cast<Eigen::Index>(i)];
    }
  }
  return force;
}

void add_gravity(const Model& model, std::span<const double> density_kg_per_m3,
                 const Vec3& gravity_m_per_s2, std::span<double> load_n) {
  for (std::size_t t = 0; t < model.tets.size(); ++t) {
    const double mass_kg = tet_shape(corners(model, model.tets[t])).volume_m3 *
                           density_kg_per_m3[static_cast<std::size_t>(model.material_of_tet[t])];
    for (const auto v : model.tets[t])
      for (std::size_t i = 0; i < 3; ++i)
        load_n[3 * static_cast<std::size_t>(v) + i] +=
            0.25 * mass_kg * gravity_m_per_s2[static_cast<Eigen::Index>(i)];
  }
}

}  // namespace sutured::fem
