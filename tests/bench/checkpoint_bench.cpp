// SPDX-License-Identifier: GPL-3.0-or-later
// What a checkpoint costs the simulation's thread: the copy that is made between two steps.
#include "bench/figures.hpp"
#include "simulation/simulation.hpp"
#include "support/closure_scene.hpp"

namespace sutured::bench {
namespace {

using Caches = Archive::Caches;

std::size_t copy(simulation::Simulation& sim, Caches caches, std::vector<std::byte>& bytes) {
  bytes.clear();
  Archive archive = Archive::writing(bytes, caches);
  archive(sim);
  return bytes.size();
}

}  // namespace

void measure_checkpoint(Figures& figures) {
  constexpr int kCopies = 100, kSteps = 90;
  for (const auto mesh : {testing::ClosureMesh::k1k6, testing::ClosureMesh::k24k}) {
    const std::string name = testing::name_of(mesh);
    testing::ClosureOptions options;
    options.mesh = mesh;
    options.shortening_m = testing::closing_shortening_m(20);
    const testing::Closure closure = testing::closure_scene(options);
    const double period_us = 1e6 / closure.scene.rate_hz;
    simulation::Simulation sim(closure.scene);
    for (int i = 0; i < kSteps; ++i) sim.step({}, 1.0 / closure.scene.rate_hz);
    std::vector<std::byte> bytes, whole;
    copy(sim, Caches::kLeftOut, bytes);  // takes the memory
    std::vector<double> copy_us, restore_us;
    for (int i = 0; i < kCopies; ++i)
      copy_us.push_back(time_us([&] { copy(sim, Caches::kLeftOut, bytes); }));
    for (int i = 0; i < kCopies / 10; ++i)
      restore_us.push_back(time_us([&] {
        Archive archive = Archive::reading(bytes);
        archive(sim);
      }));
    figures.add("checkpoint_copy_us." + name + ".p50", quantile(copy_us, 0.5), "us");
    figures.add("checkpoint_copy_over_period." + name + ".max", quantile(copy_us, 1.0) / period_us,
                "", 1.0);
    figures.add("checkpoint_restore_us." + name + ".p50", quantile(restore_us, 0.5), "us");
    figures.add("checkpoint_kb." + name, 1e-3 * static_cast<double>(bytes.size()), "kB");
    for (int i = 0; i < kSteps / 2; ++i) sim.step({}, 1.0 / closure.scene.rate_hz);
    figures.add("checkpoint_with_caches_kb." + name,
                1e-3 * static_cast<double>(copy(sim, Caches::kKept, whole)), "kB");
  }
}

}  // namespace sutured::bench
