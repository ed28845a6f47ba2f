// SPDX-License-Identifier: GPL-3.0-or-later
// Where the thread's tension acts on the tissue, `model = "outside"` against `"path"`: the same
// closures on three meshes, compared where the gap is equally wide (docs/adr/0030).
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "bench/figures.hpp"
#include "fem/elements.hpp"
#include "simulation/simulation.hpp"
#include "support/closure_scene.hpp"

namespace sutured::bench {
namespace {

using geometry::Vec3;
constexpr double kStep_s = 1.0 / 250.0;
constexpr double kHalf_m = 0.75e-3, kShut_m = 0.0;
constexpr int kStillSteps = 20;

/// What is seen when the gap passes a width.
struct Crossing {
  double tension_n = 0.0, principal_pa = 0.0;
};

struct Outcome {
  Crossing half, shut;
  double given_n = 0.0;  ///< tension once each piece is shorter by `closing_shortening_m`
  double after_5_m = 0.0, after_20_m = 0.0;  ///< motion in a step, so many after the pull
  double forces_ms = 0.0;                    ///< of a step at rest
  int inverted = 0;
};

double largest_principal_pa(const simulation::Simulation& sim, simulation::StressField& field) {
  sim.compute_stress(field);
  double largest = 0.0;
  for (const auto& stress : field.tet_pa)
    largest = std::max(largest, fem::principal_stress_pa(stress)[0]);
  return largest;
}

/// Pulls until the rims meet on average, then holds.
Outcome close(testing::ClosureMesh mesh, int punctures, scene::ThreadModel model) {
  testing::ClosureOptions options;
  options.mesh = mesh;
  options.punctures = punctures;
  options.model = model;
  options.shortening_m = 3e-3;  // more than it takes; the pull ends where the gap does
  testing::Closure closure = testing::closure_scene(options);
  // A first run tells when the gap is shut, a second one stops there.
  Outcome out;
  simulation::StressField field;
  double stop_s = 0.0;
  {
    simulation::Simulation sim(closure.scene);
    double gap_before = testing::mean_gap_m(closure, sim.positions_m());
    Crossing before;
    const double given_s = testing::closing_shortening_m(punctures) / options.speed_m_per_s;
    while ((stop_s == 0.0 || out.given_n == 0.0) && sim.time_s() < closure.closed_at_s) {
      sim.step({}, kStep_s);
      sim.update_displacements();
      const double gap = testing::mean_gap_m(closure, sim.positions_m());
      const Crossing now{sim.threads()[0].tension_n, largest_principal_pa(sim, field)};
      for (const auto& [width, crossing] :
           {std::pair(kHalf_m, &out.half), std::pair(kShut_m, &out.shut)})
        if (gap_before > width && gap <= width) {
          const double share = (gap_before - width) / (gap_before - gap);
          crossing->tension_n = std::lerp(before.tension_n, now.tension_n, share);
          crossing->principal_pa = std::lerp(before.principal_pa, now.principal_pa, share);
          if (width == kShut_m && stop_s == 0.0) stop_s = sim.time_s();
        }
      if (out.given_n == 0.0 && sim.time_s() > given_s - 0.1 * kStep_s) out.given_n = now.tension_n;
      gap_before = gap;
      before = now;
    }
  }
  if (stop_s == 0.0) return out;
  auto& program = closure.scene.threads[0].length_program;
  const double share = stop_s / closure.closed_at_s;
  program.back() = {stop_s, std::lerp(closure.open_length_m, closure.closed_length_m, share)};
  simulation::Simulation sim(closure.scene);
  std::vector<double> forces_us;
  std::vector<Vec3> last;
  const int pulling = static_cast<int>(std::lround(stop_s / kStep_s));
  for (int step = 1; step <= pulling + 2 * kStillSteps; ++step) {
    const double took_us = time_us([&] { sim.step({}, kStep_s); });
    sim.update_displacements();
    const auto x = sim.positions_m();
    double motion = 0.0;
    for (std::size_t v = 0; v < last.size(); ++v)
      motion = std::max(motion, (x[v] - last[v]).norm());
    last.assign(x.begin(), x.end());
    if (step == pulling + 5) out.after_5_m = motion;
    if (step == pulling + kStillSteps) out.after_20_m = motion;
    if (step > pulling + kStillSteps) forces_us.push_back(took_us);
    out.inverted = std::max(out.inverted, sim.report().inverted_tets);
  }
  out.forces_ms = 1e-3 * quantile(forces_us, 0.5);
  return out;
}

}  // namespace

void study_thread_model() {
  std::printf("%-10s %-6s %-8s | %-21s | %-21s | %-12s | %-20s | %-9s %s\n", "punctures", "mesh",
              "model", "gap 0.75 mm: N    kPa", "gap 0: N          kPa", "as short: N",
              "motion after 5, 20 m", "forces ms", "inverted");
  for (const int punctures : {20, 50})
    for (const auto mesh :
         {testing::ClosureMesh::k1k6, testing::ClosureMesh::k6k, testing::ClosureMesh::k24k})
      for (const auto model : {scene::ThreadModel::kOutside, scene::ThreadModel::kPath}) {
        const Outcome out = close(mesh, punctures, model);
        std::printf(
            "%-10d %-6s %-8s | %12.4f %8.1f | %12.4f %8.1f | %12.4f | %9.1e %10.1e | %9.2f %d\n",
            punctures, testing::name_of(mesh).c_str(),
            model == scene::ThreadModel::kPath ? "path" : "outside", out.half.tension_n,
            1e-3 * out.half.principal_pa, out.shut.tension_n, 1e-3 * out.shut.principal_pa,
            out.given_n, out.after_5_m, out.after_20_m, out.forces_ms, out.inverted);
        std::fflush(stdout);
      }
}

}  // namespace sutured::bench
