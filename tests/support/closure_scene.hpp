// SPDX-License-Identifier: GPL-3.0-or-later
// The paper's scene, without files: two vessels end to end, sewn all around, and pulled together.
//
//        ── proximal ──┐     ┌── distal ──        gap 1.5 mm at z = 0, far ends fixed
//            ● 2.75 mm └─────┘ 2.75 mm ●          ● a bite, straight through the wall
//
// Bite k lies at angle 4° + k 720°/n, of the proximal vessel where k is even: in from outside, out
// into the lumen; of the distal one where k is odd: in from the lumen, out. Between two bites the
// thread crosses the gap. So lie the punctures of the reference R4, too.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "scene/scene.hpp"

namespace sutured::testing {

/// How finely the two vessels are cut: from the paper's mesh (1,620 vertices, 5,832 tets) on, each
/// a refinement with the same grading.
enum class ClosureMesh { k1k6, k6k, k24k, k53k };

/// "v1k6", "v6k", "v24k" or "v53k".
[[nodiscard]] std::string name_of(ClosureMesh mesh);

struct ClosureOptions {
  ClosureMesh mesh = ClosureMesh::k1k6;
  int punctures = 20;  ///< even, at least 4; fewer than 20 lie 30° apart
  scene::ThreadModel model = scene::ThreadModel::kOutside;
  /// By how much the thread is shortened for each time it crosses the gap. The mean gap at the
  /// end follows; see `closing_shortening_m`.
  double shortening_m = 1.5e-3;
  double speed_m_per_s = 5e-3;  ///< of the shortening, of one piece across the gap
};

/// A scene that closes, and what a measurement of it needs to know.
struct Closure {
  scene::Scene scene;
  double open_length_m = 0.0;    ///< of the counted pieces at rest
  double closed_length_m = 0.0;  ///< the program's last
  double closed_at_s = 0.0;      ///< when the program reaches it; the pull begins at zero
  std::array<std::vector<std::int32_t>, 2> rim;  ///< vertices at the gap, common numbering
};

/// Builds the scene. One thread, `ends` none, no tools, contact on, 250 Hz.
[[nodiscard]] Closure closure_scene(const ClosureOptions& options);

/// Shortening that closes the gap, on `ClosureMesh::k1k6` with the thread pulling outside: 0.115 N
/// of tension at 20 punctures, 0.058 N at 50. The one stitch of 4 brings the rims together where
/// it lies, by 0.21 N.
[[nodiscard]] double closing_shortening_m(int punctures);

/// Returns the two vessels sewn by `punctures` and still open, the thread anchored at its tail, its
/// head free for the scene's one tool, "driver", to pull.
[[nodiscard]] scene::Scene hand_sewn_scene(int punctures);

/// Returns how far apart the rims are along z, on average; 1.5 mm at rest.
[[nodiscard]] double mean_gap_m(const Closure& closure,
                                std::span<const geometry::Vec3> positions_m);

}  // namespace sutured::testing
