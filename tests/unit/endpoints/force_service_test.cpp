// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/force_service.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "scene/scene.hpp"
#include "support/heap_guard.hpp"
#include "support/test_session.hpp"

namespace sutured::endpoints {
namespace {

using testing::eventually;

class ForceServiceTest : public ::testing::Test {
 protected:
  suture::v1::ToolPose pose(const std::string& tool) {
    suture::v1::ToolPose wire{};
    wire.tool_id = suture::tool_id(tool);
    wire.sequence_number = ++sequence_;
    wire.orientation_xyzw[3] = 1.0;
    return wire;
  }
  /// Sends poses until one is answered, and returns the answer.
  suture::v1::ToolForce await_answer() {
    suture::v1::ToolForce force{};
    suture::SampleInfo info;
    EXPECT_TRUE(eventually([&] {
      poses_.write(pose("driver"));
      return forces_.take(force, info) && info.valid;
    }));
    return force;
  }

  suture::Participant participant_{testing::own_session(), suture::Channel::kControl};
  scene::Tool tool_;
  haptics::ToolChannel channel_{tool_, 4 * haptics::kMillisecond_ns};
  std::vector<ServedTool> tools_{{"driver", "driver", &channel_}};
  ForceService service_{participant_, tools_};
  suture::Reader<suture::v1::ToolForce> forces_{participant_};
  suture::Writer<suture::v1::ToolPose> poses_{participant_};
  std::uint64_t sequence_ = 0;
};

TEST_F(ForceServiceTest, AnswersOnTheReceiveThreadWithTheHoldersGuid) {
  const suture::v1::ToolForce force = await_answer();
  EXPECT_TRUE(suture::guid_of(force.device) == poses_.guid());
  EXPECT_EQ(force.tool_id, suture::tool_id("driver"));
  EXPECT_GT(force.pose_sequence, 0U);
  EXPECT_EQ(force.flags & suture_v1_FORCE_FROM_SUPERVISOR, 0U);
  EXPECT_NE(channel_.lease(), 0U);
}

TEST_F(ForceServiceTest, CountsPosesForToolsThatTheSceneHasNot) {
  (void)await_answer();
  EXPECT_TRUE(eventually([&] {
    poses_.write(pose("spoon"));
    return service_.strangers() > 0;
  }));
}

TEST_F(ForceServiceTest, CountsCommandsThatFindNoRoom) {
  suture::Writer<suture::v1::Command> commands(participant_);
  suture::v1::Command command{};
  command.kind = suture_v1_COMMAND_PAUSE;
  // Until the service hears this writer.
  ASSERT_TRUE(eventually([&] {
    commands.write(command);
    return service_.next_command(command);
  }));
  while (service_.next_command(command)) {
  }
  for (int i = 0; i < 64; ++i) commands.write(command);
  EXPECT_EQ(service_.commands_dropped(), 0U);
  commands.write(command);
  EXPECT_TRUE(eventually([&] { return service_.commands_dropped() == 1; }));
}

TEST_F(ForceServiceTest, EndsTheLeaseOfAWriterThatLeft) {
  (void)await_answer();
  service_.end_leases_of_the_departed();
  EXPECT_NE(channel_.lease(), 0U);
  poses_ = {};
  EXPECT_TRUE(eventually([&] {
    service_.end_leases_of_the_departed();
    return channel_.lease() == 0;
  }));
}

TEST_F(ForceServiceTest, AllocatesNothingFromPoseToForce) {
  if (!testing::HeapGuard::active()) GTEST_SKIP() << "a sanitizer owns malloc here";
  // The writer is on another thread than the listener only over a network; in one process
  // Cyclone delivers on the writing thread, so that its allocations are this thread's.
  (void)await_answer();
  suture::v1::ToolForce force{};
  suture::SampleInfo info;
  for (int i = 0; i < 50; ++i) {
    poses_.write(pose("driver"));
    while (forces_.take(force, info)) {
    }
  }
  const std::uint64_t answered = channel_.counters().forces.load();
  // Cyclone may add a buffer late; what a message costs shows in every round.
  std::uint64_t fewest = ~std::uint64_t{0};
  for (int round = 0; round < 5 && fewest > 0; ++round) {
    const testing::HeapGuard guard;
    // Poses beyond 4 kHz are dropped: go on until some were answered.
    const std::uint64_t before = channel_.counters().forces.load();
    for (int i = 0; i < 1'000'000 && channel_.counters().forces.load() < before + 5; ++i) {
      poses_.write(pose("driver"));
      while (forces_.take(force, info)) {
      }
      service_.tick(suture::monotonic_ns());
    }
    fewest = std::min<std::uint64_t>(fewest, guard.allocations());
  }
  EXPECT_EQ(fewest, 0U);
  EXPECT_GT(channel_.counters().forces.load(), answered);
}

}  // namespace
}  // namespace sutured::endpoints
