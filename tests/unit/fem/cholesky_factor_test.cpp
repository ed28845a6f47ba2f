// SPDX-License-Identifier: GPL-3.0-or-later
#include "fem/cholesky_factor.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

#include "support/block_mesh.hpp"
#include "support/fem_model.hpp"

namespace sutured::fem {
namespace {

/// Two blocks side by side, not touching, each fixed below; one axis of one vertex prescribed.
Model two_blocks() {
  Model model = testing::model_of(
      testing::side_by_side(testing::block_mesh(3, 4, 3), testing::block_mesh(2, 2, 3)),
      {1000.0, 0.3});
  testing::prescribe(
      model, [](const Vec3& x) { return x[2] < 1e-9; }, [](const Vec3&) { return Vec3(0, 0, 0); });
  model.prescribed[3 * 70 + 1] = 1;
  model.prescribed_m[3 * 70 + 1] = 0.01;
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> load(-1.0, 1.0);
  for (double& f : model.load_n) f = load(random);
  return model;
}

TEST(CholeskyFactor, PathColumnsReproduceTheInverse) {
  const Model model = two_blocks();
  const LinearSystem system = assemble(model);
  const CholeskyFactor factor(system);
  const Eigen::MatrixXd inverse = testing::dense_inverse(system);
  const auto n = static_cast<std::int32_t>(model.vertices_m.size());
  std::vector<PathColumns> columns(static_cast<std::size_t>(n));
  for (std::int32_t v = 0; v < n; ++v) factor.walk_path(v, columns[static_cast<std::size_t>(v)]);
  double worst = 0.0;
  for (std::int32_t v = 0; v < n; ++v)
    for (std::int32_t w = 0; w < n; ++w)
      worst = std::max(worst, (factor.inverse_block(columns[static_cast<std::size_t>(v)],
                                                    columns[static_cast<std::size_t>(w)]) -
                               inverse.block<3, 3>(3 * v, 3 * w))
                                  .cwiseAbs()
                                  .maxCoeff());
  EXPECT_LT(worst, 1e-11 * inverse.cwiseAbs().maxCoeff());
}

TEST(CholeskyFactor, PathsWalkedTogetherAreThoseWalkedAlone) {
  const Model model = two_blocks();
  const LinearSystem system = assemble(model);
  const CholeskyFactor factor(system);
  // Of both blocks, in no order, with prescribed ones among them.
  const std::vector<std::int32_t> vertices{70, 3, 95, 41, 0, 112, 64, 79, 58, 101, 33};
  std::vector<PathColumns> together(vertices.size());
  std::vector<PathColumns*> into;
  for (PathColumns& columns : together) into.push_back(&columns);
  factor.walk_paths(vertices, into);
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    PathColumns alone;
    factor.walk_path(vertices[i], alone);
    EXPECT_EQ(together[i].vertex, vertices[i]);
    EXPECT_EQ(together[i].first_supernode, alone.first_supernode);
    ASSERT_EQ(together[i].length, alone.length);
    double largest = 0.0, worst = 0.0;
    for (std::size_t k = 0; k < alone.value.size(); ++k) {
      largest = std::max(largest, std::abs(alone.value[k]));
      worst = std::max(worst, std::abs(together[i].value[k] - alone.value[k]));
    }
    EXPECT_LE(worst, 1e-13 * largest);  // rounding: sums of at most a few hundred terms
  }
}

TEST(CholeskyFactor, BlocksTakenTogetherAreThoseTakenAlone) {
  const Model model = two_blocks();
  const LinearSystem system = assemble(model);
  const CholeskyFactor factor(system);
  const std::vector<std::int32_t> vertices{70, 3, 95, 41, 0, 112, 64, 79};
  std::vector<PathColumns> columns(vertices.size());
  for (std::size_t i = 0; i < vertices.size(); ++i) factor.walk_path(vertices[i], columns[i]);
  const std::vector<const PathColumns*> a{&columns[2], &columns[0], &columns[5]};
  std::vector<const PathColumns*> b;
  for (const PathColumns& one : columns) b.push_back(&one);
  std::vector<double> block;
  factor.inverse_blocks(a, b, block);
  ASSERT_EQ(block.size(), 9 * a.size() * b.size());
  double largest = 0.0, worst = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::size_t j = 0; j < b.size(); ++j) {
      const Mat3 expected = factor.inverse_block(*a[i], *b[j]);
      for (std::size_t r = 0; r < 3; ++r)
        for (std::size_t c = 0; c < 3; ++c) {
          const double one = expected(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(c));
          largest = std::max(largest, std::abs(one));
          worst = std::max(worst, std::abs(block[(3 * j + c) * 3 * a.size() + 3 * i + r] - one));
        }
    }
  EXPECT_GT(largest, 0.0);
  EXPECT_LE(worst, 1e-13 * largest);  // rounding
}

