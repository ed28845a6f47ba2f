// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/workspace.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "scene/scene.hpp"

namespace sutured::haptics {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;
using Mat6 = Eigen::Matrix<double, 6, 6>;
using Vec6 = Eigen::Matrix<double, 6, 1>;

scene::Workspace turned() {
  scene::Workspace scene;
  scene.pose.position_m = {0.1, -0.2, 0.3};
  scene.pose.orientation = Eigen::AngleAxisd(0.7, Vector3d(1, 2, -1).normalized());
  scene.motion_scale = 0.2;
  scene.force_scale = 5.0;
  return scene;
}

suture::Pose pose_of(const Vector3d& p, const Vector3d& theta) {
  const double angle = theta.norm();
  const Quaterniond q =
      angle > 0 ? Quaterniond(Eigen::AngleAxisd(angle, theta / angle)) : Quaterniond::Identity();
  return {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
}

Vec6 vector_of(const suture::Wrench& w) {
  Vec6 v;
  v << w.force_n[0], w.force_n[1], w.force_n[2], w.torque_nm[0], w.torque_nm[1], w.torque_nm[2];
  return v;
}

TEST(Workspace, ScalesMotionAndTurnsTheToolWithTheHand) {
  const scene::Workspace scene = turned();
  const Workspace workspace(scene);
  const suture::Pose pose = workspace.to_world(pose_of({0.01, 0.02, 0.03}, {0.0, 0.5, 0.0}));
  const Vector3d expected =
      scene.pose.position_m + 0.2 * (scene.pose.orientation * Vector3d(0.01, 0.02, 0.03));
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(pose.position_m[i], expected[i], 1e-15);
  const Quaterniond q =
      scene.pose.orientation * Quaterniond(Eigen::AngleAxisd(0.5, Vector3d::UnitY()));
  EXPECT_NEAR(std::abs(q.x() * pose.orientation_xyzw[0] + q.y() * pose.orientation_xyzw[1] +
                       q.z() * pose.orientation_xyzw[2] + q.w() * pose.orientation_xyzw[3]),
              1.0, 1e-14);
}

TEST(Workspace, EngagesWhereTheToolIs) {
  Workspace workspace(turned());
  const suture::Pose tool = pose_of({0.4, 0.5, 0.6}, {0.3, -0.2, 0.9});
  const suture::Pose hand = pose_of({-0.05, 0.01, 0.02}, {-1.0, 0.2, 0.1});
  workspace.engage(hand, tool);
  const suture::Twist gap = suture::motion_between(tool, workspace.to_world(hand));
  for (const double component : gap) EXPECT_NEAR(component, 0.0, 1e-12);
  workspace.reset();
  EXPECT_GT(std::abs(workspace.to_world(hand).position_m[0] - 0.4), 0.1);
}

// The stiffness that the hand feels must be symmetric where the tissue's is: only then
// is the work on every closed loop zero.
TEST(Workspace, KeepsTheHandsStiffnessSymmetric) {
  const Workspace workspace(turned());
  Mat6 stiffness;  // symmetric, coupling translation and rotation
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j)
      stiffness(i, j) = 10.0 / (1 + std::abs(i - j)) * (i < 3 ? 1 : 0.1) * (j < 3 ? 1 : 0.1);
  const auto felt = [&](const Vec6& hand) {
    const suture::Twist xi =
        suture::motion_between(workspace.to_world(suture::Pose{}),
                               workspace.to_world(pose_of(hand.head<3>(), hand.tail<3>())));
    const Vec6 w = -stiffness * Eigen::Map<const Vec6>(xi.data());
    return vector_of(workspace.to_device({{w[0], w[1], w[2]}, {w[3], w[4], w[5]}}));
  };
  Mat6 hand_stiffness;
  constexpr double kStep = 1e-6;
  for (int k = 0; k < 6; ++k) hand_stiffness.col(k) = -felt(Vec6::Unit(k) * kStep) / kStep;
  EXPECT_GT(hand_stiffness.norm(), 1.0);
  EXPECT_LT((hand_stiffness - hand_stiffness.transpose()).norm(), 1e-5 * hand_stiffness.norm());
}

}  // namespace
}  // namespace sutured::haptics
