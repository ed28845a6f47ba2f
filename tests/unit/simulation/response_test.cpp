// SPDX-License-Identifier: GPL-3.0-or-later
// What a step says about the next one: of other tools, of friction, of more rows than it holds.
#include <gtest/gtest.h>

#include <cmath>

#include "support/closure_scene.hpp"
#include "support/hands.hpp"

namespace sutured::simulation {
namespace {

using geometry::Vec3;
using testing::Hands;
using testing::kAssistant;
using testing::kDriver;

const ToolCoupling* coupling(const ToolResponse& response, int tool) {
  for (int k = 0; k < response.other_count; ++k)
    if (response.others[static_cast<std::size_t>(k)].tool == tool)
      return &response.others[static_cast<std::size_t>(k)];
  return nullptr;
}

/// The driver's needle 6 mm deep in the block, sideways under load; the assistant has a fold of its
/// top, 4 mm away, lifted by 0.3 mm.
void take_needle_and_fold(Hands& hands) {
  const Vec3 tail(0.0011, 0.0007, 0.0255);
  hands.grasp(kDriver, tail);
  hands.move(kDriver, tail - Vec3(0, 0, 0.006));
  hands.move(kDriver, tail - Vec3(0.0004, 0, 0.006));
  hands.grasp(kAssistant, Vec3(-0.003, 0.0005, 0.0));
  ASSERT_EQ(hands.response(kAssistant).held.kind, HeldKind::kTissue);
  hands.move_by(kAssistant, Vec3(0, 0, 3e-4));
  hands.step(50);
}

TEST(Response, ForeseesWhatTheMotionOfAnotherToolDoes) {
  for (const Vec3& motion : {Vec3(2e-5, 0, 0), Vec3(0, 2e-5, 0), Vec3(2e-5, -1e-5, 0)}) {
    Hands hands(testing::block_scene());
    take_needle_and_fold(hands);
    const ToolResponse before = hands.response(kDriver);
    const ToolCoupling* const other = coupling(before, kAssistant);
    ASSERT_NE(other, nullptr);
    // What a step does when nobody moves is not the motion's doing.
    Hands still(testing::block_scene());
    take_needle_and_fold(still);
    still.step();
    hands.at(kAssistant).position_m += motion;
    hands.step();
    const Vec6 change = hands.response(kDriver).wrench - still.response(kDriver).wrench;
    const Vec6 foreseen = -(other->stiffness * (Vec6() << motion, Vec3::Zero()).finished());
    ASSERT_GT(change.head<3>().norm(), 1e-5);
    // The step slides with viscous friction, the response at constant friction: what is sideways to
    // the needle moves it little along itself.
    EXPECT_LT((foreseen - change).head<3>().norm(), 0.05 * change.head<3>().norm())
        << motion.transpose();
  }
}

TEST(Response, IsReciprocalBetweenTwoTools) {
  Hands hands(testing::block_scene());
  take_needle_and_fold(hands);
  const ToolCoupling* const there = coupling(hands.response(kDriver), kAssistant);
  const ToolCoupling* const back = coupling(hands.response(kAssistant), kDriver);
  ASSERT_NE(there, nullptr);
  ASSERT_NE(back, nullptr);
  EXPECT_GT(there->stiffness.norm(), 1.0);
  EXPECT_LT((there->stiffness - back->stiffness.transpose()).norm(),
            1e-9 * there->stiffness.norm());
  EXPECT_EQ(there->reference.position_m, hands.at(kAssistant).position_m);
}

TEST(Response, KnowsNoCouplingOfAToolThatTouchesNothing) {
  Hands hands(testing::block_scene());
  hands.at(kAssistant) = testing::tool_at(Vec3(0, 0, 0.02));
  hands.grasp(kDriver, Vec3(0.0011, 0.0007, 0.0255));
  EXPECT_EQ(hands.response(kDriver).other_count, 0);
  EXPECT_EQ(hands.response(kAssistant).other_count, 0);
}

TEST(Response, KeepsRowsInForceWhereThereAreMoreThanItHolds) {
  // Two vessels pulled together by a thread in the driver's hand: contact all along the rims.
  Hands hands(testing::hand_sewn_scene(8));
  hands.step();
  hands.grasp(0, hands.thread().punctures.front().position_m);
  ASSERT_EQ(hands.response(0).held.kind, HeldKind::kThread);
  hands.move_by(0, Vec3(0.024, 0, 0), 0.05);
  hands.step(30);
  const ToolResponse before = hands.response(0);
  ASSERT_GT(before.condensed.frozen_rows, 0);
  const Vec3 motion(3e-5, 0, 0);
  hands.at(0).position_m += motion;
  hands.step();
  const Vec3 change = hands.force_n(0) - before.wrench.head<3>();
  const Vec3 foreseen = -(before.stiffness * (Vec6() << motion, Vec3::Zero()).finished()).head<3>();
  ASSERT_GT(change.norm(), 1e-4);
  EXPECT_LT((foreseen - change).norm(), 0.05 * change.norm());
}

/// A tip that stands on the surface lets go sideways at its cone, in the model as in the step.
TEST(Response, LetsTheTipSlipAtItsFrictionCone) {
  scene::Scene scene = testing::block_scene();
  scene.tissues[0].puncture_force_n = 10.0;  // never
  Hands hands(scene);
  const Vec3 tail(0.0011, 0.0007, 0.0255);
  hands.grasp(kDriver, tail);
  hands.move(kDriver, tail - Vec3(0, 0, 0.001));
  hands.step(10);
  const CondensedProblem& problem = hands.response(kDriver).condensed;
  const double pressed = hands.force_n(kDriver)[2];
  ASSERT_GT(pressed, 0.02);
  const double cone = scene.tissues[0].surface_friction_coefficient * pressed;
  int bounded = 0;
  for (Eigen::Index i = 0; i < problem.multiplier_max_n.size(); ++i) {
    if (std::abs(problem.multiplier_max_n[i] - 2.0 * cone) >= 0.05 * cone) {
      EXPECT_EQ(problem.bound_slope[i], 0.0);
      continue;
    }
    ++bounded;
    EXPECT_EQ(problem.bound_slope[i], scene.tissues[0].surface_friction_coefficient);
    EXPECT_NEAR(problem.multiplier_n[problem.bound_row[static_cast<std::size_t>(i)]], pressed,
                0.05 * pressed);
  }
  EXPECT_EQ(bounded, 2);  // two directions, each from −cone to cone
}

}  // namespace
}  // namespace sutured::simulation
