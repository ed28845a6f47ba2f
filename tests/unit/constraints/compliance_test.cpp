// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/compliance.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>

#include "support/block_mesh.hpp"
#include "support/fem_model.hpp"

namespace sutured::constraints {
namespace {

/// Of a block with 125 vertices, and one with 27 that nothing ties to it.
class ComplianceOfTwoBlocks : public ::testing::Test {
 protected:
  ComplianceOfTwoBlocks() {
    const auto mesh =
        testing::side_by_side(testing::block_mesh(4, 4, 4), testing::block_mesh(2, 2, 2));
    fem::Model model = testing::model_of(mesh, {1000.0, 0.45});
    testing::prescribe(
        model, [](const Vec3& x) { return x[2] < 1e-9; },
        [](const Vec3&) { return Vec3(0, 0, 0); });
    system_ = fem::assemble(model);
    inverse_ = testing::dense_inverse(system_);
    factor_ = std::make_shared<fem::CholeskyFactor>(system_);
  }

  /// `count` rows on random vertices `first` to `last` (fixed ones too), some coupled to a needle.
  ConstraintRows random_rows(int count, std::int32_t first = 0, std::int32_t last = 151) {
    ConstraintRows rows;
    for (int i = 0; i < count; ++i) {
      Row& row = rows.add(Bounds::bilateral(), uniform_(random_), 1e-5 * (i % 3));
      if (i % 4 == 0) {
        row.needle = 0;
        for (double& j : row.needle_jacobian) j = uniform_(random_);
        row.slide = uniform_(random_);
      }
      for (int e = 0; e < 1 + i % 5; ++e)
        rows.touch(std::uniform_int_distribution<std::int32_t>(first, last)(random_),
                   Vec3(uniform_(random_), uniform_(random_), uniform_(random_)));
    }
    return rows;
  }

  Eigen::MatrixXd dense_rows(const ConstraintRows& rows) const {
    Eigen::MatrixXd c = Eigen::MatrixXd::Zero(rows.size(), inverse_.rows());
    for (int i = 0; i < rows.size(); ++i)
      for (const Entry& entry : rows.entries(rows[i]))
        c.block<1, 3>(i, 3 * entry.vertex) += entry.coefficient.transpose();
    return c;
  }

