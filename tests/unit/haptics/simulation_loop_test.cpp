// SPDX-License-Identifier: GPL-3.0-or-later
// Tools whose world was replaced.
#include "haptics/simulation_loop.hpp"

#include <gtest/gtest.h>

namespace sutured::haptics {
namespace {

TEST(WaitForHand, StaysAtThePlaceUntilTheHandIsOfThisWorld) {
  constexpr std::uint64_t kEpoch = 7;
  constexpr std::int64_t kLong_ns = SimulationLoop::kStay_ns;
  ToolPlace place;
  place.pose.position_m = {0.01, 0.0, 0.0};
  ToolTarget target;
  EXPECT_EQ(wait_for_hand(place, target, kEpoch, kLong_ns - 1), Waiting::kAtPlace);
  EXPECT_EQ(wait_for_hand(place, target, kEpoch, kLong_ns), Waiting::kNobodyComes);

  // A hand at its clutch, which has moved nothing yet in this world.
  target.present = true;
  target.epoch = kEpoch - 1;
  target.pose.position_m = {0.2, 0.0, 0.0};
  EXPECT_EQ(wait_for_hand(place, target, kEpoch, kLong_ns - 1), Waiting::kAtPlace);
  EXPECT_EQ(wait_for_hand(place, target, kEpoch, kLong_ns), Waiting::kAway);

  // Engaged from the place, and fast.
  target.epoch = kEpoch;
  target.pose.position_m = {0.02, 0.0, 0.0};
  EXPECT_EQ(wait_for_hand(place, target, kEpoch, 0), Waiting::kJoins);
  target.frame = Frame::kWorld;
  EXPECT_EQ(wait_for_hand(place, target, kEpoch, 0), Waiting::kJoinsAnew);
  target.pose.position_m = {0.014, 0.0, 0.0};
  EXPECT_EQ(wait_for_hand(place, target, kEpoch, 0), Waiting::kJoins);
}

}  // namespace
}  // namespace sutured::haptics
