// SPDX-License-Identifier: GPL-3.0-or-later
// The paper's closure with contact, on four meshes: what a step costs while the rims meet, and once
// they rest on each other.
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>

#include "bench/figures.hpp"
#include "simulation/simulation.hpp"
#include "support/closure_scene.hpp"

namespace sutured::bench {
namespace {

constexpr double kStep_s = 1.0 / 250.0;
/// Steps before the end of the pull in which surfaces meet, and steps of rest.
constexpr int kMeeting = 20, kAtRest = 40, kSettling = 20;

enum Stage { kContact, kAssemble, kSolve, kModel, kBackward, kTrack, kStages };
constexpr std::array<const char*, kStages> kStageNames{"contact", "assemble", "solve",
                                                       "model",   "backward", "track"};

/// Times of one phase, ms.
struct Phase {
  std::vector<double> forces_ms, displacements_ms, step_ms;
};

struct Case {
  std::map<std::string, Phase> phases;  ///< "closure": all, "meeting", "settled"
  std::array<double, kStages> stage_ns{};
  std::vector<double> rows, active;  ///< settled
  double setup_ms = 0.0;
};

Case play(testing::ClosureMesh mesh, int punctures) {
  testing::ClosureOptions options;
  options.mesh = mesh;
  options.punctures = punctures;
  options.shortening_m = testing::closing_shortening_m(punctures);
  const testing::Closure closure = testing::closure_scene(options);
  Case out;
  std::optional<simulation::Simulation> built;
  out.setup_ms = 1e-3 * time_us([&] { built.emplace(closure.scene); });
  simulation::Simulation& sim = *built;
  const int pulling = static_cast<int>(std::ceil(closure.closed_at_s / kStep_s));
  for (int step = 1; step <= pulling + kSettling + kAtRest; ++step) {
    // Displacements are brought up after each step, so that the next one owes nothing for them.
    const double forces_us = time_us([&] { sim.step({}, kStep_s); });
    const simulation::StepReport& report = sim.report();
    const double displacements_us = wall_time_us([&] { sim.update_displacements(); });
    const bool meeting = step > pulling - kMeeting && step <= pulling;
    const bool settled = step > pulling + kSettling;
    for (const auto& [name, present] : {std::pair("closure", true), std::pair("meeting", meeting),
                                        std::pair("settled", settled)}) {
      if (!present) continue;
      Phase& phase = out.phases[name];
      phase.forces_ms.push_back(1e-3 * forces_us);
      phase.displacements_ms.push_back(1e-3 * displacements_us);
      phase.step_ms.push_back(1e-3 * (forces_us + displacements_us));
    }
    if (!meeting && !settled) continue;
    const std::array<std::int64_t, kStages> stages{report.contact_ns,  report.assemble_ns,
                                                   report.solve_ns,    report.model_ns,
                                                   report.backward_ns, report.track_ns};
    for (std::size_t i = 0; i < kStages; ++i) out.stage_ns[i] += static_cast<double>(stages[i]);
    if (!settled) continue;
    out.rows.push_back(report.rows);
    out.active.push_back(report.active_unilateral_rows);
  }
  return out;
}

/// Returns the median of the run in which it was lowest: what else the machine does can only add.
template <typename Times>
double best_median(std::vector<Case>& plays, const char* phase, Times&& times) {
  double best = INFINITY;
  for (Case& play : plays) best = std::min(best, quantile(times(play.phases[phase]), 0.5));
  return best;
}

/// One closure, played as often as asked.
struct Closure {
  testing::ClosureMesh mesh;
  int punctures;
  std::vector<Case> plays;

