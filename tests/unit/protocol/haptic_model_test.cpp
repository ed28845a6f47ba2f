// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/haptic_model.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <utility>
#include <vector>

namespace suture {
namespace {

using Mat6 = Eigen::Matrix<double, 6, 6>;
using Vec6 = Eigen::Matrix<double, 6, 1>;
using Vec3 = Eigen::Vector3d;

Pose pose_of(const Vec3& p, const Eigen::Quaterniond& q) {
  return {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
}

Eigen::Quaterniond rotation(const Vec3& theta) {
  const double angle = theta.norm();
  if (angle == 0.0) return Eigen::Quaterniond::Identity();
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, theta / angle));
}

Vec6 vector_of(const Wrench& w) {
  Vec6 v;
  v << w.force_n[0], w.force_n[1], w.force_n[2], w.torque_nm[0], w.torque_nm[1], w.torque_nm[2];
  return v;
}

Wrench wrench_of(const Vec6& v) { return {{v[0], v[1], v[2]}, {v[3], v[4], v[5]}}; }

void set_matrix(std::array<double, 36>& to, const Mat6& from) {
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) to[6 * i + j] = from(i, j);
}

class RandomModels {
 public:
  explicit RandomModels(unsigned seed) : engine_(seed) {}

  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(engine_);
  }
  Vec6 twist(double translation_m, double rotation_rad) {
    Vec6 xi;
    for (int i = 0; i < 6; ++i) xi[i] = uniform(-1.0, 1.0) * (i < 3 ? translation_m : rotation_rad);
    return xi;
  }

  /// A model of `rows` rows with tissue-like magnitudes: compliances of about 0.02 m/N.
  HapticModel make(int rows) {
    HapticModel model;
    model.sequence = ++sequence_;
    model.epoch = 1;
    model.touching = true;
    model.rows = rows;
    Eigen::MatrixXd b(rows, rows);
    for (int i = 0; i < rows; ++i)
      for (int j = 0; j < rows; ++j) b(i, j) = uniform(-1.0, 1.0);
    const Eigen::MatrixXd s =
        0.02 / std::max(rows, 1) * b * b.transpose() + 1e-4 * Eigen::MatrixXd::Identity(rows, rows);
    for (int i = 0; i < rows; ++i) {
      for (int j = 0; j <= i; ++j) model.compliance_m_per_n[packed_index(i, j)] = s(i, j);
      const Vec6 row = twist(1.0, 0.005);
      for (int k = 0; k < 6; ++k) model.jacobian[i][k] = row[k];
      model.offset_m[i] = uniform(-1e-3, 1e-3);
      model.multiplier_max_n[i] = i % 7 == 5   ? 0.0  // no room: friction without pressure
                                  : i % 3 == 0 ? 0.05
                                               : std::numeric_limits<double>::infinity();
    }
    Mat6 l = Mat6::Zero();
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j <= i; ++j) l(i, j) = uniform(-1.0, 1.0) * (i < 3 ? 5.0 : 0.03);
    set_matrix(model.bilateral_stiffness, l * l.transpose());
    model.bilateral_wrench = wrench_of(twist(0.2, 1e-3));
    return model;
  }

 private:
  std::mt19937 engine_;
  std::uint64_t sequence_ = 0;
};

Eigen::MatrixXd compliance_of(const HapticModel& model) {
  Eigen::MatrixXd s(model.rows, model.rows);
  for (int i = 0; i < model.rows; ++i)
    for (int j = 0; j <= i; ++j) s(i, j) = s(j, i) = model.compliance_m_per_n[packed_index(i, j)];
  return s;
}

/// The worst violation of the box complementarity conditions, in metres.
double complementarity_residual_m(const HapticModel& model, const Vec6& xi,
                                  const Eigen::VectorXd& lambda) {
  const Eigen::MatrixXd s = compliance_of(model);
  double worst = 0.0;
  for (int i = 0; i < model.rows; ++i) {
    double gap = s.row(i).dot(lambda) - model.offset_m[i];
    for (int k = 0; k < 6; ++k) gap -= model.jacobian[i][k] * xi[k];
    // The natural residual: λ − clamp(λ − gap / s_ii) vanishes exactly at solutions.
    const double projected = std::clamp(lambda[i] - gap / s(i, i), 0.0, model.multiplier_max_n[i]);
    worst = std::max(worst, std::abs(lambda[i] - projected) * s(i, i));
  }
  return worst;
}

