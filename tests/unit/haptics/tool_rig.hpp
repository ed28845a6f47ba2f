// SPDX-License-Identifier: GPL-3.0-or-later
// A tool's channel between a device and a simulation, on a clock that the test moves.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <optional>

#include "haptics/tool_channel.hpp"
#include "scene/scene.hpp"

namespace sutured::haptics {

inline constexpr std::int64_t kMs = kMillisecond_ns;
inline constexpr std::int64_t kPromise_ns = 50 * kMs;
inline constexpr double kWall_n_per_m = 100.0;

inline double norm(const std::array<double, 3>& v) { return std::hypot(v[0], v[1], v[2]); }

/// A device, a simulation of a spring towards x = 0, and the two force threads, all on
/// one timeline: poses at each millisecond, a model every fourth, the supervisor half a
/// millisecond after the poses. Each force is held against the limits as it comes.
class Rig {
 public:
  explicit Rig(const scene::Tool& tool = {}) : tool_(tool), channel_(tool, 4 * kMs) {
    hand.orientation_xyzw = {0.0, 0.0, 0.0, 1.0};
    hand.position_m = {-0.005, 0.0, 0.0};
  }

  // What the world does, until changed.
  suture::Pose hand;
  double jaw = 0.0;
  std::uint32_t buttons = 0;
  std::uint64_t writer = 7;
  bool sends = true, steps = true, supervises = true, says_goodbye = false, says_stop = false;
  std::int64_t pose_period_ms = 1;
  double wrench_offset_n = 0.0;
  std::uint64_t epoch = 1;
  bool world_changed = false;
  std::function<void(PoseSample&)> spoil;
  std::function<void(suture::HapticModel&)> couple;
  std::optional<ToolPlace> place;  ///< of a world that was put in

  void run(std::int64_t milliseconds) {
    for (std::int64_t i = 0; i < milliseconds; ++i) {
      now += kMs;
      if (steps && now / kMs % 4 == 0) step();
      if (sends && now / kMs % pose_period_ms == 0) send();
      if (supervises) {
        if (auto force = channel_.supervise(now + kMs / 2)) take(*force, now + kMs / 2);
      }
    }
  }
  void step() {
    const ToolTarget target = channel_.target();
    suture::HapticModel model;
    model.epoch = epoch;
    model.sequence = ++model_sequence_;
    model.period_ns = 4 * kMs;
    model.touching = target.present;
    if (world_changed) changed_sequence_ = model_sequence_;
    model.changed_sequence = changed_sequence_;
    model.reference = target.pose;
    model.bilateral_wrench.force_n[0] =
        -kWall_n_per_m * target.pose.position_m[0] + wrench_offset_n;
    for (int i = 0; i < 3; ++i) model.bilateral_stiffness[7 * i] = kWall_n_per_m;
    if (couple) couple(model);
    suture::complete_model(model);
    channel_.publish_model(model, now, now, place);
  }
  PoseSample sample() {
    PoseSample pose;
    pose.writer = writer;
    pose.sequence = ++sequence_;
    pose.stamp_ns = now + 12345;
    pose.pose = hand;
    pose.jaw = jaw;
    pose.buttons = buttons;
    pose.goodbye = says_goodbye;
    pose.stop = says_stop;
    return pose;
  }
  std::optional<ForceSample> send() {
    PoseSample pose = sample();
    if (spoil) spoil(pose);
    auto force = channel_.on_pose(pose, now);
    if (force) take(*force, now);
    return force;
  }
  void take(const ForceSample& force, std::int64_t at) {
    const double elapsed_s = static_cast<double>(at - last_ns_) * 1e-9;
    const auto& f = force.wrench.force_n;
    const auto& t = force.wrench.torque_nm;
    EXPECT_LE(norm(f), tool_.max_force_n * (1 + 1e-12));
    EXPECT_LE(norm(t), tool_.max_torque_nm * (1 + 1e-12));
    if (force.writer == last.writer) {
      std::array<double, 3> df, dt;
      for (int i = 0; i < 3; ++i) {
        df[i] = f[i] - last.wrench.force_n[i];
        dt[i] = t[i] - last.wrench.torque_nm[i];
      }
      EXPECT_LE(norm(df), tool_.max_force_slew_n_per_s * elapsed_s + 1e-12) << "at " << at;
      EXPECT_LE(norm(dt), tool_.max_torque_slew_nm_per_s * elapsed_s + 1e-12) << "at " << at;
      largest_step_n = std::max(largest_step_n, norm(df));
      largest_rise_n = std::max(largest_rise_n, norm(f) - norm(last.wrench.force_n));
    }
    EXPECT_TRUE(force.sequence == last.sequence + 1 || last.sequence == 0);
    last = force;
    last_ns_ = at;
    if (norm(f) > 0.0 || norm(t) > 0.0) last_felt_ns = at;
  }
  double force_n() const { return norm(last.wrench.force_n); }
  std::uint64_t faults(Fault fault) const { return channel_.counters().of(fault); }

  /// Brings the tool to full force: 0.5 N at 5 mm.
  void engage() {
    run(300);
    ASSERT_EQ(last.state, ToolState::kRendering);
    ASSERT_NEAR(force_n(), 0.5, 1e-9);
  }
  /// The force must have been zero from `since + 50 ms` on; run at least so long before.
  void expect_zero_since(std::int64_t since) const {
    EXPECT_LE(last_felt_ns, since + kPromise_ns);
    EXPECT_EQ(force_n(), 0.0);
  }
  /// Without the fault the force comes back to what the model says, by a ramp.
  void expect_recovery(double force = 0.5) {
    largest_rise_n = 0.0;
    run(400);
    EXPECT_EQ(last.state, ToolState::kRendering);
    EXPECT_EQ(last.faults, 0U);
    EXPECT_NEAR(force_n(), force, 1e-9);
    // A smoothstep of 200 ms rises by at most 1.5 / 200 of the whole a millisecond.
    EXPECT_LE(largest_rise_n, force * 1.5 / 200 * 1.5 + 1e-9);
    EXPECT_GE(channel_.counters().recoveries.load(), 1U);
  }

  ToolChannel& channel() { return channel_; }

  std::int64_t now = 1'000'000 * kMs;
  ForceSample last;
  std::int64_t last_felt_ns = 0;
  double largest_step_n = 0.0, largest_rise_n = 0.0;

 private:
  scene::Tool tool_;
  ToolChannel channel_;
  std::int64_t last_ns_ = 0;
  std::uint64_t sequence_ = 0, model_sequence_ = 0;
  std::uint64_t changed_sequence_ = 0;
};

}  // namespace sutured::haptics
