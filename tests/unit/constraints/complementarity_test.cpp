// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/complementarity.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <limits>
#include <random>

namespace sutured::constraints {
namespace {

struct Problem {
  ComplianceMatrix w;
  std::vector<Bounds> bounds;
  std::vector<double> q;
};

/// A random problem with bilateral, unilateral and doubly bounded rows; W has rank `rank`
/// before its ε, so rows may be redundant.
Problem random_problem(std::mt19937_64& random, int m, int rank, double epsilon) {
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  Eigen::MatrixXd a(m, rank);
  for (double& x : a.reshaped()) x = uniform(random);
  const Eigen::MatrixXd w = a * a.transpose() + epsilon * Eigen::MatrixXd::Identity(m, m);
  Problem p;
  p.w.size = m;
  p.w.value.assign(w.data(), w.data() + w.size());
  for (int i = 0; i < m; ++i) {
    p.q.push_back(uniform(random));
    const auto kind = random() % 3;
    p.bounds.push_back(kind == 0   ? Bounds::bilateral()
                       : kind == 1 ? Bounds::unilateral()
                                   : Bounds{-0.3, 0.5});
  }
  return p;
}

void expect_solved(const Problem& p, const std::vector<double>& lambda, double tolerance) {
  const Eigen::Map<const Eigen::MatrixXd> w(p.w.value.data(), p.w.size, p.w.size);
  const Eigen::Map<const Eigen::VectorXd> l(lambda.data(), p.w.size), q(p.q.data(), p.w.size);
  const Eigen::VectorXd gap = w * l - q;
  for (int i = 0; i < p.w.size; ++i) {
    const auto& b = p.bounds[static_cast<std::size_t>(i)];
    EXPECT_GE(l[i], b.lower_n);
    EXPECT_LE(l[i], b.upper_n);
    if (l[i] > b.lower_n) {
      EXPECT_LT(gap[i], tolerance) << i;
    }
    if (l[i] < b.upper_n) {
      EXPECT_GT(gap[i], -tolerance) << i;
    }
  }
}

TEST(Complementarity, SolvesRandomMixedProblems) {
  std::mt19937_64 random(23);
  ComplementaritySolver solver;
  for (int trial = 0; trial < 300; ++trial) {
    const int m = 1 + static_cast<int>(random() % 60);
    const Problem p = random_problem(random, m, std::max(1, m / 2), 1e-3);
    std::vector<double> lambda(p.q.size());
    std::vector<RowState> state(p.q.size(), RowState::kLower);
    solver.factor(p.w, p.bounds);
    const SolveReport report = solver.solve(p.q, lambda, state);
    ASSERT_TRUE(report.converged) << "trial " << trial;
    // Rounding: multipliers reach 1/ε, so a gap is known to about 1e-13 of W λ.
    expect_solved(p, lambda, 1e-9);
  }
}

TEST(Complementarity, AWarmStartFromTheSolutionNeedsNoPivot) {
  std::mt19937_64 random(29);
  const Problem p = random_problem(random, 50, 40, 1e-3);
  ComplementaritySolver solver;
  std::vector<double> lambda(50), again(50);
  std::vector<RowState> state(50, RowState::kLower);
  solver.factor(p.w, p.bounds);
  solver.solve(p.q, lambda, state);
  const SolveReport report = solver.solve(p.q, again, state);
  EXPECT_EQ(report.pivoting_rounds, 0);
  EXPECT_EQ(lambda, again);
}

TEST(Complementarity, OfAKeptComplianceIsSolvedAsOfANewOne) {
  std::mt19937_64 random(30);
  Problem p = random_problem(random, 50, 40, 1e-3);
  ComplementaritySolver kept;
  std::vector<double> lambda(50), expected(50);
  std::vector<RowState> state(50, RowState::kLower);
  std::normal_distribution<double> normal;
  for (int step = 0; step < 20; ++step) {
    // Other targets, from time to time other limits, and once a row that loses its own.
    for (double& q : p.q) q += 0.1 * normal(random);
    for (Bounds& b : p.bounds)
      if (step % 3 == 2 && b.upper_n != kUnbounded) b.upper_n *= 1.1;
    if (step == 10)
      *std::find_if(p.bounds.begin(), p.bounds.end(),
                    [](const Bounds& b) { return !b.bilateral_unbounded(); }) = Bounds::bilateral();
    std::vector<RowState> state_of_new = state;
    ComplementaritySolver fresh;
    fresh.factor(p.w, p.bounds);
    fresh.solve(p.q, expected, state_of_new);
    kept.factor(p.w, p.bounds, step > 0);
    kept.solve(p.q, lambda, state);
    EXPECT_EQ(lambda, expected) << step;
    EXPECT_EQ(state, state_of_new) << step;
  }
}

TEST(Complementarity, CondensedProblemReproducesTheWhole) {
  std::mt19937_64 random(31);
  const Problem p = random_problem(random, 20, 20, 0.1);
  ComplementaritySolver solver;
  solver.factor(p.w, p.bounds);
  const auto bilateral = solver.bilateral();
  const auto bounded = solver.bounded();
  ASSERT_FALSE(bilateral.empty());
  ASSERT_FALSE(bounded.empty());
  Eigen::MatrixXd wbb(bilateral.size(), bilateral.size()), wbu(bilateral.size(), bounded.size()),
      wuu(bounded.size(), bounded.size());
  for (std::size_t i = 0; i < bilateral.size(); ++i) {
    for (std::size_t j = 0; j < bilateral.size(); ++j) wbb(i, j) = p.w(bilateral[i], bilateral[j]);
    for (std::size_t j = 0; j < bounded.size(); ++j) wbu(i, j) = p.w(bilateral[i], bounded[j]);
  }
  for (std::size_t i = 0; i < bounded.size(); ++i)
    for (std::size_t j = 0; j < bounded.size(); ++j) wuu(i, j) = p.w(bounded[i], bounded[j]);
  const Eigen::MatrixXd s = wuu - wbu.transpose() * wbb.inverse() * wbu;
  for (int i = 0; i < static_cast<int>(bounded.size()); ++i)
    for (int j = 0; j < static_cast<int>(bounded.size()); ++j)
      EXPECT_NEAR(solver.condensed_compliance(i, j), s(i, j), 1e-10);
}

TEST(Complementarity, RedundantBilateralRowsAreLegal) {
  Problem p;
  p.w.size = 3;
  p.w.value.assign(9, 1.0);  // three times the same row, ε = 0
  p.bounds.assign(3, Bounds::bilateral());
  p.q.assign(3, 0.5);
  ComplementaritySolver solver;
  solver.factor(p.w, p.bounds);
  std::vector<double> lambda(3);
  std::vector<RowState> state(3, RowState::kFree);
  const SolveReport report = solver.solve(p.q, lambda, state);
  EXPECT_TRUE(report.regularised);
  EXPECT_NEAR(lambda[0] + lambda[1] + lambda[2], 0.5, 1e-6);
}

TEST(Complementarity, ASolutionThatIsNoNumberHasNoFiniteResidual) {
  std::mt19937_64 random(31);
  ComplementaritySolver solver;
  for (int bad = 0; bad < 12; ++bad) {
    Problem p = random_problem(random, 12, 6, 1e-3);
    p.q[static_cast<std::size_t>(bad)] = std::numeric_limits<double>::quiet_NaN();
    std::vector<double> lambda(p.q.size());
    std::vector<RowState> state(p.q.size(), RowState::kLower);
    solver.factor(p.w, p.bounds);
    EXPECT_EQ(solver.solve(p.q, lambda, state).residual, std::numeric_limits<double>::infinity())
        << bad;
  }
}

TEST(Complementarity, AnUpperBoundLetsTheGapGoNegative) {
  Problem p;
  p.w.size = 1;
  p.w.value = {0.02};
  p.bounds = {Bounds::unilateral(0.05)};
  p.q = {0.004};  // would take 0.2 N
  ComplementaritySolver solver;
  solver.factor(p.w, p.bounds);
  std::vector<double> lambda(1);
  std::vector<RowState> state(1, RowState::kLower);
  solver.solve(p.q, lambda, state);
  EXPECT_EQ(lambda[0], 0.05);
  EXPECT_EQ(state[0], RowState::kUpper);
  EXPECT_NEAR(solver.gap_m()[0], -0.003, 1e-15);
}

}  // namespace
}  // namespace sutured::constraints