/// Tries all 3^m active sets.
Eigen::VectorXd solve_by_enumeration(const HapticModel& model, const Vec6& xi) {
  const int m = model.rows;
  const Eigen::MatrixXd s = compliance_of(model);
  Eigen::VectorXd rhs(m);
  for (int i = 0; i < m; ++i) {
    rhs[i] = model.offset_m[i];
    for (int k = 0; k < 6; ++k) rhs[i] += model.jacobian[i][k] * xi[k];
  }
  int sets = 1;
  for (int i = 0; i < m; ++i) sets *= 3;
  Eigen::VectorXd best = Eigen::VectorXd::Zero(m);
  double best_residual = std::numeric_limits<double>::infinity();
  for (int set = 0; set < sets; ++set) {
    Eigen::VectorXd lambda = Eigen::VectorXd::Zero(m);
    std::vector<int> free;
    bool possible = true;
    for (int i = 0, digits = set; i < m; ++i, digits /= 3) {
      if (digits % 3 == 1) free.push_back(i);
      if (digits % 3 == 2) {
        lambda[i] = model.multiplier_max_n[i];
        possible &= std::isfinite(lambda[i]);
      }
    }
    if (!possible) continue;
    const int n = static_cast<int>(free.size());
    Eigen::MatrixXd sff(n, n);
    Eigen::VectorXd r(n);
    for (int a = 0; a < n; ++a) {
      r[a] = rhs[free[a]] - s.row(free[a]).dot(lambda);
      for (int b = 0; b < n; ++b) sff(a, b) = s(free[a], free[b]);
    }
    if (n > 0) {
      const Eigen::VectorXd x = sff.ldlt().solve(r);
      for (int a = 0; a < n; ++a) lambda[free[a]] = x[a];
    }
    const double residual = complementarity_residual_m(model, xi, lambda);
    if (residual < best_residual) best_residual = residual, best = lambda;
  }
  return best;
}

/// How far the screw `xi` takes the origin in a unit of time: V(θ) t, by its power series.
Vec3 way_of(const Vec6& xi) {
  Vec3 term = xi.head<3>(), sum = term;
  for (int k = 2; k < 40; ++k) {
    term = xi.tail<3>().cross(term) / k;
    sum += term;
  }
  return sum;
}

Pose moved(const Vec6& xi) { return pose_of(way_of(xi), rotation(xi.tail<3>())); }

TEST(MotionBetween, InvertsTheExponentialOfAScrew) {
  RandomModels random(1);
  for (int i = 0; i < 200; ++i) {
    const Eigen::Quaterniond q = rotation(random.twist(0, 3.0).tail<3>());
    const Vec3 p = random.twist(0.1, 0).head<3>();
    // Below 3 / sqrt(3) per axis the rotation is shorter than π.
    const Vec6 xi = random.twist(0.05, i % 2 ? 1.7 : 1e-7);
    const Twist found =
        motion_between(pose_of(p, q), pose_of(p + way_of(xi), rotation(xi.tail<3>()) * q));
    for (int k = 0; k < 6; ++k) EXPECT_NEAR(found[k], xi[k], 1e-13 + 1e-9 * std::abs(xi[k]));
  }
}

TEST(MovedBy, IsTheExponentialOfAScrew) {
  RandomModels random(2);
  for (int i = 0; i < 200; ++i) {
    const Eigen::Quaterniond q = rotation(random.twist(0, 3.0).tail<3>());
    const Vec3 p = random.twist(0.1, 0).head<3>();
    const Vec6 xi = random.twist(0.05, i % 4 == 0   ? 1.7
                                       : i % 4 == 1 ? 5e-3
                                       : i % 4 == 2 ? 1e-6
                                                    : 0);
    Twist twist;
    for (int k = 0; k < 6; ++k) twist[k] = xi[k];
    const Pose pose = moved_by(pose_of(p, q), twist);
    const Vec3 expected = p + way_of(xi);
    const Eigen::Quaterniond turned = rotation(xi.tail<3>()) * q;
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(pose.position_m[k], expected[k], 1e-15);
    for (int k = 0; k < 4; ++k)
      EXPECT_NEAR(pose.orientation_xyzw[k], turned.coeffs()[k], 1e-14) << i;
  }
}

TEST(MotionBetween, TakesATurnAboutADistantCentreForAMultipleOfItsTwist) {
  // A tool on a needle's arc: 8 mm from the axis, along y, that it is turned about.
  const Vec3 centre(0.011, 0.0, 0.002), axis = Vec3::UnitY(), start(0.003, 0.001, 0.002);
  for (const double angle : {1e-6, 0.01, 0.3, 1.2, -2.5}) {
    const Eigen::Quaterniond turn = rotation(angle * axis);
    const Twist xi = motion_between(pose_of(start, Eigen::Quaterniond::Identity()),
                                    pose_of(centre + turn * (start - centre), turn));
    const Vec3 expected = angle * axis.cross(start - centre);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(xi[k], expected[k], 1e-15 + 1e-10 * std::abs(angle));
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(xi[3 + k], angle * axis[k], 1e-12);
  }
}

TEST(MotionBetween, TakesTheShortWayForEitherSignOfAQuaternion) {
  const Eigen::Quaterniond q = rotation({0.1, 0.2, -0.3});
  const Eigen::Quaterniond minus(-q.w(), -q.x(), -q.y(), -q.z());
  const Twist xi = motion_between(pose_of(Vec3::Zero(), q), pose_of(Vec3::Zero(), minus));
  for (const double component : xi) EXPECT_NEAR(component, 0.0, 1e-12);
}

TEST(HapticModel, IsZeroWhereNothingTouches) {
  RandomModels random(2);
  HapticModel model = random.make(4);
  model.touching = false;
  EXPECT_EQ(vector_of(evaluate(model, moved(random.twist(1e-3, 0.05)))).norm(), 0.0);
}

