// SPDX-License-Identifier: GPL-3.0-or-later
// The SDK's device against the server's end of the protocol, over real DDS.
#include "suture/device.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <limits>
#include <thread>

#include "support/spring_model.hpp"
#include "support/spring_server.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using std::chrono::milliseconds;
using sutured::testing::eventually;
using sutured::testing::own_session;
using sutured::testing::spring_model;
using sutured::testing::SpringServer;
using ::testing::HasSubstr;

DeviceOptions device_options() {
  DeviceOptions options;
  options.domain = own_session().domain;
  options.session = own_session().session;
  options.tool = "driver";
  options.timeout = milliseconds(10'000);
  return options;
}

SpringServer::Options server_options() {
  SpringServer::Options options;
  options.session = own_session();
  return options;
}

Error error_of(const DeviceOptions& options) {
  try {
    const Device device(options);
  } catch (const Error& error) {
    return error;
  }
  ADD_FAILURE() << "no error";
  return {ErrorCode::kBadInput, "", ""};
}

TEST(Device, FeelsTheForceThatAnswersItsHand) {
  SpringServer server(server_options());
  Device device(device_options());
  Hand hand;
  hand.position_m = {0.01, 0.0, -0.02};
  const std::uint64_t sequence = device.write(hand);
  EXPECT_EQ(sequence, 1U);
  const std::optional<Force> force = device.read_after(sequence, std::chrono::seconds(10));
  ASSERT_TRUE(force);
  EXPECT_EQ(force->hand_sequence, 1U);
  EXPECT_DOUBLE_EQ(force->force_n[0], -1.0);
  EXPECT_DOUBLE_EQ(force->force_n[2], 2.0);
  EXPECT_EQ(force->state, ForceState::kRendering);
  EXPECT_GT(force->round_trip_ns, 0);
}

TEST(Device, SendsAllOfTheHand) {
  SpringServer server(server_options());
  Device device(device_options());
  Hand hand;
  hand.position_m = {1.0, 2.0, 3.0};
  hand.orientation_xyzw = {0.5, 0.5, 0.5, 0.5};
  hand.jaw = 0.25;
  hand.buttons = 5;
  hand.in_world = true;
  hand.stop = true;
  hand.linear_velocity_m_per_s = {0.1, 0.2, 0.3};
  ASSERT_TRUE(device.read_after(device.write(hand), std::chrono::seconds(10)));
  const v1::ToolPose pose = server.last_pose();
  EXPECT_EQ(pose.tool_id, tool_id("driver"));
  EXPECT_EQ(pose.position_m[2], 3.0);
  EXPECT_EQ(pose.orientation_xyzw[0], 0.5);
  EXPECT_EQ(pose.jaw, 0.25F);
  EXPECT_EQ(pose.buttons, 5U);
  EXPECT_EQ(pose.flags, std::uint32_t{suture_v1_POSE_IN_WORLD | suture_v1_POSE_STOP});
  EXPECT_EQ(pose.linear_velocity_m_per_s[1], 0.2F);
  EXPECT_TRUE(std::isnan(pose.angular_velocity_rad_per_s[0]));
  EXPECT_EQ(pose.epoch, 1U);
}

TEST(Device, RunsTheCallbackUntilItReturnsNothing) {
  SpringServer server(server_options());
  Device device(device_options());
  int ticks = 0;
  std::chrono::nanoseconds total{};
  device.run([&](const Force&, std::chrono::nanoseconds elapsed) -> std::optional<Hand> {
    total += elapsed;
    if (++ticks > 50) return std::nullopt;
    return Hand{};
  });
  EXPECT_EQ(ticks, 51);
  EXPECT_GE(total, milliseconds(50));  // an absolute clock is never early
  EXPECT_EQ(device.statistics().hands_written, 50U);
}

TEST(Device, StopsFromAnotherThread) {
  SpringServer server(server_options());
  Device device(device_options());
  std::atomic<bool> running{false};
  std::thread other([&] {
    EXPECT_TRUE(eventually([&] { return running.load(); }));
    device.stop();
  });
  device.run([&](const Force&, std::chrono::nanoseconds) {
    running = true;
    return std::optional(Hand{});
  });
  other.join();
}

TEST(Device, CountsWhatItExchanged) {
  SpringServer server(server_options());
  std::atomic<int> heard{0};
  DeviceOptions options = device_options();
  options.on_force = [&](const Force&) { ++heard; };
  Device device(options);
  for (int i = 0; i < 100; ++i) {
    Hand hand;
    hand.position_m = {1e-4 * i, 0.0, 0.0};
    ASSERT_TRUE(device.read_after(device.write(hand), std::chrono::seconds(10)));
  }
  const DeviceStatistics counts = device.statistics();
  EXPECT_EQ(counts.hands_written, 100U);
  EXPECT_EQ(counts.forces_received, 100U);
  EXPECT_EQ(counts.hands_unanswered, 0U);
  EXPECT_EQ(counts.out_of_order, 0U);
  EXPECT_EQ(heard, 100);
  EXPECT_NEAR(counts.peak_force_n, 0.99, 1e-12);
  EXPECT_LE(counts.round_trip_p50_ns, counts.round_trip_p99_ns);
  EXPECT_LE(counts.round_trip_p99_ns, counts.round_trip_max_ns);
}

TEST(Device, TakesTheForceToZeroWhenTheServerFallsSilent) {
  SpringServer server(server_options());
  Device device(device_options());
  Hand hand;
  hand.position_m = {0.01, 0.0, 0.0};
  ASSERT_TRUE(device.read_after(device.write(hand), std::chrono::seconds(10)));
  server.set_silent(true);
  EXPECT_TRUE(eventually([&] {
    const Force force = device.read();
    return force.force_n[0] == 0.0 && force.state == ForceState::kServerSilent;
  }));
}

TEST(Device, EndsItsRunWhenTheServerStaysSilent) {
  SpringServer server(server_options());
  DeviceOptions options = device_options();
  options.give_up_after = milliseconds(100);
  Device device(options);
  server.set_silent(true);
  try {
    device.run([](const Force&, std::chrono::nanoseconds) { return std::optional(Hand{}); });
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kNoServer);
  }
}

