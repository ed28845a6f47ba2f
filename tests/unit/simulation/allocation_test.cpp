// SPDX-License-Identifier: GPL-3.0-or-later
// A step that meets no new vertex allocates nothing.
#include <gtest/gtest.h>

#include <cmath>

#include "simulation/simulation.hpp"
#include "support/block_scene.hpp"
#include "support/heap_guard.hpp"

namespace sutured::simulation {
namespace {

using geometry::Vec3;
using testing::kBlockTools;
using testing::kDriver;
using testing::kProbe;
using testing::tool_at;

constexpr double kStep_s = 0.004;

/// A needle held by a driver, 5 mm in the tissue, and a probe pressed in beside it.
class WarmStep : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!testing::HeapGuard::active()) GTEST_SKIP() << "sanitizers bring their own malloc";
    inputs_[kDriver] = tool_at(kTail, 0.0);
    step();
    inputs_[kDriver].jaw = 1.0;
    const testing::HeapGuard heap;
    for (double depth_m = 0.0; depth_m < 5e-3; depth_m += 4e-5) {
      inputs_[kDriver].position_m = kTail - Vec3(0, 0, depth_m);
      step();
    }
    ASSERT_GT(heap.allocations(), 0U);  // new vertices on the way: the guard does count
    inputs_[kProbe] = tool_at(Vec3(-0.004, 0.001, 0.0015));
    step();
    ASSERT_TRUE(sim_.needles()[0].tip_inside);
    ASSERT_GT(sim_.report().rows, 10);
    ASSERT_GT(sim_.report().contacts, 0);
    held_ = inputs_[kDriver].position_m;
  }

  void step() { sim_.step(inputs_, kStep_s); }

  /// Takes every tool round its loop once; returns how often the steps allocated.
  std::uint64_t allocations_of_a_round(double amplitude_m) {
    constexpr int kSteps = 100;
    std::uint64_t allocations = 0;
    for (int i = 0; i < kSteps; ++i) {
      const double angle = 2.0 * EIGEN_PI * i / kSteps;
      inputs_[kDriver].position_m =
          held_ + amplitude_m * Vec3(std::sin(angle), std::sin(2 * angle), std::sin(angle));
      inputs_[kProbe].position_m = Vec3(-0.004, 0.001, 0.0015 + amplitude_m * std::sin(angle));
      const testing::HeapGuard heap;
      step();
      allocations += heap.allocations();
    }
    return allocations;
  }

  const Vec3 kTail{0.0011, 0.0007, 0.0205};
  Simulation sim_{testing::block_scene()};
  std::vector<ToolInput> inputs_ = std::vector<ToolInput>(kBlockTools);
  Vec3 held_ = Vec3::Zero();
};

TEST_F(WarmStep, StandingStillAllocatesNothing) {
  (void)allocations_of_a_round(0.0);
  EXPECT_EQ(allocations_of_a_round(0.0), 0U);
}

TEST_F(WarmStep, MovingOverKnownVerticesAllocatesNothing) {
  for (int warming = 0; warming < 3; ++warming) (void)allocations_of_a_round(2e-4);
  EXPECT_EQ(allocations_of_a_round(2e-4), 0U);
}

TEST_F(WarmStep, BringingDisplacementsUpToDateAllocatesNothing) {
  sim_.update_displacements();
  step();
  const testing::HeapGuard heap;
  sim_.update_displacements();
  EXPECT_EQ(heap.allocations(), 0U);
}

TEST_F(WarmStep, ComputingStressAgainAllocatesNothing) {
  StressField field;
  sim_.compute_stress(field);
  const testing::HeapGuard heap;
  sim_.compute_stress(field);
  EXPECT_EQ(heap.allocations(), 0U);
}

}  // namespace
}  // namespace sutured::simulation