TEST(HapticModel, SolvesItsComplementarityProblemLikeAnEnumerationOfAllSets) {
  RandomModels random(3);
  ModelEvaluator evaluator;
  int checked = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const HapticModel model = random.make(1 + trial % 6);
    for (int k = 0; k < 4; ++k) {
      const Vec6 xi = random.twist(2e-3, 0.05);
      const std::uint64_t before = evaluator.fallbacks();
      const Vec6 found = vector_of(evaluator.evaluate(model, moved(xi)));
      if (evaluator.fallbacks() != before) continue;
      ++checked;
      const Eigen::VectorXd lambda = solve_by_enumeration(model, xi);
      Vec6 expected = vector_of(model.bilateral_wrench) -
                      Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(
                          model.bilateral_stiffness.data()) *
                          xi;
      for (int r = 0; r < model.rows; ++r)
        for (int i = 0; i < 6; ++i) expected[i] -= model.jacobian[r][i] * lambda[r];
      EXPECT_LT((found - expected).norm(), 1e-9);
    }
  }
  EXPECT_GT(checked, 1150);  // of 1200 random leaps four changes of the set suffice for nearly all
}

TEST(HapticModel, MovesWithTheOtherToolsAsAProblemOfAllTheirMotionsDoes) {
  RandomModels random(11);
  int checked = 0;
  for (int trial = 0; trial < 100; ++trial) {
    HapticModel model = random.make(1 + trial % 6);
    model.other_count = 1 + trial % kModelOthersMax;
    std::vector<Pose> poses;
    std::vector<Vec6> motions;
    for (int k = 0; k < model.other_count; ++k) {
      ModelCoupling& other = model.others[k];
      other.reference = moved(random.twist(0.1, 1.0));
      for (double& x : other.stiffness) x = random.twist(30.0, 0.0)[0];
      for (Twist& row : other.jacobian)
        for (int c = 0; c < 6; ++c) row[c] = random.twist(1.0, 0.01)[c];
      motions.push_back(random.twist(5e-4, 0.0));
      poses.push_back(other.reference);
      for (int i = 0; i < 3; ++i) poses.back().position_m[i] += motions.back()[i];
    }
    const Vec6 xi = random.twist(1e-3, 0.0);
    // The same with the others' motions put into q and w_0.
    HapticModel alone = model;
    alone.other_count = 0;
    for (int k = 0; k < model.other_count; ++k) {
      const ModelCoupling& other = model.others[k];
      for (int j = 0; j < 6; ++j) {
        for (int i = 0; i < 3; ++i) {
          alone.bilateral_wrench.force_n[i] -= other.stiffness[6 * i + j] * motions[k][j];
          alone.bilateral_wrench.torque_nm[i] -= other.stiffness[6 * (i + 3) + j] * motions[k][j];
        }
        for (int r = 0; r < model.rows; ++r)
          alone.offset_m[r] += other.jacobian[r][j] * motions[k][j];
      }
    }
    ModelEvaluator with, without;
    const Vec6 found = vector_of(with.evaluate(model, moved(xi), poses));
    const Vec6 expected = vector_of(without.evaluate(alone, moved(xi)));
    if (with.fallbacks() + without.fallbacks() > 0) continue;
    ++checked;
    EXPECT_LT((found - expected).norm(), 1e-9 * (1.0 + expected.norm()));
    // One that is not given stands where it was.
    std::vector<Pose> still;
    for (int k = 0; k < model.other_count; ++k) still.push_back(model.others[k].reference);
    EXPECT_LT((vector_of(evaluate(model, moved(xi))) - vector_of(evaluate(model, moved(xi), still)))
                  .norm(),
              1e-12);
  }
  EXPECT_GT(checked, 90);
}

TEST(HapticModel, FollowsAHandThroughSixtyFourRowsWithoutRunningOutOfPivots) {
  RandomModels random(4);
  for (int trial = 0; trial < 5; ++trial) {
    const HapticModel model = random.make(kModelRowsMax);
    ModelEvaluator evaluator;
    // Let the first call, which knows nothing, settle where it starts.
    for (int i = 0; i < 20; ++i) (void)evaluator.evaluate(model, Pose{});
    const std::uint64_t before = evaluator.fallbacks();
    const Vec6 goal = random.twist(1e-3, 0.02);
    for (int tick = 0; tick <= 100; ++tick) {
      const Vec6 xi = goal * (tick / 100.0);
      (void)evaluator.evaluate(model, moved(xi));
      const Eigen::Map<const Eigen::VectorXd> lambda(evaluator.multipliers_n().data(), model.rows);
      ASSERT_LT(complementarity_residual_m(model, xi, lambda), 1e-10) << tick;
    }
    EXPECT_EQ(evaluator.fallbacks(), before);
  }
}

TEST(HapticModel, NeverPullsEvenWhereItsPivotsRunOut) {
  RandomModels random(5);
  ModelEvaluator evaluator;
  for (int trial = 0; trial < 200; ++trial) {
    const HapticModel model = random.make(kModelRowsMax);
    for (int k = 0; k < 3; ++k) {
      (void)evaluator.evaluate(model, moved(random.twist(0.05, 1.0)));
      for (int r = 0; r < model.rows; ++r) {
        ASSERT_GE(evaluator.multipliers_n()[r], 0.0);
        ASSERT_LE(evaluator.multipliers_n()[r], model.multiplier_max_n[r]);
      }
    }
  }
  EXPECT_GT(evaluator.fallbacks(), 0U) << "the leaps were meant to exhaust the pivots";
}