TEST(Device, PassesNoNonsenseToTheHand) {
  SpringServer server(server_options());
  Device device(device_options());
  server.set_nonsense(true);
  const std::optional<Force> force = device.read_after(device.write({}), std::chrono::seconds(10));
  ASSERT_TRUE(force);
  EXPECT_EQ(force->force_n, Vector3{});
  EXPECT_EQ(force->state, ForceState::kFault);
}

/// Whoever renders: the server's own limits may not be the device's yet, or not be kept.
TEST(Device, KeepsToItsOwnLimitsWhateverTheServerSends) {
  SpringServer server(server_options());
  DeviceOptions options = device_options();
  options.limits.max_force_n = 0.2;
  options.limits.max_force_slew_n_per_s = 20.0;
  Device device(options);
  Hand hand;
  hand.position_m = {0.01, 0.0, 0.0};
  double most_n = 0.0, before_n = 0.0;
  auto then = std::chrono::steady_clock::now();
  EXPECT_TRUE(eventually([&] {
    device.write(hand);
    const double now_n = std::abs(device.read().force_n[0]);
    const auto now = std::chrono::steady_clock::now();
    const double elapsed_s = std::chrono::duration<double>(now - then).count();
    if (before_n > 0.0) {
      EXPECT_LE(now_n - before_n, 20.0 * elapsed_s + 1e-3);
    }
    most_n = std::max(most_n, now_n);
    before_n = now_n;
    then = now;
    return now_n >= 0.2 - 1e-12;
  }));
  EXPECT_NEAR(most_n, 0.2, 1e-12);
}

TEST(Device, FeelsNothingOfForcesForAnother) {
  SpringServer server(server_options());
  Device device(device_options());
  Guid other{};
  other.fill(7);
  server.set_holder(other);
  Hand hand;
  hand.position_m = {0.01, 0.0, 0.0};
  EXPECT_TRUE(eventually([&] {
    device.write(hand);
    EXPECT_EQ(device.read().force_n, Vector3{});
    return device.tool_in_use();
  }));
  try {
    device.run([&](const Force&, std::chrono::nanoseconds) { return std::optional(hand); });
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kToolInUse);
  }
}

