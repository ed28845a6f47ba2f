// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/snapshot.hpp"

#include <gtest/gtest.h>

#include <cstdint>
#include <thread>

namespace suture {
namespace {

struct Value {
  std::array<std::uint64_t, 512> words{};
};

TEST(Snapshot, GivesTheLatestValueOnce) {
  Snapshot<int> snapshot;
  EXPECT_FALSE(snapshot.update());
  EXPECT_EQ(snapshot.front(), 0);
  snapshot.publish(1);
  snapshot.publish(2);
  EXPECT_TRUE(snapshot.pending());
  EXPECT_TRUE(snapshot.update());
  EXPECT_EQ(snapshot.front(), 2);
  EXPECT_FALSE(snapshot.update());
  EXPECT_EQ(snapshot.front(), 2);
}

TEST(Snapshot, KeepsTheReadersValueWhileTheWriterWrites) {
  Snapshot<int> snapshot;
  snapshot.publish(1);
  ASSERT_TRUE(snapshot.update());
  for (int i = 2; i < 100; ++i) {
    snapshot.publish(i);
    ASSERT_EQ(snapshot.front(), 1);
  }
}

// The claim of the thread sanitizer's preset; elsewhere it still sees torn or old values.
TEST(Snapshot, IsNeverTornNorGoesBackBetweenTwoThreads) {
  constexpr std::uint64_t kValues = 100'000;
  Snapshot<Value> snapshot;
  std::thread writer([&] {
    for (std::uint64_t i = 1; i <= kValues; ++i) {
      snapshot.back().words.fill(i);
      snapshot.publish();
    }
  });
  std::uint64_t last = 0, torn = 0, back = 0;
  while (last < kValues) {
    if (!snapshot.update()) continue;
    const auto& words = snapshot.front().words;
    for (const std::uint64_t word : words) torn += word != words[0];
    back += words[0] <= last;
    last = words[0];
  }
  writer.join();
  EXPECT_EQ(torn, 0U);
  EXPECT_EQ(back, 0U);
}

}  // namespace
}  // namespace suture