TEST(HapticModel, LeavesContactWithoutGlue) {
  // A wall of 50 N/m at x = 0, touched 1 mm deep; the hand leaves through x > 0.
  HapticModel model;
  model.epoch = model.sequence = 1;
  model.touching = true;
  model.rows = 1;
  model.compliance_m_per_n[0] = 0.02;
  model.jacobian[0] = {-1.0, 0, 0, 0, 0, 0};
  model.offset_m[0] = 1e-3;
  model.multiplier_n[0] = 0.05;
  model.multiplier_max_n[0] = 0.1;
  complete_model(model);
  EXPECT_NEAR(model.wrench.force_n[0], 0.05, 1e-12);
  EXPECT_NEAR(model.stiffness[0], 50.0, 1e-9);
  EXPECT_NEAR(model.radius_m, 1e-3, 1e-12);
  ModelEvaluator evaluator;
  for (int i = -40; i <= 40; ++i) {
    const double x = i * 1e-4;
    const double expected = std::clamp(50.0 * (1e-3 - x), 0.0, 0.1);
    EXPECT_NEAR(evaluator.evaluate(model, moved(Vec6::Unit(0) * x)).force_n[0], expected, 1e-9);
  }
  EXPECT_EQ(evaluator.fallbacks(), 0U);
}

/// A wall of 50 N/m below y = 0 with friction μ along x, pressed by 0.05 N and stuck.
HapticModel rough_wall(double mu) {
  HapticModel model;
  model.epoch = model.sequence = 1;
  model.touching = true;
  model.rows = 2;
  model.compliance_m_per_n = {0.02, 0.0, 0.02};
  model.jacobian[0] = {0, -1.0, 0, 0, 0, 0};
  model.offset_m[0] = 1e-3;
  model.multiplier_n[0] = 0.05;
  model.multiplier_max_n[0] = std::numeric_limits<double>::infinity();
  model.jacobian[1] = {1.0, 0, 0, 0, 0, 0};
  const double cone = mu * 0.05;  // counted from −cone, so that 0 ≤ λ ≤ 2 cone
  model.multiplier_n[1] = cone;
  model.multiplier_max_n[1] = 2.0 * cone;
  model.offset_m[1] = 0.02 * cone;
  model.bilateral_wrench.force_n[0] = cone;
  model.bound_row[1] = 0;
  model.bound_slope[1] = mu;
  complete_model(model);
  return model;
}

TEST(HapticModel, SlidesAtTheConeOfTheNormalForceThatItHasNow) {
  constexpr double kMu = 0.5;
  const HapticModel model = rough_wall(kMu);
  ModelEvaluator evaluator;
  double last_x = 0.0;
  const auto slide_to = [&](double x, double y) {
    (void)evaluator.evaluate(model, moved((Vec6() << x, y, 0, 0, 0, 0).finished()));
    // Two millimetres on, for the bound is that of the normal force of the call before.
    const double on = x + std::copysign(2e-3, x - last_x);
    last_x = x;
    return evaluator.evaluate(model, moved((Vec6() << on, y, 0, 0, 0, 0).finished())).force_n;
  };
  const auto force_at = [&](double x, double y) {
    return evaluator.evaluate(model, moved((Vec6() << x, y, 0, 0, 0, 0).finished())).force_n;
  };
  EXPECT_NEAR(force_at(0.0, 0.0)[0], 0.0, 1e-12);
  EXPECT_NEAR(force_at(2e-4, 0.0)[0], -0.01, 1e-12) << "sticks within the cone";
  double x = 2e-4;
  for (const double depth : {1e-3, 2e-3, 4e-3, 3e-3, 0.5e-3, 0.0, 2e-3}) {
    x += 4e-3;
    const auto force = slide_to(x, 1e-3 - depth);
    EXPECT_NEAR(force[1], 50.0 * depth, 1e-12);
    EXPECT_NEAR(force[0], -kMu * 50.0 * depth, 1e-12) << depth;
  }
  // It slipped for good: on the way back it unloads at once, and slips again at the other side.
  const double cone = kMu * 0.1;
  EXPECT_NEAR(force_at(x + 2e-3 - 1e-3, -1e-3)[0], -cone + 0.05, 1e-12);
  EXPECT_NEAR(force_at(x - 9e-3, -1e-3)[0], cone, 1e-12);
  EXPECT_EQ(evaluator.fallbacks(), 0U);
}

TEST(HapticModel, FindsTheConeInAModelsFirstCall) {
  const HapticModel model = rough_wall(0.5);
  const auto force = evaluate(model, moved((Vec6() << 8e-3, -1e-3, 0, 0, 0, 0).finished())).force_n;
  EXPECT_NEAR(force[0], -0.5 * 0.1, 1e-12);
  // The next model knows nothing of what slipped in the last.
  ModelEvaluator evaluator;
  (void)evaluator.evaluate(model, moved(Vec6::Unit(0) * 8e-3));
  HapticModel next = model;
  ++next.sequence;
  EXPECT_NEAR(evaluator.evaluate(next, Pose{}).force_n[0], 0.0, 1e-12);
}