TEST(Device, RendersItselfFromTheServersModels) {
  SpringServer server(server_options());  // 100 N/m, by ToolForce
  const Participant participant(own_session(), Channel::kControl);
  Writer<v1::HapticModel> models(participant);
  DeviceOptions options = device_options();
  options.render = Render::kDevice;
  Device device(options);
  ASSERT_TRUE(eventually([&] { return models.matched() == 1; }));
  Hand hand;
  hand.in_world = true;
  hand.position_m = {0.01, 0.0, 0.0};
  ASSERT_TRUE(device.read_after(device.write(hand), std::chrono::seconds(10)));
  EXPECT_EQ(server.last_pose().flags & suture_v1_POSE_RENDER_DEVICE,
            std::uint32_t{suture_v1_POSE_RENDER_DEVICE});

  // 50 N/m: another answer than the server's, to tell them apart.
  v1::HapticModel model = spring_model(50.0, 0);
  set_guid(model.device, server.last_sender());
  model.stale_after_ns = 10'000'000'000;
  model.blend_ns = 1'000'000;
  EXPECT_TRUE(eventually([&] {
    ++model.sequence_number;
    models.write(model);
    device.write(hand);
    return std::abs(device.read().force_n[0] + 0.5) < 1e-9;
  })) << device.read().force_n[0];
  Hand elsewhere = hand;  // felt without being sent
  elsewhere.position_m[0] = 0.02;
  EXPECT_TRUE(eventually([&] {
    device.write(hand);
    return std::abs(device.feel(elsewhere).force_n[0] + 1.0) < 1e-9;
  }));
}

TEST(Device, SaysGoodbye) {
  SpringServer server(server_options());
  {
    Device device(device_options());
    ASSERT_TRUE(device.read_after(device.write({}), std::chrono::seconds(10)));
  }
  EXPECT_TRUE(eventually([&] { return server.matched_devices() == 0; }));
  EXPECT_EQ(server.goodbyes(), 1);
}

TEST(Connecting, NamesTheMissingServer) {
  DeviceOptions options = device_options();
  options.timeout = milliseconds(50);
  const Error error = error_of(options);
  EXPECT_EQ(error.code(), ErrorCode::kNoServer);
  EXPECT_THAT(error.cause(), HasSubstr("domain " + std::to_string(options.domain)));
  EXPECT_THAT(error.mend(), HasSubstr("sutured serve"));
}

TEST(Connecting, NamesTheSessionInWhichAServerDoesAnswer) {
  SpringServer server(server_options());
  {  // once it is found in its session, it will be seen from another
    const Device device(device_options());
  }
  DeviceOptions options = device_options();
  options.session = "elsewhere";
  options.timeout = milliseconds(500);
  const Error error = error_of(options);
  EXPECT_EQ(error.code(), ErrorCode::kNoServer);
  EXPECT_THAT(error.cause(), HasSubstr(own_session().session));
}

TEST(Connecting, NamesAnotherProtocolVersion) {
  SpringServer::Options newer = server_options();
  newer.protocol_version = 2;
  SpringServer server(newer);
  const Error error = error_of(device_options());
  EXPECT_EQ(error.code(), ErrorCode::kVersionMismatch);
  EXPECT_THAT(error.cause(), HasSubstr("protocol version 2"));
  EXPECT_EQ(error.mend(), "update this client");
}

TEST(Connecting, NamesAnUnknownToolAndTheKnownOnes) {
  SpringServer::Options options = server_options();
  options.tools = {"left", "right"};
  SpringServer server(options);
  const Error error = error_of(device_options());
  EXPECT_EQ(error.code(), ErrorCode::kUnknownTool);
  EXPECT_THAT(error.mend(), HasSubstr("left, right"));
}

TEST(Connecting, NamesAToolInUse) {
  SpringServer server(server_options());
  Guid other{};
  other.fill(7);
  server.publish_status(other);
  DeviceOptions options = device_options();
  options.timeout = milliseconds(500);
  EXPECT_EQ(error_of(options).code(), ErrorCode::kToolInUse);
}

TEST(Connecting, WaitsForADeviceThatHasJustLeft) {
  SpringServer server(server_options());
  Guid other{};
  other.fill(7);
  server.publish_status(other);
  std::thread leaving([&] { server.publish_status(); });
  const Device device(device_options());
  leaving.join();
  EXPECT_EQ(device.scene(), "spring");
  EXPECT_EQ(device.max_force_n(), 3.3);
}

TEST(Connecting, RefusesAnOddDomain) {
  DeviceOptions options = device_options();
  options.domain = 1;
  EXPECT_EQ(error_of(options).code(), ErrorCode::kBadInput);
}

