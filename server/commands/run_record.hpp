// SPDX-License-Identifier: GPL-3.0-or-later
// What a run leaves behind, offline or served: final.vtk and summary.json
// (docs/guide/what-a-run-leaves.md).
#pragma once

#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "scene/scene.hpp"
#include "simulation/quality.hpp"
#include "simulation/simulation.hpp"

namespace sutured::commands {

/// Returns an event as a line of events.jsonl.
[[nodiscard]] nlohmann::json to_json(const simulation::Event& event);

/// Watches a simulation and writes its record.
///
/// Thread: the one that steps. Memory: bounded; of more than 10,000 punctures the first ones stay,
/// and the tension over time gets coarser as the run gets longer.
class RunRecord {
 public:
  RunRecord(const scene::Scene& scene, const simulation::Simulation& simulation, double rate_hz);

  /// Takes in the step just made. Brings displacements up to date 60 times a second of its time.
  void watch(simulation::Simulation& simulation);

  /// Archives the record: another one of the same scene goes on with it.
  void serialize(Archive& archive);

  /// Writes final.vtk and summary.json into `folder`. Throws std::runtime_error naming the file.
  void write(const std::filesystem::path& folder, simulation::Simulation& simulation);

 private:
  [[nodiscard]] nlohmann::json summarise(const simulation::Simulation& simulation) const;

  scene::Scene scene_;
  double rate_hz_;
  simulation::QualityMeter meter_;
  simulation::StressField stress_;
  std::uint64_t steps_ = 0, steps_a_frame_ = 1, steps_a_sample_ = 1;
  std::array<std::uint64_t, simulation::kEventKinds> event_counts_{};  ///< by kind
  std::vector<simulation::Event> punctures_;
  std::vector<double> peak_force_n_, peak_tension_n_;
  std::vector<std::vector<std::array<double, 2>>> tension_over_time_;  ///< [time_s, tension_n]
  double residual_max_ = 0.0;
  int inverted_tets_max_ = 0, contacts_max_ = 0;
};

}  // namespace sutured::commands