TEST(HapticModel, GivesNoFrictionThatHelpsAHandToReturnWithAHarderPress) {
  // Out lightly and back hard: a friction that springs back would give 2 (N₂ − N₁) μ a loop.
  const HapticModel model = rough_wall(0.5);
  for (const double way : {1.0, -1.0}) {
    ModelEvaluator evaluator;
    double work = 0.0;
    Vec6 last_xi = Vec6::Zero();
    Vec6 last_w = vector_of(evaluator.evaluate(model, moved(last_xi)));
    constexpr int kSteps = 4000;
    for (int i = 1; i <= kSteps; ++i) {
      const double t = 2.0 * M_PI * i / kSteps;
      Vec6 xi = Vec6::Zero();
      xi[0] = 3e-3 * (1.0 - std::cos(t));
      xi[1] = way * 5e-4 * std::sin(t);
      const Vec6 w = vector_of(evaluator.evaluate(model, moved(xi)));
      work += 0.5 * (w + last_w).dot(xi - last_xi);
      last_xi = xi, last_w = w;
    }
    // μ N 0.025 N over 12 mm, less what sticks.
    EXPECT_LT(work, -0.5 * 0.025 * 0.012) << way;
  }
}

TEST(HapticModel, SurvivesRedundantRows) {
  HapticModel model;
  model.epoch = model.sequence = 1;
  model.touching = true;
  model.rows = 2;
  model.compliance_m_per_n = {0.02, 0.02, 0.02};  // the same row twice, no compliance
  model.jacobian[0] = model.jacobian[1] = {-1.0, 0, 0, 0, 0, 0};
  model.offset_m[0] = model.offset_m[1] = 1e-3;
  model.multiplier_max_n[0] = model.multiplier_max_n[1] = std::numeric_limits<double>::infinity();
  ModelEvaluator evaluator;
  EXPECT_NEAR(evaluator.evaluate(model, Pose{}).force_n[0], 0.05, 1e-12);
}

// Work given to the hand on a closed way through the six-dimensional ξ, its exact value
// replaced by a fine trapezoidal sum (error of order steps⁻²).
double loop_work_j(const HapticModel& model, const Vec6& a, const Vec6& b, int steps) {
  ModelEvaluator evaluator;
  // A leap to the start may take more changes of the active set than one call makes.
  for (int i = 0; i < 5; ++i) (void)evaluator.evaluate(model, moved(a));
  double work = 0.0;
  Vec6 last_xi = a;
  Vec6 last_w = vector_of(evaluator.evaluate(model, moved(last_xi)));
  for (int i = 1; i <= steps; ++i) {
    const double t = 2.0 * M_PI * i / steps;
    const Vec6 xi = a * std::cos(t) + b * std::sin(t);
    const Vec6 w = vector_of(evaluator.evaluate(model, moved(xi)));
    work += 0.5 * (w + last_w).dot(xi - last_xi);
    last_xi = xi, last_w = w;
  }
  return work;
}

TEST(HapticModel, GivesNoEnergyOnAClosedLoop) {
  RandomModels random(6);
  for (const int rows : {0, 8}) {
    for (int trial = 0; trial < 10; ++trial) {
      HapticModel model = random.make(rows);
      const Vec6 a = random.twist(3e-4, 0.035), b = random.twist(3e-4, 0.035);
      const Mat6 stiffness = Eigen::Map<const Mat6>(model.bilateral_stiffness.data());
      const double stored = 0.5 * (a.dot(stiffness * a) + b.dot(stiffness * b));
      EXPECT_LT(std::abs(loop_work_j(model, a, b, 4000)), 1e-4 * stored);
      // The check can fail: a skew part, as a slide by least squares has, pumps.
      Mat6 skew = stiffness;
      skew += 0.09 * (stiffness.triangularView<Eigen::StrictlyUpper>().toDenseMatrix() -
                      stiffness.triangularView<Eigen::StrictlyLower>().toDenseMatrix());
      set_matrix(model.bilateral_stiffness, skew);
      EXPECT_GT(std::abs(loop_work_j(model, a, b, 4000)), 1e-3 * stored);
    }
  }
}

TEST(HapticModel, ChangesItsSetFourTimesACallAtMostAlsoInAModelsFirst) {
  RandomModels random(13);
  constexpr std::uint64_t kMost = ModelEvaluator::kPivotsMax;
  std::uint64_t most = 0;
  int ran_out = 0;
  for (int trial = 0; trial < 200; ++trial) {
    HapticModel model = random.make(30);
    for (int i = 0; i < model.rows; i += 3) {
      model.bound_row[i] = i + 1;
      model.bound_slope[i] = random.uniform(0.1, 1.0);
    }
    complete_model(model);
    ModelEvaluator evaluator;
    const Pose away = moved(random.twist(5e-3, 0.2));
    for (int call = 0; call < 30; ++call) {
      const std::uint64_t before = evaluator.pivots(), clamped = evaluator.fallbacks();
      const Wrench w = evaluator.evaluate(model, away);
      most = std::max(most, evaluator.pivots() - before);
      ASSERT_LE(evaluator.pivots() - before, kMost);
      for (int i = 0; i < 3; ++i) ASSERT_TRUE(std::isfinite(w.force_n[i] + w.torque_nm[i]));
      if (evaluator.fallbacks() > clamped) ++ran_out;
      if (call == 29) {
        EXPECT_EQ(evaluator.fallbacks(), clamped) << "it settles where the hand stays";
      }
    }
  }
  EXPECT_GT(ran_out, 0);
  EXPECT_EQ(most, kMost) << "the leaps were meant to use them up";
}