/// A spring of 150 N/m, where the server's own forces are of one of 100 N/m.
v1::HapticModel stiffer_spring(const Guid& device, std::uint64_t sequence) {
  v1::HapticModel wire = spring_model(150.0, sequence);
  set_guid(wire.device, device);
  wire.max_force_slew_n_per_s = 200.0;
  return wire;
}

double norm_of(const Force& force) {
  return std::hypot(force.force_n[0], force.force_n[1], force.force_n[2]);
}

/// A hand at 10 mm, where the server's spring gives 1 N and the models', rendered by the device,
/// 1.5 N, and the steepest change that it feels.
class HandOver : public ::testing::Test {
 protected:
  HandOver() : models_(participant_), rendered_(participant_) {
    hand_.position_m = {0.01, 0.0, 0.0};
    hand_.in_world = true;
  }
  /// A tick; every fourth brings a model.
  void tick() {
    std::this_thread::sleep_for(milliseconds(1));
    const std::uint64_t written = device_.write(hand_);
    if (written % 4 == 0) models_.write(stiffer_spring(server_.last_sender(), ++sequence_));
    read_from_ns_ = monotonic_ns();
    const Force force = device_.read();
    const std::int64_t now_ns = monotonic_ns();
    force_n_ = -force.force_n[0];
    if (force.sequence == 0) return;
    // Until the end of this call since the beginning of the last: at least what the SDK saw.
    if (last_ns_ != 0)
      steepest_n_per_s_ = std::max(steepest_n_per_s_, std::abs(force_n_ - last_n_) * 1e9 /
                                                          static_cast<double>(now_ns - last_ns_));
    last_n_ = force_n_;
    last_ns_ = read_from_ns_;
  }
  bool play_until(double newtons, Render render) {
    return eventually([&] {
      tick();
      return std::abs(force_n_ - newtons) < 1e-9 && device_.renders() == render;
    });
  }

  SpringServer server_{server_options()};
  Participant participant_{own_session(), Channel::kControl};
  Writer<v1::HapticModel> models_;
  Reader<v1::ToolRendered> rendered_;
  Device device_{device_options()};
  Hand hand_;
  double last_n_ = 0.0, force_n_ = 0.0, steepest_n_per_s_ = 0.0;
  std::int64_t last_ns_ = 0, read_from_ns_ = 0;  // when the last reads began: with a force; any
  std::uint64_t sequence_ = 0;
};

TEST_F(HandOver, InBothDirectionsIsWithoutAStep) {
  ASSERT_TRUE(play_until(1.0, Render::kServer));
  for (int round = 0; round < 2; ++round) {
    steepest_n_per_s_ = 0.0;
    device_.set_render(Render::kDevice);
    ASSERT_TRUE(play_until(1.5, Render::kDevice));
    // Half a newton within 60 ms by a smoothstep: 1.5 times the mean.
    EXPECT_LE(steepest_n_per_s_, 1.5 * 0.5 / 0.060 * 1.05);
    EXPECT_GT(steepest_n_per_s_, 0.0);
    EXPECT_EQ(server_.last_pose().flags & suture_v1_POSE_RENDER_DEVICE,
              std::uint32_t{suture_v1_POSE_RENDER_DEVICE});
    bool told = false;
    EXPECT_TRUE(eventually([&] {
      tick();
      rendered_.take_each([&](const v1::ToolRendered& wire, const SampleInfo& info) {
        told |= info.valid && wire.tool_id == tool_id("driver") && wire.model_sequence > 0 &&
                std::abs(wire.force_n[0] + 1.5) < 1e-9;
      });
      return told;
    }));
    steepest_n_per_s_ = 0.0;
    device_.set_render(Render::kServer);
    ASSERT_TRUE(play_until(1.0, Render::kServer));
    EXPECT_LE(steepest_n_per_s_, 1.5 * 0.5 / 0.060 * 1.05);
    tick();
    EXPECT_TRUE(eventually(
        [&] { return (server_.last_pose().flags & suture_v1_POSE_RENDER_DEVICE) == 0; }));
  }
}

