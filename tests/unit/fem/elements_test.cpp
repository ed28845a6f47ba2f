// SPDX-License-Identifier: GPL-3.0-or-later
#include "fem/elements.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>
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

Vec6 components(const Mat3& s) {
  return (Vec6() << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(2, 0)).finished();
}

/// Closed-form eigenvalues lose half the digits where two coincide: √ε, with room for the constant.
constexpr double kClosedFormTolerance = 1e-7;

TEST(PrincipalStress, IsReadOffSimpleStates) {
  const auto expect = [](const Vec6& stress_pa, const Vec3& expected_pa) {
    EXPECT_LT((principal_stress_pa(stress_pa) - expected_pa).norm(),
              kClosedFormTolerance * std::max(1.0, expected_pa.norm()))
        << principal_stress_pa(stress_pa).transpose();
  };
  const auto state = [](double xx, double yy, double zz, double xy, double yz, double zx) {
    return (Vec6() << xx, yy, zz, xy, yz, zx).finished();
  };
  expect(state(0, 0, 0, 0, 0, 0), Vec3(0, 0, 0));
  expect(state(0, 5e4, 0, 0, 0, 0), Vec3(5e4, 0, 0));                // uniaxial tension
  expect(state(0, 0, -5e4, 0, 0, 0), Vec3(0, 0, -5e4));              // uniaxial compression
  expect(state(-2e3, -2e3, -2e3, 0, 0, 0), Vec3(-2e3, -2e3, -2e3));  // hydrostatic
  for (int shear = 3; shear < 6; ++shear) {                          // pure, in each plane
    Vec6 stress = Vec6::Zero();
    stress[shear] = 7.0;
    expect(stress, Vec3(7, 0, -7));
  }
  expect(state(1, 2, 3, 0, 0, 0), Vec3(3, 2, 1));
}

TEST(PrincipalStress, SolvesTheCharacteristicPolynomial) {
  std::mt19937_64 random(13);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int trial = 0; trial < 1000; ++trial) {
    const double size_pa = std::pow(10.0, 8.0 * uniform(random));
    Mat3 m;
    for (int i = 0; i < 9; ++i) m(i) = size_pa * uniform(random);
    const Mat3 stress = m + m.transpose();
    const Vec3 p = principal_stress_pa(components(stress));
    EXPECT_GE(p[0], p[1]);
    EXPECT_GE(p[1], p[2]);
    const double scale = stress.norm();
    const double second = 0.5 * (stress.trace() * stress.trace() - (stress * stress).trace());
    EXPECT_NEAR(p.sum(), stress.trace(), kClosedFormTolerance * scale);
    EXPECT_NEAR(p[0] * p[1] + p[1] * p[2] + p[2] * p[0], second,
                kClosedFormTolerance * scale * scale);
    EXPECT_NEAR(p.prod(), stress.determinant(), kClosedFormTolerance * std::pow(scale, 3));
    for (int i = 0; i < 3; ++i)
      EXPECT_NEAR((stress - p[i] * Mat3::Identity()).determinant(), 0.0,
                  kClosedFormTolerance * std::pow(scale, 3));
  }
}

TEST(PrincipalStress, AndVonMisesDoNotDependOnTheAxes) {
  std::mt19937_64 random(17);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 1000; ++trial) {
    Vec3 p(normal(random), normal(random), normal(random));
    if (trial % 4 == 0) p[1] = p[0];  // a double eigenvalue
    std::sort(p.data(), p.data() + 3, std::greater<>());
    const Eigen::Quaterniond turn =
        Eigen::Quaterniond(normal(random), normal(random), normal(random), normal(random))
            .normalized();
    const Mat3 stress =
        turn.toRotationMatrix() * p.asDiagonal() * turn.toRotationMatrix().transpose();
    const double von_mises = std::sqrt(
        0.5 * (std::pow(p[0] - p[1], 2) + std::pow(p[1] - p[2], 2) + std::pow(p[2] - p[0], 2)));
    EXPECT_LT((principal_stress_pa(components(stress)) - p).norm(),
              kClosedFormTolerance * p.norm());
    EXPECT_NEAR(von_mises_pa(components(stress)), von_mises, 1e-14 * p.norm());  // rounding
  }
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
