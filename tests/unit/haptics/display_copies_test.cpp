// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/display_copies.hpp"

#include <gtest/gtest.h>

#include "support/heap_guard.hpp"

namespace sutured::haptics {
namespace {

using simulation::ContactPoint;
using simulation::NeedleState;
using simulation::ThreadState;

ThreadState long_thread(std::size_t points, std::size_t punctures) {
  ThreadState thread;
  thread.length_m = 0.45;
  thread.tension_n = 0.1;
  thread.head = simulation::ThreadEnd::kSwaged;
  thread.head_holder = 2;
  for (std::size_t i = 0; i < points; ++i) {
    thread.course_m.emplace_back(static_cast<double>(i), 0.0, 0.0);
    thread.arc_length_m.push_back(static_cast<double>(i));
  }
  thread.segment_tension_n.assign(points - 1, 0.1);
  thread.punctures.resize(punctures);
  return thread;
}

TEST(CopyThread, KeepsAThreadOfOrdinaryLengthWhole) {
  const ThreadState from = long_thread(100, 4);
  ThreadState to;
  reserve_thread(to);
  copy_thread(from, to);
  EXPECT_EQ(to.course_m, from.course_m);
  EXPECT_EQ(to.arc_length_m, from.arc_length_m);
  EXPECT_EQ(to.segment_tension_n, from.segment_tension_n);
  EXPECT_EQ(to.punctures.size(), 4U);
  EXPECT_EQ(to.length_m, 0.45);
  EXPECT_EQ(to.head, simulation::ThreadEnd::kSwaged);
  EXPECT_EQ(to.head_holder, 2);
}

TEST(CopyThread, CutsWhatHasNoEndAndAllocatesNothing) {
  if (!testing::HeapGuard::active()) GTEST_SKIP() << "sanitizers bring their own malloc";
  const ThreadState endless = long_thread(10 * kShownCourseMax, 10 * kShownPuncturesMax);
  const ThreadState brief = long_thread(3, 1);
  const std::vector<ContactPoint> many(10 * kShownContactsMax);
  ThreadState to;
  reserve_thread(to);
  std::vector<ContactPoint> contacts;
  contacts.reserve(kShownContactsMax);
  const testing::HeapGuard heap;
  copy_thread(brief, to);
  copy_thread(endless, to);
  copy_contacts(many, contacts);
  EXPECT_EQ(heap.allocations(), 0U);
  EXPECT_EQ(to.course_m.size(), kShownCourseMax);
  EXPECT_EQ(to.arc_length_m.size(), kShownCourseMax);
  EXPECT_EQ(to.segment_tension_n.size(), kShownCourseMax - 1);  // still one per pair
  EXPECT_EQ(to.punctures.size(), kShownPuncturesMax);
  EXPECT_EQ(contacts.size(), kShownContactsMax);
  copy_contacts({}, contacts);
  EXPECT_TRUE(contacts.empty());
}

TEST(CopyNeedle, KeepsEveryFigure) {
  NeedleState from;
  from.position_m = {1, 2, 3};
  from.orientation = Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0);
  from.holder = 1;
  from.active_cells = 4;
  from.embedded_length_m = 0.01;
  from.tip_force_n = 0.2;
  from.tip_inside = true;
  from.punctures = {{1, {7, 8, 9}, 0.1, true}};
  NeedleState to;
  to.punctures.resize(3);  // of the frame before
  copy_needle(from, to);
  EXPECT_EQ(to.position_m, from.position_m);
  EXPECT_EQ(to.orientation.coeffs(), from.orientation.coeffs());
  EXPECT_EQ(to.holder, 1);
  EXPECT_EQ(to.active_cells, 4);
  EXPECT_EQ(to.embedded_length_m, 0.01);
  EXPECT_EQ(to.tip_force_n, 0.2);
  EXPECT_TRUE(to.tip_inside);
  ASSERT_EQ(to.punctures.size(), 1U);
  EXPECT_EQ(to.punctures[0].tissue, 1);
  EXPECT_EQ(to.punctures[0].position_m, simulation::Vec3(7, 8, 9));
  EXPECT_EQ(to.punctures[0].arc_length_m, 0.1);
  EXPECT_TRUE(to.punctures[0].inward);
}

TEST(CopyNeedle, CutsWhatHasNoEndAndAllocatesNothing) {
  if (!testing::HeapGuard::active()) GTEST_SKIP() << "sanitizers bring their own malloc";
  NeedleState endless, to;
  endless.punctures.resize(10 * kShownPuncturesMax);
  reserve_needle(to);
  const testing::HeapGuard heap;
  copy_needle(endless, to);
  EXPECT_EQ(heap.allocations(), 0U);
  EXPECT_EQ(to.punctures.size(), kShownPuncturesMax);
}

}  // namespace
}  // namespace sutured::haptics
