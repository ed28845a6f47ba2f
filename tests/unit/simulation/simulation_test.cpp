// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/simulation.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <functional>
#include <limits>
#include <random>
#include <stdexcept>

#include "fem/stiffness.hpp"
#include "scene/scene_error.hpp"
#include "simulation/tissue_state.hpp"
#include "support/block_scene.hpp"

namespace sutured::simulation {
namespace {

using geometry::Vec3;
using testing::kAssistant;
using testing::kBlockTools;
using testing::kDriver;
using testing::kProbe;
using testing::tool_at;

constexpr double kStep_s = 0.004;
const Vec3 kTail(0.0011, 0.0007, 0.0205);  // where the driver holds the needle: 5 mm from its tail

class BlockSimulation : public ::testing::Test {
 protected:
  explicit BlockSimulation(scene::Scene s = testing::block_scene())
      : scene(std::move(s)), sim(scene) {}

  void step(int count = 1) {
    for (int i = 0; i < count; ++i) {
      sim.step(inputs, kStep_s);
      events.insert(events.end(), sim.events().begin(), sim.events().end());
    }
  }
  /// Moves a tool in a straight line at `speed_m_per_s`.
  void move(int tool, const Vec3& to, double speed_m_per_s = 0.01) {
    const Vec3 from = inputs[at(tool)].position_m;
    const int count =
        std::max(1, static_cast<int>(std::ceil((to - from).norm() / (speed_m_per_s * kStep_s))));
    for (int i = 1; i <= count; ++i) {
      inputs[at(tool)].position_m = from + (to - from) * i / count;
      step();
    }
  }
  void grasp(int tool, const Vec3& point) {
    inputs[at(tool)] = tool_at(point, 0.0);
    step();
    inputs[at(tool)].jaw = 1.0;
    step();
  }
  [[nodiscard]] int count(EventKind kind) const {
    return static_cast<int>(std::count_if(events.begin(), events.end(),
                                          [&](const Event& e) { return e.kind == kind; }));
  }
  [[nodiscard]] const Event& last(EventKind kind) const {
    return *std::find_if(events.rbegin(), events.rend(),
                         [&](const Event& e) { return e.kind == kind; });
  }
  [[nodiscard]] Vec6 wrench(int tool) const { return sim.responses()[at(tool)].wrench; }
  static std::size_t at(int i) { return static_cast<std::size_t>(i); }

  /// The sum of what the fixed vertices carry, N: minus all that the constraints put on the tissue.
  [[nodiscard]] Vec3 reaction() {
    sim.update_displacements();
    const fem::Model model = assemble_model(scene);
    std::vector<double> u(3 * model.vertices_m.size());
    for (std::size_t v = 0; v < model.vertices_m.size(); ++v)
      for (std::size_t i = 0; i < 3; ++i)
        u[3 * v + i] = sim.positions_m()[v][static_cast<Eigen::Index>(i)] -
                       model.vertices_m[v][static_cast<Eigen::Index>(i)];
    const auto internal = fem::internal_forces_n(model, u);
    Vec3 sum = Vec3::Zero();
    for (std::size_t dof = 0; dof < internal.size(); ++dof)
      if (model.prescribed[dof]) sum[static_cast<Eigen::Index>(dof % 3)] += internal[dof];
    return sum;
  }

