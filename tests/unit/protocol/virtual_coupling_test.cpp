// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/virtual_coupling.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <random>

namespace suture {
namespace {

using Eigen::Matrix;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using Mat6 = Matrix<double, 6, 6>;
using Vec6 = Matrix<double, 6, 1>;
constexpr double kLength_m = 0.01;

/// Units in which one limit serves translation and rotation: (t, ℓθ).
Mat6 unit() {
  Vec6 diagonal;
  diagonal << 1, 1, 1, 1 / kLength_m, 1 / kLength_m, 1 / kLength_m;
  return diagonal.asDiagonal();
}

/// A loaded model of `rows` rows whose stiffness is about `stiffness_n_per_m`.
std::unique_ptr<HapticModel> random_model(std::mt19937& random, int rows,
                                          double stiffness_n_per_m) {
  std::normal_distribution<double> normal;
  const auto matrix = [&](int m, int n) {
    return MatrixXd::NullaryExpr(m, n, [&] { return normal(random); });
  };
  auto model = std::make_unique<HapticModel>();
  model->touching = true;
  model->sequence = 1;
  model->characteristic_length_m = kLength_m;
  model->rows = rows;
  const MatrixXd root = unit().inverse() * matrix(6, 4);  // two directions without stiffness
  const Mat6 a = stiffness_n_per_m * root * root.transpose();
  for (int i = 0; i < 36; ++i) model->bilateral_stiffness[i] = a(i / 6, i % 6);
  const Vec6 w = unit().inverse() * matrix(6, 1);
  for (int i = 0; i < 3; ++i) {
    model->bilateral_wrench.force_n[i] = w[i];
    model->bilateral_wrench.torque_nm[i] = w[i + 3];
  }
  const MatrixXd s = matrix(rows, rows);
  const MatrixXd compliance =
      (s * s.transpose() / rows + 0.1 * MatrixXd::Identity(rows, rows)) / stiffness_n_per_m;
  const MatrixXd j = matrix(rows, 6) * unit().inverse();
  for (int i = 0; i < rows; ++i) {
    for (int k = 0; k <= i; ++k) model->compliance_m_per_n[packed_index(i, k)] = compliance(i, k);
    for (int k = 0; k < 6; ++k) model->jacobian[i][k] = j(i, k);
    model->offset_m[i] = 1e-3 * normal(random);
    model->multiplier_max_n[i] = i % 3 == 0 ? 0.5 : std::numeric_limits<double>::infinity();
  }
  complete_model(*model);
  return model;
}

Mat6 stiffest(const HapticModel& model) {
  const int m = model.rows;
  MatrixXd s(m, m), j(m, 6);
  for (int i = 0; i < m; ++i)
    for (int k = 0; k < m; ++k)
      s(i, k) = model.compliance_m_per_n[i >= k ? packed_index(i, k) : packed_index(k, i)];
  for (int i = 0; i < m; ++i)
    for (int k = 0; k < 6; ++k) j(i, k) = model.jacobian[i][k];
  Mat6 a = Mat6::NullaryExpr(
      [&](Eigen::Index r, Eigen::Index c) { return model.bilateral_stiffness[6 * r + c]; });
  if (m > 0) a += j.transpose() * s.ldlt().solve(j);
  return unit() * a * unit();
}

Vec6 as_vector(const Wrench& w) {
  Vec6 v;
  v << w.force_n[0], w.force_n[1], w.force_n[2], w.torque_nm[0], w.torque_nm[1], w.torque_nm[2];
  return v;
}

/// Where the screw ξ takes the pose at the origin.
Pose moved(const Vec6& xi) {
  const Eigen::Vector3d theta = xi.tail<3>(), t = xi.head<3>();
  const double angle = theta.norm();
  const Eigen::Vector3d axis = angle > 0.0 ? theta.normalized() : Eigen::Vector3d::UnitX();
  const Eigen::Quaterniond q(Eigen::AngleAxisd(angle, axis));
  const double share = angle > 1e-4 ? std::sin(angle) / angle : 1.0 - angle * angle / 6.0;
  const double turn = angle > 1e-4 ? (1.0 - std::cos(angle)) / angle : angle / 2.0;
  const Eigen::Vector3d x = share * t + turn * axis.cross(t) + (1.0 - share) * axis * axis.dot(t);
  return {{x[0], x[1], x[2]}, {q.x(), q.y(), q.z(), q.w()}};
}

/// At a turn of the hand, friction is as stiff as the tissue that the needle drags along.
TEST(VirtualCoupling, HoldsTheFrictionOfANeedleWhereItWouldBeStifferThanTheDeviceRenders) {
  const auto coupled = [](double max_stiffness_n_per_m) {
    auto model = std::make_unique<HapticModel>();
    model->touching = true;
    model->sequence = 1;
    model->characteristic_length_m = kLength_m;
    for (int i = 0; i < 3; ++i) model->bilateral_stiffness[7 * i] = 100.0;
    model->slide_twist[0] = model->slide_gradient[0] = 1.0;
    model->slide_stiffness = 300.0;
    model->slide_drag_n_s_per_m = 0.2;
    complete_model(*model);
    couple_model(*model, max_stiffness_n_per_m);
    return model->slide_drag_n_s_per_m;
  };
  EXPECT_EQ(coupled(500.0), 0.2);
  EXPECT_EQ(coupled(350.0), 0.0);
  EXPECT_EQ(coupled(0.0), 0.2) << "a device that tells no limit";
}

TEST(VirtualCoupling, HoldsTheFrictionOfANeedleThatWouldDampMoreThanTheDeviceRenders) {
  const auto drag = [](double max_damping_n_s_per_m) {
    const auto model = std::make_unique<HapticModel>();
    model->slide_drag_n_s_per_m = 0.1;
    model->characteristic_length_m = kLength_m;
    model->slide_gradient[1] = 1.0;
    model->slide_gradient[3] = kLength_m;  // felt as 0.2
    limit_damping(*model, max_damping_n_s_per_m);
    return model->slide_drag_n_s_per_m;
  };
  EXPECT_EQ(drag(0.21), 0.1);
  EXPECT_EQ(drag(0.19), 0.0);
  for (const double none : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN(),
                            std::numeric_limits<double>::infinity()})
    EXPECT_EQ(drag(none), 0.1) << none;
}

TEST(VirtualCoupling, ChangesNothingWhereTheDeviceIsStiffEnough) {
  std::mt19937 random(1);
  for (const int rows : {0, 5, 40}) {
    const auto model = random_model(random, rows, 100.0);
    const double limit = stiffest(*model).eigenvalues().real().maxCoeff() * 1.001;
    const auto coupled = std::make_unique<HapticModel>(*model);
    const double found = couple_model(*coupled, limit);
    EXPECT_NEAR(found, limit / 1.001, 1e-6 * limit);
    EXPECT_EQ(std::memcmp(model.get(), coupled.get(), sizeof(HapticModel)), 0);
    for (const double none : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN(),
                              std::numeric_limits<double>::infinity()}) {
      couple_model(*coupled, none);
      EXPECT_EQ(std::memcmp(model.get(), coupled.get(), sizeof(HapticModel)), 0);
    }
  }
}

