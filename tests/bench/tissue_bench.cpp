// SPDX-License-Identifier: GPL-3.0-or-later
// Three columns of L⁻¹ by one walk of a path against full solves, and the backward pass against
// reading L. The two sides of a ratio are measured in turn: a machine that is shared or changes
// its clock slows both.
#include <algorithm>
#include <cstdio>
#include <random>

#include "bench/figures.hpp"
#include "fem/cholesky_factor.hpp"
#include "support/fem_model.hpp"
#include "support/tube_mesh.hpp"

namespace sutured::bench {
namespace {

using geometry::Vec3;

/// Two vessels with the measures of the paper's, cut as finely as asked, far ends fixed.
fem::Model two_vessels(int around, int across, int along) {
  auto mesh = testing::tube_mesh({4.5e-3, 6.0e-3, -20.75e-3, -0.75e-3, around, across, along});
  const auto other = testing::tube_mesh({3.5e-3, 5.0e-3, 0.75e-3, 20.75e-3, around, across, along});
  const auto first = static_cast<std::int32_t>(mesh.vertices_m.size());
  mesh.vertices_m.insert(mesh.vertices_m.end(), other.vertices_m.begin(), other.vertices_m.end());
  for (geometry::Tet tet : other.tets) {
    for (auto& v : tet) v += first;
    mesh.tets.push_back(tet);
  }
  fem::Model model = testing::model_of(mesh, {2.0e5, 0.45});
  testing::prescribe(
      model, [](const Vec3& x) { return std::abs(x.z()) > 20.7e-3; },
      [](const Vec3&) -> Vec3 { return Vec3::Zero(); });
  return model;
}

void measure_mesh(Figures& figures, const std::string& name, const fem::Model& model,
                  bool with_budget) {
  const fem::LinearSystem system = fem::assemble(model);
  const double factor_us = time_us([&] { (void)fem::CholeskyFactor(system); });
  const fem::CholeskyFactor factor(system);
  const auto size = static_cast<std::size_t>(factor.size());

  std::mt19937_64 random(1);
  std::vector<double> walk_us, solve_us, ratio;
  fem::PathColumns columns;
  std::vector<double> b(3 * size), x(3 * size);
  const int trials = model.vertices_m.size() > 10000 ? 40 : 200;
  for (int trial = 0; trial < trials + 1; ++trial) {
    std::size_t v = 0;
    do v = random() % model.vertices_m.size();
    while (model.prescribed[3 * v] != 0);
    std::fill(b.begin(), b.end(), 0.0);
    for (std::size_t axis = 0; axis < 3; ++axis)
      b[axis * size + static_cast<std::size_t>(system.free_index[3 * v + axis])] = 1.0;
    const double walked_us =
        time_us([&] { factor.walk_path(static_cast<std::int32_t>(v), columns); });
    const double solved_us = time_us([&] { factor.solve(b, x); });
    if (trial == 0) continue;  // memory touched for the first time
    walk_us.push_back(walked_us);
    solve_us.push_back(solved_us);
    ratio.push_back(solved_us / walked_us);
  }

  std::vector<double> backward_us, read_us, backward_ratio;
  const fem::PathLoad load{&columns, geometry::Vec3(0.1, 0.2, -0.3)};
  std::vector<double> offset(3 * model.vertices_m.size(), 0.0), u(offset.size());
  double sum = 0.0;
  for (int trial = 0; trial < trials + 1; ++trial) {
    const double read = wall_time_us([&] { sum += factor.read_once(); });
    const double backward = wall_time_us([&] { factor.backward({&load, 1}, offset, u); });
    if (trial == 0) continue;
    read_us.push_back(read);
    backward_us.push_back(backward);
    backward_ratio.push_back(backward / read);
  }
  if (!(std::abs(sum) > 0.0)) std::printf("an empty factor\n");  // keeps the reading in the program

  figures.add("vertices." + name, static_cast<double>(model.vertices_m.size()), "");
  figures.add("tets." + name, static_cast<double>(model.tets.size()), "");
  figures.add("factor_mb." + name, 8e-6 * static_cast<double>(factor.stored_values()), "MB");
  figures.add("factor_ms." + name, 1e-3 * factor_us, "ms");
  figures.add("three_columns_by_full_solve_ms." + name, 1e-3 * quantile(solve_us, 0.5), "ms");
  figures.add("three_columns_by_path_walk_ms." + name, 1e-3 * quantile(walk_us, 0.5), "ms");
  figures.add("path_walk_over_full_solve." + name, quantile(ratio, 0.5), "x");
  figures.add("backward_ms." + name, 1e-3 * quantile(backward_us, 0.5), "ms");
  figures.add("reading_factor_ms." + name, 1e-3 * quantile(read_us, 0.5), "ms");
  figures.add("backward_over_reading_factor." + name, quantile(backward_ratio, 0.5), "x",
              with_budget ? std::optional<double>(1.5) : std::nullopt);
}

}  // namespace

void measure_tissue(Figures& figures) {
  measure_mesh(figures, "v1k6", two_vessels(20, 1, 20), false);
  measure_mesh(figures, "v6k", two_vessels(32, 2, 31), false);
  measure_mesh(figures, "v24k", two_vessels(60, 3, 49), true);
}

}  // namespace sutured::bench