  scene::Scene scene;
  Simulation sim;
  std::vector<ToolInput> inputs = std::vector<ToolInput>(kBlockTools);
  std::vector<Event> events;
};

TEST_F(BlockSimulation, NothingIsFeltWhereNothingIsTouched) {
  inputs[kDriver] = tool_at(Vec3(0.005, 0.005, 0.01), 0.0);
  inputs[kProbe] = tool_at(Vec3(-0.005, 0, 0.01));
  step(5);
  for (int tool = 0; tool < kBlockTools; ++tool) {
    EXPECT_EQ(wrench(tool).norm(), 0.0);
    EXPECT_FALSE(sim.responses()[at(tool)].touching);
  }
  EXPECT_EQ(reaction().norm(), 0.0);
}

TEST_F(BlockSimulation, AResponseSaysWhatTheJawHolds) {
  step();
  for (int tool = 0; tool < kBlockTools; ++tool)
    EXPECT_EQ(sim.responses()[at(tool)].held.kind, HeldKind::kNothing);
  grasp(kDriver, kTail);
  grasp(kAssistant, Vec3(-0.005, -0.005, 0.0));  // a point of the surface
  EXPECT_EQ(sim.responses()[kDriver].held.kind, HeldKind::kNeedle);
  EXPECT_EQ(sim.responses()[kDriver].held.index, 0);
  EXPECT_EQ(sim.responses()[kAssistant].held.kind, HeldKind::kTissue);
  EXPECT_EQ(sim.responses()[kAssistant].held.index, 0);
  inputs[kAssistant].jaw = 0.0;
  step();
  EXPECT_EQ(sim.responses()[kAssistant].held.kind, HeldKind::kNothing);
}

TEST_F(BlockSimulation, AProbeIsPushedBackAndNeverPulled) {
  inputs[kProbe] = tool_at(Vec3(0.0031, 0.0013, 0.004));
  step();
  double peak = 0.0;
  const auto follow = [&](double from_mm, double to_mm) {
    for (int i = 0; i <= 100; ++i) {
      inputs[kProbe].position_m[2] = 1e-3 * (from_mm + (to_mm - from_mm) * i / 100);
      step();
      EXPECT_GE(wrench(kProbe)[2], 0.0);
      peak = std::max(peak, wrench(kProbe)[2]);
      EXPECT_LT((reaction() - wrench(kProbe).head<3>()).norm(), 1e-9 * (1.0 + peak));
    }
  };
  follow(4.0, 1.2);  // the sphere has a radius of 2 mm: 0.8 mm deep
  EXPECT_GT(peak, 0.05);
  follow(1.2, 4.0);
  EXPECT_EQ(wrench(kProbe).norm(), 0.0);
  sim.update_displacements();
  for (std::size_t v = 0; v < sim.positions_m().size(); ++v)
    ASSERT_LT((sim.positions_m()[v] - sim.rest_positions_m()[v]).norm(), 1e-15);
}

TEST_F(BlockSimulation, TheNeedlePuncturesAtThePunctureForce) {
  grasp(kDriver, kTail);
  ASSERT_EQ(count(EventKind::kGrasp), 1);
  EXPECT_LT(wrench(kDriver).norm(), 1e-12);  // a grasp starts without force
  double before = 0.0;
  while (count(EventKind::kPuncture) == 0 && inputs[kDriver].position_m[2] > 0.01) {
    before = wrench(kDriver)[2];
    move(kDriver, inputs[kDriver].position_m - Vec3(0, 0, 4e-5));
  }
  ASSERT_EQ(count(EventKind::kPuncture), 1);
  const double threshold = scene.tissues[0].puncture_force_n;
  EXPECT_NEAR(last(EventKind::kPuncture).force_n, threshold, 1e-3);
  EXPECT_NEAR(before, threshold, 2e-3);  // straight down: all of it reaches the hand
  EXPECT_EQ(count(EventKind::kContact), 1);
  step(10);  // the wall slides back over the needle
  EXPECT_LT(wrench(kDriver).head<3>().norm(), 0.3 * threshold);
  EXPECT_TRUE(sim.needles()[0].tip_inside);
  EXPECT_GT(sim.needles()[0].embedded_length_m, 5e-5);  // about what it was indented by
}

TEST_F(BlockSimulation, ANeedlePulledBackLeavesTheTissueAtRest) {
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.005));
  ASSERT_TRUE(sim.needles()[0].tip_inside);
  EXPECT_GT(sim.needles()[0].embedded_length_m, 0.003);
  move(kDriver, kTail);
  EXPECT_FALSE(sim.needles()[0].tip_inside);
  EXPECT_EQ(sim.needles()[0].active_cells, 0);
  EXPECT_EQ(count(EventKind::kExit), 1);
  step(3);
  EXPECT_LT(reaction().norm(), 1e-12);
  EXPECT_LT(wrench(kDriver).norm(), 1e-9);
}