TEST(HapticModel, GivesNoEnergyOnALoopWhereBoundsFollowOtherRows) {
  RandomModels random(12);
  int followed = 0;
  for (int trial = 0; trial < 30; ++trial) {
    HapticModel model = random.make(9);
    for (int i = 0; i < model.rows; i += 3) {  // those of 0.05 N
      model.bound_row[i] = i + 1;
      model.bound_slope[i] = random.uniform(0.1, 1.0);
    }
    ModelEvaluator settled;
    for (int i = 0; i < 20; ++i) (void)settled.evaluate(model, Pose{});
    model.multiplier_n = settled.multipliers_n();
    ++model.sequence;
    const Vec6 a = random.twist(1.5e-3, 0.1), b = random.twist(1.5e-3, 0.1);
    const Mat6 stiffness = Eigen::Map<const Mat6>(model.bilateral_stiffness.data());
    const double stored = 0.5 * (a.dot(stiffness * a) + b.dot(stiffness * b));
    // What was in the rows at the start can come back once; a pump gives again with every loop.
    ModelEvaluator evaluator;
    for (int i = 0; i < 5; ++i) (void)evaluator.evaluate(model, moved(a));
    const std::uint64_t before = evaluator.fallbacks();
    double work = 0.0;
    Vec6 last_xi = a;
    Vec6 last_w = vector_of(evaluator.evaluate(model, moved(last_xi)));
    constexpr int kLoops = 6, kSteps = 2000;
    for (int i = 1; i <= kLoops * kSteps; ++i) {
      const double t = 2.0 * M_PI * i / kSteps;
      const Vec6 xi = a * std::cos(t) + b * std::sin(t);
      const Vec6 w = vector_of(evaluator.evaluate(model, moved(xi)));
      if (i > kSteps) work += 0.5 * (w + last_w).dot(xi - last_xi);
      last_xi = xi, last_w = w;
    }
    EXPECT_EQ(evaluator.fallbacks(), before);
    EXPECT_LT(work, (kLoops - 1) * 1e-4 * stored) << trial;
    followed += work < -1e-3 * stored;
  }
  EXPECT_GT(followed, 10) << "rows were meant to slip";
}

// A rigid tool whose points r_i hang on springs: the exact wrench at any pose.
struct SpringTool {
  std::vector<Vec3> arms, anchors;
  double k = 50.0;
  Vec6 slide = Vec6::Zero();  // twist of the tool along its own axis or arc; zero: no slide

  /// Where point i lies on the tool after the tissue slid back by σ along the axis.
  Vec3 arm(std::size_t i, double sigma) const {
    return rotation(-sigma * slide.tail<3>()) * arms[i] + way_of(-sigma * slide);
  }

  Vec6 wrench(const Vec6& xi, double sigma) const {
    Vec6 w = Vec6::Zero();
    const Eigen::Quaterniond q = rotation(xi.tail<3>());
    for (std::size_t i = 0; i < arms.size(); ++i) {
      const Vec3 r = q * arm(i, sigma);
      const Vec3 f = k * (anchors[i] - (xi.head<3>() + r));
      w.head<3>() += f;
      w.tail<3>() += r.cross(f);
    }
    return w;
  }
  double axial(const Vec6& xi, double sigma) const {
    const Eigen::Quaterniond q = rotation(xi.tail<3>());
    const Vec6 w = wrench(xi, sigma);
    return (q * slide.head<3>()).dot(w.head<3>()) + (q * slide.tail<3>()).dot(w.tail<3>());
  }
  Vec6 wrench_after_slide(const Vec6& xi) const {
    if (slide.isZero()) return wrench(xi, 0.0);
    // The secant method: along a straight axis the axial force is affine in σ.
    double before = 0.0, sigma = 1e-3, axial_before = axial(xi, before);
    for (int round = 0; round < 20 && sigma != before; ++round) {
      const double now = axial(xi, sigma);
      if (now == axial_before) break;
      const double next = sigma - now * (sigma - before) / (now - axial_before);
      before = std::exchange(sigma, next);
      axial_before = now;
    }
    return wrench(xi, sigma);
  }

  HapticModel model() const {
    HapticModel result;
    result.epoch = result.sequence = 1;
    result.touching = true;
    Mat6 a = Mat6::Zero();
    Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < arms.size(); ++i) {
      Eigen::Matrix<double, 3, 6> j;
      const Vec3& r = arms[i];
      j << Eigen::Matrix3d::Identity(),
          (Eigen::Matrix3d() << 0, r.z(), -r.y(), -r.z(), 0, r.x(), r.y(), -r.x(), 0).finished();
      a += k * j.transpose() * j;
      moment += r * (k * (anchors[i] - r)).transpose();
    }
    if (!slide.isZero()) {
      const double kappa = slide.dot(a * slide);
      const Vec6 g = a * slide / kappa;
      a = a - a * slide * g.transpose();
      for (int i = 0; i < 6; ++i) {
        result.slide_twist[i] = slide[i];
        result.slide_gradient[i] = g[i];
      }
      result.slide_stiffness = kappa;
    }
    set_matrix(result.bilateral_stiffness, a);
    result.bilateral_wrench = wrench_of(wrench_after_slide(Vec6::Zero()));
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) result.arm_moment_nm[3 * i + j] = moment(i, j);
    return result;
  }
};

enum class Slide { kNone, kStraight, kArc };