  fem::LinearSystem system_;
  Eigen::MatrixXd inverse_;
  std::shared_ptr<const fem::CholeskyFactor> factor_;
  std::mt19937_64 random_{17};
  std::uniform_real_distribution<double> uniform_{-1.0, 1.0};
};

TEST_F(ComplianceOfTwoBlocks, MatchesTheDenseInverse) {
  Compliance compliance(factor_);
  NeedleMobility needle;
  needle.mobility.setRandom();
  needle.mobility = (needle.mobility * needle.mobility.transpose()).eval();
  needle.slide_compliance_m_per_n = 0.7;
  for (int trial = 0; trial < 5; ++trial) {
    const ConstraintRows rows = random_rows(60);
    const Eigen::MatrixXd c = dense_rows(rows);
    Eigen::MatrixXd expected = c * inverse_ * c.transpose();
    for (int i = 0; i < rows.size(); ++i) {
      expected(i, i) += rows[i].compliance_m_per_n;
      for (int j = 0; j < rows.size(); ++j)
        if (rows[i].needle == 0 && rows[j].needle == 0)
          expected(i, j) += rows[i].needle_jacobian.dot(needle.mobility * rows[j].needle_jacobian) +
                            0.7 * rows[i].slide * rows[j].slide;
    }
    const ComplianceMatrix& w = compliance.assemble(rows, {&needle, 1});
    const Eigen::Map<const Eigen::MatrixXd> got(w.value.data(), w.size, w.size);
    EXPECT_LT((got - expected).norm(), 1e-9 * expected.norm());
    EXPECT_EQ((got - got.transpose()).cwiseAbs().maxCoeff(), 0.0);
    EXPECT_GT(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(got).eigenvalues()[0],
              -1e-12 * expected.norm());
  }
}

TEST_F(ComplianceOfTwoBlocks, KeepsWOfRowsThatAreHeld) {
  Compliance compliance(factor_);
  ConstraintRows rows = random_rows(12);
  for (int i = 0; i < rows.size(); ++i) rows[i].needle = -1;
  const std::vector<double> w = compliance.assemble(rows, {}, true).value;
  EXPECT_FALSE(compliance.kept()) << "of which rows?";
  EXPECT_EQ(compliance.assemble(rows, {}, true).value, w);
  EXPECT_TRUE(compliance.kept());
  compliance.clear();
  EXPECT_EQ(compliance.assemble(rows, {}, true).value, w);
  EXPECT_FALSE(compliance.kept());
}

TEST_F(ComplianceOfTwoBlocks, DisplacementsFollowTheForcesAtOneVertexAndAtAll) {
  Compliance compliance(factor_);
  const ConstraintRows rows = random_rows(25);
  compliance.assemble(rows, std::vector<NeedleMobility>(1));
  std::vector<double> lambda(25);
  for (double& l : lambda) l = uniform_(random_);
  compliance.apply(rows, lambda);
  const Eigen::VectorXd expected =
      inverse_ * dense_rows(rows).transpose() * Eigen::Map<Eigen::VectorXd>(lambda.data(), 25);
  std::vector<double> u(static_cast<std::size_t>(inverse_.rows()));
  compliance.displacements_m(std::vector<double>(u.size(), 0.0), u);
  const double scale = expected.cwiseAbs().maxCoeff();
  for (std::int32_t v = 0; v < 152; ++v) {
    const Vec3 at(u[static_cast<std::size_t>(3 * v)], u[static_cast<std::size_t>(3 * v + 1)],
                  u[static_cast<std::size_t>(3 * v + 2)]);
    EXPECT_LT((at - expected.segment<3>(3 * v)).norm(), 1e-11 * scale);
    EXPECT_LT((compliance.displacement_m(v) - expected.segment<3>(3 * v)).norm(), 1e-11 * scale);
  }
}

TEST_F(ComplianceOfTwoBlocks, WalksAVertexOnceAndForgetsItWhenIdle) {
  Compliance compliance(factor_);
  ConstraintRows rows;
  rows.add(Bounds::bilateral(), 0.0, 0.0);
  rows.touch(60, Vec3::UnitX());
  for (int step = 0; step < 5; ++step) compliance.assemble(rows, {});
  EXPECT_EQ(compliance.walks(), 1U);
  ConstraintRows others;
  others.add(Bounds::bilateral(), 0.0, 0.0);
  others.touch(100, Vec3::UnitY());
  for (int step = 0; step < 20; ++step) compliance.assemble(others, {});
  compliance.evict(10);
  EXPECT_EQ(compliance.cached_vertices(), 1);
  const ComplianceMatrix& w = compliance.assemble(rows, {});
  EXPECT_EQ(compliance.walks(), 3U);
  EXPECT_NEAR(w(0, 0), inverse_(180, 180), 1e-12);
}

TEST_F(ComplianceOfTwoBlocks, WhatIsPreparedIsNeverWalkedAgain) {
  std::vector<std::int32_t> vertices(152);
  std::iota(vertices.begin(), vertices.end(), 0);
  std::shuffle(vertices.begin(), vertices.end(), random_);
  vertices.resize(90);
  Compliance plain(factor_), compliance(factor_);
  compliance.prepare(vertices);
  EXPECT_EQ(compliance.walks(), 90U);
  EXPECT_EQ(compliance.cached_vertices(), 90);
  const std::vector<NeedleMobility> needle(1);
  for (int trial = 0; trial < 6; ++trial) {
    const ConstraintRows rows = random_rows(12 + 10 * trial);  // of other vertices, too
    const ComplianceMatrix& expected = plain.assemble(rows, needle);
    const ComplianceMatrix& got = compliance.assemble(rows, needle);
    const double scale = *std::max_element(expected.value.begin(), expected.value.end());
    for (std::size_t i = 0; i < got.value.size(); ++i)
      ASSERT_NEAR(got.value[i], expected.value[i], 1e-11 * scale) << "trial " << trial;
    if (trial % 2 == 1) compliance.evict(0);
  }
  compliance.clear();
  EXPECT_EQ(compliance.cached_vertices(), 90);
  const std::uint64_t before = compliance.walks();
  ConstraintRows rows;
  for (const std::int32_t v : vertices) {
    rows.add(Bounds::bilateral(), 0.0, 0.0);
    rows.touch(v, Vec3::UnitZ());
  }
  compliance.assemble(rows, {});
  compliance.evict(0);
  compliance.assemble(rows, {});
  EXPECT_EQ(compliance.walks(), before);
}

TEST_F(ComplianceOfTwoBlocks, SumsDoNotDependOnTheOrderInWhichVerticesCameIntoUse) {
  // The same two batches, one way and the other. A vertex walked beside others than before may
  // differ in its last bits: BLAS kernels of some processors sum by a column's place.
  const ConstraintRows low = random_rows(30, 0, 61), high = random_rows(30, 62, 151);
  ConstraintRows rows;
  for (const ConstraintRows* part : {&high, &low})
    for (int i = 0; i < part->size(); ++i) {
      rows.add(Bounds::bilateral(), 0.0, 0.0);
      for (const Entry& entry : part->entries((*part)[i]))
        rows.touch(entry.vertex, entry.coefficient);
    }
  std::vector<double> lambda(60);
  for (double& l : lambda) l = uniform_(random_);
  std::vector<std::vector<double>> displacement_m;
  for (const auto& [first, second] : {std::pair(&low, &high), std::pair(&high, &low)}) {
    Compliance compliance(factor_);
    compliance.assemble(*first, std::vector<NeedleMobility>(1));
    compliance.assemble(*second, std::vector<NeedleMobility>(1));
    compliance.assemble(rows, {});
    compliance.apply(rows, lambda);
    std::vector<double> u(static_cast<std::size_t>(inverse_.rows()));
    compliance.displacements_m(std::vector<double>(u.size(), 0.0), u);
    displacement_m.push_back(u);
  }
  EXPECT_EQ(displacement_m[0], displacement_m[1]);
}

}  // namespace
}  // namespace sutured::constraints
