// SPDX-License-Identifier: GPL-3.0-or-later
// The needle's shaft against tissue from outside: it does not pass through a wall.
//
// The shaft is a tube of the needle's radius r about its axis. Points of the axis, kSpacing_m
// apart, look for the nearest point x of the surface; where one is nearer than its neighbours, and
// for every other point that is near, it is a normal-only unilateral row
//
//     gap = n · (p(s) − x) − r ≥ 0,   λ ≥ 0        n from x to p(s)
//
// Left out are the stretches that are in the tissue, with kHole_m on both sides of each, where
// the hole lets the shaft through, and as much behind the tip, which has rows of its own.
#pragma once

#include <array>
#include <span>

#include "archive/archive.hpp"
#include "constraints/rows.hpp"
#include "needle/path.hpp"
#include "simulation/tissue_state.hpp"

namespace sutured::simulation {

class NeedleBody;

/// Thread: simulation. Allocates: never.
class ShaftContact {
 public:
  static constexpr std::size_t kRowsMax = 28;
  struct Touch {
    int sample = 0;
    double s = 0.0;
    Vec3 point_m = Vec3::Zero();  ///< on the axis
    Vec3 normal = Vec3::UnitZ();  ///< from the surface to the axis
    needle::BoundaryPoint at;
    double gap_m = 0.0;
    double force_n = 0.0;
  };

  /// Finds what the shaft may meet within `reach_m`.
  void find(const TissueState& tissue, const NeedleBody& needle, double reach_m);
  void add_rows(const TissueState& tissue, const NeedleBody& needle, int needle_index,
                constraints::ConstraintRows& rows);
  void read(std::span<const double> lambda);
  void reset() { count_ = 0; }
  void serialize(Archive& archive);

  [[nodiscard]] std::span<const Touch> touches() const { return {touches_.data(), count_}; }
  [[nodiscard]] bool pressing() const;

 private:
  std::array<Touch, kRowsMax> touches_;
  std::size_t count_ = 0;
  int first_row_ = 0;
};

}  // namespace sutured::simulation
