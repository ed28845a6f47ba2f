// SPDX-License-Identifier: GPL-3.0-or-later
#include "fem/elements.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "support/block_mesh.hpp"
#include "support/fem_model.hpp"

namespace sutured::fem {
namespace {

const Material kSoft{2.0e5, 0.45};

TEST(Elements, BarycentricCoordinatesReproduceAPoint) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const auto point = [&] { return Vec3(uniform(random), uniform(random), uniform(random)); };
  for (int trial = 0; trial < 100; ++trial) {
    const std::array<Vec3, 4> x{point(), point(), point(), point()};
    if (std::abs(tet_shape(x).volume_m3) < 1e-3) continue;
    const Vec3 p = point();
    const Eigen::Vector4d b = barycentric(x, p);
    EXPECT_NEAR(b.sum(), 1.0, 1e-12);
    EXPECT_LT((b[0] * x[0] + b[1] * x[1] + b[2] * x[2] + b[3] * x[3] - p).norm(), 1e-11);
  }
}

TEST(Elements, RigidMotionsCauseNoForceAndNoStress) {
  const std::array<Vec3, 4> x{Vec3(0, 0, 0), Vec3(1, 0.1, 0), Vec3(0.2, 1, 0), Vec3(0.1, 0.3, 0.9)};
  const TetShape shape = tet_shape(x);
  const Vec3 axis(0.3, -0.7, 0.4);
  std::array<Vec3, 4> u;
  for (std::size_t a = 0; a < 4; ++a) u[a] = Vec3(0.1, 0.2, 0.3) + axis.cross(x[a]);
  EXPECT_LT(tet_stress_pa(shape, kSoft, u).norm(), 1e-9 * kSoft.young_modulus_pa);
  for (int a = 0; a < 4; ++a) {
    Vec3 force = Vec3::Zero();
    for (int b = 0; b < 4; ++b)
      force += stiffness_block(shape, kSoft, a, b) * u[static_cast<std::size_t>(b)];
    EXPECT_LT(force.norm(), 1e-9 * kSoft.young_modulus_pa);
  }
}

TEST(Elements, UniaxialStressIsItsOwnVonMises) {
  EXPECT_DOUBLE_EQ(von_mises_pa((Vec6() << 3.0, 0, 0, 0, 0, 0).finished()), 3.0);
  EXPECT_DOUBLE_EQ(von_mises_pa((Vec6() << 0, 0, 0, 2.0, 0, 0).finished()), 2.0 * std::sqrt(3.0));
}

/// A linear field imposed on the boundary must hold inside, to rounding (the patch test).
TEST(PatchTest, LinearFieldsAreExactInADistortedMesh) {
  auto mesh = testing::block_mesh(3, 3, 3);
  std::mt19937_64 random(11);
  std::uniform_real_distribution<double> shift(-0.06, 0.06);
  const auto on_boundary = [](const Vec3& x) {
    return x.minCoeff() < 1e-9 || x.maxCoeff() > 1.0 - 1e-9;
  };
  for (Vec3& x : mesh.vertices_m)
    if (!on_boundary(x)) x += Vec3(shift(random), shift(random), shift(random));
  Model model = testing::model_of(mesh, kSoft);
  Mat3 gradient;
  gradient << 0.01, 0.02, -0.01, 0.005, -0.02, 0.013, 0.007, -0.004, 0.015;
  const auto field = [&](const Vec3& x) { return Vec3(gradient * x + Vec3(0.1, -0.2, 0.05)); };
  testing::prescribe(model, on_boundary, field);
  const auto u = testing::solve(model);
  double worst = 0.0;
  int inside = 0;
  for (std::size_t v = 0; v < mesh.vertices_m.size(); ++v) {
    inside += !on_boundary(mesh.vertices_m[v]);
    worst = std::max(
        worst, (Vec3(u[3 * v], u[3 * v + 1], u[3 * v + 2]) - field(mesh.vertices_m[v])).norm());
  }
  ASSERT_EQ(inside, 8);
  EXPECT_LT(worst, 1e-10);
}

}  // namespace
}  // namespace sutured::fem
