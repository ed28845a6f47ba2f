// SPDX-License-Identifier: GPL-3.0-or-later
// Against results of an independent implementation, tests/validation/reference/README.md.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>

#include "constraints/complementarity.hpp"
#include "geometry/mesh_quality.hpp"
#include "geometry/mesh_reader.hpp"
#include "needle/curve.hpp"
#include "support/fem_model.hpp"

namespace sutured {
namespace {

using geometry::Vec3;
using nlohmann::json;

std::string reference_path(const std::string& name) {
  return SUTURED_SOURCE_DIR "/tests/validation/reference/" + name;
}

json reference(const std::string& name) {
  std::ifstream file(reference_path(name));
  return json::parse(file);
}

Vec3 vector_of(const json& values) {
  const auto x = values.get<std::array<double, 3>>();
  return {x[0], x[1], x[2]};
}

/// Keeps the largest deviation of what it is shown, so that a test can print it.
class Worst {
 public:
  void see(double got, double expected, double scale) {
    error_ = std::max(error_, std::abs(got - expected) / scale);
  }
  [[nodiscard]] double error() const { return error_; }

 private:
  double error_ = 0.0;
};

TEST(Reference, R1PointLoadsOnTwoVessels) {
  const json expected = reference("R1_fem_point_loads.json");
  const double tolerance = expected.at("tol_rel");
  const geometry::TetMesh mesh = geometry::read_mesh(reference_path(expected.at("mesh")), 1.0).mesh;
  fem::Model model =
      testing::model_of(mesh, {expected.at("E").get<double>(), expected.at("nu").get<double>()});
  testing::prescribe(
      model, [](const Vec3& x) { return std::abs(x.z()) > 20.7495e-3; },
      [](const Vec3&) -> Vec3 { return Vec3::Zero(); });
  const double volume_m3 = expected.at("volume_m3");
  EXPECT_NEAR(geometry::mesh_quality(mesh).volume_m3, volume_m3, tolerance * volume_m3);

  const fem::LinearSystem system = fem::assemble(model);
  const fem::CholeskyFactor factor(system);
  std::vector<double> load(static_cast<std::size_t>(factor.size())), free(load.size());
  Worst worst;
  for (const json& c : expected.at("cases")) {
    const auto node = c.at("node").get<std::int32_t>();
    const auto found = std::find(mesh.file_index.begin(), mesh.file_index.end(), node);
    ASSERT_NE(found, mesh.file_index.end());
    const auto v = static_cast<std::size_t>(found - mesh.file_index.begin());
    ASSERT_LT((mesh.vertices_m[v] - vector_of(c.at("xyz"))).norm(), 1e-15);
    const Vec3 direction = vector_of(c.at("dir"));

    std::fill(load.begin(), load.end(), 0.0);
    for (std::size_t axis = 0; axis < 3; ++axis)
      load[static_cast<std::size_t>(system.free_index[3 * v + axis])] =
          direction[static_cast<Eigen::Index>(axis)];
    factor.solve(load, free);
    std::vector<double> u(3 * mesh.vertices_m.size(), 0.0);
    for (std::size_t dof = 0; dof < u.size(); ++dof)
      if (system.free_index[dof] >= 0)
        u[dof] = free[static_cast<std::size_t>(system.free_index[dof])];
    const auto displacement = [&](std::size_t w) {
      return Vec3(u[3 * w], u[3 * w + 1], u[3 * w + 2]);
    };
    double largest_m = 0.0, energy_j = 0.0;
    const std::vector<double> internal_n = fem::internal_forces_n(model, u);
    for (std::size_t w = 0; w < mesh.vertices_m.size(); ++w)
      largest_m = std::max(largest_m, displacement(w).norm());
    for (std::size_t dof = 0; dof < u.size(); ++dof) energy_j += 0.5 * u[dof] * internal_n[dof];

    fem::PathColumns columns;
    factor.walk_path(static_cast<std::int32_t>(v), columns);
    const double walked = direction.dot(factor.inverse_block(columns, columns) * direction);

    const json& e = c.at("expect");
    const double compliance = e.at("compliance_m_per_N");
    const double max_u = e.at("max_u_per_N");
    const double energy = e.at("energy_per_N2");
    SCOPED_TRACE("node " + std::to_string(node));
    EXPECT_NEAR(direction.dot(displacement(v)), compliance, tolerance * compliance);
    EXPECT_NEAR(walked, compliance, tolerance * compliance);
    EXPECT_NEAR(largest_m, max_u, tolerance * max_u);
    EXPECT_NEAR(energy_j, energy, tolerance * energy);
    worst.see(direction.dot(displacement(v)), compliance, compliance);
    worst.see(walked, compliance, compliance);
    worst.see(largest_m, max_u, max_u);
    worst.see(energy_j, energy, energy);
  }
  std::printf("R1: largest relative error %.2g (tolerance %g)\n", worst.error(), tolerance);
}

needle::Pose pose_of(const json& frame) {
  Eigen::Matrix3d rotation;
  for (int i = 0; i < 3; ++i) rotation.row(i) = vector_of(frame.at("R").at(i)).transpose();
  return {vector_of(frame.at("c")), Eigen::Quaterniond(rotation)};
}

TEST(Reference, R3SlideOfAnArc) {
  const json expected = reference("R3_slide_least_squares.json");
  const double tolerance_m = expected.at("tol_abs");
  const auto curve = needle::Curve::arc(expected.at("rad"), EIGEN_PI);
  Worst worst;
  for (const json& c : expected.at("cases")) {
    auto s = c.at("s").get<std::vector<double>>();
    for (double& value : s) value = -value;  // the reference runs from tip to tail
    const auto weight = c.at("w").get<std::vector<double>>();
    const double got = needle::slide_least_squares(curve, pose_of(c.at("pose0")),
                                                   pose_of(c.at("pose1")), s, weight);
    const double want = c.at("expect").at("slide_m");
    EXPECT_NEAR(got, want, tolerance_m);
    worst.see(got, want, 1.0);
  }
  std::printf("R3: largest error %.2g m (tolerance %g m)\n", worst.error(), tolerance_m);
}

TEST(Reference, R6ComplementarityOfContactAndThread) {
  const json expected = reference("R6_lcp.json");
  const auto want = expected.at("l").get<std::vector<double>>();
  auto q = expected.at("q").get<std::vector<double>>();
  for (double& value : q) value = -value;  // the reference's w = W l + q
  const std::size_t m = want.size();
  constraints::ComplianceMatrix w;
  w.size = static_cast<int>(m);
  for (std::size_t column = 0; column < m; ++column)
    for (std::size_t row = 0; row < m; ++row)
      w.value.push_back(expected.at("W").at(row).at(column).get<double>());
  const std::vector<constraints::Bounds> bounds(m, constraints::Bounds::unilateral());

  constraints::ComplementaritySolver solver;
  solver.factor(w, bounds);
  std::vector<double> lambda(m);
  std::vector<constraints::RowState> state(m, constraints::RowState::kLower);
  const constraints::SolveReport report = solver.solve(q, lambda, state);
  EXPECT_TRUE(report.converged);
  EXPECT_FALSE(report.regularised);
  double error = 0.0, norm = 0.0;
  for (std::size_t i = 0; i < m; ++i) {
    EXPECT_GE(lambda[i], 0.0) << "row " << i;
    EXPECT_GE(solver.gap_m()[i], -1e-12) << "row " << i;
    error = std::hypot(error, lambda[i] - want[i]);
    norm = std::hypot(norm, want[i]);
  }
  const double tolerance = expected.at("tol_rel");
  EXPECT_LT(error, tolerance * norm);
  std::printf("R6: relative error %.2g (tolerance %g), %d rows active of %zu\n", error / norm,
              tolerance, report.active_bounded_rows, m);
}

}  // namespace
}  // namespace sutured
