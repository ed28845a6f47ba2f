// SPDX-License-Identifier: GPL-3.0-or-later
// The simulation: a value that steps. It knows no clock, no thread, no network.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "archive/archive.hpp"
#include "geometry/tet_mesh.hpp"
#include "scene/scene.hpp"
#include "simulation/types.hpp"

namespace sutured::simulation {

/// A tissue as viewers see it; indices of `surface` count from the body's first vertex.
struct Body {
  std::string name;
  std::int32_t first_vertex = 0;
  std::int32_t vertex_count = 0;
  std::vector<geometry::Triangle> surface;     ///< boundary, wound outward, body-local indices
  std::vector<std::int32_t> surface_vertices;  ///< body-local, sorted: the ones `surface` uses
};

/// Cauchy stress (xx, yy, zz, xy, yz, zx; Pa) of the last displacements. `fem/elements.hpp` has its
/// invariants: `von_mises_pa` and `principal_stress_pa`.
///
///     σ_v = Σ_t V_t σ_t / Σ_t V_t        over the tets t at vertex v, V_t their volumes at rest
///
/// The tensors are averaged and the invariants taken of the mean, so that what is shown at a vertex
/// is the invariant of one stress. Where materials meet, the mean is over all of them.
struct StressField {
  std::vector<Vec6> tet_pa;     ///< one per tet: constant in a linear tetrahedron
  std::vector<Vec6> vertex_pa;  ///< one per vertex: σ_v
};

/// Says whether a tool is somewhere that its rows may be made of: finite, and no coordinate beyond
/// 1e6 m.
[[nodiscard]] bool may_follow(const ToolInput& tool) noexcept;

/// Tissue, needles and tools of one scene, stepped through quasi-static equilibria.
///
/// Thread: one at a time. Allocates: in the constructor, and in steps that touch new vertices.
class Simulation {
 public:
  /// Assembles and factors the tissue. Throws scene::SceneError if K is not positive definite.
  explicit Simulation(const scene::Scene& scene);
  ~Simulation();
  Simulation(Simulation&&) noexcept;
  Simulation& operator=(Simulation&&) noexcept;

  /// Moves to the next equilibrium: the tools go to `tools` (one per scene tool, in order)
  /// within `dt_s`, in as many substeps as their motion asks for. Throws std::invalid_argument,
  /// and changes nothing, where a present tool's place is none that `may_follow` accepts. A solve
  /// that gives no finite multipliers is told as a kSolverResidual event, and its forces are none.
  void step(std::span<const ToolInput> tools, double dt_s);

  /// Brings the displacements of all vertices up to the last step: one backward pass.
  /// Forces, responses and needles do not need it.
  void update_displacements();

  /// Returns to the state after construction.
  void reset();

  /// Archives the whole state, from which another instance of the same scene goes on: with the
  /// caches to the bit, without them up to rounding. Everything that can be read is as it was, but
  /// for the times in `report`. Throws ArchiveError when reading; it is then as after `reset`.
  void serialize(Archive& archive);

  [[nodiscard]] double time_s() const;
  [[nodiscard]] std::span<const ToolResponse> responses() const;  ///< one per tool
  [[nodiscard]] std::span<const NeedleState> needles() const;
  [[nodiscard]] std::span<const ThreadState> threads() const;    ///< one per scene thread
  [[nodiscard]] std::span<const ContactPoint> contacts() const;  ///< pairs that carry force
  [[nodiscard]] std::span<const Event> events() const;           ///< of the last step
  [[nodiscard]] const StepReport& report() const;
  [[nodiscard]] std::span<const Body> bodies() const;
  /// Present positions of all vertices, bodies one after the other (m, world).
  [[nodiscard]] std::span<const geometry::Vec3> positions_m() const;
  [[nodiscard]] std::span<const geometry::Vec3> rest_positions_m() const;
  [[nodiscard]] std::span<const geometry::Tet> tets() const;  ///< global vertex indices
  /// Computes the stress of all tets and vertices, of the last displacements, in one pass.
  /// Allocates: only where `field` is smaller than the tissue.
  void compute_stress(StressField& field) const;
  /// Writes what the rows of the last solve put on the tissue, Cᵀ λ (N, 3n, world axes): together
  /// with the loads it is what K u balances. Allocates: only where `force_n` is too small.
  void constraint_forces_n(std::vector<double>& force_n) const;
  /// Returns what grips, threads and contacts store in giving way, ½ Σ ε λ² over the rows of the
  /// last solve (J).
  [[nodiscard]] double row_energy_j() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace sutured::simulation
