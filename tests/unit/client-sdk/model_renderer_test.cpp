// SPDX-License-Identifier: GPL-3.0-or-later
// Forces rendered on the device's machine from models that arrive over the wire.
#include "model_renderer.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "support/heap_guard.hpp"
#include "support/spring_model.hpp"

namespace suture {
namespace {

using sutured::testing::spring_model;

constexpr std::int64_t kMs = 1'000'000;

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
      force = render(hand, rendering(), now_ns_);
    }
    return force;
  }

  Force render(const Hand& hand, const Force& server, std::int64_t now_ns) {
    return renderer_.render(hand, now_ns, server, false, now_ns);
  }

  ModelRenderer renderer_{DeviceLimits{}, 2.0};
  v1::HapticModel wire_ = spring_model(100.0);
  std::int64_t now_ns_ = 1000 * kMs;
};

TEST_F(ModelRendererTest, RendersTheModelInTheWorld) {
  const Force force = settle(hand_at(0.01));
  EXPECT_NEAR(force.force_n[0], -1.0, 1e-12);
  EXPECT_EQ(force.state, ForceState::kRendering);
  EXPECT_TRUE(force.touching);
  EXPECT_FALSE(force.holding);
}

TEST_F(ModelRendererTest, SaysThatTheJawHoldsSomething) {
  wire_.flags |= suture_v1_MODEL_HOLDING;
  EXPECT_TRUE(settle(hand_at(0.01)).holding);
}

