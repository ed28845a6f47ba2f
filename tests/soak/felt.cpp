// SPDX-License-Identifier: GPL-3.0-or-later
#include "soak/felt.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include "haptics/model_builder.hpp"

namespace sutured::soak {
namespace {

using Vector = std::array<double, 3>;

constexpr std::int64_t kTick_ns = haptics::kMillisecond_ns;
constexpr double kRounding = 1e-9;

double norm(const Vector& v) { return std::hypot(v[0], v[1], v[2]); }
double distance(const Vector& a, const Vector& b) {
  return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

suture::Pose pose_between(const simulation::ToolInput& a, const simulation::ToolInput& b,
                          double share) {
  const geometry::Vec3 x = (1.0 - share) * a.position_m + share * b.position_m;
  const Eigen::Quaterniond q = a.orientation.slerp(share, b.orientation);
  return {{x[0], x[1], x[2]}, {q.x(), q.y(), q.z(), q.w()}};
}

}  // namespace

FeltForces::FeltForces(std::uint64_t seed, const scene::Scene& scene)
    : random_(seed), board_(scene.tools.size()), model_(std::make_unique<suture::HapticModel>()) {
  const auto period_ns = static_cast<std::int64_t>(1e9 / scene.rate_hz);
  for (const scene::Tool& description : scene.tools) {
    Tool tool;
    tool.name = description.name;
    tool.channel = std::make_unique<haptics::ToolChannel>(description, period_ns);
    tool.channel->join(board_, tools_.size());
    tool.frame = random_.chance(0.5) ? haptics::Frame::kWorld : haptics::Frame::kDevice;
    haptics::DeviceLimits device;
    device.force.max_force_n = random_.one_of({0.0, 0.5, 2.0, 100.0});
    device.force.max_force_slew_n_per_s = random_.one_of({0.0, 20.0, 1e4});
    device.max_stiffness_n_per_m = random_.one_of({0.0, 50.0, 2000.0});
    device.max_damping_n_s_per_m = random_.one_of({0.0, 0.01, 5.0});
    tool.channel->set_device_limits(device);
    tools_.push_back(std::move(tool));
  }
}

void FeltForces::reset() {
  ++epoch_;
  for (Tool& tool : tools_) tool.changed = 0;
}

std::optional<std::string> FeltForces::play(const simulation::Simulation& sim,
                                            const std::vector<simulation::ToolInput>& inputs,
                                            double dt_s) {
  const auto step_ns = static_cast<std::int64_t>(1e9 * dt_s);
  const auto taken_ns = now_ns_ + step_ns;
  for (; now_ns_ < taken_ns; now_ns_ += kTick_ns) {
    const double share =
        1.0 - static_cast<double>(taken_ns - now_ns_) / static_cast<double>(step_ns);
    for (std::size_t t = 0; t < tools_.size(); ++t) {
      Tool& tool = tools_[t];
      haptics::ToolChannel& channel = *tool.channel;
      if (random_.chance(0.001)) tool.lost_poses = random_.below(60);
      if (random_.chance(channel.stopped() ? 0.02 : 0.0005))
        channel.set_stopped(!channel.stopped());
      const bool sends = inputs[t].present || tool.last.present;
      if (sends && tool.lost_poses-- <= 0) {
        haptics::PoseSample pose;
        pose.writer = 1;
        pose.sequence = ++tool.poses;
        pose.stamp_ns = now_ns_;
        pose.frame = tool.frame;
        pose.pose = pose_between(tool.last.present ? tool.last : inputs[t],
                                 inputs[t].present ? inputs[t] : tool.last, share);
        pose.jaw = inputs[t].jaw;
        pose.goodbye = !inputs[t].present;
        if (const auto force = channel.on_pose(pose, now_ns_))
          if (auto fault = hold(tool, *force, now_ns_)) return fault;
      }
      const std::int64_t later_ns = now_ns_ + kTick_ns / 2;
      if (const auto force = channel.supervise(later_ns))
        if (auto fault = hold(tool, *force, later_ns)) return fault;
    }
  }
  for (std::size_t t = 0; t < tools_.size(); ++t) {
    Tool& tool = tools_[t];
    tool.last = inputs[t];
    const simulation::ToolResponse& response = sim.responses()[t];
    model_->epoch = epoch_;
    model_->sequence = sim.report().step;
    model_->period_ns = step_ns;
    model_->stale_after_ns = haptics::model_stale_after_ns(step_ns);
    if (response.world_changed) tool.changed = model_->sequence;
    model_->changed_sequence = tool.changed;
    haptics::fill_model(response, *model_);
    if (random_.chance(0.005)) tool.lost_models = random_.below(20);
    if (tool.lost_models-- > 0) continue;
    if (!tool.channel->publish_model(*model_, taken_ns, now_ns_))
      return "the model of " + tool.name + " was refused";
  }
  return std::nullopt;
}

std::optional<std::string> FeltForces::hold(Tool& tool, const haptics::ForceSample& force,
                                            std::int64_t now_ns) {
  const suture::ForceLimits limits = tool.channel->limits();
  const Vector &f = force.wrench.force_n, &m = force.wrench.torque_nm;
  const double force_n = norm(f), torque_nm = norm(m);
  const double elapsed_s = 1e-9 * static_cast<double>(now_ns - tool.force_ns);
  const double step_n = distance(f, tool.force.wrench.force_n),
               turn_nm = distance(m, tool.force.wrench.torque_nm);
  // Negated, so that what is not a number is a fault.
  const bool good = force_n <= limits.max_force_n * (1.0 + kRounding) &&
                    torque_nm <= limits.max_torque_nm * (1.0 + kRounding) &&
                    step_n <= limits.max_force_slew_n_per_s * elapsed_s + kRounding &&
                    turn_nm <= limits.max_torque_slew_nm_per_s * elapsed_s + kRounding;
  ++forces_;
  felt_ += force_n > 0.0;
  largest_n_ = std::max(largest_n_, force_n);
  tool.force = force;
  tool.force_ns = now_ns;
  if (good) return std::nullopt;
  char text[200];
  std::snprintf(text, sizeof text,
                "%.40s is given %.6g N and %.6g N m, %.6g N and %.6g N m from %.3g ms before",
                tool.name.c_str(), force_n, torque_nm, step_n, turn_nm, 1e3 * elapsed_s);
  return text;
}

}  // namespace sutured::soak
