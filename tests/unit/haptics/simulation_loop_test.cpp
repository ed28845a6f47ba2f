// SPDX-License-Identifier: GPL-3.0-or-later
// Tools whose world was replaced.
#include "haptics/simulation_loop.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "support/block_scene.hpp"
#include "support/test_session.hpp"

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

/// A loop over the block, which is held between two steps on request.
class Loop : public ::testing::Test {
 protected:
  Loop() {
    for (const scene::Tool& tool : scene_.tools) {
      tools_.push_back(std::make_unique<ToolChannel>(tool, kPeriod_ns));
      channels_.push_back(tools_.back().get());
    }
    SimulationLoop::Options options;
    options.rate_hz = 250.0;
    options.keep = [this](simulation::Simulation&, simulation::QualityMeter*, std::uint64_t,
                          std::int64_t) {
      held_.store(hold_.load());
      while (hold_.load()) std::this_thread::yield();
    };
    loop_.emplace(simulation::Simulation(scene_), channels_, std::move(options));
  }
  ~Loop() override { hold_.store(false); }
  void hold() {
    hold_.store(true);
    while (!held_.load()) std::this_thread::yield();
  }
  /// Lets the loop go on, and waits until it begins an epoch and makes ten beats more.
  void go_on() {
    const std::uint64_t epoch = loop_->epoch();
    hold_.store(false);
    ASSERT_TRUE(testing::eventually([&] { return loop_->epoch() != epoch; }));
    const std::uint64_t beats = loop_->beats();
    ASSERT_TRUE(testing::eventually([&] { return loop_->beats() > beats + 10; }));
  }
  SimulationLoop::Replace replacing() {
    return [this](simulation::Simulation&, simulation::QualityMeter*) { replaced_.fetch_add(1); };
  }

  static constexpr std::int64_t kPeriod_ns = 4'000'000;
  scene::Scene scene_ = testing::block_scene(4);
  std::vector<std::unique_ptr<ToolChannel>> tools_;
  std::vector<ToolChannel*> channels_;
  std::atomic<bool> hold_{false}, held_{false};
  std::atomic<int> replaced_{0};
  std::optional<SimulationLoop> loop_;
};

TEST_F(Loop, OfTwoChangesWithinABeatTheLastCounts) {
  hold();
  loop_->replace_state(replacing());
  EXPECT_TRUE(loop_->reset());
  EXPECT_FALSE(loop_->reset()) << "nothing waits any more";
  go_on();
  EXPECT_EQ(replaced_.load(), 0);

  hold();
  EXPECT_FALSE(loop_->reset());
  loop_->replace_state(replacing());
  go_on();
  EXPECT_EQ(replaced_.load(), 1);
}

}  // namespace
}  // namespace sutured::haptics
