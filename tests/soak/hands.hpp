// SPDX-License-Identifier: GPL-3.0-or-later
// A surgeon at random: what two hands and a probe do next, from a seed and from what they see.
//
// A hand plays short moves (go, follow the needle's curve, turn, hold, shake the jaw, vanish); when
// it has none left it plans the next manoeuvre from what it holds. A sensible surgeon approaches,
// grasps, drives, hands over, pulls thread through and lets go; a wild one also jumps, spins,
// flutters, tears, races and disappears.
#pragma once

#include <array>
#include <deque>
#include <vector>

#include "needle/curve.hpp"
#include "simulation/simulation.hpp"
#include "support/random_scene.hpp"

namespace sutured::soak {

using geometry::Vec3;

enum class Temper { kSensible, kWild };

class Surgeon {
 public:
  Surgeon(std::uint64_t seed, Temper temper, const scene::Scene& scene);

  /// Returns where the tools are at the end of the next step.
  const std::vector<simulation::ToolInput>& next(const simulation::Simulation& sim, double dt_s);

  /// Takes note of what was grasped and let go. Call after each step.
  void see(std::span<const simulation::Event> events);
  /// Everything was let go: the simulation was reset.
  void forget();

 private:
  enum class Kind : std::uint8_t { kGo, kAlong, kTurn, kHold, kFlutter, kJump, kVanish };
  struct Move {
    Kind kind = Kind::kHold;
    double jaw = 0.0;
    double speed_m_per_s = 0.0;    ///< kTurn: rad/s
    Vec3 target_m = Vec3::Zero();  ///< kGo; kTurn: axis
    double amount = 0.0;           ///< kAlong: metres left; others: steps left
  };
  enum class Held : std::uint8_t { kNothing, kNeedle, kThread, kTissue };
  struct Hand {
    simulation::ToolInput input;
    std::deque<Move> moves;
    Held held = Held::kNothing;
    int thing = -1;
  };

  void plan(std::size_t hand, const simulation::Simulation& sim);
  void plan_wild(Hand& hand);
  bool play(Hand& hand, const simulation::Simulation& sim, double dt_s);
  void reach(Hand& hand, const Vec3& target_m);
  [[nodiscard]] Vec3 on_needle(const simulation::Simulation& sim, double share) const;
  [[nodiscard]] double speed();

  testing::Random random_;
  Temper temper_;
  const scene::Scene* scene_;
  needle::Curve curve_;
  std::array<Hand, 3> hands_;
  std::vector<simulation::ToolInput> inputs_;
};

}  // namespace sutured::soak