TEST(VirtualCoupling, LimitsTheStiffnessOfEveryActiveSet) {
  std::mt19937 random(2);
  for (const int rows : {0, 1, 7, 64}) {
    const auto model = random_model(random, rows, 1000.0);
    const Eigen::SelfAdjointEigenSolver<Mat6> before(stiffest(*model));
    constexpr double kLimit = 900.0;
    ASSERT_GT(before.eigenvalues().maxCoeff(), kLimit);
    couple_model(*model, kLimit);
    const Eigen::SelfAdjointEigenSolver<Mat6> after(stiffest(*model));
    const Vec6 expected = before.eigenvalues().cwiseMin(kLimit);
    // Squaring S costs half the digits.
    EXPECT_LT((after.eigenvalues() - expected).cwiseAbs().maxCoeff(), 1e-6 * kLimit) << rows;
    // Fewer rows are softer: the present set, whichever it is.
    const Mat6 present = unit() * Mat6::NullaryExpr([&](Eigen::Index r, Eigen::Index c) {
                           return model->stiffness[6 * r + c];
                         }) *
                         unit();
    EXPECT_LE(Eigen::SelfAdjointEigenSolver<Mat6>(present).eigenvalues().maxCoeff(),
              kLimit * (1 + 1e-6));
  }
}

TEST(VirtualCoupling, IsASpringBetweenTheHandAndTheProxyOfTheSameModel) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  constexpr double kLimit = 700.0;
  for (int trial = 0; trial < 50; ++trial) {
    const auto model = random_model(random, trial % 12, 1000.0);
    const auto coupled = std::make_unique<HapticModel>(*model);
    couple_model(*coupled, kLimit);
    // The compliance in series, from the definition.
    const Eigen::SelfAdjointEigenSolver<Mat6> eigen(stiffest(*model));
    Mat6 c = Mat6::Zero();
    for (int e = 0; e < 6; ++e)
      if (eigen.eigenvalues()[e] > kLimit)
        c += (1 / kLimit - 1 / eigen.eigenvalues()[e]) * eigen.eigenvectors().col(e) *
             eigen.eigenvectors().col(e).transpose();
    c = unit() * c * unit();
    ModelEvaluator evaluator, of_proxy;
    for (int k = 0; k < 20; ++k) {
      // Small steps, so that four pivots a tick follow; translations only, because the first
      // order terms of rotation are the hand's.
      Vec6 xi = Vec6::Zero();
      for (int i = 0; i < 3; ++i) xi[i] = 1e-3 * k / 20 * normal(random);
      for (int settle = 0; settle < 20; ++settle) (void)evaluator.evaluate(*coupled, moved(xi));
      const Vec6 w = as_vector(evaluator.evaluate(*coupled, moved(xi)));
      const Vec6 proxy = xi + c * w;
      for (int settle = 0; settle < 20; ++settle) (void)of_proxy.evaluate(*model, moved(proxy));
      const Vec6 there = as_vector(of_proxy.evaluate(*model, moved(proxy)));
      // Its arms are zero: a turn of the proxy adds nothing to the linear model.
      EXPECT_LT((unit() * (w - there)).norm(), 1e-6 * (1 + (unit() * w).norm()))
          << trial << ' ' << k;
    }
  }
}

