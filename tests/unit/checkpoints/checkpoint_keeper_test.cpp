// SPDX-License-Identifier: GPL-3.0-or-later
#include "checkpoints/checkpoint_keeper.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <filesystem>
#include <thread>

#include "support/block_scene.hpp"
#include "support/temporary_folder.hpp"

namespace sutured::checkpoints {
namespace {

using ::testing::HasSubstr;

/// A keeper that copies whenever it is offered something new.
class Keeper : public ::testing::Test {
 protected:
  /// Goes on by `count` steps, and waits until each is on the disk.
  void step(int count) {
    for (int i = 0; i < count; ++i) {
      simulation_.step(away_, 0.01);
      keep();
    }
  }
  void keep() {
    const std::string file = file_of(++written_);
    keeper_.offer(simulation_, nullptr, epoch_, now_ns_ += 10);
    for (int i = 0; i < 5000 && !std::filesystem::exists(file); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    ASSERT_TRUE(std::filesystem::exists(file)) << file;
    // Its thread has told itself, too, once it writes a name behind it.
    keeper_.ask("told");
    keeper_.offer(simulation_, nullptr, epoch_, now_ns_);
    while (!keeper_.next_word()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  /// Goes back and returns the time there.
  double rewind(double seconds) {
    keeper_.back_by(seconds).apply(simulation_, nullptr);
    ++epoch_;
    return simulation_.time_s();
  }
  std::string fault_of_rewind(double seconds) {
    try {
      (void)keeper_.back_by(seconds);
      return "";
    } catch (const CheckpointError& error) {
      return error.what();
    }
  }
  void reset() {
    simulation_.reset();
    keeper_.offer(simulation_, nullptr, ++epoch_, now_ns_);  // nothing is due
  }
  [[nodiscard]] std::string file_of(int sequence) const {
    const std::string number = std::to_string(sequence);
    return path_ + "/second." + std::string(10 - number.size(), '0') + number + ".checkpoint";
  }

  testing::TemporaryFolder temporary_;
  std::string path_ = temporary_.path("checkpoints");
  scene::Scene scene_ = testing::block_scene(4);
  simulation::Simulation simulation_{scene_};
  std::array<simulation::ToolInput, testing::kBlockTools> away_{};
  CheckpointKeeper keeper_{{{path_, 50}, 5}, scene_};
  std::int64_t now_ns_ = 0;
  std::uint64_t epoch_ = 1;
  int written_ = 0;
};

TEST_F(Keeper, GoesBackInTheOwnPastAfterARewind) {
  step(6);
  EXPECT_DOUBLE_EQ(rewind(0.035), 0.02);
  step(2);
  EXPECT_DOUBLE_EQ(rewind(0.005), 0.03) << "the second one";
  step(1);
  EXPECT_DOUBLE_EQ(rewind(0.025), 0.01);
}

TEST_F(Keeper, AfterAResetThereIsNothingToRewindTo) {
  EXPECT_THAT(fault_of_rewind(0.01), HasSubstr("no checkpoint to go back to yet"));
  step(6);
  reset();
  EXPECT_THAT(fault_of_rewind(0.01), HasSubstr("just after a reset"));
  step(3);
  EXPECT_DOUBLE_EQ(rewind(1.0), 0.01) << "the oldest since then";
  step(2);
  reset();
  EXPECT_THAT(fault_of_rewind(1.0), HasSubstr("just after a reset"));
}

TEST_F(Keeper, NoticesAResetThatTheTimeDoesNotShow) {
  simulation_.step(away_, 0.004);
  keep();
  // The next step is longer than all before the reset.
  simulation_.reset();
  ++epoch_;
  step(2);
  EXPECT_DOUBLE_EQ(rewind(1.0), 0.01) << "not into the world before it";
}

}  // namespace
}  // namespace sutured::checkpoints