/// A device that asked for no force for half a second has let go: what it felt before comes back
/// in no hand-over, but the server's force from zero.
TEST_F(HandOver, AfterARestBeginsAtZero) {
  device_.set_render(Render::kDevice);
  ASSERT_TRUE(play_until(1.5, Render::kDevice));
  device_.set_render(Render::kServer);  // which begins with the next force
  const std::int64_t rests_ns = monotonic_ns();
  ASSERT_TRUE(eventually([&] { return monotonic_ns() - rests_ns > 500'000'000; }));
  last_n_ = 0.0;
  last_ns_ = monotonic_ns();
  EXPECT_EQ(norm_of(device_.read()), 0.0);
  EXPECT_EQ(device_.renders(), Render::kServer);
  steepest_n_per_s_ = 0.0;
  ASSERT_TRUE(play_until(1.0, Render::kServer));
  // The rise of a server that is heard again: 1 N within 50 ms.
  EXPECT_LE(steepest_n_per_s_, 1.5 * 1.0 / 0.050 * 1.05);
}

TEST_F(HandOver, UnderAStopIsOverWithTheForce) {
  // On its way from one to the other; again where this process was held up for all of it.
  ASSERT_TRUE(eventually([&] {
    device_.set_render(Render::kDevice);
    EXPECT_TRUE(play_until(1.5, Render::kDevice));
    device_.set_render(Render::kServer);
    while (force_n_ > 1.49) tick();
    return force_n_ > 1.01;
  }));
  steepest_n_per_s_ = 0.0;
  hand_.stop = true;
  tick();
  const std::int64_t stopped_ns = monotonic_ns();
  EXPECT_TRUE(eventually([&] {
    tick();
    return read_from_ns_ - stopped_ns > 30'000'000;
  }));
  EXPECT_EQ(force_n_, 0.0);
  // By the smoothstep of 30 ms, and what the hand-over adds.
  EXPECT_LE(steepest_n_per_s_, (1.5 * 1.5 / 0.030 + 1.5 * 0.5 / 0.060) * 1.05);
  EXPECT_GT(steepest_n_per_s_, 0.0);
}

TEST(Device, StopsByItselfAndAsksUntilTheServerSaysSo) {
  SpringServer server(server_options());
  Device device(device_options());
  Hand hand;
  hand.position_m = {0.01, 0.0, 0.0};
  ASSERT_TRUE(device.read_after(device.write(hand), std::chrono::seconds(10)));
  server.set_silent(true);  // it hears, and says nothing
  hand.stop = true;
  device.write(hand);
  hand.stop = false;  // a short press
  EXPECT_TRUE(eventually([&] {
    device.write(hand);
    const Force force = device.read();
    return force.state == ForceState::kStopped && force.force_n[0] == 0.0;
  }));
  server.set_silent(false);  // and this one never stops: a stop is still a stop
  const std::uint64_t sequence = device.write(hand);
  const std::optional<Force> force = device.read_after(sequence, std::chrono::seconds(10));
  ASSERT_TRUE(force);
  EXPECT_EQ(force->force_n[0], 0.0);
  EXPECT_EQ(force->state, ForceState::kStopped);
  EXPECT_NE(server.last_pose().flags & suture_v1_POSE_STOP, 0U);
}

TEST(Device, TellsWhatItCanDo) {
  SpringServer server(server_options());
  const Participant participant(own_session(), Channel::kControl);
  Reader<v1::DeviceProfile> profiles(participant);
  DeviceOptions options = device_options();
  options.model = "spring board";
  options.limits = {.max_force_n = 2.0,
                    .max_force_slew_n_per_s = 90.0,
                    .max_stiffness_n_per_m = 800.0,
                    .max_damping_n_s_per_m = 4.0};
  Device device(options);
  device.write({});
  bool told = false;
  double rate_hz = -1.0;
  EXPECT_TRUE(eventually([&] {
    profiles.take_each([&](const v1::DeviceProfile& profile, const SampleInfo& info) {
      told |= info.valid && text_of(profile.tool) == "driver" && profile.max_force_n == 2.0 &&
              profile.max_force_slew_n_per_s == 90.0 && profile.max_stiffness_n_per_m == 800.0 &&
              profile.max_damping_n_s_per_m == 4.0 && text_of(profile.model) == "spring board" &&
              guid_of(profile.device) == server.last_sender();
      rate_hz = profile.rate_hz;
    });
    return told;
  }));
  EXPECT_EQ(rate_hz, 0.0) << "not known yet";
  device.run([](const Force&, std::chrono::nanoseconds) { return std::optional<Hand>(); }, 2000.0);
  EXPECT_TRUE(eventually([&] {
    profiles.take_each([&](const v1::DeviceProfile& profile, const SampleInfo& info) {
      if (info.valid) rate_hz = profile.rate_hz;
    });
    return rate_hz == 2000.0;
  }));
}

}  // namespace
}  // namespace suture