// Where the other tool moves, the coupled model is the coupling of the model that it leaves.
TEST(VirtualCoupling, FeelsAnotherToolAsTheProxyDoes) {
  std::mt19937 random(8);
  std::normal_distribution<double> normal;
  constexpr double kLimit = 700.0;
  for (int trial = 0; trial < 20; ++trial) {
    const auto model = random_model(random, trial % 12, 1000.0);
    model->other_count = 1;
    ModelCoupling& other = model->others[0];
    for (double& b : other.stiffness) b = 300.0 * normal(random);
    for (int i = 0; i < model->rows; ++i)
      for (double& j : other.jacobian[i]) j = normal(random);
    const auto coupled = std::make_unique<HapticModel>(*model);
    couple_model(*coupled, kLimit);
    Vec6 way = Vec6::Zero();
    for (int i = 0; i < 3; ++i) way[i] = 1e-4 * normal(random);
    // The same motion of the other, taken into the model's own terms.
    const auto shifted = std::make_unique<HapticModel>(*model);
    shifted->other_count = 0;
    for (int i = 0; i < 6; ++i)
      for (int k = 0; k < 6; ++k) {
        double& w = i < 3 ? shifted->bilateral_wrench.force_n[i]
                          : shifted->bilateral_wrench.torque_nm[i - 3];
        w -= other.stiffness[6 * i + k] * way[k];
      }
    for (int i = 0; i < model->rows; ++i)
      for (int k = 0; k < 6; ++k) shifted->offset_m[i] += other.jacobian[i][k] * way[k];
    complete_model(*shifted);
    couple_model(*shifted, kLimit);
    const std::array<Pose, 1> others{moved(way)};
    ModelEvaluator evaluator, of_shifted;
    Wrench got, expected;
    for (int settle = 0; settle < 20; ++settle) {
      got = evaluator.evaluate(*coupled, Pose{}, others);
      expected = of_shifted.evaluate(*shifted, Pose{});
    }
    EXPECT_LT((unit() * (as_vector(got) - as_vector(expected))).norm(),
              1e-9 * (1 + (unit() * as_vector(expected)).norm()))
        << trial;
  }
}

TEST(VirtualCoupling, AStiffWallIsAsStiffAsTheDeviceAllowsAndStillLetsGo) {
  HapticModel wall;
  wall.touching = true;
  wall.sequence = 1;
  wall.rows = 1;
  wall.compliance_m_per_n[0] = 1.0 / 50'000.0;
  wall.jacobian[0] = {1.0, 0.0, 0.0, 0.0, 0.0, 0.0};  // the wall fills x > 0
  wall.multiplier_max_n[0] = std::numeric_limits<double>::infinity();
  complete_model(wall);
  couple_model(wall, 1000.0);
  ModelEvaluator evaluator;
  const auto force = [&](double x) {
    return evaluator.evaluate(wall, {{x, 0.0, 0.0}, {0.0, 0.0, 0.0, 1.0}}).force_n[0];
  };
  EXPECT_NEAR(force(1e-3), -1.0, 1e-9);
  EXPECT_NEAR(force(2e-3), -2.0, 1e-9);
  EXPECT_EQ(force(-1e-6), 0.0);
}

TEST(VirtualCoupling, TwiceIsOnce) {
  std::mt19937 random(4);
  const auto model = random_model(random, 9, 1000.0);
  couple_model(*model, 500.0);
  const auto again = std::make_unique<HapticModel>(*model);
  couple_model(*again, 500.0);
  for (int i = 0; i < 36; ++i)
    EXPECT_NEAR(again->stiffness[i], model->stiffness[i], 1e-6 * 500.0) << i;
}

TEST(VirtualCoupling, NoClosedLoopGainsEnergy) {
  std::mt19937 random(5);
  for (int trial = 0; trial < 10; ++trial) {
    const auto model = random_model(random, 6, 2000.0);
    couple_model(*model, 600.0);
    ModelEvaluator evaluator;
    double work_j = 0.0;
    Vec6 before = Vec6::Zero(), w_before = as_vector(evaluator.evaluate(*model, moved(before)));
    for (int i = 1; i <= 4000; ++i) {
      const double t = 2 * M_PI * i / 2000;
      Vec6 xi = Vec6::Zero();
      xi[0] = 5e-4 * std::sin(t), xi[1] = 5e-4 * (1 - std::cos(t)), xi[2] = 3e-4 * std::sin(2 * t);
      const Vec6 w = as_vector(evaluator.evaluate(*model, moved(xi)));
      work_j += 0.5 * (w + w_before).dot(xi - before);
      before = xi;
      w_before = w;
    }
    // Of about a millijoule moved; a row that switches between two points costs k Δx² / 8.
    EXPECT_LT(work_j, 1e-7) << trial;
  }
}

}  // namespace
}  // namespace suture