TEST_F(ModelRendererTest, RisesByARampFromZero) {
  double last = 0.0;
  for (int i = 0; i < 250; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    const double now = -render(hand_at(0.01), rendering(), now_ns_).force_n[0];
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
  wire_.reference_orientation_xyzw[2] = wire_.reference_orientation_xyzw[3] = std::sqrt(0.5);
  wire_.stiffness[0] = wire_.bilateral_stiffness[0] = 0.0;  // nothing along the world's x
  const Force force = settle(hand_at(0.02, false));
  EXPECT_NEAR(force.force_n[0], -2.0, 1e-12);  // 0.5 × 0.02 m × 100 N/m × 2
  EXPECT_NEAR(force.force_n[1], 0.0, 1e-12);
}

TEST_F(ModelRendererTest, BlendsFromOneModelToTheNext) {
  settle(hand_at(0.01));
  const v1::HapticModel next = spring_model(120.0, 2);
  renderer_.receive(next, now_ns_);
  const double at_once = -render(hand_at(0.01), rendering(), now_ns_).force_n[0];
  EXPECT_NEAR(at_once, 1.0, 1e-12);  // no step at the swap
  const double later = -render(hand_at(0.01), rendering(), now_ns_ + 4 * kMs).force_n[0];
  EXPECT_NEAR(later, 1.2, 1e-12);
}

TEST_F(ModelRendererTest, GoesToZeroWhenModelsStopAndNeverSteps) {
  double last = -settle(hand_at(0.01)).force_n[0];
  for (int age = 1; age <= 140; ++age) {
    const Force force = render(hand_at(0.01), rendering(), now_ns_ + age * kMs);
    EXPECT_LE(std::abs(-force.force_n[0] - last), 1.5 / 25.0 + 1e-9) << age;  // 20 to 45 ms
    last = -force.force_n[0];
    if (age >= 45) {
      EXPECT_EQ(last, 0.0) << age;
    }
  }
  EXPECT_EQ(last, 0.0);
}

TEST_F(ModelRendererTest, TellsOneFaultWhereModelsComeAtTheEdgeOfTheirTime) {
  settle(hand_at(0.01));
  int begun = 0;
  bool stale = false;
  for (int i = 1; i <= 1000; ++i) {
    now_ns_ += kMs;
    if (i % 22 == 0) renderer_.receive(wire_, now_ns_);  // stale at 20 ms
    (void)render(hand_at(0.01), rendering(), now_ns_);
    const bool now = (renderer_.faults() & suture_v1_FAULT_MODEL_STALE) != 0;
    begun += now && !stale;
    stale = now;
  }
  EXPECT_EQ(begun, 1);
  settle(hand_at(0.01));
  EXPECT_EQ(renderer_.faults(), 0U);
}

TEST_F(ModelRendererTest, ObeysTheServersStop) {
  double last = -settle(hand_at(0.01)).force_n[0];
  Force stopped;
  stopped.state = ForceState::kStopped;
  Force force;
  for (int i = 1; i <= 31; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    force = render(hand_at(0.01), stopped, now_ns_);
    EXPECT_LE(last + force.force_n[0], 1.5 / 30.0 + 1e-9);
    last = -force.force_n[0];
  }
  EXPECT_EQ(last, 0.0);
  EXPECT_EQ(force.state, ForceState::kStopped);
}

TEST_F(ModelRendererTest, StaysWithinTheToolsLimits) {
  wire_ = spring_model(1e4);
  Force force = settle(hand_at(0.004));  // 40 N by the model
  EXPECT_NEAR(std::abs(force.force_n[0]), 3.0, 1e-9);
  EXPECT_NE(force.faults & suture_v1_FAULT_FORCE_LIMIT, 0U);
  Vector3 last = force.force_n;
  for (int i = 0; i < 100; ++i) {  // wildly to and fro
    now_ns_ += kMs;
    renderer_.receive(wire_, now_ns_);
    force = render(hand_at(i % 2 == 0 ? -0.004 : 0.004), rendering(), now_ns_);
    EXPECT_LE(std::abs(force.force_n[0] - last[0]), 0.5 + 1e-9);  // 500 N/s
    EXPECT_LE(std::abs(force.force_n[0]), 3.0 + 1e-9);
    last = force.force_n;
  }
}

TEST_F(ModelRendererTest, DropsModelsThatDoNotHoldTogether) {
  settle(hand_at(0.01));
  const std::vector<double> three(3, 1.0);
  const auto refused = [&](auto&& spoil) {
    v1::HapticModel bad = spring_model(1e6, 9);
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

/// A wall of 100 N/m pressed by 1 N, with friction across it.
struct RoughWall {
  std::vector<double> compliance{0.01, 0.0, 0.01}, jacobian = std::vector<double>(12),
                                                   offset{0.01, 0.005}, multiplier{1.0, 0.5},
                                                   multiplier_max{HUGE_VAL, 1.0}, slope{0.0, 0.5};
  std::vector<std::int32_t> normal{0, 0};
  v1::HapticModel wire = spring_model(0.0);

  RoughWall() {
    jacobian[1] = -1.0;
    jacobian[6] = 1.0;
    wire.bilateral_wrench[0] = 0.5;
    lend_rows();
  }
  void lend_rows() {
    lend(wire.compliance_m_per_n, std::span<const double>(compliance));
    lend(wire.jacobian, std::span<const double>(jacobian));
    lend(wire.offset_m, std::span<const double>(offset));
    lend(wire.multiplier_n, std::span<const double>(multiplier));
    lend(wire.multiplier_max_n, std::span<const double>(multiplier_max));
    lend(wire.bound_row, std::span<const std::int32_t>(normal));
    lend(wire.bound_slope, std::span<const double>(slope));
  }
};

TEST_F(ModelRendererTest, KeepsFrictionInTheConeOfItsNormalForce) {
  RoughWall wall;
  wire_ = wall.wire;
  Hand hand = hand_at(0.0);
  settle(hand);
  for (int i = 0; i < 50; ++i) {  // slides along it while it presses twice as hard
    hand.position_m[0] += 1e-3;
    hand.position_m[1] -= 0.01 / 50;
    renderer_.receive(wire_, now_ns_ += kMs);
    (void)render(hand, rendering(), now_ns_);
  }
  Force force;
  for (int i = 0; i < 10; ++i) {  // the cone is that of the millisecond before
    hand.position_m[0] += 1e-3;
    force = render(hand, rendering(), now_ns_ += kMs);
  }
  EXPECT_NEAR(force.force_n[1], 2.0, 1e-9);
  EXPECT_NEAR(force.force_n[0], -1.0, 1e-9);
}

TEST(ReceivedModel, IsCoupledToWhatTheHandFeelsOfIt) {
  const DeviceLimits device{.max_stiffness_n_per_m = 50.0};
  const auto stiffness_of = [&](double motion_scale, bool in_world) {
    v1::HapticModel wire = spring_model(100.0);
    wire.mapping.motion_scale = motion_scale;
    const auto received = std::make_unique<ReceivedModel>();
    EXPECT_TRUE(receive_model(wire, 1, device, *received, in_world));
    return received->model.bilateral_stiffness[0];
  };
  const double whole = stiffness_of(1.0, false);
  EXPECT_GT(stiffness_of(0.5, false), 1.2 * whole) << "a hand that is scaled down feels half of it";
  EXPECT_EQ(stiffness_of(0.5, true), whole) << "one that is in the world, all of it";
}

TEST(ReceivedModel, DampsTheHandNoMoreThanTheDeviceRenders) {
  const auto drag_of = [&](double max_damping_n_s_per_m, double motion_scale, bool in_world) {
    v1::HapticModel wire = spring_model(100.0);
    wire.slide_drag_n_s_per_m = 0.1;
    wire.slide_gradient[0] = 1.0;
    wire.slide_gradient[4] = 0.01;  // at an arm of 10 mm: twice as much
    wire.mapping.motion_scale = motion_scale;
    const auto received = std::make_unique<ReceivedModel>();
    EXPECT_TRUE(receive_model(wire, 1, {.max_damping_n_s_per_m = max_damping_n_s_per_m}, *received,
                              in_world));
    return received->model.slide_drag_n_s_per_m;
  };
  EXPECT_EQ(drag_of(0.0, 1.0, false), 0.1) << "a device that tells no limit";
  EXPECT_EQ(drag_of(0.15, 1.0, false), 0.0);
  EXPECT_EQ(drag_of(0.15, 0.5, false), 0.1) << "a hand that is scaled down feels half of it";
  EXPECT_EQ(drag_of(0.15, 0.5, true), 0.0) << "one that is in the world, all of it";
}

TEST_F(ModelRendererTest, DropsModelsWhoseBoundsFollowNothing) {
  const auto received = std::make_unique<ReceivedModel>();
  RoughWall wall;
  ASSERT_TRUE(receive_model(wall.wire, 1, {}, *received));
  EXPECT_EQ(received->model.bound_slope[1], 0.5);
  const auto refused = [&](auto&& spoil) {
    RoughWall bad;
    spoil(bad);
    bad.lend_rows();
    return !receive_model(bad.wire, 1, {}, *received);
  };
  EXPECT_TRUE(refused([](RoughWall& w) { w.normal[1] = 2; }));
  EXPECT_TRUE(refused([](RoughWall& w) { w.normal[1] = -1; }));
  EXPECT_TRUE(refused([](RoughWall& w) { w.normal.pop_back(); }));
  EXPECT_TRUE(refused([](RoughWall& w) { w.slope.pop_back(); }));
  EXPECT_TRUE(refused([](RoughWall& w) { w.slope[1] = -0.1; }));
  EXPECT_TRUE(refused([](RoughWall& w) { w.slope[1] = std::nan(""); }));
  EXPECT_TRUE(refused([](RoughWall& w) { w.slope[1] = HUGE_VAL; }));
}

TEST_F(ModelRendererTest, DropsAModelWhoseMultiplierHasNoRoomAtAll) {
  double compliance = 1e-3, zero = 0.0, slope = 0.0, jacobian[6] = {1.0};
  std::int32_t bound = 0;
  for (const double max_n : {-1.0, std::numeric_limits<double>::quiet_NaN()}) {
    double most = max_n;
    lend(wire_.compliance_m_per_n, std::span<const double>(&compliance, 1));
    lend(wire_.jacobian, std::span<const double>(jacobian));
    lend(wire_.offset_m, std::span<const double>(&zero, 1));
    lend(wire_.multiplier_n, std::span<const double>(&zero, 1));
    lend(wire_.multiplier_max_n, std::span<const double>(&most, 1));
    lend(wire_.bound_row, std::span<const std::int32_t>(&bound, 1));
    lend(wire_.bound_slope, std::span<const double>(&slope, 1));
    ReceivedModel received;
    EXPECT_FALSE(receive_model(wire_, 1, {}, received)) << max_n;
  }
}

TEST_F(ModelRendererTest, WaitsNoLongerThanASecondWhateverAModelAsksFor) {
  wire_.blend_ns = wire_.ramp_ns = wire_.stale_after_ns = std::numeric_limits<std::int64_t>::max();
  ReceivedModel received;
  ASSERT_TRUE(receive_model(wire_, 1, {}, received));
  EXPECT_EQ(received.blend_ns, 1000 * kMs);
  EXPECT_EQ(received.ramp_ns, 1000 * kMs);
  EXPECT_EQ(received.stale_after_ns, 1000 * kMs);
  EXPECT_GT(received.zero_after_ns, received.stale_after_ns);
  wire_.blend_ns = wire_.ramp_ns = wire_.stale_after_ns = std::numeric_limits<std::int64_t>::min();
  ASSERT_TRUE(receive_model(wire_, 1, {}, received));
  EXPECT_EQ(received.blend_ns, 0);
  EXPECT_EQ(received.ramp_ns, 1);
  EXPECT_EQ(received.stale_after_ns, 0);
}

TEST_F(ModelRendererTest, LetsNothingThroughThatIsNotFinite) {
  settle(hand_at(0.01));
  void (*const spoils[])(v1::HapticModel&) = {
      [](v1::HapticModel& m) { m.wrench[0] = m.bilateral_wrench[0] = std::nan(""); },
      [](v1::HapticModel& m) { m.stiffness[3] = std::numeric_limits<double>::infinity(); },
      [](v1::HapticModel& m) { m.reference_position_m[1] = std::nan(""); },
      [](v1::HapticModel& m) { m.slide_friction_n = std::nan(""); },
      [](v1::HapticModel& m) { m.slide_drag_n_s_per_m = std::nan(""); },
      [](v1::HapticModel& m) { m.mapping.position_m[2] = std::nan(""); },
  };
  for (const auto spoil : spoils) {
    // One is told, and passed over: what a needle's friction remembers is not touched by it.
    v1::HapticModel bad = wire_;
    spoil(bad);
    renderer_.receive(bad, now_ns_ += kMs);
    Force force = render(hand_at(0.01), rendering(), now_ns_);
    EXPECT_NEAR(force.force_n[0], -1.0, 1e-12);
    EXPECT_NE(force.faults & suture_v1_FAULT_MODEL_NOT_FINITE, 0U);
    renderer_.receive(wire_, now_ns_ += kMs);
    force = render(hand_at(0.01), rendering(), now_ns_);
    EXPECT_NEAR(force.force_n[0], -1.0, 1e-12);
    EXPECT_EQ(force.faults, 0U);
  }
  // Many: the last good one gets old.
  v1::HapticModel bad = wire_;
  spoils[0](bad);
  double last = 1.0;
  for (int i = 0; i < 50; ++i) {
    renderer_.receive(bad, now_ns_ += kMs);
    const double now = -render(hand_at(0.01), rendering(), now_ns_).force_n[0];
    EXPECT_LE(last - now, 1.5 / 25.0 + 1e-9);
    EXPECT_LE(now, last);
    last = now;
  }
  EXPECT_EQ(last, 0.0);
}

/// A needle that slides keeps its friction from model to model: one that is bad must not get in.
TEST_F(ModelRendererTest, KeepsTheFrictionOfASlidingNeedleThroughABadModel) {
  wire_.slide_twist[0] = 1.0;
  wire_.slide_stiffness = 100.0;
  wire_.slide_friction_n = -0.2;
  wire_.slide_drag_n_s_per_m = 2.0;
  settle(hand_at(0.001));
  v1::HapticModel bad = wire_;
  bad.slide_friction_n = bad.wrench[0] = std::nan("");
  renderer_.receive(bad, now_ns_ += kMs);
  (void)render(hand_at(0.001), rendering(), now_ns_);
  double most = 0.0;
  for (int i = 0; i < 300; ++i) {
    wire_.sequence_number++;
    renderer_.receive(wire_, now_ns_ += kMs);
    const Force force = render(hand_at(0.001 + 1e-5 * i), rendering(), now_ns_);
    most = std::max(most, std::abs(force.force_n[0]));
    EXPECT_EQ(force.state, ForceState::kRendering);
  }
  EXPECT_GT(most, 0.01);
}

// The server goes on saying that all is well: it may be a network away, or gone.
struct BadHand {
  const char* name;
  std::uint32_t fault;
  void (*spoil)(Hand&, int tick);
};

class RendererBadHand : public ModelRendererTest, public ::testing::WithParamInterface<BadHand> {};

TEST_P(RendererBadHand, EndsTheForceHereSmoothlyAndGivesItBack) {
  double last = -settle(hand_at(0.01)).force_n[0];
  for (int i = 1; i <= 60; ++i) {
    Hand hand = hand_at(0.01);
    GetParam().spoil(hand, i);
    renderer_.receive(wire_, now_ns_ += kMs);
    const Force force = render(hand, rendering(), now_ns_);
    EXPECT_LE(std::abs(last + force.force_n[0]), 1.5 / 30.0 + 1e-9) << i;
    EXPECT_EQ(force.state, ForceState::kFault);
    EXPECT_NE(force.faults & GetParam().fault, 0U);
    last = -force.force_n[0];
    if (i > 31) {
      EXPECT_EQ(last, 0.0) << i;
    }
  }
  for (int i = 0; i < 250; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    const double now = -render(hand_at(0.01), rendering(), now_ns_).force_n[0];
    EXPECT_LE(now - last, 1.5 / 200.0 + 1e-9);
    if (i < 19) {
      EXPECT_EQ(now, 0.0) << "20 ms of good hands come first";
    }
    last = now;
  }
  EXPECT_NEAR(last, 1.0, 1e-9);
  EXPECT_EQ(renderer_.faults(), 0U);
}

INSTANTIATE_TEST_SUITE_P(
    Faults, RendererBadHand,
    ::testing::Values(
        BadHand{"NotANumber", suture_v1_FAULT_POSE_NOT_FINITE,
                [](Hand& hand, int) { hand.position_m[1] = std::nan(""); }},
        BadHand{"BeyondTheWorld", suture_v1_FAULT_POSE_NOT_FINITE,
                [](Hand& hand, int) { hand.position_m[2] = -1e308; }},
        BadHand{"WrongQuaternion", suture_v1_FAULT_POSE_QUATERNION,
                [](Hand& hand, int) { hand.orientation_xyzw[3] = 0.5; }},
        BadHand{"Jaw", suture_v1_FAULT_POSE_JAW, [](Hand& hand, int) { hand.jaw = 2.0; }},
        BadHand{"Jumps", suture_v1_FAULT_POSE_JUMP,
                [](Hand& hand, int tick) { hand.position_m[0] += tick % 2 == 0 ? 0.0 : 0.1; }},
        BadHand{"ChangesItsFrame", suture_v1_FAULT_POSE_JUMP,
                [](Hand& hand, int tick) { hand.in_world = tick % 2 == 0; }}),
    [](const auto& fault) { return std::string(fault.param.name); });

TEST_F(ModelRendererTest, EndsTheForceOfAHandThatIsNotHeardOf) {
  settle(hand_at(0.01));
  const std::int64_t taken_ns = now_ns_;
  for (int age = 1; age <= 60; ++age) {
    renderer_.receive(wire_, now_ns_ += kMs);
    const Force force = renderer_.render(hand_at(0.01), taken_ns, rendering(), false, now_ns_);
    if (age <= 15) {
      EXPECT_NEAR(force.force_n[0], -1.0, 1e-12);
    }
    if (age >= 45) {
      EXPECT_EQ(force.force_n[0], 0.0) << age;
      EXPECT_NE(force.faults & suture_v1_FAULT_POSE_STALE, 0U);
    }
  }
}

TEST_F(ModelRendererTest, StopsForTheDeviceWithoutTheServersWord) {
  double last = -settle(hand_at(0.01)).force_n[0];
  for (int i = 1; i <= 60; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    const Force force = renderer_.render(hand_at(0.01), now_ns_, rendering(), true, now_ns_);
    EXPECT_LE(std::abs(last + force.force_n[0]), 1.5 / 30.0 + 1e-9);
    EXPECT_EQ(force.state, ForceState::kStopped);
    last = -force.force_n[0];
  }
  EXPECT_EQ(last, 0.0);
}

TEST_F(ModelRendererTest, FollowsAHandAtFourKilohertzWithoutAStepAtAnyModel) {
  settle(hand_at(0.01));
  double last = 1.0;
  for (int i = 1; i <= 4000; ++i) {  // a second: 5 mm to and fro at 2 Hz, a model every 4 ms
    now_ns_ += kMs / 4;
    const double t = 1e-9 * static_cast<double>(i * kMs / 4);
    const double x = 0.01 + 0.005 * std::sin(4.0 * M_PI * t);
    if (i % 16 == 0) {
      ++wire_.sequence_number;
      wire_.reference_position_m[0] = x;
      wire_.bilateral_wrench[0] = -100.0 * x;
      renderer_.receive(wire_, now_ns_);
    }
    const double now = -render(hand_at(x), rendering(), now_ns_).force_n[0];
    ASSERT_NEAR(now, 100.0 * x, 1e-9) << i;  // the same spring all the time: no lag, no blend
    ASSERT_LE(std::abs(now - last), 100.0 * 0.005 * 4.0 * M_PI * 0.25e-3 + 1e-9);
    last = now;
  }
  EXPECT_EQ(renderer_.faults(), 0U);
}

TEST_F(ModelRendererTest, SoftensWhatTheDeviceCannotRender) {
  ModelRenderer weak({.max_stiffness_n_per_m = 500.0}, 2.0);
  wire_ = spring_model(4000.0);
  Force force;
  for (int i = 0; i < 300; ++i) {
    weak.receive(wire_, now_ns_ += kMs);
    force = weak.render(hand_at(0.001), now_ns_, rendering(), false, now_ns_);
  }
  EXPECT_NEAR(force.force_n[0], -0.5, 1e-9);
  EXPECT_NEAR(settle(hand_at(0.0005)).force_n[0], -2.0, 1e-9) << "another device feels all of it";
}

TEST_F(ModelRendererTest, KeepsToTheDevicesLimits) {
  ModelRenderer weak({.max_force_n = 0.25, .max_force_slew_n_per_s = 50.0}, 2.0);
  double last = 0.0;
  for (int i = 0; i < 300; ++i) {
    weak.receive(wire_, now_ns_ += kMs);
    const Force force = weak.render(hand_at(0.01), now_ns_, rendering(), false, now_ns_);
    EXPECT_LE(std::abs(-force.force_n[0] - last), 0.05 + 1e-12);
    last = -force.force_n[0];
  }
  EXPECT_NEAR(last, 0.25, 1e-9);
}

// A spring that turns what pushes it: no tissue does that.
TEST_F(ModelRendererTest, EndsAForceThatGivesMoreEnergyThanItTook) {
  constexpr double kSkew = 200.0;
  wire_.bilateral_stiffness[1] = wire_.stiffness[1] = kSkew;
  wire_.bilateral_stiffness[6] = wire_.stiffness[6] = -kSkew;
  settle(hand_at(0.005));
  bool found = false;
  double last = 0.0, given_j = 0.0;
  for (int i = 0; i < 3000 && !found; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    Hand hand = hand_at(0.005);
    hand.position_m = {0.005 * std::cos(0.01 * i), 0.005 * std::sin(0.01 * i), 0.0};
    static_cast<void>(render(hand, rendering(), now_ns_));
    given_j = renderer_.energy().given_j();
    found = (renderer_.faults() & suture_v1_FAULT_ENERGY) != 0;
  }
  ASSERT_TRUE(found);
  // What a loop gives is 2 π r² × skew = 31 mJ; stored are 1.25 mJ.
  EXPECT_LT(given_j, 2 * 1.3e-3 + 3 * EnergyBound{}.energy_j);
  for (int i = 0; i < 40; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    last = render(hand_at(0.005), rendering(), now_ns_).force_n[0];
  }
  EXPECT_EQ(last, 0.0);
  settle(hand_at(0.005));
  EXPECT_EQ(renderer_.faults(), 0U) << "a hand at rest gets it back";
}

/// The assistant, felt by 40 N/m along x from where the model's step had it: at the origin.
class TwoTools : public ModelRendererTest {
 protected:
  TwoTools() {
    set_text(coupling_.tool, "assistant");
    coupling_.orientation_xyzw[3] = 1.0;
    coupling_.stiffness[0] = 40.0;
    lend(wire_.others, std::span<const v1::ToolCoupling>(&coupling_, 1));
  }
  void assistant_model(double offset_m, std::uint64_t used_pose) {
    v1::HapticModel model = spring_model(0.0, used_pose);
    set_text(model.tool, "assistant");
    model.pose_sequence = used_pose;
    model.mapping.position_m[0] = offset_m;
    model.mapping.motion_scale = 0.5;
    renderer_.others().receive(model);
  }
  void assistant_force(bool follows, std::uint64_t answered) {
    v1::ToolForce force{};
    force.tool_id = tool_id("assistant");
    force.pose_sequence = answered;
    if (follows) force.flags = suture_v1_FORCE_ENGAGED;
    renderer_.others().receive(force);
  }
  void assistant_hand(double x_m) {
    v1::ToolPose pose{};
    pose.tool_id = tool_id("assistant");
    pose.position_m[0] = x_m;
    pose.orientation_xyzw[3] = 1.0;
    renderer_.others().receive(pose);
  }
  double force_n() {
    renderer_.receive(wire_, now_ns_ += kMs);
    return render(hand_at(0.01), rendering(), now_ns_).force_n[0];
  }

  v1::ToolCoupling coupling_{};
};

TEST_F(TwoTools, FeelsTheOtherThroughItsMapping) {
  settle(hand_at(0.01));
  EXPECT_NEAR(force_n(), -1.0, 1e-12);  // nothing is known of it: it stands at its reference
  assistant_force(true, 5);
  assistant_model(0.001, 5);
  assistant_hand(0.004);  // in its device; 1 mm + 0.5 × 4 mm in the world
  EXPECT_NEAR(force_n(), -1.0 - 40.0 * 0.003, 1e-12);
  EXPECT_NEAR(force_n(), -1.0 - 40.0 * 0.003, 1e-12) << "silent, it stays where it was";
}

TEST_F(TwoTools, DoesNotFollowTheHandOfAToolThatStands) {
  settle(hand_at(0.01));
  assistant_force(true, 5);
  assistant_model(0.0, 5);
  assistant_hand(0.002);
  EXPECT_NEAR(force_n(), -1.0 - 40.0 * 0.001, 1e-12);
  assistant_force(false, 6);  // the clutch
  assistant_hand(0.2);
  EXPECT_NEAR(force_n(), -1.0 - 40.0 * 0.001, 1e-12);
  assistant_force(true, 7);  // let go, but the mapping that goes with it has not come
  assistant_hand(0.2);
  EXPECT_NEAR(force_n(), -1.0 - 40.0 * 0.001, 1e-12);
  assistant_model(-0.099, 7);
  assistant_hand(0.2);
  EXPECT_NEAR(force_n(), -1.0 - 40.0 * 0.001, 1e-12);
}

TEST_F(TwoTools, DropsACouplingThatDoesNotFitItsModel) {
  const auto received = std::make_unique<ReceivedModel>();
  EXPECT_TRUE(receive_model(wire_, 1, {}, *received));
  EXPECT_EQ(received->model.other_count, 1);
  EXPECT_EQ(received->others[0], tool_id("assistant"));
  const std::vector<double> stray(6);
  lend(coupling_.jacobian, std::span<const double>(stray));
  EXPECT_FALSE(receive_model(wire_, 1, {}, *received));
}

TEST_F(ModelRendererTest, TakesLongerOverAChangeOfTheWorldThanOverASwap) {
  const auto largest_step_n = [this](bool changed, bool overtaken, double towards_n) {
    double last = settle(hand_at(0.01)).force_n[0], largest = 0.0;
    wire_.bilateral_wrench[0] = towards_n;
    ++wire_.sequence_number;
    if (changed) wire_.changed_sequence = wire_.sequence_number;
    for (int i = 0; i < 40; ++i) {
      if (i % 4 == 0) {
        renderer_.receive(wire_, now_ns_);
        ++wire_.sequence_number;
        if (overtaken) renderer_.receive(wire_, now_ns_);
      }
      const double now = render(hand_at(0.01), rendering(), now_ns_ += kMs).force_n[0];
      largest = std::max(largest, std::abs(now - last));
      last = now;
    }
    EXPECT_NEAR(last, -1.0 + towards_n, 1e-12);
    return largest;
  };
  const double at_a_swap = largest_step_n(false, false, 0.5);
  const double at_a_change = largest_step_n(true, false, 0.0);
  // A smoothstep over 4 and 30 ms is at most 1.5 times as steep as its mean.
  EXPECT_LE(at_a_swap, 0.5 * 1.5 / 4.0 + 1e-9);
  EXPECT_LE(at_a_change, 0.5 * 1.5 / 30.0 + 1e-9);
  EXPECT_LE(largest_step_n(true, true, 0.5), 0.5 * 1.5 / 30.0 + 1e-9);
}

/// The world is reset or replaced, and pushes harder, from elsewhere.
class AnotherWorld : public ModelRendererTest {
 protected:
  void replace_world() {
    wire_ = spring_model(200.0);
    wire_.epoch = 2;
    wire_.bilateral_wrench[1] = wire_.wrench[1] = 2.0;
  }
};

TEST_F(AnotherWorld, IsFeltOnceTheOldOneHasFadedAsItWas) {
  double last = -settle(hand_at(0.01)).force_n[0];
  replace_world();
  Force force;
  for (int i = 0; i < 31; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    ++wire_.sequence_number;
    force = render(hand_at(0.01), rendering(), now_ns_);
    EXPECT_LE(-force.force_n[0], last + 1e-12) << i;
    EXPECT_LE(last + force.force_n[0], 1.5 / 30.0 + 1e-9) << i;
    EXPECT_EQ(force.force_n[1], 0.0) << i;
    last = -force.force_n[0];
  }
  EXPECT_EQ(last, 0.0);
  EXPECT_EQ(force.state, ForceState::kRamping);
  for (int i = 0; i < 250; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    force = render(hand_at(0.01), rendering(), now_ns_);
    EXPECT_LE(std::abs(last + force.force_n[0]), 2.0 * 1.5 / 200.0 + 1e-9) << i;
    last = -force.force_n[0];
  }
  EXPECT_NEAR(force.force_n[0], -2.0, 1e-9);
  EXPECT_NEAR(force.force_n[1], 2.0, 1e-9);
  EXPECT_EQ(force.state, ForceState::kRendering);
}

/// What was on its way to the hand, held up by the slew, is of the old world too.
TEST_F(AnotherWorld, LetsNothingMoreOfTheOldOneReachTheHand) {
  wire_.max_force_slew_n_per_s = 100.0;
  double last = -settle(hand_at(0.001)).force_n[0];
  for (int i = 1; i <= 8; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    last = -render(hand_at(0.001 + 0.002 * i), rendering(), now_ns_).force_n[0];
  }
  ASSERT_NEAR(last, 0.9, 1e-9) << "of 1.7 N";
  replace_world();
  wire_.max_force_slew_n_per_s = 100.0;
  for (int i = 0; i < 31; ++i) {
    renderer_.receive(wire_, now_ns_ += kMs);
    const Force force = render(hand_at(0.017), rendering(), now_ns_);
    const double now = std::hypot(force.force_n[0], force.force_n[1]);
    EXPECT_LE(now, last + 1e-12) << i;
    EXPECT_LE(last - now, 0.1 + 1e-9) << i;
    last = now;
  }
  EXPECT_EQ(last, 0.0);
}

/// Its mapping and its limits are its own: nothing of them reaches what fades.
TEST_F(AnotherWorld, MapsOnlyItsOwnForces) {
  const double felt = -settle(hand_at(0.01)).force_n[0];
  replace_world();
  wire_.mapping.force_scale = 5.0;
  wire_.max_force_slew_n_per_s = 100.0;
  double last = felt;
  int ticks = 0;
  while (last > 0.0 && ++ticks < 60) {
    renderer_.receive(wire_, now_ns_ += kMs);
    const double now = -render(hand_at(0.01), rendering(), now_ns_).force_n[0];
    ASSERT_LE(now, last + 1e-12);
    ASSERT_LE(last - now, 0.1 + 1e-9);
    last = now;
  }
  EXPECT_LE(ticks, 35);
}

TEST_F(ModelRendererTest, NeitherAllocatesNorLocks) {
  if (!sutured::testing::HeapGuard::active()) GTEST_SKIP() << "sanitizers bring their own malloc";
  settle(hand_at(0.01));
  ModelRenderer weak({.max_stiffness_n_per_m = 50.0}, 2.0);
  const sutured::testing::HeapGuard guard;
  settle(hand_at(0.01));
  for (int i = 0; i < 100; ++i) {
    weak.receive(wire_, now_ns_ += kMs);
    static_cast<void>(
        weak.render(hand_at(i == 50 ? std::nan("") : 0.01), now_ns_, rendering(), i > 80, now_ns_));
  }
  EXPECT_EQ(guard.allocations(), 0U);
  EXPECT_EQ(guard.locks(), 0U);
}

}  // namespace
}  // namespace suture
