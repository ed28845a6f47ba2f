// SPDX-License-Identifier: GPL-3.0-or-later
// How near a hand's rendered force is to a full re-solve: five motions, one way of measuring.
//
//     1 kHz run ──every ms──▶ truth
//         └──every 33 ms──▶ haptic model ──used one frame late──▶ evaluated, blended ──▶ shown
//
// A model is put to use when its successor is taken, so it is 33 to 66 ms old: as late as a scene
// of 30 Hz that takes a whole frame to solve.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "scene/scene.hpp"
#include "support/hands.hpp"

namespace sutured::testing {

/// One motion of one or two hands, from a state that was brought about before.
struct FidelityMotion {
  std::string name;   ///< "needle"
  std::string title;  ///< what the hands do, for the table
  scene::Scene scene;
  std::function<void(Hands&)> prepare;
  /// Where the tools are at `time_s` since the preparation, given where they were at its end.
  std::function<void(double time_s, const Hands& prepared, std::span<simulation::ToolInput>)> move;
  int tool = 0;  ///< whose force is compared
  double duration_s = 2.0;
};

/// Errors of one way to foresee the force, against the run at 1 kHz, in % of the run's peak.
struct FidelityError {
  double rms_pct = 0.0, max_pct = 0.0, torque_rms_pct = 0.0;
};

/// One millisecond of a run: the force along its own principal direction.
struct FidelitySample {
  double time_s = 0.0;
  simulation::Vec6 truth, model, held, linear;
};

struct FidelityResult {
  double peak_force_n = 0.0, peak_torque_nm = 0.0;
  FidelityError model, held, linear;
  /// Most by which the shown force leaves the truth's own change in one millisecond while a model
  /// gives way to the next, N; and what it would be without a blend.
  double swap_step_n = 0.0, swap_jump_n = 0.0;
  std::uint64_t fallbacks = 0;  ///< ticks that ended with a clamped multiplier
  int rows_max = 0, frozen_rows_max = 0;
  std::vector<FidelitySample> samples;
};

struct FidelityOptions {
  int model_period_ms = 33;
  bool couple_tools = true;  ///< models know the other tools
};

/// Returns the five: needle, sideways, tip, thread, two_hands. Throws where the scene's files
/// cannot be read.
[[nodiscard]] std::vector<FidelityMotion> fidelity_motions();

/// Runs one motion at 1 kHz and measures.
[[nodiscard]] FidelityResult measure_fidelity(const FidelityMotion& motion,
                                              const FidelityOptions& options = {});

/// Returns the error of everything together: a simulation that steps at `rate_hz`, its models
/// used one step late, against the run at 1 kHz whose truth is in `reference`.
[[nodiscard]] FidelityError measure_total_error(const FidelityMotion& motion,
                                                const FidelityResult& reference, double rate_hz);

}  // namespace sutured::testing
