// SPDX-License-Identifier: GPL-3.0-or-later
// Who holds a tool, and what ends or renews that: leases, stops, pauses, other worlds, the clutch.
#include <gtest/gtest.h>

#include "tool_rig.hpp"

namespace sutured::haptics {
namespace {

TEST(ToolChannel, RefusesASecondWriterAndGoesOnServingTheFirst) {
  Rig rig;
  rig.engage();
  for (int i = 0; i < 20; ++i) {
    rig.run(1);
    PoseSample rival = rig.sample();
    rival.writer = 8;
    rival.pose.position_m[0] = 0.3;
    EXPECT_FALSE(rig.channel().on_pose(rival, rig.now + kMs / 4));
  }
  EXPECT_EQ(rig.faults(Fault::kToolInUse), 1U);
  EXPECT_EQ(rig.channel().lease(), 7U);
  EXPECT_NEAR(rig.force_n(), 0.5, 1e-9);
}

TEST(ToolChannel, PassesTheLeaseOnWhenTheWriterDies) {
  Rig rig;
  rig.engage();
  const std::int64_t last_good_ns = rig.now;
  rig.sends = false;
  rig.channel().end_lease(8);  // nobody's
  EXPECT_EQ(rig.channel().lease(), 7U);
  rig.channel().end_lease(7);
  rig.run(60);
  rig.expect_zero_since(last_good_ns);
  EXPECT_EQ(rig.last.state, ToolState::kIdle);
  EXPECT_FALSE(rig.channel().target().present);
  const std::uint64_t forces = rig.channel().counters().forces.load();
  rig.run(60);
  EXPECT_EQ(rig.channel().counters().forces.load(), forces) << "nobody to send to";
  rig.writer = 8;
  rig.sends = true;
  rig.largest_step_n = 0.0;
  rig.run(300);
  EXPECT_EQ(rig.last.writer, 8U);
  EXPECT_NEAR(rig.force_n(), 0.5, 1e-9);
}

TEST(ToolChannel, StartsAtZeroForAnotherHandThatFollowsAtOnce) {
  Rig rig;
  rig.engage();
  rig.channel().end_lease(7);
  rig.writer = 8;
  rig.run(1);
  EXPECT_EQ(rig.last.writer, 8U);
  EXPECT_EQ(rig.force_n(), 0.0);
}

TEST(ToolChannel, EndsTheLeaseOfASilentWriter) {
  Rig rig;
  rig.engage();
  rig.sends = false;
  rig.run(1900);
  EXPECT_EQ(rig.channel().lease(), 7U);
  rig.run(200);
  EXPECT_EQ(rig.channel().lease(), 0U);
  EXPECT_FALSE(rig.channel().target().present);
}

TEST(ToolChannel, LetsGoOnGoodbye) {
  Rig rig;
  rig.engage();
  const std::int64_t last_good_ns = rig.now;
  rig.says_goodbye = true;
  rig.run(1);
  rig.sends = false;
  rig.run(60);
  rig.expect_zero_since(last_good_ns);
  EXPECT_EQ(rig.channel().lease(), 0U);
}

TEST(ToolChannel, StopsForTheCommandUntilToldOtherwise) {
  Rig rig;
  rig.engage();
  const std::int64_t since = rig.now;
  rig.channel().set_stopped(true);
  rig.run(100);
  rig.expect_zero_since(since);
  EXPECT_EQ(rig.last.state, ToolState::kStopped);
  rig.run(500);
  EXPECT_EQ(rig.force_n(), 0.0);
  rig.channel().set_stopped(false);
  rig.run(400);
  EXPECT_NEAR(rig.force_n(), 0.5, 1e-9);
}

TEST(ToolChannel, MissesNoPoseOfADeviceThatHasLeft) {
  Rig rig;
  rig.engage();
  rig.says_goodbye = true;
  rig.run(1);
  rig.sends = false;
  rig.run(200);
  EXPECT_EQ(rig.last.state, ToolState::kIdle);
  EXPECT_EQ(rig.faults(Fault::kPoseStale), 0U);
  EXPECT_EQ(rig.last.faults, 0U);
}

TEST(ToolChannel, KeepsAToolFromTheDeviceThatWasToldToLetGoUntilItsJawOpens) {
  Rig rig;
  rig.jaw = 1.0;
  rig.engage();
  const std::int64_t since = rig.now;
  EXPECT_TRUE(rig.channel().release());
  EXPECT_FALSE(rig.channel().release()) << "nobody holds it";
  rig.run(3000);
  rig.expect_zero_since(since);
  EXPECT_EQ(rig.channel().lease(), 0U);
  EXPECT_FALSE(rig.channel().target().present) << "what the jaw held is let go";
  EXPECT_EQ(rig.faults(Fault::kToolInUse), 0U);
  rig.jaw = 0.0;
  rig.run(400);
  EXPECT_EQ(rig.channel().lease(), 7U);
  EXPECT_EQ(rig.last.state, ToolState::kRendering);
}

TEST(ToolChannel, GivesAToolThatWasReleasedToAnotherDevice) {
  Rig rig;
  rig.engage();
  ASSERT_TRUE(rig.channel().release());
  rig.run(100);
  EXPECT_EQ(rig.channel().lease(), 0U) << "its jaw was open all the time";
  rig.writer = 8;
  rig.run(300);
  EXPECT_EQ(rig.channel().lease(), 8U);
  EXPECT_EQ(rig.last.state, ToolState::kRendering);
}

TEST(ToolChannel, KeepsAReleaseWhoeverWasReleasedBefore) {
  Rig rig;
  rig.jaw = 1.0;
  rig.engage();
  ASSERT_TRUE(rig.channel().release());
  rig.run(100);
  rig.writer = 8;
  rig.jaw = 0.0;
  rig.run(300);
  ASSERT_EQ(rig.channel().lease(), 8U);
  ASSERT_TRUE(rig.channel().release());
  rig.run(500);
  EXPECT_EQ(rig.channel().lease(), 0U) << "the jaw that was closed is another's";
}

TEST(ToolChannel, StopsForTheButtonAtTheDevice) {
  Rig rig;
  rig.engage();
  rig.says_stop = true;
  rig.run(1);
  rig.says_stop = false;
  rig.run(100);
  EXPECT_EQ(rig.force_n(), 0.0);
  EXPECT_EQ(rig.last.state, ToolState::kStopped);
}

TEST(ToolChannel, IsSilentWhileTheSimulationIsPaused) {
  Rig rig;
  rig.engage();
  const std::int64_t since = rig.now;
  rig.channel().set_paused(true);
  rig.steps = false;
  rig.run(100);
  rig.expect_zero_since(since);
  EXPECT_EQ(rig.last.state, ToolState::kPaused);
  EXPECT_EQ(rig.faults(Fault::kModelStale), 0U) << "a pause is no fault";
  rig.channel().set_paused(false);
  rig.run(3);
  EXPECT_EQ(rig.faults(Fault::kModelStale), 0U) << "the first step after it has its time";
  rig.steps = true;
  rig.run(400);
  EXPECT_NEAR(rig.force_n(), 0.5, 1e-9);
  EXPECT_EQ(rig.faults(Fault::kModelStale), 0U);
  EXPECT_EQ(rig.last.faults, 0U);
}

TEST(ToolChannel, KeepsAToolWhereItIsWhileAHandRestsElsewhereInAPause) {
  Rig rig;
  rig.engage();
  const suture::Pose place = rig.channel().target().pose;
  rig.channel().set_paused(true);
  rig.steps = false;
  for (int i = 0; i < 100; ++i) {
    rig.hand.position_m[1] += 1e-3;
    rig.run(1);
  }
  rig.channel().set_paused(false);
  rig.steps = true;
  rig.run(300);
  EXPECT_EQ(rig.last.state, ToolState::kRendering);
  EXPECT_NEAR(rig.channel().target().pose.position_m[1], place.position_m[1], 1e-12);
  rig.hand.position_m[1] += 1e-3;
  rig.run(5);
  EXPECT_NEAR(rig.channel().target().pose.position_m[1], place.position_m[1] + 1e-3, 1e-12);
}

TEST(ToolChannel, CallsNoPauseAFaultOfADeviceThatRendersItself) {
  Rig rig;
  rig.engage();
  const auto shows = [&](std::uint32_t faults) {
    RenderedSample sample;
    sample.faults = faults;
    rig.channel().on_rendered(sample, rig.now);
    rig.run(5);
  };
  constexpr std::uint32_t kStale = fault_bit(Fault::kModelStale);
  shows(0);
  rig.channel().set_paused(true);
  shows(kStale);
  rig.channel().set_paused(false);
  shows(kStale);
  EXPECT_EQ(rig.faults(Fault::kModelStale), 0U) << "the next model is on its way";
  shows(0);
  shows(kStale);
  EXPECT_EQ(rig.faults(Fault::kModelStale), 1U);
}

TEST(ToolChannel, StartsAgainFromZeroAfterAReset) {
  Rig rig;
  rig.engage();
  ++rig.epoch;
  rig.wrench_offset_n = 1.0;
  rig.largest_step_n = 0.0;
  rig.run(60);
  EXPECT_LE(rig.force_n(), 0.1);
  rig.run(300);
  EXPECT_NEAR(rig.force_n(), 1.5, 1e-9);
}

/// What was on its way to the hand, held up by the slew, is of the old world too.
TEST(ToolChannel, LetsNothingMoreOfAnOldWorldReachTheHand) {
  scene::Tool tool;
  tool.max_force_slew_n_per_s = 100.0;
  Rig rig(tool);
  rig.engage();
  for (int i = 0; i < 8; ++i) {  // 0.2 N each millisecond, of which the slew lets half through
    rig.hand.position_m[0] -= 0.002;
    rig.run(1);
  }
  const double felt = rig.force_n();
  ASSERT_LT(felt, 1.5) << "of 2.1 N";
  ++rig.epoch;
  rig.wrench_offset_n = 1.0;
  rig.step();
  rig.largest_rise_n = 0.0;
  rig.run(40);
  EXPECT_LE(rig.largest_rise_n, 1e-12);
  EXPECT_EQ(rig.force_n(), 0.0);
}

/// A rewind: the tool was elsewhere, with its jaw closed. The hand takes it over where it is.
TEST(ToolChannel, EngagesFromWhereAnotherWorldHasTheTool) {
  Rig rig;
  rig.engage();
  rig.place = ToolPlace{{{-0.02, 0.001, 0.0}, {0.0, 0.0, 0.0, 1.0}}, 1.0};
  ++rig.epoch;
  rig.largest_rise_n = 0.0;
  rig.run(60);
  rig.place.reset();  // the hand has come
  rig.run(300);
  const ToolTarget target = rig.channel().target();
  EXPECT_EQ(target.epoch, rig.epoch);
  EXPECT_NEAR(target.pose.position_m[0], -0.02, 1e-12);
  EXPECT_NEAR(target.pose.position_m[1], 0.001, 1e-12);
  EXPECT_EQ(target.jaw, 1.0);  // the hand's is open
  EXPECT_EQ(rig.last.state, ToolState::kRendering);
  EXPECT_NEAR(rig.force_n(), kWall_n_per_m * 0.02, 1e-9);
  // From zero by the ramp, as after any fade.
  EXPECT_LE(rig.largest_rise_n, rig.force_n() * 1.5 / 200 * 1.5 + 1e-9);
  rig.jaw = 0.9;  // it takes the jaw over
  rig.run(8);
  rig.jaw = 0.0;
  rig.run(8);
  EXPECT_EQ(rig.channel().target().jaw, 0.0);
  rig.hand.position_m[0] += 0.003;
  rig.run(8);
  EXPECT_NEAR(rig.channel().target().pose.position_m[0], -0.017, 1e-12);
}

/// A new server that resumed what another one left: its first device finds the tool in place.
TEST(ToolChannel, EngagesFromThereWithTheFirstDeviceToo) {
  Rig rig;
  rig.place = ToolPlace{{{-0.02, 0.0, 0.0}, {0.0, 0.0, 0.0, 1.0}}, 1.0};
  rig.run(8);
  EXPECT_NEAR(rig.channel().target().pose.position_m[0], -0.02, 1e-12);
  rig.writer = 8;  // and another one, before the first was seen to have come
  rig.run(40);
  EXPECT_NEAR(rig.channel().target().pose.position_m[0], -0.02, 1e-12);
}

/// A link that was down, poses that were refused, a stop: the hand moved on meanwhile.
TEST(ToolChannel, KeepsTheToolInPlaceWhereTheHandWentOnWithoutIt) {
  const auto expect_offset = [](const char* what, auto&& begin, auto&& end) {
    SCOPED_TRACE(what);
    Rig rig;
    rig.engage();
    begin(rig);
    rig.run(100);
    rig.hand.position_m[0] += 0.03;
    rig.run(100);
    end(rig);
    rig.run(100);
    EXPECT_NEAR(rig.channel().target().pose.position_m[0], -0.005, 1e-12);
    rig.hand.position_m[0] += 0.001;
    rig.run(1);
    EXPECT_NEAR(rig.channel().target().pose.position_m[0], -0.004, 1e-12);
    rig.expect_recovery(0.4);
  };
  expect_offset(
      "lost", [](Rig& rig) { rig.sends = false; }, [](Rig& rig) { rig.sends = true; });
  expect_offset(
      "not finite",
      [](Rig& rig) { rig.spoil = [](PoseSample& pose) { pose.pose.position_m[1] = NAN; }; },
      [](Rig& rig) { rig.spoil = nullptr; });
  expect_offset(
      "jump", [](Rig&) {}, [](Rig&) {});
}

/// Where the world's frame is the device's, there is no offset.
TEST(ToolChannel, FollowsAHandInTheWorldToWhereItIs) {
  Rig rig;
  rig.spoil = [](PoseSample& pose) { pose.frame = Frame::kWorld; };
  rig.engage();
  rig.sends = false;
  rig.run(200);
  rig.sends = true;
  rig.hand.position_m[0] += 0.003;
  rig.run(100);
  EXPECT_NEAR(rig.channel().target().pose.position_m[0], -0.002, 1e-12);
}

TEST(ToolChannel, EngagesTheClutchWithAnOffsetAndFromZero) {
  scene::Tool tool;
  tool.workspace.clutch_button = 2;
  Rig rig(tool);
  rig.engage();
  rig.buttons = 1U << 2;
  rig.run(60);
  EXPECT_EQ(rig.force_n(), 0.0);
  EXPECT_EQ(rig.last.state, ToolState::kClutched);
  for (int i = 0; i < 100; ++i) {  // the hand moves back, the tool stays
    rig.hand.position_m[0] += 1e-3;
    rig.run(1);
  }
  EXPECT_NEAR(rig.channel().target().pose.position_m[0], -0.005, 1e-12);
  rig.buttons = 0;
  rig.largest_step_n = 0.0;
  rig.run(1);
  EXPECT_NEAR(rig.channel().target().pose.position_m[0], -0.005, 1e-12);
  EXPECT_EQ(rig.force_n(), 0.0);
  rig.run(400);
  EXPECT_NEAR(rig.force_n(), 0.5, 1e-9);
  EXPECT_LE(rig.largest_step_n, 0.5 * 1.5 / 200 * 1.5 + 1e-9);
}

}  // namespace
}  // namespace sutured::haptics