SpringTool random_tool(RandomModels& random, Slide slides) {
  SpringTool tool;
  if (slides != Slide::kNone) tool.slide.head<3>() = Vec3(0.36, 0.48, 0.8);
  // A metre along an arc of 8 mm; the tool's origin lies on it.
  if (slides == Slide::kArc) tool.slide.tail<3>() = 125.0 * Vec3(0.8, -0.6, 0.0);
  for (int i = 0; i < 6; ++i) {
    tool.arms.push_back(random.twist(0.01, 0).head<3>());
    tool.anchors.push_back(tool.arms.back() + random.twist(2e-3, 0).head<3>());
  }
  // At the reference the slide has left no axial force.
  if (slides != Slide::kNone) {
    std::vector<Vec3> along;
    double square = 0.0;
    for (const Vec3& arm : tool.arms) {
      along.push_back(tool.slide.head<3>() + tool.slide.tail<3>().cross(arm));
      square += along.back().squaredNorm();
    }
    const double excess_m = tool.axial(Vec6::Zero(), 0.0) / (tool.k * square);
    for (std::size_t i = 0; i < along.size(); ++i) tool.anchors[i] -= excess_m * along[i];
  }
  return tool;
}

double error_at(const SpringTool& tool, const HapticModel& model, const Vec6& xi) {
  const Vec6 error = vector_of(evaluate(model, moved(xi))) - tool.wrench_after_slide(xi);
  return error.head<3>().norm() + error.tail<3>().norm() / 0.01;
}

TEST(HapticModel, CarriesTorqueArmsToSecondOrder) {
  RandomModels random(7);
  for (const Slide slides : {Slide::kNone, Slide::kStraight, Slide::kArc}) {
    for (int trial = 0; trial < 20; ++trial) {
      const SpringTool tool = random_tool(random, slides);
      HapticModel model = tool.model();
      const Vec6 xi = random.twist(5e-4, 0.02);
      // Second order: half the motion, a quarter of the error.
      const double whole = error_at(tool, model, xi), half = error_at(tool, model, xi / 2);
      EXPECT_NEAR(half / whole, 0.25, 0.05) << "slides " << static_cast<int>(slides);
      EXPECT_NEAR(error_at(tool, model, xi / 32) / error_at(tool, model, xi / 16), 0.25, 0.01);
      model.arm_moment_nm = {};
      model.slide_stiffness = 0.0;
      const double bare = error_at(tool, model, xi / 64),
                   bare_half = error_at(tool, model, xi / 128);
      EXPECT_GT(bare_half / bare, 0.4) << "without the arms the error is of first order";
    }
  }
}

TEST(HapticModel, AFarSlideAlongAnArcMovesNothingButTheOrigin) {
  RandomModels random(23);
  for (int trial = 0; trial < 20; ++trial) {
    const SpringTool tool = random_tool(random, Slide::kArc);
    const HapticModel model = tool.model();
    const Vec6 aside = random.twist(5e-4, 0.02);
    const Vec6 near = vector_of(evaluate(model, moved(aside)));
    for (const double slide_m : {-3e-3, 1e-3, 4e-3}) {
      // First along the arc, up to half a radian, then aside: about a point at rest.
      const Vec3 along = way_of(slide_m * tool.slide);
      const Eigen::Quaterniond turn = rotation(aside.tail<3>());
      const Vec3 origin = turn * along + way_of(aside);
      const Pose pose = pose_of(origin, turn * rotation(slide_m * tool.slide.tail<3>()));
      Vec6 far = vector_of(evaluate(model, pose));
      far.tail<3>() += (origin - way_of(aside)).cross(far.head<3>());
      // What is left is of third order.
      EXPECT_LT((far - near).head<3>().norm(), 1e-4 * near.head<3>().norm()) << slide_m;
      EXPECT_LT((far - near).tail<3>().norm(), 1e-3 * near.tail<3>().norm()) << slide_m;
    }
  }
}

/// A needle that slides against a viscous friction, moved to and fro along itself and across: the
/// model at 1 kHz against the equation of motion in steps of 10 µs.
TEST(HapticModel, DragsAtASlidingNeedleAsTheTissueDoes) {
  constexpr std::int64_t kTick_ns = 1'000'000;
  constexpr int kFine = 100;
  RandomModels random(9);
  SpringTool tool = random_tool(random, Slide::kStraight);
  HapticModel model = tool.model();
  // A spring in series with a damper, which gives way within 20 ms: seen well at 1 kHz.
  model.slide_drag_n_s_per_m = 0.02 * model.slide_stiffness;
  const auto motion = [&](double time_s) {
    Vec6 xi = Vec6::Zero();
    xi.head<3>() = 1e-3 * std::sin(2.0 * M_PI * time_s) * tool.slide.head<3>() +
                   2e-4 * std::sin(4.0 * M_PI * time_s) * Vec3::UnitX();
    return xi;
  };
  ModelEvaluator evaluator, without;
  double slid_m = 0.0, error = 0.0, held = 0.0, felt = 0.0;
  for (int tick = 0; tick < 1000; ++tick) {
    const double time_s = 1e-3 * tick;
    const Vec6 xi = motion(time_s);
    const Pose pose = moved(xi);
    for (int i = 1; tick > 0 && i <= kFine; ++i) {
      const Vec6 at = motion(time_s - 1e-3 + 1e-3 * i / kFine);
      slid_m -= 1e-3 / kFine * tool.axial(at, slid_m) / model.slide_drag_n_s_per_m;
    }
    const Vec6 truth = tool.wrench(xi, slid_m);
    error +=
        (vector_of(evaluator.evaluate(model, pose, {}, tick * kTick_ns)) - truth).squaredNorm();
    held += (vector_of(without.evaluate(model, pose)) - truth).squaredNorm();
    felt = std::max(felt, std::abs(tool.axial(xi, slid_m)));
  }
  EXPECT_GT(felt, 0.01) << "there is a friction to be felt";
  // A step of 1 ms of a decay within 20, of first order: 2.5 %.
  EXPECT_LT(std::sqrt(error), 0.04 * std::sqrt(held));
}