TEST_F(BlockSimulation, APunctureIsWhereTheNeedlePassesTheDeformedSurface) {
  // Fixed at two sides instead of below, so that the needle gets through.
  scene.tissues[0].prescribed[0].vertices.clear();
  for (std::size_t v = 0; v < scene.tissues[0].mesh.vertices_m.size(); ++v)
    if (std::abs(scene.tissues[0].mesh.vertices_m[v][0]) > 0.01 - 1e-9)
      scene.tissues[0].prescribed[0].vertices.push_back(static_cast<std::int32_t>(v));
  sim = Simulation(scene);
  const auto punctures = [this]() -> const std::vector<NeedlePuncture>& {
    sim.update_displacements();
    return sim.needles()[0].punctures;
  };
  /// How far a point is from the surface that is shown.
  const auto off_surface_m = [this](const Vec3& p) {
    double least = std::numeric_limits<double>::infinity();
    const auto x = sim.positions_m();
    for (const auto& t : sim.bodies()[0].surface)
      least = std::min(least, std::sqrt(geometry::closest_point_on_triangle(
                                            p, x[at(t[0])], x[at(t[1])], x[at(t[2])])
                                            .squared_distance_m2));
    return least;
  };
  EXPECT_TRUE(punctures().empty());
  grasp(kDriver, kTail);
  while (count(EventKind::kContact) == 0)
    move(kDriver, inputs[kDriver].position_m - Vec3(0, 0, 4e-5));
  EXPECT_TRUE(punctures().empty()) << "the tip stands on the wall";

  move(kDriver, kTail - Vec3(0, 0, 0.006));
  move(kDriver, kTail - Vec3(-0.0005, 0, 0.006));
  ASSERT_EQ(count(EventKind::kPuncture), 1);
  ASSERT_EQ(punctures().size(), 1U);
  const NeedlePuncture entry = punctures()[0];
  EXPECT_EQ(entry.tissue, 0);
  EXPECT_FALSE(entry.inward);  // from tip to tail it leads out
  EXPECT_LT(off_surface_m(entry.position_m), 1e-6);
  EXPECT_GT(entry.position_m[0] - 0.0011, 5e-5) << "the needle has taken its hole along";
  EXPECT_NEAR(entry.arc_length_m, sim.needles()[0].embedded_length_m, 1e-6);

  move(kDriver, kTail - Vec3(0, 0, 0.014));
  ASSERT_EQ(count(EventKind::kExit), 1);
  ASSERT_EQ(punctures().size(), 2U);
  for (const NeedlePuncture& each : punctures()) EXPECT_LT(off_surface_m(each.position_m), 1e-6);
  const NeedlePuncture &out = punctures()[0], &in = punctures()[1];  // from tip to tail
  EXPECT_TRUE(out.inward);
  EXPECT_FALSE(in.inward);
  EXPECT_NEAR(out.position_m[2], -0.01, 1e-3);
  EXPECT_NEAR(in.position_m[2], 0.0, 1e-3);
  EXPECT_GT(out.arc_length_m, 1e-3);
  EXPECT_NEAR(in.arc_length_m - out.arc_length_m, sim.needles()[0].embedded_length_m, 1e-6);

  move(kDriver, kTail);
  EXPECT_TRUE(punctures().empty());
  move(kDriver, kTail - Vec3(0, 0, 0.006));
  sim.reset();
  EXPECT_TRUE(punctures().empty());
}

TEST_F(BlockSimulation, WhatTheHandFeelsIsWhatTheTissueCarries) {
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.006));
  move(kDriver, kTail - Vec3(0.0007, -0.0004, 0.006));
  step(200);  // until the weak spring to the needle's last pose has let go
  const Vec3 carried = reaction(), felt = wrench(kDriver).head<3>();
  EXPECT_GT(felt.norm(), 0.02);
  EXPECT_LT((carried - felt).norm(), 1e-6 * felt.norm());
}

/// The response's stiffness against a second solve after a small motion. The step slides with
/// viscous friction, the response at constant friction: sideways both hold the needle.
TEST_F(BlockSimulation, TheResponsePredictsTheNextStep) {
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.006));
  move(kDriver, kTail - Vec3(0.0004, 0, 0.006));
  step(50);
  const ToolResponse response = sim.responses()[kDriver];
  EXPECT_LT((response.stiffness - response.stiffness.transpose()).norm(),
            1e-9 * response.stiffness.norm());
  EXPECT_GT(Eigen::SelfAdjointEigenSolver<Mat6>(response.stiffness).eigenvalues()[0],
            -1e-9 * response.stiffness.norm());
  Vec6 xi = Vec6::Zero();
  xi[0] = 2e-5;
  xi[1] = -1e-5;
  inputs[kDriver].position_m += xi.head<3>();
  step();
  const Vec6 predicted = response.wrench - response.stiffness * xi;
  const Vec6 change = wrench(kDriver) - response.wrench;
  EXPECT_GT(change.head<3>().norm(), 1e-4);
  EXPECT_LT((predicted - wrench(kDriver)).head<3>().norm(), 0.02 * change.head<3>().norm());
  EXPECT_LT((predicted - wrench(kDriver)).tail<3>().norm(), 0.02 * change.tail<3>().norm());
}

