// SPDX-License-Identifier: GPL-3.0-or-later
// Small tissues for tests, and dense oracles of them.
#pragma once

#include <Eigen/Dense>
#include <memory>

#include "fem/cholesky_factor.hpp"
#include "fem/stiffness.hpp"
#include "geometry/tet_mesh.hpp"

namespace sutured::testing {

/// Wraps a mesh as one material without prescribed displacements or loads.
inline fem::Model model_of(const geometry::TetMesh& mesh, const fem::Material& material) {
  fem::Model model;
  model.vertices_m = mesh.vertices_m;
  model.tets = mesh.tets;
  model.materials = {material};
  model.material_of_tet.assign(mesh.tets.size(), 0);
  model.prescribed.assign(3 * mesh.vertices_m.size(), 0);
  model.prescribed_m.assign(3 * mesh.vertices_m.size(), 0.0);
  model.load_n.assign(3 * mesh.vertices_m.size(), 0.0);
  return model;
}

/// Imposes `displacement(x)` wherever `where(x)`.
template <typename Where, typename Displacement>
void prescribe(fem::Model& model, Where&& where, Displacement&& displacement) {
  for (std::size_t v = 0; v < model.vertices_m.size(); ++v) {
    if (!where(model.vertices_m[v])) continue;
    const geometry::Vec3 u = displacement(model.vertices_m[v]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      model.prescribed[3 * v + axis] = 1;
      model.prescribed_m[3 * v + axis] = u[static_cast<Eigen::Index>(axis)];
    }
  }
}

/// Solves K u = f through the factor and returns all 3n displacements.
inline std::vector<double> solve(const fem::Model& model) {
  const fem::LinearSystem system = fem::assemble(model);
  const fem::CholeskyFactor factor(system);
  std::vector<double> free(static_cast<std::size_t>(factor.size()));
  factor.solve(system.right_hand_side_n, free);
  std::vector<double> u = model.prescribed_m;
  for (std::size_t dof = 0; dof < u.size(); ++dof)
    if (system.free_index[dof] >= 0)
      u[dof] = free[static_cast<std::size_t>(system.free_index[dof])];
    else if (!model.prescribed[dof])
      u[dof] = 0.0;
  return u;
}

/// K of the free degrees of freedom as a dense matrix.
inline Eigen::MatrixXd dense_stiffness(const fem::LinearSystem& system) {
  const auto n = static_cast<Eigen::Index>(system.size());
  Eigen::MatrixXd k = Eigen::MatrixXd::Zero(n, n);
  for (Eigen::Index j = 0; j < n; ++j)
    for (auto at = system.column_start[static_cast<std::size_t>(j)];
         at < system.column_start[static_cast<std::size_t>(j) + 1]; ++at) {
      const auto i = static_cast<Eigen::Index>(system.row[static_cast<std::size_t>(at)]);
      k(i, j) = k(j, i) = system.value[static_cast<std::size_t>(at)];
    }
  return k;
}

/// K⁻¹ over all 3n degrees of freedom, zero at prescribed ones.
inline Eigen::MatrixXd dense_inverse(const fem::LinearSystem& system) {
  const Eigen::MatrixXd inverse = dense_stiffness(system).inverse();
  const auto n = static_cast<Eigen::Index>(system.free_index.size());
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(n, n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j) {
      const auto fi = system.free_index[static_cast<std::size_t>(i)];
      const auto fj = system.free_index[static_cast<std::size_t>(j)];
      if (fi >= 0 && fj >= 0) all(i, j) = inverse(fi, fj);
    }
  return all;
}

}  // namespace sutured::testing