/// Whatever the hand does, it gets back at most what the friction had stored at the beginning.
TEST(HapticModel, GivesNothingToAHandThatSlidesANeedleToAndFro) {
  RandomModels random(10);
  SpringTool tool = random_tool(random, Slide::kStraight);
  HapticModel model = tool.model();
  model.slide_friction_n = 0.05;  // is part of the wrench
  for (int i = 0; i < 3; ++i) {
    model.bilateral_wrench.force_n[i] += model.slide_friction_n * model.slide_gradient[i];
    model.bilateral_wrench.torque_nm[i] += model.slide_friction_n * model.slide_gradient[i + 3];
  }
  for (const double time_constant_s : {1e-6, 4e-4, 0.02, 10.0}) {
    model.slide_drag_n_s_per_m = time_constant_s * model.slide_stiffness;
    ModelEvaluator evaluator;
    std::mt19937 dice(11);
    std::normal_distribution<double> normal;
    double place_m = 0.0, work_j = 0.0, most_j = 0.0;
    std::int64_t now_ns = 0;
    for (int i = 0; i < 5000; ++i) {
      const double step_m = i == 0 ? 0.0 : 1e-4 * normal(dice), before_m = place_m;
      place_m = std::clamp(place_m + step_m, -2e-3, 2e-3);
      if (i % 33 == 0) ++model.sequence;  // another model of the same tissue
      Vec6 xi = Vec6::Zero();
      xi.head<3>() = place_m * tool.slide.head<3>();
      const Wrench w = evaluator.evaluate(model, moved(xi), {}, now_ns += 1'000'000);
      work_j += vector_of(w).head<3>().dot(tool.slide.head<3>()) * (place_m - before_m);
      most_j = std::max(most_j, work_j);
    }
    const double stored_j = 0.5 * 0.05 * 0.05 / model.slide_stiffness;
    EXPECT_LE(most_j, stored_j * 1.001) << time_constant_s;
    EXPECT_LT(work_j, 0.0) << time_constant_s;
  }
}

/// One model after the other of the same needle: the friction goes on as it was.
TEST(HapticModel, CarriesTheFrictionFromOneModelToTheNext) {
  RandomModels random(12);
  SpringTool tool = random_tool(random, Slide::kStraight);
  HapticModel model = tool.model();
  model.slide_drag_n_s_per_m = 0.02 * model.slide_stiffness;
  ModelEvaluator evaluator;
  Vec6 xi = Vec6::Zero();
  std::int64_t now_ns = 0;
  for (int i = 0; i < 100; ++i) {
    xi.head<3>() += 2e-5 * tool.slide.head<3>();
    (void)evaluator.evaluate(model, moved(xi), {}, now_ns += 1'000'000);
  }
  const Wrench before = evaluator.evaluate(model, moved(xi), {}, now_ns);
  const double friction_n = vector_of(before).head<3>().dot(tool.slide.head<3>());
  EXPECT_NEAR(friction_n, -0.02 * model.slide_drag_n_s_per_m, 0.05 * std::abs(friction_n));
  HapticModel next = model;
  ++next.sequence;
  next.slide_friction_n = friction_n;
  for (int i = 0; i < 3; ++i)
    next.bilateral_wrench.force_n[i] += friction_n * model.slide_gradient[i];
  for (int i = 0; i < 3; ++i)
    next.bilateral_wrench.torque_nm[i] += friction_n * model.slide_gradient[i + 3];
  const Wrench after = evaluator.evaluate(next, moved(xi), {}, now_ns);
  EXPECT_NEAR((vector_of(after) - vector_of(before)).norm(), 0.0, 1e-6 * vector_of(before).norm());
}

TEST(CompleteModel, GivesTheTangentAndTheRadiusOfTheActiveSet) {
  RandomModels random(8);
  for (int trial = 0; trial < 50; ++trial) {
    HapticModel model = random.make(12);
    ModelEvaluator settled;
    for (int i = 0; i < 20; ++i) (void)settled.evaluate(model, Pose{});
    model.multiplier_n = settled.multipliers_n();
    complete_model(model);
    ASSERT_GT(model.radius_m, 0.0);
    const Mat6 a =
        Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(model.stiffness.data());
    EXPECT_LT((a - a.transpose()).norm(), 1e-9 * a.norm());
    for (int k = 0; k < 20; ++k) {
      Vec6 xi = random.twist(1.0, 1.0);
      const double norm =
          std::max(xi.head<3>().norm(), model.characteristic_length_m * xi.tail<3>().norm());
      xi *= 0.999 * std::min(model.radius_m, 1e-2) / norm;
      const Vec6 affine = vector_of(model.wrench) - a * xi;
      // No row switches within the radius, so the affine model is exact there.
      EXPECT_LT((vector_of(evaluate(model, moved(xi))) - affine).norm(), 1e-9);
    }
  }
}

}  // namespace
}  // namespace suture
