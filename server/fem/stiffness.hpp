// SPDX-License-Identifier: GPL-3.0-or-later
// From a mesh with materials to K u = f over the free degrees of freedom.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "fem/elements.hpp"

namespace sutured::fem {

/// Everything K and f are assembled from. Several bodies may stand side by side in it.
///
///   n vertices, degree of freedom 3 v + axis
struct Model {
  std::vector<Vec3> vertices_m;  ///< n, at rest
  std::vector<Tet> tets;         ///< positively oriented
  std::vector<Material> materials;
  std::vector<std::int32_t> material_of_tet;  ///< one per tet, into `materials`
  std::vector<std::uint8_t> prescribed;       ///< 3n, 1 where the displacement is imposed
  std::vector<double> prescribed_m;           ///< 3n, read where `prescribed`
  std::vector<double> load_n;                 ///< 3n, dead loads; ignored where `prescribed`
};

/// K and f over the free degrees of freedom, the prescribed ones eliminated:
///
///     K_ff u_f = f_f − K_fp u_p
///
/// K is the lower triangle, compressed by columns with sorted rows.
struct LinearSystem {
  std::int32_t vertex_count = 0;
  std::vector<std::int32_t> free_index;  ///< 3n: its row in K, or −1 where prescribed
  std::vector<std::int64_t> column_start;
  std::vector<std::int64_t> row;
  std::vector<double> value;  ///< N/m
  std::vector<double> right_hand_side_n;
  [[nodiscard]] std::int64_t size() const {
    return static_cast<std::int64_t>(right_hand_side_n.size());
  }
};

/// Assembles K and f. Precondition: tets are valid and have positive volume.
[[nodiscard]] LinearSystem assemble(const Model& model);

/// Computes K u over all degrees of freedom (3n), element by element: the internal forces,
/// whose values at prescribed degrees of freedom are the reactions (plus their load).
[[nodiscard]] std::vector<double> internal_forces_n(const Model& model,
                                                    std::span<const double> u_m);

/// Adds the forces of gravity, ρ V g / 4 per corner, to `load_n` (3n). One density per material.
void add_gravity(const Model& model, std::span<const double> density_kg_per_m3,
                 const Vec3& gravity_m_per_s2, std::span<double> load_n);

}  // namespace sutured::fem
