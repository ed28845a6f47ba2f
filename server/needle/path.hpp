// SPDX-License-Identifier: GPL-3.0-or-later
// Λ, the cells that the needle has passed through, and how a slide changes it (paper section 3.2).
//
// The needle's course through the tissue is topological: only the tip makes new cells, and a cell
// stays in the path until the tip is drawn back out of it. Cells the tail has left are the
// thread's way. From tail to tip:
//
//     bite 1                    gap       bite 2 …
//     ┌──────┬──────┬──────┐           ┌──────┬──
//     │ cell │ cell │ cell │           │ cell │ ▸ tip
//     └──────┴──────┴──────┘           └──────┴──
//     enters               leaves      enters
//
// A cell knows the stretch [s_back, s_front] of the needle inside it, and the material point ξ
// (barycentric) that sits at the middle of the active part of that stretch, s_mid. Tissue and
// needle need not coincide there: the difference x(ξ) − p(s_mid) is the elastic residual −ε λ
// of its sticking rows (eq. 3), and every change of the stretch keeps the force of the row where
// it grows, the force per length where it shrinks. So a slide by itself exerts no force.
//
// The walk obeys: leave a cell at the first outward crossing of one of its half-spaces (closed
// form, no triangle test); at once where already outside and moving out; ties within 1e-10 m
// fall at random from a seed carried in the state; start from the tip cell's own material point;
// retract by parameter. After repeated cells without length, step ahead and look around.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <random>
#include <span>
#include <utility>
#include <vector>

#include "archive/archive.hpp"
#include "fem/elements.hpp"
#include "geometry/topology.hpp"
#include "geometry/triangle_tree.hpp"
#include "needle/curve.hpp"

namespace sutured::needle {

/// The deforming tissue as the tracker sees it: all bodies, one numbering.
struct TissueView {
  std::span<const Vec3> positions_m;
  std::span<const geometry::Tet> tets;
  const geometry::TetAdjacency* adjacency = nullptr;
  const geometry::BoundarySurface* surface = nullptr;
  const geometry::TriangleTree* tree = nullptr;    ///< over `surface`, refit to positions
  std::span<const std::int32_t> triangle_of_face;  ///< 4 tet + face → surface triangle or −1

  [[nodiscard]] std::array<Vec3, 4> corners(std::int32_t tet) const {
    std::array<Vec3, 4> x;
    for (std::size_t a = 0; a < 4; ++a)
      x[a] = positions_m[static_cast<std::size_t>(tets[static_cast<std::size_t>(tet)][a])];
    return x;
  }
  [[nodiscard]] Vec3 at(std::int32_t tet, const Eigen::Vector4d& barycentric) const {
    const auto x = corners(tet);
    return barycentric[0] * x[0] + barycentric[1] * x[1] + barycentric[2] * x[2] +
           barycentric[3] * x[3];
  }
};

/// A place where the needle passes a boundary: a material point of a surface triangle.
struct BoundaryPoint {
  std::int32_t triangle = -1;  ///< of TissueView::surface
  Vec3 barycentric = Vec3::Zero();
};

/// One cell of Λ.
struct Cell {
  std::int32_t tet = -1;
  double s_back = 0.0,
         s_front = 0.0;          ///< stretch inside, towards tail and tip (m along the needle)
  double s_mid = 0.0;            ///< middle of its active part when last updated
  double active_length_m = 0.0;  ///< of the stretch within [0, length]; 0 behind the tail
  Eigen::Vector4d barycentric = Eigen::Vector4d::Zero();  ///< ξ, the material point at s_mid
  BoundaryPoint entered;                                  ///< set where its back is a boundary
  BoundaryPoint left;                                     ///< set where its front is a boundary
};

/// What a change of the path met, in order.
struct Crossing {
  enum class Kind : std::uint8_t {
    kEntered,    ///< the tip went in through a boundary
    kLeft,       ///< the tip went out through a boundary
    kWithdrawn,  ///< the tip was drawn back out of where it had entered
    kReturned,   ///< the tip was drawn back in through where it had left
    kBlocked     ///< the tip is at a boundary it may not pass
  };
  Kind kind{};
  BoundaryPoint at;
  double s = 0.0;
};

/// What boundaries do to an advancing tip.
enum class Passage : std::uint8_t {
  kClosed,  ///< they stop it
  kOnce,    ///< the first lets it out, and it stays outside
  kFree     ///< it passes all of them, out and in
};

/// Returns the length that scales a cell's coupling to the needle: its active length, with a floor
/// that keeps short cells from fading entirely. A cell with an entry holds the hole on the needle,
/// so its floor is higher.
[[nodiscard]] inline double coupling_length_m(const Cell& cell) {
  return std::max(cell.active_length_m, cell.entered.triangle >= 0 ? 200e-6 : 20e-6);
}

/// The path of one needle. Allocates: when it grows longer than ever before.
class Path {
 public:
  Path(const Curve& curve, std::uint64_t seed);

