// SPDX-License-Identifier: GPL-3.0-or-later
// The clock's policy, the queue of events and the histogram.
#include <gtest/gtest.h>

#include <memory>
#include <thread>

#include "haptics/bounded_queue.hpp"
#include "haptics/period_latency.hpp"
#include "haptics/supervisor.hpp"
#include "protocol/types.hpp"
#include "support/heap_guard.hpp"

namespace sutured::haptics {
namespace {

TEST(NextTick, KeepsTheGridAndNeverBursts) {
  EXPECT_EQ(next_tick(1000, 1200, 1000).at_ns, 2000);
  EXPECT_EQ(next_tick(1000, 1200, 1000).missed, 0U);
  EXPECT_EQ(next_tick(1000, 2000, 1000).at_ns, 3000);
  EXPECT_EQ(next_tick(1000, 2000, 1000).missed, 1U);
  EXPECT_EQ(next_tick(1000, 7500, 1000).at_ns, 8000);
  EXPECT_EQ(next_tick(1000, 7500, 1000).missed, 6U);
}

TEST(Supervisor, TicksOnItsOwnThreadWithTimesThatGrow) {
  std::atomic<int> ticks{0};
  std::atomic<bool> grew{true};
  std::int64_t last = 0;
  {
    Supervisor supervisor([&](std::int64_t now_ns) {
      if (now_ns <= last) grew = false;
      last = now_ns;
      ++ticks;
    });
    while (ticks < 50) std::this_thread::yield();
    EXPECT_GE(supervisor.take_wakeup().count, 49U);
  }
  EXPECT_TRUE(grew);
}

TEST(BoundedQueue, KeepsOrderDropsWhatIsTooMuchAndCounts) {
  BoundedQueue<int, 4> queue;
  for (int i = 0; i < 6; ++i) EXPECT_EQ(queue.push(i), i < 4);
  EXPECT_EQ(queue.dropped(), 2U);
  int value = -1;
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(queue.pop(value));
    EXPECT_EQ(value, i);
  }
  EXPECT_FALSE(queue.pop(value));
}

TEST(BoundedQueue, LosesNothingBetweenTwoThreads) {
  BoundedQueue<std::uint64_t, 64> queue;
  constexpr std::uint64_t kValues = 100'000;
  std::thread writer([&] {
    for (std::uint64_t i = 0; i < kValues;)
      if (queue.push(i)) ++i;
  });
  std::uint64_t value = 0, out_of_order = 0;
  for (std::uint64_t i = 0; i < kValues;)
    if (queue.pop(value)) out_of_order += value != i++;
  writer.join();
  EXPECT_EQ(out_of_order, 0U);
}

TEST(PeriodLatency, GivesPercentilesOfWhatIsNew) {
  auto histogram = std::make_unique<PeriodLatency>();
  const testing::HeapGuard guard;
  for (int i = 1; i <= 1000; ++i) histogram->record(i * 1000);
  LatencySummary summary = histogram->take();
  EXPECT_EQ(summary.count, 1000U);
  EXPECT_NEAR(summary.p50_us, 500.0, 500 * 0.016);
  EXPECT_NEAR(summary.p99_us, 990.0, 990 * 0.016);
  EXPECT_NEAR(summary.p999_us, 999.0, 999 * 0.016);
  EXPECT_NEAR(summary.max_us, 1000.0, 1000 * 0.016);
  histogram->record(20);
  histogram->record(-5);
  summary = histogram->take();
  EXPECT_EQ(summary.count, 2U);
  EXPECT_NEAR(summary.max_us, 0.02, 1e-9);
  EXPECT_EQ(guard.allocations(), 0U);
  EXPECT_EQ(histogram->take().count, 0U);
}

}  // namespace
}  // namespace sutured::haptics
