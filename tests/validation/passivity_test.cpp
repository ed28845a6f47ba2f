// SPDX-License-Identifier: GPL-3.0-or-later
// Honest play through the whole way of the force: the surgeon of the anastomosis, both hands,
// with the simulation at its rate and poses at 1 kHz, on a clock that the test moves. The
// energy observer has nothing to say, and the coupling of a usual device nothing to soften.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "haptics/model_builder.hpp"
#include "haptics/tool_channel.hpp"
#include "protocol/surgeon.hpp"
#include "protocol/virtual_coupling.hpp"
#include "scene/scene_reader.hpp"
#include "simulation/simulation.hpp"

namespace sutured {
namespace {

using haptics::kMillisecond_ns;

double norm(const std::array<double, 3>& v) { return std::hypot(v[0], v[1], v[2]); }

TEST(Passivity, OfASurgeonAtTheAnastomosisIsNeverInDoubt) {
  const std::string folder = std::string(SUTURED_SOURCE_DIR) + "/server/scenes/anastomosis/";
  const scene::Scene scene = scene::read_scene(folder + "scene.toml");
  const suture::Surgeon surgeon = suture::read_surgeon(folder + "surgeon.csv");
  const auto step_ms = static_cast<std::int64_t>(std::llround(1e3 / scene.rate_hz));
  simulation::Simulation sim(scene);
  const std::size_t tools = scene.tools.size();
  std::vector<std::unique_ptr<haptics::ToolChannel>> channels;
  std::vector<const suture::SurgeonTrack*> tracks;
  for (const scene::Tool& tool : scene.tools) {
    channels.push_back(std::make_unique<haptics::ToolChannel>(tool, step_ms * kMillisecond_ns));
    tracks.push_back(surgeon.track(tool.name));
  }
  std::vector<simulation::ToolInput> inputs(tools);
  std::vector<double> stiffness_n_per_m;
  constexpr std::array<double, 4> kLimits_n_per_m{250.0, 500.0, 1000.0, 2000.0};
  std::array<double, 4> softened_n{};  // largest change of the force at the reference
  double peak_force_n = 0.0;

  auto model = std::make_unique<suture::HapticModel>();
  auto coupled = std::make_unique<suture::HapticModel>();
  std::uint64_t sequence = 0;
  double end_s = 0.0;
  for (const suture::SurgeonTrack* track : tracks)
    if (track != nullptr) end_s = std::max(end_s, track->end_s());
  std::int64_t now_ns = 1'000'000 * kMillisecond_ns;
  for (std::int64_t ms = 0; 1e-3 * static_cast<double>(ms) < end_s; ++ms) {
    now_ns += kMillisecond_ns;
    for (std::size_t t = 0; t < tools; ++t) {
      if (tracks[t] == nullptr) continue;
      const suture::SurgeonPose at = tracks[t]->at(1e-3 * static_cast<double>(ms));
      haptics::PoseSample sample;
      sample.writer = t + 1;
      sample.sequence = static_cast<std::uint64_t>(ms) + 1;
      sample.frame = haptics::Frame::kWorld;
      sample.pose = {at.position_m, at.orientation_xyzw};
      sample.jaw = at.jaw;
      const auto force = channels[t]->on_pose(sample, now_ns);
      if (force) peak_force_n = std::max(peak_force_n, norm(force->wrench.force_n));
    }
    if (ms % step_ms != 0) continue;
    for (std::size_t t = 0; t < tools; ++t) {
      const haptics::ToolTarget& target = channels[t]->target();
      const auto& q = target.pose.orientation_xyzw;
      inputs[t].present = target.present;
      inputs[t].position_m = {target.pose.position_m[0], target.pose.position_m[1],
                              target.pose.position_m[2]};
      inputs[t].orientation = Eigen::Quaterniond(q[3], q[0], q[1], q[2]);
      inputs[t].jaw = target.jaw;
    }
    sim.step(inputs, 1e-3 * static_cast<double>(step_ms));
    ++sequence;
    for (std::size_t t = 0; t < tools; ++t) {
      model->epoch = 1;
      model->sequence = sequence;
      model->period_ns = step_ms * kMillisecond_ns;
      haptics::fill_model(sim.responses()[t], *model);
      channels[t]->publish_model(*model, now_ns, now_ns);
      if (sequence % 8 != 0 || !model->touching) continue;
      for (std::size_t l = 0; l < kLimits_n_per_m.size(); ++l) {
        *coupled = *model;
        const double stiffness = suture::couple_model(*coupled, kLimits_n_per_m[l]);
        if (l == 0) stiffness_n_per_m.push_back(stiffness);
        std::array<double, 3> change{};
        for (int i = 0; i < 3; ++i)
          change[i] = coupled->wrench.force_n[i] - model->wrench.force_n[i];
        softened_n[l] = std::max(softened_n[l], norm(change));
      }
    }
  }
  ASSERT_GT(stiffness_n_per_m.size(), 500U);
  ASSERT_GT(peak_force_n, 0.05);
  std::sort(stiffness_n_per_m.begin(), stiffness_n_per_m.end());
  const auto quantile = [&](double fraction) {
    return stiffness_n_per_m[static_cast<std::size_t>(
        fraction * static_cast<double>(stiffness_n_per_m.size() - 1))];
  };
  std::printf(
      "peak force %.3f N; stiffest direction of %zu models p50 %.0f, p99 %.0f, max %.0f N/m\n",
      peak_force_n, stiffness_n_per_m.size(), quantile(0.5), quantile(0.99), quantile(1.0));
  for (std::size_t l = 0; l < kLimits_n_per_m.size(); ++l)
    std::printf("device of %5.0f N/m: force at most %.2f %% of the peak off\n", kLimits_n_per_m[l],
                100.0 * softened_n[l] / peak_force_n);
  for (std::size_t t = 0; t < tools; ++t) {
    const haptics::ToolReport& report = channels[t]->report();
    std::printf("%s: energy to the hand %.3f mJ, largest debt %.3f mJ of %.0f\n",
                scene.tools[t].name.c_str(), 1e3 * report.energy_to_hand_j,
                1e3 * report.energy_debt_peak_j, 1e3 * suture::EnergyBound{}.energy_j);
    EXPECT_EQ(channels[t]->counters().of(haptics::Fault::kEnergy), 0U);
    // Far from the bound, or a livelier surgeon would pass it.
    EXPECT_LT(report.energy_debt_peak_j, 0.5 * suture::EnergyBound{}.energy_j);
  }
}

}  // namespace
}  // namespace sutured
