// SPDX-License-Identifier: GPL-3.0-or-later
// Every fault of a device, a network and a simulation, and what the hand is given meanwhile.
#include "haptics/tool_channel.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <thread>
#include <vector>

#include "support/heap_guard.hpp"
#include "tool_rig.hpp"

namespace sutured::haptics {
namespace {

TEST(ToolChannel, StartsFromZeroByARamp) {
  Rig rig;
  rig.run(15);
  EXPECT_EQ(rig.force_n(), 0.0);
  rig.engage();
  EXPECT_LE(rig.largest_step_n, 0.5 * 1.5 / 200 * 1.5 + 1e-9);
}

TEST(ToolChannel, AnswersEachPoseOnceAndInOrder) {
  Rig rig;
  rig.engage();
  for (int i = 0; i < 50; ++i) {
    rig.now += kMs;
    const PoseSample pose = rig.sample();
    const auto force = rig.channel().on_pose(pose, rig.now);
    ASSERT_TRUE(force);
    EXPECT_EQ(force->pose_sequence, pose.sequence);
    EXPECT_EQ(force->pose_stamp_ns, pose.stamp_ns);
    EXPECT_FALSE(force->from_supervisor);
    EXPECT_FALSE(rig.channel().supervise(rig.now + kMs / 2));
  }
}

TEST(ToolChannel, TakesOverFromADeviceThatIsSlowerThanTheSupervisor) {
  Rig rig;
  rig.pose_period_ms = 8;
  rig.engage();
  const std::uint64_t forces = rig.channel().counters().forces.load();
  const std::uint64_t takeovers = rig.channel().counters().takeovers.load();
  rig.run(80);
  // Of 8 ms each: one answer, and the supervisor at 3.5, 4.5, … 7.5 ms.
  EXPECT_EQ(rig.channel().counters().forces.load() - forces, 60U);
  EXPECT_EQ(rig.channel().counters().takeovers.load() - takeovers, 10U);
}

struct PoseFault {
  const char* name;
  Fault fault;
  std::function<void(PoseSample&)> spoil;
};

class BadPose : public ::testing::TestWithParam<PoseFault> {};

TEST_P(BadPose, EndsTheForceSmoothlyAndComesBack) {
  Rig rig;
  rig.engage();
  const std::int64_t last_good_ns = rig.now;
  rig.spoil = GetParam().spoil;
  rig.run(100);
  rig.expect_zero_since(last_good_ns);
  EXPECT_EQ(rig.last.state, ToolState::kFault);
  EXPECT_NE(rig.last.faults & fault_bit(GetParam().fault), 0U);
  EXPECT_GE(rig.faults(GetParam().fault), 1U);
  rig.spoil = nullptr;
  rig.expect_recovery();
}

TEST_P(BadPose, EvenASingleOneIsNotFelt) {
  Rig rig;
  rig.engage();
  rig.spoil = GetParam().spoil;
  rig.run(1);
  rig.spoil = nullptr;
  rig.largest_step_n = 0.0;
  rig.run(5);
  // Falling within 30 ms, not at once, and not up.
  EXPECT_LT(rig.force_n(), 0.5);
  EXPECT_GT(rig.force_n(), 0.4);
  EXPECT_LE(rig.largest_step_n, 0.5 * 1.5 / 30 + 1e-9);
  rig.expect_recovery();
}

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

INSTANTIATE_TEST_SUITE_P(
    Faults, BadPose,
    ::testing::Values(
        PoseFault{"NotANumber", Fault::kPoseNotFinite,
                  [](PoseSample& p) { p.pose.position_m[1] = kNan; }},
        PoseFault{"BeyondTheWorld", Fault::kPoseNotFinite,
                  [](PoseSample& p) { p.pose.position_m[2] = -1e308; }},
        PoseFault{"InfiniteQuaternion", Fault::kPoseNotFinite,
                  [](PoseSample& p) {
                    p.pose.orientation_xyzw[2] = std::numeric_limits<double>::infinity();
                  }},
        PoseFault{"JawNotANumber", Fault::kPoseNotFinite, [](PoseSample& p) { p.jaw = kNan; }},
        PoseFault{"WrongQuaternion", Fault::kPoseQuaternion,
                  [](PoseSample& p) { p.pose.orientation_xyzw[3] = 0.9; }},
        PoseFault{"ZeroQuaternion", Fault::kPoseQuaternion,
                  [](PoseSample& p) { p.pose.orientation_xyzw = {}; }},
        PoseFault{"JawBeyondClosed", Fault::kPoseJaw, [](PoseSample& p) { p.jaw = 1.5; }},
        // There and back every time: a jump each.
        PoseFault{"Jumping", Fault::kPoseJump,
                  [](PoseSample& p) { p.pose.position_m[0] += p.sequence % 2 ? 0.1 : 0.0; }},
        PoseFault{"Spinning", Fault::kPoseJump,
                  [](PoseSample& p) {
                    if (p.sequence % 2) p.pose.orientation_xyzw = {1.0, 0.0, 0.0, 0.0};
                  }}),
    [](const auto& fault) { return std::string(fault.param.name); });

TEST(ToolChannel, FollowsAHandInTheWorldThatJumpedToItsNewPlace) {
  Rig rig;
  rig.spoil = [](PoseSample& pose) { pose.frame = Frame::kWorld; };
  rig.engage();
  rig.hand.position_m[0] = -0.02;
  const std::int64_t last_good_ns = rig.now;
  rig.run(49);
  EXPECT_EQ(rig.faults(Fault::kPoseJump), 1U);
  EXPECT_LE(rig.last_felt_ns, last_good_ns + kPromise_ns);
  rig.expect_recovery(2.0);
}

TEST(ToolChannel, DoesNotMistakeBunchedPosesForAJump) {
  Rig rig;
  rig.engage();
  // 1 m/s, but five poses arrive together.
  for (int i = 0; i < 100; ++i) {
    if (i % 5 == 0) rig.now += 5 * kMs;
    rig.hand.position_m[0] += (i / 50 % 2 ? 1 : -1) * 1e-3;
    rig.send();
  }
  EXPECT_EQ(rig.faults(Fault::kPoseJump), 0U);
  EXPECT_EQ(rig.faults(Fault::kPoseRate), 0U);
}

TEST(ToolChannel, EndsTheForceOfADeviceThatFellSilent) {
  Rig rig;
  rig.engage();
  const std::int64_t last_good_ns = rig.now;
  rig.sends = false;
  rig.run(100);
  rig.expect_zero_since(last_good_ns);
  EXPECT_EQ(rig.faults(Fault::kPoseStale), 1U);
  EXPECT_TRUE(rig.last.from_supervisor);
  EXPECT_TRUE(rig.channel().target().present) << "a short silence does not drop the needle";
  rig.sends = true;
  rig.expect_recovery();
}

TEST(ToolChannel, GivesAPointerMoreTimeWhicheverSideSaysThatItIsOne) {
  for (const bool scene_says : {true, false}) {
    scene::Tool tool;
    DeviceLimits device;
    if (scene_says) tool.stale_after_ms = 100;
    device.pointer = !scene_says;
    Rig rig(tool);
    rig.channel().set_device_limits(device);
    rig.pose_period_ms = 16;
    rig.engage();
    rig.run(16 - rig.now / kMs % 16);
    const std::int64_t last_good_ns = rig.now;
    rig.sends = false;
    rig.run(99);
    EXPECT_NEAR(rig.force_n(), 0.5, 1e-9);
    rig.run(61);
    EXPECT_LE(rig.last_felt_ns, last_good_ns + 150 * kMs);
    EXPECT_EQ(rig.force_n(), 0.0);
  }
}

TEST(ToolChannel, EndsTheForceOfASimulationThatFellSilent) {
  Rig rig;
  rig.engage();
  const std::int64_t last_model_ns = rig.now / (4 * kMs) * (4 * kMs);
  rig.steps = false;
  rig.run(100);
  rig.expect_zero_since(last_model_ns);
  EXPECT_EQ(rig.faults(Fault::kModelStale), 1U);
  EXPECT_FALSE(rig.last.from_supervisor);
  rig.steps = true;
  rig.expect_recovery();
}

TEST(ToolChannel, EndsTheForceInTimeAtEveryModelRateOfAScene) {
  for (const std::int64_t period_ns : {kMs, 2 * kMs, 4 * kMs, 10 * kMs, 33'333'333 * kMs / kMs}) {
    const std::int64_t stale = model_stale_after_ns(period_ns);
    EXPECT_GT(stale, period_ns * 11 / 10);
    EXPECT_LE(stale + 9 * kMs, 48 * kMs);
  }
}

TEST(ToolChannel, SurvivesOneSlowStepWithoutAStep) {
  Rig rig;
  rig.engage();
  rig.steps = false;
  rig.run(30);  // a puncture that took long: 10 ms into the fading
  rig.steps = true;
  rig.largest_step_n = 0.0;
  EXPECT_GT(rig.force_n(), 0.1);
  rig.expect_recovery();
}

TEST(ToolChannel, RefusesAModelThatIsNotFinite) {
  Rig rig;
  rig.engage();
  const std::int64_t last_model_ns = rig.now / (4 * kMs) * (4 * kMs);
  rig.wrench_offset_n = kNan;
  rig.run(100);
  rig.expect_zero_since(last_model_ns);
  EXPECT_GE(rig.faults(Fault::kModelNotFinite), 20U);
  rig.wrench_offset_n = 0.0;
  rig.expect_recovery();
}

TEST(ToolChannel, LeavesNoStepAtASwapOfModels) {
  Rig rig;
  rig.engage();
  rig.largest_step_n = 0.0;
  rig.wrench_offset_n = 0.1;  // the next model says 0.6 N where this one says 0.5
  rig.run(12);
  EXPECT_NEAR(rig.force_n(), 0.6, 1e-9);
  // 0.1 N over a blend of 4 ms, sampled each millisecond.
  EXPECT_LT(rig.largest_step_n, 0.1 * 0.4);
  rig.world_changed = true;
  rig.wrench_offset_n = 0.0;
  rig.largest_step_n = 0.0;
  rig.run(4);
  rig.world_changed = false;
  rig.run(30);
  EXPECT_LT(rig.largest_step_n, 0.1 * 0.4);
}

TEST(ToolChannel, TakesLongerOverAChangeOfTheWorldThanOverASwap) {
  // The largest step that half a newton makes in a millisecond: 30 ms against 4.
  const auto step_of = [](bool changed, bool overtaken) {
    Rig rig;
    rig.engage();
    rig.largest_step_n = 0.0;
    rig.world_changed = changed;
    rig.wrench_offset_n = 0.5;
    if (overtaken) {  // the model of that step is never shown
      rig.step();
      rig.world_changed = false;
      rig.step();
    }
    rig.run(4);
    rig.world_changed = false;
    rig.run(60);
    EXPECT_NEAR(rig.force_n(), 1.0, 1e-9);
    return rig.largest_step_n;
  };
  const double at_a_swap = step_of(false, false), at_a_change = step_of(true, false);
  // A smoothstep is at most 1.5 times as steep as its mean; ticks are half a millisecond apart.
  EXPECT_LE(at_a_swap, 0.5 * 1.5 / 4.0 + 1e-9);
  EXPECT_LE(at_a_change, 0.5 * 1.5 / 30.0 + 1e-9);
  EXPECT_GT(at_a_swap, 2.0 * at_a_change);
  EXPECT_LE(step_of(true, true), 0.5 * 1.5 / 30.0 + 1e-9);
}

/// Two tools of one scene, each with a model that feels the other by 40 N/m.
TEST(ToolChannel, FeelsWhereTheOtherToolIsNow) {
  PoseBoard board(2);
  Rig here, there;
  here.channel().join(board, 0);
  there.channel().join(board, 1);
  here.couple = [](suture::HapticModel& model) {
    model.other_count = 1;
    model.others[0].tool = 1;
    model.others[0].reference.position_m = {-0.005, 0.0, 0.0};
    model.others[0].stiffness[0] = 40.0;
  };
  here.engage();  // the other one was never anywhere: it counts as at its reference
  there.run(300);
  EXPECT_NEAR(here.force_n(), 0.5, 1e-9);
  there.hand.position_m[0] += 1e-3;
  there.run(1);
  here.run(1);
  EXPECT_NEAR(here.last.wrench.force_n[0], 0.5 - 40.0 * 1e-3, 1e-9);
  // Silent, it stays where it was.
  here.run(100);
  EXPECT_NEAR(here.last.wrench.force_n[0], 0.5 - 40.0 * 1e-3, 1e-9);
}

/// Under the thread sanitizer: every reader and writer of a board at once.
TEST(PoseBoard, IsReadWhileItIsWritten) {
  constexpr std::size_t kTools = 3;
  constexpr int kRounds = 20'000;
  PoseBoard board(kTools);
  EXPECT_EQ(board.pose(1, 0), nullptr);
  std::atomic<int> torn{0};
  std::vector<std::thread> threads;
  for (std::size_t tool = 0; tool < kTools; ++tool)
    threads.emplace_back([&board, &torn, tool] {
      for (int i = 1; i <= kRounds; ++i) {
        const double x = i;
        board.publish(tool, {{x, x, x}, {0, 0, 0, 1}});
        for (std::size_t other = 0; other < kTools; ++other) {
          if (other == tool) continue;
          const suture::Pose* pose = board.pose(other, tool);
          if (pose != nullptr && pose->position_m[0] != pose->position_m[2]) ++torn;
        }
      }
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(torn.load(), 0);
  ASSERT_NE(board.pose(1, 0), nullptr);
  EXPECT_EQ(board.pose(1, 0)->position_m[0], kRounds);
}

TEST(ToolChannel, FollowsTheHandWithoutLag) {
  Rig rig;
  rig.engage();
  for (int i = 1; i <= 40; ++i) {
    rig.hand.position_m[0] = -0.005 - i * 1e-5;
    rig.run(1);
    EXPECT_NEAR(rig.force_n(), -kWall_n_per_m * rig.hand.position_m[0], 1e-9);
  }
}

TEST(ToolChannel, ClampsAForceInMagnitudeAndSaysSo) {
  Rig rig;
  rig.engage();
  rig.wrench_offset_n = 50.0;
  rig.run(50);
  EXPECT_NEAR(rig.force_n(), rig.channel().limits().max_force_n, 1e-9);
  EXPECT_EQ(rig.faults(Fault::kForceLimit), 1U);
  EXPECT_GE(rig.faults(Fault::kSlewLimit), 1U);
  EXPECT_NE(rig.last.faults & fault_bit(Fault::kForceLimit), 0U);
  // At the limit, and ended from there within the promise.
  const std::int64_t last_good_ns = rig.now;
  rig.sends = false;
  rig.run(100);
  rig.expect_zero_since(last_good_ns);
}

TEST(ToolChannel, KeepsItsPromiseWithASlowSlewByAllowingLess) {
  scene::Tool tool;
  tool.max_force_slew_n_per_s = 40.0;
  Rig rig(tool);
  rig.wrench_offset_n = 50.0;
  rig.run(400);
  EXPECT_GT(rig.force_n(), 0.5);
  const std::int64_t last_model_ns = rig.now / (4 * kMs) * (4 * kMs);
  rig.steps = false;
  rig.run(100);
  rig.expect_zero_since(last_model_ns);
}

TEST(ToolChannel, DropsAndCountsPosesBeyondFourKilohertz) {
  Rig rig;
  rig.engage();
  const std::uint64_t dropped = rig.channel().counters().poses_dropped.load();
  int answered = 0;
  constexpr std::int64_t kEighthMs = kMs / 8;
  for (int i = 0; i < 800; ++i) {
    rig.now += kEighthMs;
    if (i % 32 == 0) rig.step();
    answered += rig.send().has_value();
  }
  EXPECT_NEAR(answered, 400, 12);
  EXPECT_EQ(rig.channel().counters().poses_dropped.load() - dropped,
            static_cast<std::uint64_t>(800 - answered));
  EXPECT_GT(rig.faults(Fault::kPoseRate), 0U);
}

TEST(ToolChannel, DropsPosesThatComeTwiceOrLate) {
  Rig rig;
  rig.engage();
  rig.now += kMs;
  const PoseSample pose = rig.sample();
  const PoseSample next = rig.sample();
  EXPECT_TRUE(rig.channel().on_pose(next, rig.now));
  EXPECT_FALSE(rig.channel().on_pose(next, rig.now));
  EXPECT_FALSE(rig.channel().on_pose(pose, rig.now));
  EXPECT_EQ(rig.faults(Fault::kPoseOrder), 2U);
}

/// A simulation whose every model comes a moment late: one fault that lasts, and one recovery.
TEST(ToolChannel, DoesNotFlickerWhereModelsComeAtTheEdgeOfTheirTime) {
  Rig rig;
  rig.engage();
  rig.steps = false;
  for (int i = 0; i < 50; ++i) {
    rig.run(22);  // stale at 20
    rig.step();
  }
  EXPECT_EQ(rig.faults(Fault::kModelStale), 1U);
  EXPECT_EQ(rig.channel().counters().recoveries.load(), 0U);
  rig.steps = true;
  rig.run(400);
  EXPECT_EQ(rig.channel().counters().recoveries.load(), 1U);
  EXPECT_EQ(rig.last.faults, 0U);
  EXPECT_NEAR(rig.force_n(), 0.5, 1e-9);
}

TEST(ToolChannel, ShowsTheForceInTheDevicesFrameAndScale) {
  scene::Tool tool;
  tool.workspace.pose.orientation = Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ());
  tool.workspace.force_scale = 3.0;
  Rig rig(tool);
  rig.hand.position_m = {0.0, 0.005, 0.0};  // world: x = −5 mm
  rig.run(300);
  EXPECT_NEAR(rig.last.wrench.force_n[1], -1.5, 1e-9);
  EXPECT_NEAR(rig.channel().report().wrench.force_n[0], 0.5, 1e-9);
  // Poses in the world are neither mapped nor scaled.
  rig.spoil = [](PoseSample& p) { p.frame = Frame::kWorld, p.pose.position_m = {-0.004, 0, 0}; };
  rig.writer = 9;
  rig.channel().end_lease(7);
  rig.run(300);
  EXPECT_NEAR(rig.last.wrench.force_n[0], 0.4, 1e-9);
}

TEST(ToolChannel, IsSafeWhenItsOwnThreadsStall) {
  Rig rig;
  rig.engage();
  rig.now += 500 * kMs;  // nobody ran
  const std::int64_t woke_ns = rig.now;
  rig.run(100);
  // What was missed counts as missed: zero at once, within the slew, then a ramp.
  EXPECT_GE(rig.faults(Fault::kModelStale) + rig.faults(Fault::kPoseStale), 1U);
  EXPECT_LE(rig.last_felt_ns, woke_ns + 100 * kMs);
  rig.expect_recovery();
}

TEST(ToolChannel, LatchesASingleFaultUntilTheForceIsWholeAgain) {
  Rig rig;
  rig.engage();
  rig.spoil = [](PoseSample& p) { p.jaw = 2.0; };
  rig.run(1);
  rig.spoil = nullptr;
  rig.run(100);
  EXPECT_NE(rig.last.faults & fault_bit(Fault::kPoseJaw), 0U);
  EXPECT_EQ(rig.channel().counters().recoveries.load(), 0U);
  rig.expect_recovery();
  EXPECT_EQ(rig.channel().counters().recoveries.load(), 1U);
}

// A world that pushes along with the hand, by its models alone: each of them is a spring.
TEST(ToolChannel, EndsAForceThatGivesMoreEnergyThanItTook) {
  Rig rig;
  rig.engage();
  rig.largest_step_n = 0.0;
  double before_m = rig.hand.position_m[0];
  int ticks = 0;
  while (rig.faults(Fault::kEnergy) == 0 && ticks < 20'000) {
    rig.hand.position_m[0] = -0.005 + 0.004 * std::sin(0.02 * ticks++);
    const double v_m_per_s = (rig.hand.position_m[0] - before_m) * 1e3;
    before_m = rig.hand.position_m[0];
    rig.wrench_offset_n = 12.0 * v_m_per_s;
    rig.run(1);
  }
  ASSERT_EQ(rig.faults(Fault::kEnergy), 1U);
  EXPECT_GT(rig.channel().report().energy_debt_peak_j, suture::EnergyBound{}.energy_j);
  const std::int64_t since = rig.now;
  rig.run(48);  // then it begins to come back
  rig.expect_zero_since(since);
  EXPECT_NE(rig.last.faults & fault_bit(Fault::kEnergy), 0U);
  rig.wrench_offset_n = 0.0;
  rig.run(400);
  EXPECT_EQ(rig.last.state, ToolState::kRendering);
  EXPECT_EQ(rig.last.faults, 0U);
}

TEST(ToolChannel, LeavesTheEnergyOfADeviceThatRendersItselfToTheDevice) {
  Rig rig;
  rig.spoil = [](PoseSample& p) { p.renders_itself = true; };
  rig.engage();
  EXPECT_TRUE(rig.last.renders_itself);
  RenderedSample shown;
  shown.wrench.force_n[0] = 0.4;
  shown.faults = fault_bit(Fault::kSlewLimit) | fault_bit(Fault::kPoseJump);
  rig.channel().on_rendered(shown, rig.now);
  rig.run(2);
  const ToolReport& report = rig.channel().report();
  EXPECT_TRUE(report.renders_itself);
  EXPECT_EQ(report.shown_force_n, 0.4);
  EXPECT_NE(report.faults & fault_bit(Fault::kSlewLimit), 0U);
  EXPECT_EQ(rig.faults(Fault::kSlewLimit), 1U);
  EXPECT_EQ(rig.faults(Fault::kPoseJump), 0U) << "those the server counts itself";
  rig.channel().on_rendered(shown, rig.now);
  EXPECT_EQ(rig.faults(Fault::kSlewLimit), 1U) << "it lasts";
  rig.run(150);  // it says nothing any more
  EXPECT_NEAR(rig.channel().report().shown_force_n, 0.5, 1e-9);
}

TEST(ToolChannel, KeepsToTheSmallerOfSceneAndDevice) {
  Rig rig;
  const suture::ForceLimits scene = rig.channel().limits();
  DeviceLimits device;
  device.force.max_force_n = 100.0;
  device.force.max_force_slew_n_per_s = 10.0;
  rig.channel().set_device_limits(device);
  EXPECT_EQ(rig.channel().limits().max_force_slew_n_per_s, 10.0);
  // What a slew of 10 N/s can end in time.
  EXPECT_LT(rig.channel().limits().max_force_n, 0.3);
  rig.channel().set_device_limits({});
  EXPECT_EQ(rig.channel().limits().max_force_n, scene.max_force_n);
  device = {};
  device.max_stiffness_n_per_m = 40.0;  // the wall has 100
  rig.channel().set_device_limits(device);
  rig.run(300);
  EXPECT_NEAR(rig.force_n(), 40.0 * 0.005, 1e-9);
  rig.channel().set_device_limits({});
  rig.run(50);
  EXPECT_NEAR(rig.force_n(), 0.5, 1e-9);
}

/// A needle that is drawn on at 0.1 m/s, and then stands: friction follows the speed, or stays as
/// it was in the step where that damps the hand by more than its device renders.
TEST(ToolChannel, DampsTheHandNoMoreThanItsDeviceRenders) {
  const auto friction_felt_n = [](double max_damping_n_s_per_m, double motion_scale = 1.0) {
    scene::Tool tool;
    tool.workspace.motion_scale = motion_scale;
    Rig rig(tool);
    rig.couple = [](suture::HapticModel& model) {
      model.bilateral_wrench.force_n[1] = -0.5;
      model.slide_twist[1] = model.slide_gradient[1] = 1.0;
      model.slide_stiffness = 300.0;
      model.slide_friction_n = -0.5;
      model.slide_drag_n_s_per_m = 0.2;
      model.bilateral_stiffness[7] = 0.0;
    };
    DeviceLimits device;
    device.max_damping_n_s_per_m = max_damping_n_s_per_m;
    rig.channel().set_device_limits(device);
    rig.run(300);
    rig.steps = false;
    rig.run(12);
    return std::abs(rig.channel().report().wrench.force_n[1]);
  };
  EXPECT_NEAR(friction_felt_n(0.1), 0.5, 1e-9);
  EXPECT_LT(friction_felt_n(0.3), 0.05);
  EXPECT_LT(friction_felt_n(0.0), 0.05);
  EXPECT_LT(friction_felt_n(0.15, 0.5), 0.05) << "a hand that is scaled down feels half of it";
}

TEST(ToolChannel, NeitherAllocatesNorLocks) {
  if (!testing::HeapGuard::active()) GTEST_SKIP() << "a sanitizer owns malloc here";
  Rig rig;
  rig.engage();
  DeviceLimits limits;
  limits.max_stiffness_n_per_m = 50.0;  // so that models are coupled
  const testing::HeapGuard guard;
  for (int i = 0; i < 200; ++i) {
    rig.now += kMs;
    PoseSample pose = rig.sample();
    if (i % 50 == 0) pose.pose.position_m[0] = kNan;
    if (i < 120) (void)rig.channel().on_pose(pose, rig.now);
    (void)rig.channel().supervise(rig.now + kMs / 2);
    if (i % 4 == 0) rig.step();
    (void)rig.channel().report();
    // And what others do on threads that a force may wait for.
    if (i % 10 == 0) rig.channel().on_rendered({}, rig.now);
    if (i % 60 == 0) rig.channel().set_device_limits(limits);
    rig.channel().set_stopped(i % 80 == 79);
  }
  EXPECT_EQ(guard.allocations(), 0U);
  EXPECT_EQ(guard.locks(), 0U);
}

// Four threads at once, as in the server; the thread sanitizer watches. Every pose is
// answered at most once and in order, whoever answers. The device renders itself, and what it
// says to have shown comes on the thread of its poses.
TEST(ToolChannel, AnswersInOrderFromTwoThreads) {
  constexpr std::uint64_t kPoses = 20'000;
  scene::Tool tool;
  ToolChannel channel(tool, 4 * kMs);
  std::atomic<std::int64_t> clock{1'000'000 * kMs};
  std::atomic<bool> done{false};
  std::vector<std::uint64_t> by_receive, by_supervisor;
  by_receive.reserve(kPoses);
  by_supervisor.reserve(kPoses);
  std::uint64_t sequence_errors = 0;

  std::thread supervisor([&] {
    while (!done.load()) {
      const auto force = channel.supervise(clock.load() + 2 * kMs);
      if (force && !force->from_supervisor) by_supervisor.push_back(force->pose_sequence);
    }
  });
  std::thread simulation([&] {
    suture::HapticModel model;
    model.epoch = 1;
    model.touching = true;
    for (int i = 0; i < 3; ++i) model.bilateral_stiffness[7 * i] = kWall_n_per_m;
    while (!done.load()) {
      ++model.sequence;
      model.reference = channel.target().pose;
      channel.publish_model(model, clock.load(), clock.load());
      if (channel.report().gain > 1.0) ++sequence_errors;
    }
  });
  PoseSample pose;
  pose.writer = 1;
  pose.renders_itself = true;
  RenderedSample rendered;
  for (std::uint64_t i = 1; i <= kPoses; ++i) {
    pose.sequence = i;
    // Every other pose is late, so that the supervisor takes over now and then.
    const std::int64_t now = clock.fetch_add(i % 2 ? kMs : 5 * kMs) + (i % 2 ? kMs : 5 * kMs);
    if (const auto force = channel.on_pose(pose, now)) by_receive.push_back(force->pose_sequence);
    rendered.wrench.force_n[0] = 1e-3 * static_cast<double>(i);
    channel.on_rendered(rendered, now);
  }
  done = true;
  supervisor.join();
  simulation.join();
  const auto rest = channel.supervise(clock.load());
  if (rest && !rest->from_supervisor) by_supervisor.push_back(rest->pose_sequence);

  std::vector<int> answers(kPoses + 1, 0);
  for (const auto* list : {&by_receive, &by_supervisor}) {
    for (std::size_t i = 0; i < list->size(); ++i) {
      ++answers[(*list)[i]];
      if (i > 0) {
        ASSERT_GT((*list)[i], (*list)[i - 1]);
      }
    }
  }
  for (std::uint64_t i = 1; i <= kPoses; ++i) ASSERT_LE(answers[i], 1) << "pose " << i;
  EXPECT_EQ(sequence_errors, 0U);
  // Poses that follow each other while the other thread holds the token (and here it may
  // be preempted with it) replace each other, but the last one is never forgotten.
  EXPECT_EQ(answers[kPoses], 1);
}

}  // namespace
}  // namespace sutured::haptics
