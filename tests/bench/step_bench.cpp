// SPDX-License-Identifier: GPL-3.0-or-later
// The main scene, played by its surgeon without display on the calling thread: what `sutured run`
// does, without its files.
#include <cstdint>

#include "bench/figures.hpp"
#include "protocol/surgeon.hpp"
#include "scene/scene_reader.hpp"
#include "simulation/simulation.hpp"

namespace sutured::bench {
namespace {

const std::string kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/";

simulation::ToolInput input_at(const suture::SurgeonTrack* track, double time_s) {
  simulation::ToolInput input;
  if (track == nullptr) return input;
  const suture::SurgeonPose pose = track->at(time_s);
  const auto& [x, y, z, w] = pose.orientation_xyzw;
  input.present = true;
  input.position_m = {pose.position_m[0], pose.position_m[1], pose.position_m[2]};
  input.orientation = Eigen::Quaterniond(w, x, y, z).normalized();
  input.jaw = pose.jaw;
  return input;
}

}  // namespace

void measure_step(Figures& figures) {
  constexpr int kPlays = 3;  // each from a cold start
  const scene::Scene scene = scene::read_scene(kScene + "scene.toml");
  const suture::Surgeon surgeon = suture::read_surgeon(kScene + "one_bite.csv");
  std::vector<const suture::SurgeonTrack*> tracks;
  for (const auto& tool : scene.tools) tracks.push_back(surgeon.track(tool.name));
  const auto steps = static_cast<std::int64_t>(surgeon.end_s() * scene.rate_hz);
  std::vector<simulation::ToolInput> inputs(tracks.size());
  std::vector<double> step_us, displacements_us, rows;
  for (int play = 0; play < kPlays; ++play) {
    simulation::Simulation sim(scene);
    for (std::int64_t step = 1; step <= steps; ++step) {
      const double time_s = static_cast<double>(step) / scene.rate_hz;
      for (std::size_t i = 0; i < inputs.size(); ++i) inputs[i] = input_at(tracks[i], time_s);
      const double took_us = time_us([&] { sim.step(inputs, 1.0 / scene.rate_hz); });
      if (sim.report().rows == 0) continue;  // nothing is touched: microseconds, and no merit
      step_us.push_back(took_us);
      rows.push_back(sim.report().rows);
      displacements_us.push_back(time_us([&] { sim.update_displacements(); }));
    }
  }
  figures.add("step_ms.paper.p50", 1e-3 * quantile(step_us, 0.5), "ms", 1.0);
  figures.add("step_ms.paper.p99", 1e-3 * quantile(step_us, 0.99), "ms");
  figures.add("step_ms.paper.max", 1e-3 * quantile(step_us, 1.0), "ms");
  figures.add("step_rows.paper.p50", quantile(rows, 0.5), "");
  figures.add("step_rows.paper.max", quantile(rows, 1.0), "");
  figures.add("step_count.paper", static_cast<double>(step_us.size()), "");
  figures.add("displacements_ms.paper.p50", 1e-3 * quantile(displacements_us, 0.5), "ms");
}

}  // namespace sutured::bench
