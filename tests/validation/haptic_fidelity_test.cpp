// SPDX-License-Identifier: GPL-3.0-or-later
// The haptic model against the simulation itself: snapshots every 32 ms of a 500 Hz run,
// each used one snapshot late, as a 30 Hz scene would use them.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <memory>
#include <string>

#include "haptics/model_builder.hpp"
#include "protocol/surgeon.hpp"
#include "scene/scene_reader.hpp"
#include "simulation/simulation.hpp"
#include "support/fidelity.hpp"

namespace sutured {
namespace {

using simulation::Vec6;

constexpr double kStep_s = 2e-3;
constexpr int kStepsPerModel = 16;
// From a change of the world (a puncture, a grasp, a new cell on the path) until models of it are
// in use.
constexpr double kAfterChange_s = 0.1;

/// Error of one predictor, and what it is measured against.
struct Error {
  double sum = 0.0, max = 0.0;
  void add(double e) {
    sum += e * e;
    max = std::max(max, e);
  }
  [[nodiscard]] double rms(int count) const { return std::sqrt(sum / count); }
};

Vec6 vector_of(const suture::Wrench& w) {
  Vec6 v;
  v << w.force_n[0], w.force_n[1], w.force_n[2], w.torque_nm[0], w.torque_nm[1], w.torque_nm[2];
  return v;
}

struct Snapshot {
  suture::HapticModel model;
  Vec6 wrench;
};

TEST(HapticFidelity, OfANeedleInTissueIsWithinOnePercentOfAResolve) {
  const std::string folder = std::string(SUTURED_SOURCE_DIR) + "/server/scenes/anastomosis/";
  const scene::Scene scene = scene::read_scene(folder + "scene.toml");
  const suture::Surgeon surgeon = suture::read_surgeon(folder + "one_bite.csv");
  const suture::SurgeonTrack* track = surgeon.track("driver");
  ASSERT_NE(track, nullptr);
  std::size_t driver = 0;
  while (scene.tools.at(driver).name != "driver") ++driver;

  simulation::Simulation sim(scene);
  std::vector<simulation::ToolInput> inputs(scene.tools.size());
  suture::ModelEvaluator evaluator;
  std::unique_ptr<Snapshot> newest, used;
  Error force, torque, held_force;
  double peak_force_n = 0.0, peak_torque_nm = 0.0, changed_s = 0.0;
  int count = 0, last_cells = 0;
  const int steps = static_cast<int>(surgeon.end_s() / kStep_s);
  for (int k = 0; k < steps; ++k) {
    const double time_s = k * kStep_s;
    const suture::SurgeonPose at = track->at(time_s);
    simulation::ToolInput& input = inputs[driver];
    input.present = true;
    input.position_m = {at.position_m[0], at.position_m[1], at.position_m[2]};
    input.orientation = Eigen::Quaterniond(at.orientation_xyzw[3], at.orientation_xyzw[0],
                                           at.orientation_xyzw[1], at.orientation_xyzw[2]);
    input.jaw = at.jaw;
    sim.step(inputs, kStep_s);
    const simulation::ToolResponse& response = sim.responses()[driver];
    const int cells = sim.needles()[0].active_cells;
    if (cells != last_cells) changed_s = time_s;
    last_cells = cells;
    if (response.world_changed || !response.touching) changed_s = time_s;
    // A new cell on the needle's path is a step of the simulation that no model can foresee;
    // a tip that touches has the face's normal in it, which changes as it slides.
    bool tip_touches =
        false;  // or the shaft, or a taut thread: rows that may switch and carry force
    for (Eigen::Index i = 0; i < response.condensed.multiplier_n.size(); ++i)
      tip_touches = tip_touches || response.condensed.multiplier_n[i] > 0.0;
    for (int i = 0; used && i < used->model.rows; ++i)
      tip_touches = tip_touches || used->model.multiplier_n[static_cast<std::size_t>(i)] > 0.0;
    if (used && time_s - changed_s > kAfterChange_s && cells > 0 && !tip_touches) {
      const suture::Pose pose{{input.position_m.x(), input.position_m.y(), input.position_m.z()},
                              at.orientation_xyzw};
      const Vec6 truth = response.wrench;
      const Vec6 error = vector_of(evaluator.evaluate(used->model, pose)) - truth;
      force.add(error.head<3>().norm());
      torque.add(error.tail<3>().norm());
      held_force.add((used->wrench - truth).head<3>().norm());
      peak_force_n = std::max(peak_force_n, truth.head<3>().norm());
      peak_torque_nm = std::max(peak_torque_nm, truth.tail<3>().norm());
      ++count;
    }
    if (k % kStepsPerModel == 0) {
      used = std::move(newest);
      newest = std::make_unique<Snapshot>();
      newest->model.epoch = 1;
      newest->model.sequence = static_cast<std::uint64_t>(k) + 1;
      haptics::fill_model(response, newest->model);
      newest->wrench = response.wrench;
    }
  }
  ASSERT_GT(count, 700) << "the surgeon's file shall hold the needle in tissue for a while";
  const double rms = 100 * force.rms(count) / peak_force_n, max = 100 * force.max / peak_force_n;
  const double torque_rms = 100 * torque.rms(count) / peak_torque_nm;
  std::printf(
      "%d samples, peak %.4f N, %.2f N·mm\n"
      "force   model RMS %.2f %%  max %.2f %%   held RMS %.2f %%  max %.2f %%\n"
      "torque  model RMS %.2f %%\n",
      count, peak_force_n, 1e3 * peak_torque_nm, rms, max,
      100 * held_force.rms(count) / peak_force_n, 100 * held_force.max / peak_force_n, torque_rms);
  EXPECT_LE(rms, 1.0);
  EXPECT_LE(max, 3.0);
  EXPECT_LE(torque_rms, 2.0);
  EXPECT_GT(held_force.rms(count), 3 * force.rms(count)) << "a held force must be far worse";
  EXPECT_EQ(evaluator.fallbacks(), 0U);
}

/// The motions of `make fidelity`, without leaving anything out.
TEST(HapticFidelity, OfEachMotionIsWithinItsBudgetOrSaidToMissIt) {
  for (const testing::FidelityMotion& motion : testing::fidelity_motions()) {
    SCOPED_TRACE(motion.name);
    const testing::FidelityResult result = testing::measure_fidelity(motion);
    ASSERT_GT(result.samples.size(), 1500U);
    std::printf("%-10s model RMS %.2f %%  max %.2f %%  torque RMS %.2f %%\n", motion.name.c_str(),
                result.model.rms_pct, result.model.max_pct, result.model.torque_rms_pct);
    EXPECT_LT(result.model.rms_pct, 0.5 * result.held.rms_pct) << "a held force must be far worse";
    EXPECT_LE(result.swap_step_n, std::max(0.02 * result.peak_force_n, 0.01));
    if (motion.name == "needle" || motion.name == "sideways" || motion.name == "two_hands") {
      EXPECT_LE(result.model.rms_pct, 1.0);
      EXPECT_LE(result.model.max_pct, 3.0);
      EXPECT_LE(result.model.torque_rms_pct, 2.0);
    }
    if (motion.name == "tip") {
      EXPECT_LE(result.model.rms_pct, 4.0);
    }
    if (motion.name == "thread") {
      EXPECT_LE(result.model.rms_pct, 1.0);
      EXPECT_GT(result.frozen_rows_max, 0) << "more rows than a model holds were meant to meet";
    }
    if (motion.name != "two_hands") continue;
    const testing::FidelityResult alone =
        testing::measure_fidelity(motion, {.couple_tools = false});
    EXPECT_GT(alone.model.rms_pct, 10.0 * result.model.rms_pct);
  }
}

}  // namespace
}  // namespace sutured
