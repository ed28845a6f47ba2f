// SPDX-License-Identifier: GPL-3.0-or-later
// Contact between the boundaries of all tissues, and of a boundary with itself.
//
// Normal-only unilateral rows (paper section 2, tangents released),
//
//     n · Σ cᵢ xᵢ − d + ε λ ≥ 0,   λ ≥ 0        d = kThickness_m: surfaces rest this far apart
//
// for the pairs that are true closest features:
//
//   vertex–face   the vertex projects into the face, and faces it; of several faces that it lies
//                 behind, the nearest
//   edge–edge     the edges cross inside both, and around each crossing its own surface lies
//                 behind the common perpendicular: the normal is in the normal cones of both
//
// Broad phase: each vertex and edge keeps the features within its reach and a margin, and looks
// again when its own way and the longest of all together have used up the margin; where nothing is
// near, what was clear when it last looked. It passes over those that cannot face it, by cones
// around the normals below each node of the tree: all of a smooth surface, at a glance.
// Choice: made anew when the surfaces have moved by kChoose_m since the last, of what is near
// enough to close within two steps of its own motion; a pair that carried force stays on looser
// terms, and only one that was known before may be deep: surfaces meet from outside. So still
// tissue keeps its pairs, and a step is a smooth map that settles.
//
// Relaxation: a row knows the normal of the step before, not how it turns when its pair slides.
// Under a large force that lets features overshoot past each other and back, for ever. So where a
// pair carries force, n and c of its row go half of the way to those of the present each step:
//
//     x ← A c,   c ← (1 − ω) c + ω c(x)        stable for eigenvalues of A ∂c/∂x in (1 − 2/ω, 1)
//
// Above 1 the equilibrium itself is unstable. Once all is still, c = c(x): the equilibrium is that
// of surfaces without friction (docs/adr/0031).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "archive/archive.hpp"
#include "constraints/rows.hpp"
#include "contact/features.hpp"
#include "contact/proximity.hpp"
#include "geometry/triangle_tree.hpp"

namespace sutured::contact {

/// Surfaces in contact rest this far apart: what the rows give way, and what a step misses, stays
/// below it, so that nothing is seen to pass through.
inline constexpr double kThickness_m = 1e-5;

enum class PairKind : std::uint8_t { kVertexFace, kEdgeEdge };

/// Two features near each other.
struct Pair {
  PairKind kind{};
  std::int32_t first = -1;   ///< vertex of the mesh, or edge
  std::int32_t second = -1;  ///< triangle, or edge
  std::array<std::int32_t, 4> vertices{};
  Proximity proximity;                  ///< where the tissue was at the last update
  Vec3 normal = Vec3::Zero();           ///< of its row: follows that of `proximity`
  std::array<double, 4> coefficient{};  ///< likewise
  double force_n = 0.0;                 ///< of the last solve
  [[nodiscard]] std::uint64_t key() const {
    return (std::uint64_t{1} << 63) |
           (static_cast<std::uint64_t>(kind == PairKind::kEdgeEdge) << 62) |
           (static_cast<std::uint64_t>(first) << 31) | static_cast<std::uint64_t>(second);
  }
};

/// Thread: simulation. Allocates: when more is near than ever before.
class TissueContact {
 public:
  TissueContact() = default;
  /// `tissue_of_triangle`, `young_modulus_pa`: per boundary triangle.
  TissueContact(const geometry::BoundarySurface& surface, std::span<const Vec3> rest_m,
                std::vector<int> tissue_of_triangle, std::vector<double> young_modulus_pa);

  void reset();
  /// Archives the pairs and what decides about the next ones. The lists of what is near are caches:
  /// without them all is looked for anew.
  void serialize(Archive& archive);

  /// Finds and renews the pairs where the tissue is now. `tree` is over the surface, refit.
  void update(std::span<const Vec3> positions_m, const geometry::TriangleTree& tree);

  /// Returns the vertices of the boundary that face another part of it, or of another tissue,
  /// within `distance_m`, nearest first: those that contact may want. Cost: a search. For set-up.
  [[nodiscard]] std::vector<std::int32_t> facing_vertices(std::span<const Vec3> positions_m,
                                                          const geometry::TriangleTree& tree,
                                                          double distance_m);

  /// Adds a row per pair.
  void add_rows(constraints::ConstraintRows& rows);
  void read(std::span<const double> lambda);

  [[nodiscard]] std::span<const Pair> pairs() const { return pairs_; }
  [[nodiscard]] int tissue_of(const Pair& pair, bool second) const;

 private:
  void renew_normals(std::span<const Vec3> positions_m);
  [[nodiscard]] geometry::OpposingDirections opposing(
      std::span<const std::int32_t> triangles) const;
  template <typename Visit>
  void for_each_facing(std::int32_t vertex, double radius_m, std::span<const Vec3> positions_m,
                       const geometry::TriangleTree& tree, Visit&& visit) const;
  void note_motion(std::span<const Vec3> positions_m);
  void search(std::span<const Vec3> positions_m, const geometry::TriangleTree& tree);
  void list_close();
  void choose(std::span<const Vec3> positions_m);
  void choose_vertex(std::int32_t vertex, std::span<const std::int32_t> triangles,
                     std::span<const Vec3> positions_m);
  void choose_edge(std::int32_t edge, std::span<const std::int32_t> others,
                   std::span<const Vec3> positions_m);
  [[nodiscard]] const Pair* known(std::uint64_t key) const;
  [[nodiscard]] bool admit(Pair& pair) const;
  [[nodiscard]] std::int32_t triangle_of(const Pair& pair, bool second) const;
  [[nodiscard]] double softer_modulus_pa(const Pair& pair) const;
  [[nodiscard]] bool through_solid(std::int32_t vertex, std::int32_t triangle) const;
  [[nodiscard]] Vec3 edge_normal(const SurfaceEdge& edge) const;
  void renew(Pair& pair, std::span<const Vec3> positions_m) const;
  static void follow(Pair& pair);

  const geometry::BoundarySurface* surface_ = nullptr;
  SurfaceFeatures features_;
  std::vector<Vec3> rest_m_, rest_normals_;  ///< per vertex of the mesh; per triangle
  std::vector<int> tissue_of_triangle_;
  std::vector<double> young_modulus_pa_;
  double edge_length_m_ = 0.0;  ///< mean
  double far_m_ = 0.0;          ///< how far beyond the reach features are looked for

  std::vector<Vec3> last_m_, normals_;  ///< per surface vertex; per triangle
  double reach_m_ = 0.0;                ///< no pair is farther apart
  int slow_steps_ = 0;                  ///< in a row
  std::vector<Vec3> moved_m_;           ///< per vertex of the mesh: in the last step
  std::vector<double> way_m_;           ///< its length
  double motion_m_ = 0.0, chosen_at_m_ = -1.0, speed_m_ = 0.0;
  std::vector<geometry::DirectionCone> cones_;  ///< per node of the tree
  std::vector<std::vector<std::int32_t>> near_vertex_, near_edge_;
  std::vector<double> vertex_left_m_, edge_left_m_;        ///< to move before it looks again
  std::vector<double> vertex_clear_, edge_clear_;          ///< beyond the reach, when last looked
  std::vector<std::size_t> close_vertices_, close_edges_;  ///< with candidates
  std::vector<Pair> pairs_, known_;                        ///< now; of the choice before, by key
  int first_row_ = 0;
};

}  // namespace sutured::contact
