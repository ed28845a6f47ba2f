// SPDX-License-Identifier: GPL-3.0-or-later
// What the hands of a random surgeon would feel: each tool's own channel, at 1 kHz, on a clock that
// the simulation's steps move. Devices, each with limits of its own, send their poses on the
// straight way from step to step, in the world's frame or in theirs; some poses and models are
// lost, hands go away, and tools are stopped.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "haptics/pose_board.hpp"
#include "haptics/tool_channel.hpp"
#include "simulation/simulation.hpp"
#include "support/random_scene.hpp"

namespace sutured::soak {

/// Holds every force that a hand is given against the limits of its tool.
class FeltForces {
 public:
  FeltForces(std::uint64_t seed, const scene::Scene& scene);

  /// The world was replaced.
  void reset();
  /// Plays the ticks between the last step and this one, whose inputs were `inputs`, and hands the
  /// step's models over. Returns what is wrong with a force, or nothing.
  [[nodiscard]] std::optional<std::string> play(const simulation::Simulation& sim,
                                                const std::vector<simulation::ToolInput>& inputs,
                                                double dt_s);

  /// Returns how many forces the hands were given.
  [[nodiscard]] std::uint64_t forces() const { return forces_; }
  /// Returns how many of them were not zero.
  [[nodiscard]] std::uint64_t felt() const { return felt_; }
  [[nodiscard]] double largest_n() const { return largest_n_; }

 private:
  struct Tool {
    std::string name;
    std::unique_ptr<haptics::ToolChannel> channel;
    simulation::ToolInput last;
    haptics::ForceSample force;
    std::int64_t force_ns = 0;
    std::uint64_t poses = 0, changed = 0;
    haptics::Frame frame = haptics::Frame::kWorld;
    int lost_poses = 0, lost_models = 0;  ///< that will not arrive
  };
  std::optional<std::string> hold(Tool& tool, const haptics::ForceSample& force,
                                  std::int64_t now_ns);

  testing::Random random_;
  haptics::PoseBoard board_;
  std::vector<Tool> tools_;
  std::unique_ptr<suture::HapticModel> model_;
  std::int64_t now_ns_ = 1'000'000'000;
  std::uint64_t epoch_ = 1, forces_ = 0, felt_ = 0;
  double largest_n_ = 0.0;
};

}  // namespace sutured::soak