TEST(CholeskyFactor, PartsAreWhatNothingTiesTogether) {
  const Model model = two_blocks();
  constexpr std::int32_t kOfTheFirst = 80;
  const auto vertices = static_cast<std::int32_t>(model.vertices_m.size());
  const CholeskyFactor factor(assemble(model));
  EXPECT_EQ(factor.part_count(), 2);
  const std::int32_t one = factor.part_of(kOfTheFirst - 1), other = factor.part_of(vertices - 1);
  EXPECT_NE(one, other);
  PathColumns v, w;
  factor.walk_path(kOfTheFirst - 1, v);
  for (std::int32_t vertex = 0; vertex < vertices; ++vertex) {
    const bool fixed = model.vertices_m[static_cast<std::size_t>(vertex)][2] < 1e-9;
    EXPECT_EQ(factor.part_of(vertex), fixed ? 0 : vertex < kOfTheFirst ? one : other) << vertex;
    factor.walk_path(vertex, w);
    EXPECT_EQ(factor.inverse_block(v, w).isZero(0.0), fixed || vertex >= kOfTheFirst) << vertex;
  }
}

TEST(CholeskyFactor, BackwardPassOfLoadsSolvesTheTissue) {
  const Model model = two_blocks();
  const LinearSystem system = assemble(model);
  const CholeskyFactor factor(system);
  const Eigen::MatrixXd inverse = testing::dense_inverse(system);
  const auto dofs = static_cast<Eigen::Index>(system.free_index.size());
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  Eigen::VectorXd force = Eigen::VectorXd::Zero(dofs), offset(dofs);
  for (double& x : offset) x = uniform(random);
  std::vector<double> u(static_cast<std::size_t>(dofs), NAN);
  std::array<PathColumns, 7> columns;
  std::vector<PathLoad> loads;
  for (const std::int32_t v : {5, 33, 40, 70, 71, 79, 90}) {
    const Vec3 f(uniform(random), uniform(random), uniform(random));
    PathColumns& path = columns[loads.size()];
    factor.walk_path(v, path);
    loads.push_back({&path, f});
    force.segment<3>(3 * v) += f;
  }
  factor.backward(loads, {offset.data(), static_cast<std::size_t>(dofs)}, u);
  const Eigen::VectorXd expected = offset + inverse * force;
  const Eigen::Map<const Eigen::VectorXd> got(u.data(), dofs);
  EXPECT_LT((got - expected).cwiseAbs().maxCoeff(), 1e-12 * expected.cwiseAbs().maxCoeff() + 1e-13);
}

TEST(CholeskyFactor, BackwardPassOfTwoThreadsIsThatOfOneToTheBit) {
  auto mesh = testing::block_mesh(7, 6, 9);  // one block: what is shared lies below separators
  Model model = testing::model_of(mesh, {1000.0, 0.3});
  testing::prescribe(
      model, [](const Vec3& x) { return x[2] < 1e-9; }, [](const Vec3&) { return Vec3(0, 0, 0); });
  for (const Model& tissue : {model, two_blocks()}) {
    const LinearSystem system = assemble(tissue);
    const CholeskyFactor alone(system), shared(system, 1);
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> value(-1.0, 1.0);
    std::vector<PathColumns> columns(tissue.vertices_m.size());
    std::vector<PathLoad> loads;
    for (std::size_t v = 0; v < columns.size(); ++v) {
      alone.walk_path(static_cast<std::int32_t>(v), columns[v]);
      loads.push_back({&columns[v], Vec3(value(random), value(random), value(random))});
    }
    std::vector<double> u(system.free_index.size(), NAN), w(u);
    const std::vector<double> offset(u.size(), 0.25);
    alone.backward(loads, offset, u);
    shared.backward(loads, offset, w);
    EXPECT_EQ(u, w);
    EXPECT_NE(u, offset);
  }
}

TEST(CholeskyFactor, FullSolveBalancesLoadsAndPrescribedDisplacements) {
  const Model model = two_blocks();
  const auto u = testing::solve(model);
  EXPECT_DOUBLE_EQ(u[3 * 70 + 1], 0.01);
  const auto internal = internal_forces_n(model, u);
  double worst = 0.0;
  for (std::size_t dof = 0; dof < u.size(); ++dof)
    if (!model.prescribed[dof])
      worst = std::max(worst, std::abs(internal[dof] - model.load_n[dof]));
  EXPECT_LT(worst, 1e-10);  // loads are of order 1 N
}

TEST(CholeskyFactor, AFreeBodyIsRefusedWithOneOfItsVertices) {
  Model model = two_blocks();
  const std::int32_t first_of_other = 4 * 5 * 4;
  for (std::size_t dof = static_cast<std::size_t>(3 * first_of_other);
       dof < model.prescribed.size(); ++dof)
    model.prescribed[dof] = 0;
  model.prescribed[3 * 70 + 1] = 0;
  try {
    const CholeskyFactor factor(assemble(model));
    // Rounding may leave the last pivot positive: then the condition number gives it away.
    EXPECT_GT(factor.estimate_condition(), 1e12);
  } catch (const NotPositiveDefinite& error) {
    EXPECT_GE(error.vertex, first_of_other);
  }
}

TEST(CholeskyFactor, ConditionEstimateIsWithinTenPercent) {
  const Model model = two_blocks();
  const LinearSystem system = assemble(model);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(testing::dense_stiffness(system));
  const double condition = eigen.eigenvalues().tail<1>()[0] / eigen.eigenvalues()[0];
  // Power iteration approaches both ends from inside.
  const double estimate = CholeskyFactor(system).estimate_condition();
  EXPECT_LE(estimate, condition * (1 + 1e-9));
  EXPECT_GE(estimate, 0.9 * condition);
}

}  // namespace
}  // namespace sutured::fem