TEST_F(BlockSimulation, ASlideAlongTheNeedleIsNotFelt) {
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.006));
  step(20);
  const ToolResponse& response = sim.responses()[kDriver];
  ASSERT_GT(response.slide_stiffness, 0.0);
  EXPECT_LT((response.slide_twist.head<3>() + Vec3::UnitZ()).norm(), 1e-3);
  // What remains is the weak spring to the needle's last pose, 0.05 N/m.
  EXPECT_LT((response.stiffness * response.slide_twist).norm(), 0.06);
}

TEST_F(BlockSimulation, FrictionAlongTheNeedleIsViscous) {
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.005));
  const auto friction_at = [&](double speed) {
    move(kDriver, inputs[kDriver].position_m - Vec3(0, 0, 0.0008), speed);
    return wrench(kDriver)[2] /
           (scene.tissues[0].friction_n_s_per_m2 * sim.needles()[0].embedded_length_m * speed);
  };
  EXPECT_NEAR(friction_at(0.01), 1.0, 0.1);
  EXPECT_NEAR(friction_at(0.005), 1.0, 0.1);
}

TEST_F(BlockSimulation, WithoutFrictionTheNeedleSlidesWithoutForce) {
  scene.tissues[0].friction_n_s_per_m2 = 0.0;
  sim = Simulation(scene);
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.006));
  EXPECT_EQ(count(EventKind::kPuncture), 1);
  EXPECT_EQ(count(EventKind::kExit), 0);
  EXPECT_GT(sim.needles()[0].embedded_length_m, 0.004);
  EXPECT_LT(std::abs(wrench(kDriver)[2]), 1e-4);
  EXPECT_LT(sim.report().complementarity_residual, 1e-8);
}

/// Beyond the friction cone the tip slides over the surface; within it, it stands.
TEST_F(BlockSimulation, TheTipStandsWithinTheFrictionConeAndSlidesBeyond) {
  scene.tissues[0].puncture_force_n = 10.0;  // never
  sim = Simulation(scene);
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.001));  // presses 0.5 mm deep
  const double pressed = wrench(kDriver)[2];
  ASSERT_GT(pressed, 0.02);
  move(kDriver, inputs[kDriver].position_m + Vec3(5e-5, 0, 0));
  const double stands = -wrench(kDriver)[0];
  EXPECT_GT(stands, 1e-4);
  EXPECT_LT(stands, 0.5 * pressed);
  move(kDriver, inputs[kDriver].position_m + Vec3(0.004, 0, 0));
  const Vec6 slides = wrench(kDriver);
  const double tangential = slides.head<2>().norm(), normal = slides[2];
  EXPECT_GT(normal, 0.01);
  // The cone's bound is that of the solve before; the surface is dented, so its normal leans a
  // little.
  EXPECT_NEAR(tangential / normal, scene.tissues[0].surface_friction_coefficient, 0.1);
  EXPECT_EQ(count(EventKind::kPuncture), 0);
  move(kDriver, kTail + Vec3(0.004, 0, 0.002));
  EXPECT_LT(wrench(kDriver).norm(),
            1e-5);  // let go when drawn back, but for the weak spring in motion
}

TEST_F(BlockSimulation, AnObliqueNeedlePuncturesToo) {
  const Vec3 along = Vec3(0.7, 0.1, -0.7).normalized();
  scene.needles[0].pose.orientation = Eigen::Quaterniond::FromTwoVectors(Vec3::UnitX(), along);
  scene.needles[0].pose.position_m = Vec3(-0.003, 0, 0.0005) - 0.025 * along;
  sim = Simulation(scene);
  const Vec3 grip = Vec3(-0.003, 0, 0.0005) - 0.02 * along;
  grasp(kDriver, grip);
  move(kDriver, grip + 0.006 * along);
  EXPECT_EQ(count(EventKind::kPuncture), 1);
  EXPECT_TRUE(sim.needles()[0].tip_inside);
  EXPECT_GT(sim.needles()[0].embedded_length_m, 0.003);
}