  void play_again(int times) {
    for (int i = 0; i < times; ++i) plays.push_back(play(mesh, punctures));
  }
};

/// Adds the figures of one closure; returns the median step at rest, ms.
double add_figures(Figures& figures, Closure& closure, std::optional<double> step_budget,
                   std::optional<double> forces_budget,
                   std::optional<double> displacements_budget) {
  std::vector<Case>& plays = closure.plays;
  const std::string name =
      "p" + std::to_string(closure.punctures) + "." + testing::name_of(closure.mesh);
  const auto step = [](Phase& phase) -> std::vector<double>& { return phase.step_ms; };
  const auto forces = [](Phase& phase) -> std::vector<double>& { return phase.forces_ms; };
  const auto displacements = [](Phase& phase) -> std::vector<double>& {
    return phase.displacements_ms;
  };
  std::vector<double> all, all_forces;
  for (Case& one : plays) {
    const Phase& whole = one.phases["closure"];
    all.insert(all.end(), whole.step_ms.begin(), whole.step_ms.end());
    all_forces.insert(all_forces.end(), whole.forces_ms.begin(), whole.forces_ms.end());
  }
  const auto add_phases = [&](const std::string& what, auto&& times, std::optional<double> budget) {
    figures.add("step_ms." + name + what + ".p50", best_median(plays, "closure", times), "ms",
                budget);
    for (const std::string phase : {"meeting", "settled"})
      figures.add("step_ms." + name + what + "." + phase + ".p50",
                  best_median(plays, phase.c_str(), times), "ms");
  };
  double setup_ms = INFINITY;
  for (const Case& one : plays) setup_ms = std::min(setup_ms, one.setup_ms);
  figures.add("setup_ms." + name, setup_ms, "ms");
  add_phases("", step, step_budget);
  figures.add("step_ms." + name + ".p99", quantile(all, 0.99), "ms");
  add_phases(".forces", forces, forces_budget);
  figures.add("step_ms." + name + ".forces.p99", quantile(all_forces, 0.99), "ms");
  add_phases(".displacements", displacements, displacements_budget);
  double total = 0.0;
  std::array<double, kStages> stage_ns{};
  for (const Case& one : plays)
    for (std::size_t i = 0; i < kStages; ++i) {
      total += one.stage_ns[i];
      stage_ns[i] += one.stage_ns[i];
    }
  for (std::size_t i = 0; i < kStages; ++i)
    figures.add(std::string("step_share.") + name + "." + kStageNames[i],
                100.0 * stage_ns[i] / total, "%");
  figures.add("step_rows." + name + ".settled.p50", quantile(plays[0].rows, 0.5), "");
  figures.add("step_active_rows." + name + ".settled.p50", quantile(plays[0].active, 0.5), "");
  return best_median(plays, "settled", step);
}

}  // namespace

void measure_closure(Figures& figures) {
  using testing::ClosureMesh;
  const auto none = std::nullopt;
  Closure p20{ClosureMesh::k1k6, 20, {}}, p50{ClosureMesh::k1k6, 50, {}};
  Closure v6k{ClosureMesh::k6k, 50, {}}, v24k{ClosureMesh::k24k, 50, {}},
      v53k{ClosureMesh::k53k, 50, {}};
  // The small ones before and after the large ones: a machine that others use has slow minutes.
  p20.play_again(5);
  p50.play_again(5);
  v6k.play_again(3);
  v24k.play_again(2);
  v53k.play_again(1);
  p20.play_again(5);
  p50.play_again(5);

  std::vector<std::pair<double, double>> growth;  // logs of vertices and step
  const auto add = [&](double vertices, double step_ms) {
    growth.emplace_back(std::log(vertices), std::log(step_ms));
  };
  add_figures(figures, p20, 1.0, none, none);
  add(1620, add_figures(figures, p50, 1.0, none, none));
  add(5760, add_figures(figures, v6k, none, none, none));
  add(23760, add_figures(figures, v24k, none, 16.0, 16.0));
  add(52800, add_figures(figures, v53k, none, 16.0, 33.0));
  double x = 0.0, y = 0.0, xx = 0.0, xy = 0.0;
  const auto n = static_cast<double>(growth.size());
  for (const auto& [v, t] : growth) x += v / n, y += t / n;
  for (const auto& [v, t] : growth) xx += (v - x) * (v - x), xy += (v - x) * (t - y);
  figures.add("step_growth.p50", xy / xx, "");
}

}  // namespace sutured::bench
