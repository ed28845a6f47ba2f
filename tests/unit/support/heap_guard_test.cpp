// SPDX-License-Identifier: GPL-3.0-or-later
// A guard that counts nothing would let every claim pass.
#include "support/heap_guard.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <mutex>
#include <shared_mutex>

namespace sutured::testing {
namespace {

TEST(HeapGuard, SeesAllocationsAndFrees) {
  if (!HeapGuard::active()) GTEST_SKIP() << "a sanitizer owns malloc here";
  const HeapGuard guard;
  EXPECT_EQ(guard.allocations(), 0U);
  auto owner = std::make_unique<volatile int>(1);
  EXPECT_EQ(guard.allocations(), 1U);
  owner.reset();
  EXPECT_EQ(guard.frees(), 1U);
}

TEST(HeapGuard, SeesLocks) {
  if (!HeapGuard::active()) GTEST_SKIP() << "a sanitizer owns the locks here";
  std::mutex mutex;
  std::shared_mutex shared;
  const HeapGuard guard;
  { const std::lock_guard lock(mutex); }
  EXPECT_EQ(guard.locks(), 1U);
  if (mutex.try_lock()) mutex.unlock();
  EXPECT_EQ(guard.locks(), 2U);
  { const std::shared_lock lock(shared); }
  { const std::unique_lock lock(shared); }
  EXPECT_EQ(guard.locks(), 4U);
  EXPECT_EQ(guard.allocations(), 0U);
}

}  // namespace
}  // namespace sutured::testing
