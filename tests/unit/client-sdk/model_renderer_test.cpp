// SPDX-License-Identifier: GPL-3.0-or-later
// Forces rendered on the device's machine from models that arrive over the wire.
#include "model_renderer.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "support/heap_guard.hpp"

namespace suture {
namespace {

constexpr std::int64_t kMs = 1'000'000;

/// A spring of `stiffness` to the world's origin in all directions, as a model.
v1::HapticModel spring(double stiffness_n_per_m, std::uint64_t sequence = 1) {
  v1::HapticModel wire{};
  set_text(wire.tool, "driver");
  wire.epoch = 1;
  wire.sequence_number = sequence;
  wire.flags = suture_v1_MODEL_TOUCHING | suture_v1_MODEL_ENGAGED;
  wire.reference_orientation_xyzw[3] = 1.0;
  for (int i = 0; i < 3; ++i) {
    wire.stiffness[7 * i] = wire.bilateral_stiffness[7 * i] = stiffness_n_per_m;
  }
  wire.radius_m = std::numeric_limits<double>::infinity();
  wire.norm_length_m = 0.01;
  wire.max_force_n = 3.0;
  wire.max_torque_nm = 0.1;
  wire.max_force_slew_n_per_s = 500.0;
  wire.max_torque_slew_nm_per_s = 15.0;
  wire.stale_after_ns = 20 * kMs;
  wire.blend_ns = 4 * kMs;
  wire.ramp_ns = 30 * kMs;
  wire.mapping.orientation_xyzw[3] = wire.mapping.tool_orientation_xyzw[3] = 1.0;
  wire.mapping.motion_scale = wire.mapping.force_scale = 1.0;
  return wire;
}

Force rendering() {
  Force server;
  server.state = ForceState::kRendering;
  return server;
}

Hand hand_at(double x_m, bool in_world = true) {
  Hand hand;
  hand.position_m = {x_m, 0.0, 0.0};
  hand.in_world = in_world;
  return hand;
}

class ModelRendererTest : public ::testing::Test {
 protected:
  /// Ticks at 1 kHz with a still hand until the gain is up.
  Force settle(const Hand& hand) {
    Force force;
    for (int i = 0; i < 300; ++i) {
      renderer_.receive(wire_, now_ns_ += kMs);
      force = renderer_.render(hand, rendering(), false, now_ns_);
    }
    return force;
  }

