// SPDX-License-Identifier: GPL-3.0-or-later
// Each attacker against a secured server and an honest device: refused, and not felt.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attacks/arena.hpp"

namespace sutured::attacks {
namespace {

class Attacked : public ::testing::TestWithParam<Attack> {};

TEST_P(Attacked, IsRefused) {
  Arena arena;
  const Arena::Result result = arena.run(GetParam(), 3.0);
  EXPECT_EQ(result.reached.answered, 0) << "of " << result.reached.sent;
  if (!GetParam().may_read) {
    EXPECT_EQ(result.reached.read, 0);
  }
  if (!GetParam().may_match) {
    EXPECT_EQ(result.reached.matched, 0);
  }
  EXPECT_EQ(result.poses, 0U) << "the tool obeyed the attacker";
  EXPECT_FALSE(result.leased);
  // The device beside is served. How well is a figure of docs/results/security.md.
  EXPECT_GT(result.felt.sent, result.felt.lost);
  EXPECT_TRUE(arena.seconds_until_served(60.0)) << "the attack outlives itself";
}

INSTANTIATE_TEST_SUITE_P(Security, Attacked, ::testing::ValuesIn(attacks()),
                         [](const auto& attack) { return attack.param.name; });

// What shows that the attacks above fail for their keys and not for the attacker's clumsiness.
TEST(Attack, SucceedsWithKeysForTheTool) {
  Arena arena;
  const Arena::Result result = arena.run({"Permitted", "", "", true, true}, 3.0);
  EXPECT_EQ(result.reached.error, "");
  EXPECT_GT(result.reached.matched, 0);
  EXPECT_GT(result.reached.answered, 0);
  EXPECT_GT(result.poses, 0U);
}

}  // namespace
}  // namespace sutured::attacks
