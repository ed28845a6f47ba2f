// SPDX-License-Identifier: GPL-3.0-or-later
// Exact solutions of linear elasticity, approached by refining a mesh. Linear tetrahedra
// converge with the square of their size in displacements where the solution is smooth, so
// halving it must divide the error by four; coarse meshes are not there yet.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <functional>

#include "geometry/topology.hpp"
#include "support/block_mesh.hpp"
#include "support/fem_model.hpp"
#include "support/tube_mesh.hpp"

namespace sutured {
namespace {

using fem::Material;
using geometry::Vec3;
using Field = std::function<Vec3(const Vec3&)>;

/// Adds the nodal loads of `traction_pa` over the boundary faces whose corners are all `where`.
/// Three points a face: exact for linear tractions, and exact in its sum for quadratic ones.
template <typename Where>
void add_traction(fem::Model& model, Where&& where, const Field& traction_pa) {
  const auto surface = geometry::boundary_surface(model.tets, geometry::tet_adjacency(model.tets));
  for (const geometry::Triangle& triangle : surface.triangles) {
    std::array<Vec3, 3> x;
    for (std::size_t c = 0; c < 3; ++c)
      x[c] = model.vertices_m[static_cast<std::size_t>(triangle[c])];
    if (!where(x[0]) || !where(x[1]) || !where(x[2])) continue;
    const double area_m2 = 0.5 * (x[1] - x[0]).cross(x[2] - x[0]).norm();
    for (std::size_t point = 0; point < 3; ++point) {
      std::array<double, 3> weight{1.0 / 6.0, 1.0 / 6.0, 1.0 / 6.0};
      weight[point] = 4.0 / 6.0;
      const Vec3 force_n =
          area_m2 / 3.0 * traction_pa(weight[0] * x[0] + weight[1] * x[1] + weight[2] * x[2]);
      for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t axis = 0; axis < 3; ++axis)
          model.load_n[3 * static_cast<std::size_t>(triangle[c]) + axis] +=
              weight[c] * force_n[static_cast<Eigen::Index>(axis)];
    }
  }
}

/// Returns the error of nodal displacements in the root mean square, relative to the field's.
double relative_error(const fem::Model& model, const std::vector<double>& u, const Field& exact) {
  double error = 0.0, norm = 0.0;
  for (std::size_t v = 0; v < model.vertices_m.size(); ++v) {
    const Vec3 want = exact(model.vertices_m[v]);
    error += (Vec3(u[3 * v], u[3 * v + 1], u[3 * v + 2]) - want).squaredNorm();
    norm += want.squaredNorm();
  }
  return std::sqrt(error / norm);
}

/// Prints the errors, and claims that every refinement comes closer to dividing by four, that the
/// last divides by `last_ratio_min` at least, and that the finest error is below `finest_max`.
void expect_convergence(const char* name, const std::vector<double>& error, double last_ratio_min,
                        double finest_max) {
  std::printf("%s: relative error", name);
  for (const double e : error) std::printf(" %.3g", e);
  std::printf(" on meshes halved in size, falling by");
  double ratio = 1.0;
  for (std::size_t i = 1; i < error.size(); ++i) {
    const double next = error[i - 1] / error[i];
    std::printf(" %.2f", next);
    EXPECT_GT(next, ratio) << name << ", refinement " << i;
    ratio = next;
  }
  std::printf("; the finest may be off by %g\n", finest_max);
  EXPECT_GT(ratio, last_ratio_min) << name;
  EXPECT_LT(ratio, 4.4) << name << ": better than linear tetrahedra can be";
  EXPECT_LT(error.back(), finest_max) << name;
}

// A cantilever of length l, height 2c (along y) and width b, held at x = 0, E, ν, I = 2 b c³ / 3.
constexpr double kLength = 4.0, kHalfHeight = 1.0, kWidth = 1.0;
constexpr double kInertia = 2.0 / 3.0 * kWidth * kHalfHeight * kHalfHeight * kHalfHeight;

struct Beam {
  fem::Model model;
  std::size_t tip = 0;  ///< the vertex on the axis at the loaded end
};

Beam beam(int refinement, const Material& material, const Field& held) {
  const int n = 1 << refinement;
  auto mesh = testing::block_mesh(4 * n, 2 * n, n, {kLength, 2.0 * kHalfHeight, kWidth});
  Beam result;
  for (Vec3& x : mesh.vertices_m) x -= Vec3(0.0, kHalfHeight, 0.5 * kWidth);
  result.model = testing::model_of(mesh, material);
  testing::prescribe(
      result.model, [](const Vec3& x) { return x.x() < 1e-9; }, held);
  double nearest = 1e9;
  for (std::size_t v = 0; v < mesh.vertices_m.size(); ++v)
    if (const double d = (mesh.vertices_m[v] - Vec3(kLength, 0, 0)).norm(); d < nearest) {
      nearest = d;
      result.tip = v;
    }
  return result;
}

bool at_the_end(const Vec3& x) { return x.x() > kLength - 1e-9; }

// Tip force P: with ν = 0 the theory of Timoshenko with κ = 5/6 is the exact solution in three
// dimensions, if the end's traction is the parabola of shear and the root keeps its warp:
//
//   σ_xx = −P (l − x) y / I     σ_xy = P (c² − y²) / (2 I)
//   u_x  = P / (E I) (−(l x − x²/2) y − y³/3 + c² y / 5)
//   u_y  = P / (E I) (l x²/2 − x³/6 + 4/5 c² x)
//
// and at the end of the axis u_y = P l³ / (3 E I) + P l / (κ G A).
TEST(Analytical, CantileverUnderATipForceIsTimoshenkos) {
  const Material material{1000.0, 0.0};
  const double force_n = 1.0, c2 = kHalfHeight * kHalfHeight;
  const double scale = force_n / (material.young_modulus_pa * kInertia);
  const Field exact = [&](const Vec3& x) -> Vec3 {
    return scale * Vec3(-(kLength * x.x() - x.x() * x.x() / 2) * x.y() - x.y() * x.y() * x.y() / 3 +
                            c2 * x.y() / 5,
                        kLength * x.x() * x.x() / 2 - x.x() * x.x() * x.x() / 6 + 0.8 * c2 * x.x(),
                        0);
  };
  const double deflection_m =
      force_n * kLength * kLength * kLength / (3 * material.young_modulus_pa * kInertia) +
      force_n * kLength / (5.0 / 6.0 * material.mu_pa() * 2 * kHalfHeight * kWidth);
  ASSERT_NEAR(exact({kLength, 0, 0}).y(), deflection_m, 1e-12 * deflection_m);

  std::vector<double> field_error, tip_error;
  for (int refinement = 1; refinement <= 3; ++refinement) {
    Beam b = beam(refinement, material, exact);
    add_traction(b.model, at_the_end, [&](const Vec3& x) -> Vec3 {
      return {0, force_n * (c2 - x.y() * x.y()) / (2 * kInertia), 0};
    });
    const auto u = testing::solve(b.model);
    field_error.push_back(relative_error(b.model, u, exact));
    tip_error.push_back(std::abs(u[3 * b.tip + 1] / deflection_m - 1.0));
  }
  expect_convergence("cantilever, tip force, deflection of the tip", tip_error, 3.0, 0.03);
  expect_convergence("cantilever, tip force, all displacements", field_error, 3.0, 0.03);
}

// End moment M, any ν: pure bending, whose cross-sections bend the other way across. (At ν = 0.45
// linear tetrahedra bend too stiffly for these meshes to show the order: 0.065 on the finest.)
//
//   σ_xx = −M y / I
//   u    = M / (E I) (−x y, (x² + ν (y² − z²)) / 2, ν y z)
TEST(Analytical, CantileverUnderAnEndMomentBendsAsSaintVenants) {
  const Material material{1000.0, 0.3};
  const double moment_nm = 1.0, nu = material.poisson_ratio;
  const double scale = moment_nm / (material.young_modulus_pa * kInertia);
  const Field exact = [&](const Vec3& x) -> Vec3 {
    return scale * Vec3(-x.x() * x.y(),
                        0.5 * (x.x() * x.x() + nu * (x.y() * x.y() - x.z() * x.z())),
                        nu * x.y() * x.z());
  };
  std::vector<double> error;
  for (int refinement = 1; refinement <= 3; ++refinement) {
    Beam b = beam(refinement, material, exact);
    add_traction(b.model, at_the_end, [&](const Vec3& x) -> Vec3 {
      return {-moment_nm * x.y() / kInertia, 0, 0};
    });
    error.push_back(relative_error(b.model, testing::solve(b.model), exact));
  }
  expect_convergence("cantilever, end moment, ν = 0.3", error, 3.0, 0.04);
}

// A thick tube, radii a and b, under an inner pressure p between rigid smooth planes (Lamé):
//
//   u_r = (1 + ν) / E  p a² / (b² − a²)  ((1 − 2 ν) r + b² / r),   u_z = 0
TEST(Analytical, PressurisedThickTubeIsLames) {
  const Material material{2.0e5, 0.45};
  const double a = 4.5e-3, b = 6.0e-3, pressure_pa = 1.0e4, nu = material.poisson_ratio;
  const Field exact = [&](const Vec3& x) -> Vec3 {
    const double r = std::hypot(x.x(), x.y());
    const double u = (1 + nu) / material.young_modulus_pa * pressure_pa * a * a / (b * b - a * a) *
                     ((1 - 2 * nu) * r + b * b / r);
    return {u * x.x() / r, u * x.y() / r, 0};
  };
  std::vector<double> error;
  for (int refinement = 0; refinement <= 2; ++refinement) {
    const int n = 1 << refinement;
    const auto mesh = testing::tube_mesh({a, b, 0.0, 3.0e-3, 24 * n, 2 * n, 3 * n});
    fem::Model model = testing::model_of(mesh, material);
    for (std::size_t v = 0; v < mesh.vertices_m.size(); ++v) {
      const Vec3& x = mesh.vertices_m[v];
      // Symmetry holds the tube in its plane without touching the solution.
      model.prescribed[3 * v] = std::abs(x.x()) < 1e-12;
      model.prescribed[3 * v + 1] = std::abs(x.y()) < 1e-12;
      model.prescribed[3 * v + 2] = x.z() < 1e-12 || x.z() > 3.0e-3 - 1e-12;
    }
    add_traction(
        model, [&](const Vec3& x) { return std::hypot(x.x(), x.y()) < a + 1e-9; },
        [&](const Vec3& x) -> Vec3 { return pressure_pa * Vec3(x.x(), x.y(), 0).normalized(); });
    error.push_back(relative_error(model, testing::solve(model), exact));
  }
  expect_convergence("tube under pressure, ν = 0.45", error, 3.0, 0.01);
}

}  // namespace
}  // namespace sutured