  ModelRenderer renderer_{DeviceLimits{}, 2.0};
  v1::HapticModel wire_ = spring(100.0);
  std::int64_t now_ns_ = 1000 * kMs;
};

TEST_F(ModelRendererTest, RendersTheModelInTheWorld) {
  const Force force = settle(hand_at(0.01));
  EXPECT_NEAR(force.force_n[0], -1.0, 1e-12);
  EXPECT_EQ(force.state, ForceState::kRendering);
  EXPECT_TRUE(force.touching);
}

TEST_F(ModelRendererTest, RisesByARampFromZero) {
  double last = 0.0;
  for (int i = 0; i < 250; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    const double now = -renderer_.render(hand_at(0.01), rendering(), false, now_ns_).force_n[0];
    EXPECT_GE(now, last - 1e-12);
    EXPECT_LE(now - last, 1.5 / 200.0 + 1e-9);  // smoothstep over 200 ms
    last = now;
  }
  EXPECT_NEAR(last, 1.0, 1e-9);
}

TEST_F(ModelRendererTest, MapsAndScalesADeviceFrame) {
  // The device's x is the world's y; hands move the tool by half, and feel twice the force.
  wire_.mapping.orientation_xyzw[2] = wire_.mapping.orientation_xyzw[3] = std::sqrt(0.5);
  wire_.mapping.motion_scale = 0.5;
  wire_.mapping.force_scale = 2.0;
  wire_.stiffness[0] = wire_.bilateral_stiffness[0] = 0.0;  // nothing along the world's x
  const Force force = settle(hand_at(0.02, false));
  EXPECT_NEAR(force.force_n[0], -2.0, 1e-12);  // 0.5 × 0.02 m × 100 N/m × 2
  EXPECT_NEAR(force.force_n[1], 0.0, 1e-12);
}

TEST_F(ModelRendererTest, BlendsFromOneModelToTheNext) {
  settle(hand_at(0.01));
  const v1::HapticModel next = spring(120.0, 2);
  renderer_.receive(next, now_ns_);
  const double at_once = -renderer_.render(hand_at(0.01), rendering(), false, now_ns_).force_n[0];
  EXPECT_NEAR(at_once, 1.0, 1e-12);  // no step at the swap
  const double later =
      -renderer_.render(hand_at(0.01), rendering(), false, now_ns_ + 4 * kMs).force_n[0];
  EXPECT_NEAR(later, 1.2, 1e-12);
}

TEST_F(ModelRendererTest, GoesToZeroWhenModelsStopAndNeverSteps) {
  double last = -settle(hand_at(0.01)).force_n[0];
  for (int age = 1; age <= 140; ++age) {
    const Force force = renderer_.render(hand_at(0.01), rendering(), false, now_ns_ + age * kMs);
    EXPECT_LE(std::abs(-force.force_n[0] - last), 1.5 / 25.0 + 1e-9) << age;  // 20 to 45 ms
    last = -force.force_n[0];
    if (age >= 45) {
      EXPECT_EQ(last, 0.0) << age;
    }
  }
  EXPECT_EQ(last, 0.0);
}

TEST_F(ModelRendererTest, ObeysTheServersStop) {
  double last = -settle(hand_at(0.01)).force_n[0];
  Force stopped;
  stopped.state = ForceState::kStopped;
  Force force;
  for (int i = 1; i <= 31; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    force = renderer_.render(hand_at(0.01), stopped, false, now_ns_);
    EXPECT_LE(last + force.force_n[0], 1.5 / 30.0 + 1e-9);
    last = -force.force_n[0];
  }
  EXPECT_EQ(last, 0.0);
  EXPECT_EQ(force.state, ForceState::kStopped);
}

TEST_F(ModelRendererTest, StaysWithinTheToolsLimits) {
  wire_ = spring(1e4);
  Force force = settle(hand_at(0.004));  // 40 N by the model
  EXPECT_NEAR(std::abs(force.force_n[0]), 3.0, 1e-9);
  EXPECT_NE(force.faults & suture_v1_FAULT_FORCE_LIMIT, 0U);
  Vector3 last = force.force_n;
  for (int i = 0; i < 100; ++i) {  // wildly to and fro
    now_ns_ += kMs;
    renderer_.receive(wire_, now_ns_);
    force = renderer_.render(hand_at(i % 2 == 0 ? -0.004 : 0.004), rendering(), false, now_ns_);
    EXPECT_LE(std::abs(force.force_n[0] - last[0]), 0.5 + 1e-9);  // 500 N/s
    EXPECT_LE(std::abs(force.force_n[0]), 3.0 + 1e-9);
    last = force.force_n;
  }
}

TEST_F(ModelRendererTest, DropsModelsThatDoNotHoldTogether) {
  settle(hand_at(0.01));
  const std::vector<double> three(3, 1.0);
  const auto refused = [&](auto&& spoil) {
    v1::HapticModel bad = spring(1e6, 9);
    spoil(bad);
    ReceivedModel received;
    return !receive_model(bad, 1, {}, received);
  };
  EXPECT_TRUE(refused([&](auto& m) { lend(m.offset_m, std::span<const double>(three)); }));
  EXPECT_TRUE(refused([&](auto& m) { lend(m.jacobian, std::span<const double>(three)); }));
  EXPECT_TRUE(refused([](auto& m) { m.reference_orientation_xyzw[3] = 2.0; }));
  EXPECT_TRUE(refused([](auto& m) { m.mapping.motion_scale = 0.0; }));
  EXPECT_TRUE(refused([](auto& m) { m.max_force_n = std::nan(""); }));
  EXPECT_FALSE(refused([](auto&) {}));
}

TEST_F(ModelRendererTest, LetsNothingThroughThatIsNotFinite) {
  settle(hand_at(0.01));
  v1::HapticModel bad = spring(100.0, 2);
  bad.wrench[0] = bad.bilateral_wrench[0] = std::nan("");
  renderer_.receive(bad, now_ns_ += kMs);
  for (int i = 0; i < 10; ++i) {
    const Force force = renderer_.render(hand_at(0.01), rendering(), false, now_ns_ += kMs);
    for (const double f : force.force_n) EXPECT_TRUE(std::isfinite(f));
  }
}

TEST_F(ModelRendererTest, AllocatesNothing) {
  if (!sutured::testing::HeapGuard::active()) GTEST_SKIP() << "sanitizers bring their own malloc";
  settle(hand_at(0.01));
  const sutured::testing::HeapGuard guard;
  settle(hand_at(0.01));
  EXPECT_EQ(guard.allocations(), 0U);
}

}  // namespace
}  // namespace suture
