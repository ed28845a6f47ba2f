// SPDX-License-Identifier: GPL-3.0-or-later
// Where the other tools are, from what a device hears anyway.
#include "other_tools.hpp"

#include <gtest/gtest.h>

#include <thread>

#include "support/spring_model.hpp"

namespace suture {
namespace {

/// Under the thread sanitizer: poses of two tools are written while a renderer reads them.
TEST(OtherTools, AreReadWhileTheyAreWritten) {
  constexpr int kRounds = 20'000;
  const char* const names[] = {"driver", "assistant"};
  OtherTools others;
  std::thread receiver([&] {
    for (int i = 1; i <= kRounds; ++i)
      for (const char* name : names) {
        v1::HapticModel model = sutured::testing::spring_model(0.0);
        set_text(model.tool, name);
        others.receive(model);
        v1::ToolForce force{};
        force.tool_id = tool_id(name);
        force.flags = suture_v1_FORCE_ENGAGED;
        others.receive(force);
        v1::ToolPose pose{};
        pose.tool_id = tool_id(name);
        pose.position_m[0] = pose.position_m[1] = pose.position_m[2] = i;
        pose.orientation_xyzw[3] = 1.0;
        others.receive(pose);
      }
  });
  const Pose start;
  double last_m[2] = {0.0, 0.0};
  const auto read = [&](std::size_t tool) {
    const Pose& pose = others.pose(tool_id(names[tool]), start);
    EXPECT_EQ(pose.position_m[0], pose.position_m[2]);
    EXPECT_GE(pose.position_m[0], last_m[tool]);  // never an older one again
    last_m[tool] = pose.position_m[0];
  };
  while (last_m[0] < kRounds || last_m[1] < kRounds)
    for (const std::size_t tool : {0U, 1U}) read(tool);
  receiver.join();
}

}  // namespace
}  // namespace suture
