// SPDX-License-Identifier: GPL-3.0-or-later
// The length of one piece of thread between two points, and its first two derivatives.
//
//     ℓ(d) = |d|                     |d| ≥ s          g = d / |d|      H = (I − g gᵀ) / |d|
//     ℓ(d) = |d|² / (2 s) + s / 2    |d| < s          g = d / s        H = I / s
//
//   d   from one end to the other, m       s   kShortSegment_m
//
// Below s a piece keeps a length of s / 2 and pulls with less than the tension: a thread has a
// thickness and does not turn on the spot, and the direction of a piece that vanishes (paper
// section 4, "suitably stabilized") stays defined. ℓ is convex and continuous to its first
// derivative, so a length row with T H beside it is a Newton step for every d.
#pragma once

#include <Eigen/Core>

#include "geometry/tet_mesh.hpp"

namespace sutured::thread {

using geometry::Vec3;

/// Pieces shorter than this are stabilised.
inline constexpr double kShortSegment_m = 1e-4;

struct SegmentLength {
  double length_m = 0.0;
  Vec3 gradient = Vec3::Zero();  ///< g, by the far end
  double curvature_per_m = 0.0;  ///< H = curvature (I − g gᵀ), or curvature I where short
  bool is_short = false;
};

/// Returns ℓ, g and H of a piece that reaches from the origin to `d_m`. Allocates: never.
[[nodiscard]] inline SegmentLength segment_length(const Vec3& d_m) {
  SegmentLength out;
  const double norm = d_m.norm();
  out.is_short = norm < kShortSegment_m;
  const double scale = out.is_short ? kShortSegment_m : norm;
  out.length_m = out.is_short ? 0.5 * (norm * norm / scale + scale) : norm;
  out.gradient = d_m / scale;
  out.curvature_per_m = 1.0 / scale;
  return out;
}

}  // namespace sutured::thread