TEST_F(BlockSimulation, TheNeedleGoesThroughOneBodyAndIntoTheNext) {
  scene::Tissue below = scene.tissues[0];
  below.name = "below";
  for (Vec3& x : below.mesh.vertices_m) x -= Vec3(0, 0, 0.0106);
  scene.tissues[0].prescribed[0].vertices.clear();
  for (std::size_t v = 0; v < scene.tissues[0].mesh.vertices_m.size(); ++v)
    if (std::abs(scene.tissues[0].mesh.vertices_m[v][0]) > 0.01 - 1e-9)
      scene.tissues[0].prescribed[0].vertices.push_back(static_cast<std::int32_t>(v));
  scene.tissues.push_back(below);
  sim = Simulation(scene);
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.018), 0.02);
  ASSERT_EQ(count(EventKind::kPuncture), 2);
  EXPECT_EQ(last(EventKind::kPuncture).object, "below");
  EXPECT_EQ(last(EventKind::kExit).object, "block");
  EXPECT_TRUE(sim.needles()[0].tip_inside);
  EXPECT_GT(sim.needles()[0].embedded_length_m, 0.014);
  move(kDriver, kTail, 0.02);
  EXPECT_EQ(sim.needles()[0].active_cells, 0);
  step(5);
  EXPECT_LT(wrench(kDriver).norm(), 1e-9);
}

TEST_F(BlockSimulation, AFreeNeedleStaysWhereItIs) {
  const Vec3 before = sim.needles()[0].position_m;
  step(100);
  EXPECT_EQ((sim.needles()[0].position_m - before).norm(), 0.0);
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0.0, 0.0, 0.006));
  inputs[kDriver].jaw = 0.0;
  step(300);
  const Vec3 resting = sim.needles()[0].position_m;
  step(100);
  EXPECT_LT((sim.needles()[0].position_m - resting).norm(), 1e-6);
  EXPECT_TRUE(sim.needles()[0].tip_inside);
  EXPECT_EQ(sim.needles()[0].holder, -1);
}

TEST_F(BlockSimulation, TwoDriversHandTheNeedleOver) {
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.005));
  grasp(kAssistant, kTail - Vec3(0, 0, 0.01));
  EXPECT_EQ(count(EventKind::kGrasp), 2);
  // Each pulls its own way: the forces oppose, and the tissue carries the rest.
  move(kAssistant, inputs[kAssistant].position_m + Vec3(0.0002, 0, 0));
  step(100);
  EXPECT_LT(wrench(kAssistant)[0], -0.005);
  EXPECT_GT(wrench(kDriver)[0], 0.0);
  const Vec3 both = wrench(kDriver).head<3>() + wrench(kAssistant).head<3>();
  EXPECT_LT((reaction() - both).norm(), 1e-4 * wrench(kAssistant).norm());
  inputs[kDriver].jaw = 0.0;
  step(2);
  EXPECT_EQ(wrench(kDriver).norm(), 0.0);
  EXPECT_EQ(sim.needles()[0].holder, kAssistant);
  move(kAssistant, inputs[kAssistant].position_m + Vec3(0, 0, 0.008));
  EXPECT_FALSE(sim.needles()[0].tip_inside);  // pulled out by the other hand
}

TEST_F(BlockSimulation, AGripOnTissueSlipsAtItsLimit) {
  scene.tools[kDriver].grip_force_max_n = 0.3;
  sim = Simulation(scene);
  grasp(kDriver, Vec3(0.004, 0.003, 0.0002));
  ASSERT_EQ(count(EventKind::kGrasp), 1);
  EXPECT_EQ(last(EventKind::kGrasp).object, "block");
  double peak = 0.0;
  for (int i = 0; i < 150; ++i) {
    inputs[kDriver].position_m[2] += 1e-4;
    step();
    peak = std::max(peak, wrench(kDriver).head<3>().norm());
    EXPECT_LT((reaction() - wrench(kDriver).head<3>()).norm(), 1e-9);
  }
  EXPECT_NEAR(peak, 0.3, 0.003);
  EXPECT_LT(wrench(kDriver)[2], 0.0);
  EXPECT_EQ(count(EventKind::kGripSlip), 1);
  inputs[kDriver].jaw = 0.0;
  step(2);
  EXPECT_EQ(reaction().norm(), 0.0);
}