  [[nodiscard]] std::span<const Cell> cells() const { return cells_; }
  [[nodiscard]] bool tip_inside() const {
    return !cells_.empty() && cells_.back().left.triangle < 0;
  }
  /// Length of the needle inside tissue now.
  [[nodiscard]] double embedded_length_m() const;
  void clear();
  void serialize(Archive& archive);
  /// Removes the cells of the oldest bite. Precondition: the needle's tail has left it.
  void drop_first_bite();

  /// Slides the needle along itself by `slide_m` relative to the tissue: every parameter moves, the
  /// tip walks or is drawn back. `pose` is the needle's after the slide. Back through its own
  /// holes the tip always may. Returns what it crossed, valid until the next call.
  std::span<const Crossing> slide(const TissueView& tissue, const Pose& pose, double slide_m,
                                  Passage passage);

  /// Lets the tip in through `at`, which the needle's axis passes at parameter `s`, and walks on to
  /// the tip. Precondition: the tip is outside.
  std::span<const Crossing> enter(const TissueView& tissue, const Pose& pose,
                                  const BoundaryPoint& at, double s);

  /// Lets the tip out through the boundary it stands at: where its axis crosses one behind the tip,
  /// or else at `wall`. Precondition: the tip is inside.
  std::span<const Crossing> leave(const TissueView& tissue, const Pose& pose,
                                  const BoundaryPoint& wall);

  /// Finds the boundary that the tip would meet within `reach_m` ahead along the axis, if it is
  /// inside. The path stays as it is.
  [[nodiscard]] std::optional<std::pair<BoundaryPoint, double>> boundary_ahead(
      const TissueView& tissue, const Pose& pose, double reach_m);

  /// Finds the first boundary triangle that the axis enters between `from` and `to` (outside
  /// tissue).
  [[nodiscard]] static std::optional<std::pair<BoundaryPoint, double>> first_entry(
      const TissueView& tissue, const Curve& curve, const Pose& pose, double from, double to);

 private:
  struct Step {
    double s;
    int face;
  };
  Step leave_cell(const TissueView& tissue, const Pose& pose, const Vec3& shift, std::int32_t tet,
                  double from);
  void walk(const TissueView& tissue, const Pose& pose, Vec3 shift, double from, Passage passage);
  void enter_at(const TissueView& tissue, const Pose& pose, const BoundaryPoint& at, double s,
                Passage passage);
  void append(std::int32_t tet, double s);
  void update_active(const TissueView& tissue, const Pose& pose, Cell& cell) const;
  [[nodiscard]] std::int32_t tet_around(const TissueView& tissue, std::int32_t tet,
                                        const Vec3& p) const;

  Curve curve_;
  std::uint64_t seed_;
  std::minstd_rand random_;  ///< breaks ties; part of the state, so that runs repeat
  std::vector<Cell> cells_;  ///< from tail to tip
  std::vector<Crossing> crossings_;
};

/// Returns the barycentric coordinates of `p` in a surface triangle, by its projection.
[[nodiscard]] Vec3 triangle_barycentric(const TissueView& tissue, std::int32_t triangle,
                                        const Vec3& p);

/// Returns the material point of the surface in the world.
[[nodiscard]] Vec3 position(const TissueView& tissue, const BoundaryPoint& at);

/// Returns the outward unit normal of a surface triangle.
[[nodiscard]] Vec3 normal(const TissueView& tissue, std::int32_t triangle);

}  // namespace sutured::needle
