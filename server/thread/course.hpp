// SPDX-License-Identifier: GPL-3.0-or-later
// The thread's way through tissue: bites, and the material points they hang on.
//
// From tail to head:
//
//     tail ── p₁ ▒▒▒▒▒▒ p₂ ── p₃ ▒▒▒▒▒▒ p₄ ── … ── head
//             bite 1              bite 2
//
// A bite enters a tissue at one puncture and leaves it at the next; between them lies one inner
// point per cell that the needle (or, for a thread that starts in place, the straight line) passed.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "needle/path.hpp"

namespace sutured::thread {

using geometry::Vec3;

/// A point fixed to the tissue: of a boundary triangle (three vertices) or of a tet (four).
struct MaterialPoint {
  std::array<std::int32_t, 4> vertices{-1, -1, -1, -1};
  Eigen::Vector4d weight = Eigen::Vector4d::Zero();  ///< sums to one; zero where unused
  int count = 0;

  /// Returns its position where `vertices_m` are.
  [[nodiscard]] Vec3 position(std::span<const Vec3> vertices_m) const {
    Vec3 sum = Vec3::Zero();
    for (int i = 0; i < count; ++i)
      sum +=
          weight[i] * vertices_m[static_cast<std::size_t>(vertices[static_cast<std::size_t>(i)])];
    return sum;
  }
};

/// Returns the material point of a place on the surface.
[[nodiscard]] MaterialPoint on_surface(const geometry::BoundarySurface& surface,
                                       const needle::BoundaryPoint& at);

/// Returns the material point `barycentric` of a tet.
[[nodiscard]] MaterialPoint in_tet(const geometry::Tet& tet, const Eigen::Vector4d& barycentric);

/// One passage through a tissue, from the tail's side to the head's.
struct Bite {
  int tissue = -1;
  MaterialPoint entry, exit;
  std::vector<MaterialPoint> inner;
  bool open = false;  ///< the needle's tail is still inside: there is no exit yet
  /// What the piece inside counts for where only the outside is modelled: the distance of the
  /// two punctures when the bite was made.
  double inside_length_m = 0.0;
};

/// Finds the tets that the straight line from `entry` to `exit` passes, and returns the middle of
/// each stretch, in order: the inner points of a bite that starts in place. `tets` are those of one
/// tissue, or all. Cost: one clip per tet. Stretches under a micrometre are left out.
[[nodiscard]] std::vector<MaterialPoint> straight_course(std::span<const Vec3> vertices_m,
                                                         std::span<const geometry::Tet> tets,
                                                         const Vec3& entry, const Vec3& exit);

}  // namespace sutured::thread