TEST_F(BlockSimulation, AToolBeyondTheWorldIsRefusedAndChangesNothing) {
  grasp(kAssistant, sim.positions_m()[0]);
  sim.update_displacements();
  const std::vector<Vec3> before(sim.positions_m().begin(), sim.positions_m().end());
  const double time_s = sim.time_s();
  for (const double x : {1e7, 1e308, std::numeric_limits<double>::quiet_NaN()}) {
    std::vector<ToolInput> away(inputs.begin(), inputs.end());
    away[at(kAssistant)].position_m[0] = x;
    EXPECT_THROW(sim.step(away, kStep_s), std::invalid_argument);
    away[at(kAssistant)].present = false;  // where it is not, it may be anywhere
    EXPECT_NO_THROW(Simulation(scene).step(away, kStep_s));
  }
  sim.update_displacements();
  EXPECT_EQ(sim.time_s(), time_s);
  EXPECT_TRUE(std::equal(before.begin(), before.end(), sim.positions_m().begin()));
}

TEST_F(BlockSimulation, ASolveThatIsNoNumberGivesNoForceAndIsTold) {
  // As no file may say it.
  scene.tools[at(kAssistant)].grip_stiffness_n_per_m = std::numeric_limits<double>::quiet_NaN();
  Simulation weak(scene);
  inputs[at(kAssistant)] = tool_at(weak.positions_m()[0], 0.0);
  weak.step(inputs, kStep_s);
  inputs[at(kAssistant)].jaw = 1.0;
  weak.step(inputs, kStep_s);
  EXPECT_EQ(weak.report().complementarity_residual, std::numeric_limits<double>::infinity());
  EXPECT_TRUE(std::any_of(weak.events().begin(), weak.events().end(),
                          [](const Event& e) { return e.kind == EventKind::kSolverResidual; }));
  weak.update_displacements();
  EXPECT_TRUE(
      std::equal(weak.positions_m().begin(), weak.positions_m().end(), sim.positions_m().begin()));
}

TEST_F(BlockSimulation, AnAbsentToolLetsGo) {
  grasp(kDriver, kTail);
  inputs[kDriver].present = false;
  step();
  EXPECT_EQ(count(EventKind::kRelease), 1);
  EXPECT_EQ(sim.needles()[0].holder, -1);
  EXPECT_EQ(wrench(kDriver).norm(), 0.0);
}

TEST_F(BlockSimulation, ResetAndRepeatGiveTheSameBits) {
  const auto play = [&] {
    inputs.assign(kBlockTools, {});
    grasp(kDriver, kTail);
    move(kDriver, kTail - Vec3(0.0003, 0.0002, 0.006), 0.02);
    sim.update_displacements();
    return std::pair(wrench(kDriver),
                     std::vector<Vec3>(sim.positions_m().begin(), sim.positions_m().end()));
  };
  const auto first = play();
  sim.reset();
  EXPECT_EQ(sim.time_s(), 0.0);
  const auto second = play();
  EXPECT_GT(first.first.norm(), 1e-3);
  EXPECT_EQ(first.first, second.first);
  EXPECT_EQ(first.second, second.second);
}

TEST_F(BlockSimulation, ShowingTheTissueDoesNotChangeIt) {
  Simulation shown(scene);
  std::vector<ToolInput> probe(kBlockTools);
  probe[kProbe] = tool_at(Vec3(0.001, 0.002, 0.0015));
  for (int i = 0; i < 20; ++i) {
    probe[kProbe].position_m[0] += 5e-5;
    sim.step(probe, kStep_s);
    shown.step(probe, kStep_s);
    if (i % 3 == 0) shown.update_displacements();
    EXPECT_EQ(sim.responses()[kProbe].wrench, shown.responses()[kProbe].wrench);
  }
}

/// What happens while displacements are brought up is told by the next step as without it.
TEST_F(BlockSimulation, ShowingTheTissueDoesNotHideWhatChanged) {
  Simulation shown(scene);
  int changes = 0;
  inputs[kDriver] = tool_at(kTail, 0.0);
  for (int i = 0; i < 60; ++i) {
    if (i == 1) inputs[kDriver].jaw = 1.0;
    if (i > 2) inputs[kDriver].position_m[2] -= 1e-4;
    sim.step(inputs, kStep_s);
    shown.step(inputs, kStep_s);
    shown.update_displacements();
    EXPECT_EQ(sim.responses()[kDriver].world_changed, shown.responses()[kDriver].world_changed)
        << "step " << i;
    changes += sim.responses()[kDriver].world_changed;
  }
  EXPECT_TRUE(sim.needles()[0].tip_inside);
  EXPECT_GE(changes, 3);  // grasped, touched, in
}

