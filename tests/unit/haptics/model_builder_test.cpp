// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/model_builder.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <limits>
#include <random>

namespace sutured::haptics {
namespace {

using simulation::Mat6;
using simulation::ToolResponse;
using simulation::Vec6;

/// A response with `rows` unilateral rows whose multipliers solve its problem at ξ = 0.
ToolResponse random_response(int rows, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const auto random = [&](auto& matrix) {
    for (Eigen::Index i = 0; i < matrix.size(); ++i) matrix.data()[i] = uniform(engine);
  };
  ToolResponse response;
  response.touching = true;
  response.reference.present = true;
  response.reference.position_m = {0.01, 0.02, 0.03};
  Mat6 l;
  random(l);
  response.bilateral_stiffness = l * l.transpose();
  random(response.bilateral_wrench);
  auto& problem = response.condensed;
  Eigen::MatrixXd b(rows, rows);
  random(b);
  problem.compliance_m_per_n =
      0.01 / rows * b * b.transpose() + 1e-3 * Eigen::MatrixXd::Identity(rows, rows);
  problem.jacobian.resize(rows, 6);
  random(problem.jacobian);
  // Multipliers and gaps first, the offsets that make them a solution after.
  problem.multiplier_n = Eigen::VectorXd::Zero(rows);
  problem.multiplier_max_n =
      Eigen::VectorXd::Constant(rows, std::numeric_limits<double>::infinity());
  Eigen::VectorXd gap = Eigen::VectorXd::Zero(rows);
  for (int i = 0; i < rows; ++i) {
    if (i % 3 == 0) problem.multiplier_n[i] = 0.05 + std::abs(uniform(engine));
    if (i % 3 == 1) gap[i] = 1e-4 + 1e-3 * std::abs(uniform(engine));
    if (i % 3 == 2) {
      problem.multiplier_n[i] = problem.multiplier_max_n[i] = 0.1;
      gap[i] = -1e-4 - 1e-3 * std::abs(uniform(engine));
    }
  }
  problem.offset_m = problem.compliance_m_per_n * problem.multiplier_n - gap;
  problem.bound_slope = Eigen::VectorXd::Zero(rows);
  problem.bound_row[0] = rows - 1;
  problem.bound_slope[0] = 0.5;
  return response;
}

Vec6 wrench_at(const suture::HapticModel& model, const Vec6& xi) {
  suture::Pose pose = model.reference;
  for (int i = 0; i < 3; ++i) pose.position_m[i] += xi[i];
  const suture::Wrench w = suture::evaluate(model, pose);
  Vec6 v;
  v << w.force_n[0], w.force_n[1], w.force_n[2], w.torque_nm[0], w.torque_nm[1], w.torque_nm[2];
  return v;
}

/// The affine answer of all rows with the active set of ξ = 0.
Vec6 expected_at(const ToolResponse& response, const Vec6& xi) {
  const auto& problem = response.condensed;
  const int rows = static_cast<int>(problem.offset_m.size());
  Eigen::VectorXd lambda = problem.multiplier_n;
  std::vector<int> free;
  for (int i = 0; i < rows; i += 3) free.push_back(i);
  lambda(free) += Eigen::VectorXd(Eigen::MatrixXd(problem.compliance_m_per_n(free, free))
                                      .ldlt()
                                      .solve(problem.jacobian(free, Eigen::all) * xi));
  return response.bilateral_wrench - response.bilateral_stiffness * xi -
         problem.jacobian.transpose() * lambda;
}

TEST(FillModel, CarriesAResponseUnchanged) {
  for (const int rows : {3, 30, 64}) {
    const ToolResponse response = random_response(rows, rows);
    suture::HapticModel model;
    fill_model(response, model);
    EXPECT_EQ(model.rows, rows);
    EXPECT_EQ(model.bound_row[0], rows - 1);
    EXPECT_EQ(model.bound_slope[0], 0.5);
    EXPECT_EQ(model.bound_slope[1], 0.0);
    const Vec6 xi = Vec6::Unit(0) * 0.5 * model.radius_m;
    EXPECT_LT((wrench_at(model, xi) - expected_at(response, xi)).norm(), 1e-9);
  }
}

TEST(FillModel, ForgetsTheRowsOfTheModelBefore) {
  suture::HapticModel model;
  ToolResponse before = random_response(64, 2);
  before.held.kind = simulation::HeldKind::kTissue;
  fill_model(before, model);
  EXPECT_TRUE(model.holding);
  ToolResponse none;
  none.touching = true;
  none.bilateral_wrench = none.wrench = Vec6::Unit(1);
  fill_model(none, model);
  EXPECT_FALSE(model.holding);
  EXPECT_EQ(model.rows, 0);
  EXPECT_EQ(wrench_at(model, Vec6::Zero()), Vec6::Unit(1));
}

}  // namespace
}  // namespace sutured::haptics