/// Notes of every step whether the responses told of a change, and what happened in it.
class WorldChanges : public BlockSimulation {
 protected:
  struct Step {
    std::array<bool, kBlockTools> changed{}, touching{};
    std::vector<EventKind> told;
    [[nodiscard]] bool tells(EventKind kind) const {
      return std::find(told.begin(), told.end(), kind) != told.end();
    }
  };
  /// Moves a tool within `count` steps; a jaw that is not `jaw` moves in the first.
  void play(int tool, const Vec3& to, int count, double jaw) {
    const Vec3 from = inputs[at(tool)].position_m;
    inputs[at(tool)].jaw = jaw;
    for (int i = 1; i <= count; ++i) {
      inputs[at(tool)].position_m = from + (to - from) * i / count;
      step();
      Step& now = steps.emplace_back();
      for (std::size_t t = 0; t < kBlockTools; ++t) {
        now.changed[t] = sim.responses()[t].world_changed;
        now.touching[t] = sim.responses()[t].touching;
      }
      for (const Event& event : sim.events()) now.told.push_back(event.kind);
    }
  }

  std::vector<Step> steps;
};

TEST_F(WorldChanges, AreToldInTheStepsOfAProbesFirstContactAndOfItsLoss) {
  const Vec3 above(-0.0051, -0.0043, 0.004), within(-0.0051, -0.0043, 0.0012);
  inputs[kProbe] = tool_at(above);
  play(kProbe, within, 40, 0.0);
  play(kProbe, within + Vec3(0.001, 0.0005, 0.0), 20, 0.0);  // over edges: no change
  play(kProbe, above, 40, 0.0);
  int changes = 0;
  bool touched = false;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    EXPECT_EQ(steps[i].changed[kProbe], steps[i].touching[kProbe] != touched) << "step " << i;
    EXPECT_FALSE(steps[i].changed[kDriver]) << "step " << i;  // it is the probe's alone
    touched = steps[i].touching[kProbe];
    changes += steps[i].changed[kProbe];
  }
  EXPECT_EQ(changes, 2);
}

/// A jaw's grasp is its own; what happens to the needle is told to every tool.
TEST_F(WorldChanges, AreToldInTheStepsOfANeedlesEvents) {
  inputs[kDriver] = tool_at(kTail, 0.0);
  play(kDriver, kTail, 3, 0.0);
  play(kDriver, kTail, 5, 1.0);                            // grasped
  play(kDriver, kTail - Vec3(0.0, 0.0, 0.006), 100, 1.0);  // touches, and goes in
  play(kDriver, kTail, 100, 1.0);                          // comes out
  play(kDriver, kTail, 5, 0.0);                            // let go
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const bool jaw = steps[i].tells(EventKind::kGrasp) || steps[i].tells(EventKind::kRelease);
    // That the tip begins to press is in the response at once, and an event of the next step.
    const bool needle = steps[i].tells(EventKind::kPuncture) || steps[i].tells(EventKind::kExit) ||
                        (i + 1 < steps.size() && steps[i + 1].tells(EventKind::kContact));
    EXPECT_EQ(steps[i].changed[kDriver], jaw || needle) << "step " << i;
    EXPECT_EQ(steps[i].changed[kAssistant], needle) << "step " << i;
  }
  for (const EventKind kind : {EventKind::kGrasp, EventKind::kContact, EventKind::kPuncture,
                               EventKind::kExit, EventKind::kRelease})
    EXPECT_EQ(count(kind), 1) << "kind " << static_cast<int>(kind);
}

/// The weak spring to a needle's last pose gives way 1e6 rad/(N m): in radians those rows would
/// leave a residual of 1e-8 in rounding alone.
TEST_F(BlockSimulation, TwoHandsThatTwistANeedleAreSolvedToTheLastDigits) {
  scene.needles[0].length_m = 0.008;
  scene.needles[0].pose.position_m[2] = 0.0085;
  sim = Simulation(scene);
  grasp(kDriver, Vec3(0.0011, 0.0007, 0.007));
  grasp(kAssistant, Vec3(0.0011, 0.0007, 0.002));
  double peak_nm = 0.0;
  for (int i = 0; i < 100; ++i) {
    inputs[kAssistant].orientation = Eigen::AngleAxisd(0.004 * i, Vec3(1.0, 0.5, 0.3).normalized());
    step();
    peak_nm = std::max(peak_nm, wrench(kAssistant).tail<3>().norm());
    ASSERT_LT(sim.report().complementarity_residual, 1e-9) << "step " << i;
  }
  EXPECT_GT(peak_nm, 0.04);  // up to the limit of the grips
}

/// Without friction nothing holds a needle that nobody holds, and yet it must not slide at will.
TEST_F(BlockSimulation, AFreeNeedleWithoutFrictionIsSolvedToo) {
  scene.tissues[0].friction_n_s_per_m2 = scene.tissues[0].static_friction_n_per_m = 0.0;
  sim = Simulation(scene);
  grasp(kDriver, kTail);
  move(kDriver, kTail - Vec3(0, 0, 0.006));
  move(kDriver, kTail - Vec3(0.002, 0.001, 0.006));
  inputs[kDriver].jaw = 0.0;
  for (int i = 0; i < 100; ++i) {
    step();
    ASSERT_LT(sim.report().complementarity_residual, 1e-9) << "step " << i;
  }
  EXPECT_LT((sim.needles()[0].position_m - scene.needles[0].pose.position_m).norm(), 0.02);
}

TEST(Simulation, ATissueThatCanMoveFreelyIsRefused) {
  scene::Scene scene = testing::block_scene(2);
  scene.tissues[0].prescribed.clear();
  EXPECT_THROW(Simulation{scene}, scene::SceneError);
}

/// A hand that jumps about, grasps and lets go at random: nothing may break.
class WildHands : public ::testing::TestWithParam<int> {};

TEST_P(WildHands, LeaveEverythingFiniteAndSolved) {
  scene::Scene scene = testing::block_scene(6);
  if (GetParam() % 2 == 1) {
    scene.needles[0].shape = scene::NeedleShape::kArc;
    scene.needles[0].radius_m = 0.006;
    scene.needles[0].pose.position_m = Vec3(0, 0, 0.001);
    scene.needles[0].pose.orientation = Eigen::AngleAxisd(1.5707963, Vec3::UnitX());
  }
  if (GetParam() % 3 == 2) scene.needles[0].slide = scene::SlideRule::kLeastSquares;
  Simulation sim(scene);
  std::mt19937_64 random(static_cast<std::uint64_t>(GetParam()) + 1000);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  std::vector<ToolInput> inputs(kBlockTools);
  for (ToolInput& input : inputs)
    input = tool_at(Vec3(0.002 * uniform(random), 0.002 * uniform(random), 0.006));
  inputs[kDriver] =
      tool_at(GetParam() % 2 == 1 ? Vec3(0, 0, 0.007) : Vec3(0.0011, 0.0007, 0.0155), 1.0);
  int grasps = 0;
  for (int i = 0; i < 300; ++i) {
    const double reach = uniform(random) < 0.95 ? 5e-4 : 1e-2;
    for (ToolInput& input : inputs) {
      input.position_m += reach * Vec3(uniform(random), uniform(random), uniform(random) - 0.15);
      input.position_m = input.position_m.cwiseMax(-0.011).cwiseMin(0.02);
      input.orientation =
          (input.orientation *
           Eigen::AngleAxisd(20 * reach * uniform(random),
                             Vec3(uniform(random), uniform(random), 1).normalized()))
              .normalized();
      if (uniform(random) > 0.95) input.jaw = input.jaw > 0.5 ? 0.0 : 1.0;
      if (uniform(random) > 0.995) input.present = !input.present;
    }
    sim.step(inputs, kStep_s);
    for (const Event& event : sim.events()) grasps += event.kind == EventKind::kGrasp;
    ASSERT_LT(sim.report().complementarity_residual, 1e-8) << "step " << i;
    for (const ToolResponse& response : sim.responses()) {
      ASSERT_TRUE(response.wrench.allFinite());
      ASSERT_TRUE(response.stiffness.allFinite());
    }
    ASSERT_LT(sim.needles()[0].position_m.norm(), 1.0);
  }
  sim.update_displacements();
  for (const Vec3& x : sim.positions_m()) ASSERT_TRUE(x.allFinite());
  EXPECT_GT(grasps, 0);
}

INSTANTIATE_TEST_SUITE_P(Seeds, WildHands, ::testing::Range(0, 24));

}  // namespace
}  // namespace sutured::simulation
