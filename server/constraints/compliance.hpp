// SPDX-License-Identifier: GPL-3.0-or-later
// The compliance W of constraint rows, without a single solve with K.
//
//     W = C K⁻¹ Cᵀ + ε + J M Jᵀ + β k kᵀ          (paper eq. 1, Schur complement)
//
//   G   K⁻¹ restricted to the vertices in use, 3 × 3 blocks: inner products of walked columns
//   M   6 × 6 mobility of a needle (m/N …): its own six unknowns condensed
//   β   slide compliance of a needle (m/N)
//
// G is kept from step to step: a vertex that joins costs one walk of its path and its inner
// products; one that stays costs nothing.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "archive/archive.hpp"
#include "constraints/rows.hpp"
#include "fem/cholesky_factor.hpp"

namespace sutured::constraints {

/// How a needle gives way, condensed onto the rows that touch it.
struct NeedleMobility {
  Mat6 mobility = Mat6::Zero();           ///< M, symmetric
  double slide_compliance_m_per_n = 0.0;  ///< β
};

/// A dense symmetric matrix, both triangles filled, column-major, m × m.
struct ComplianceMatrix {
  int size = 0;
  std::vector<double> value;
  [[nodiscard]] double operator()(int i, int j) const {
    return value[static_cast<std::size_t>(j) * static_cast<std::size_t>(size) +
                 static_cast<std::size_t>(i)];
  }
};

/// K⁻¹ at the vertices in use, and what follows from it.
///
/// Thread: simulation. Allocates: for vertices it has never seen together, and when `rows`
/// outgrows every earlier call.
class Compliance {
 public:
  explicit Compliance(std::shared_ptr<const fem::CholeskyFactor> factor);

  /// Walks the paths of `vertices` and multiplies their pairs before they are needed, and keeps
  /// them for good. Rows of vertices that stand close together here are short. Call at set-up, with
  /// nothing cached. Cost for V vertices: V²/2 products of paths, 72 V² bytes of G, and their
  /// paths.
  void prepare(std::span<const std::int32_t> vertices);

  /// Forgets vertices unused for `idle_steps_max` calls of `assemble`.
  void evict(int idle_steps_max);
  /// Forgets all vertices but the prepared, and forces: what follows comes out to the bit as after
  /// construction.
  void clear();

  /// Condenses the tissue and the needles onto `rows`. Cost: O(4 m V) for V vertices in use.
  const ComplianceMatrix& assemble(const ConstraintRows& rows,
                                   std::span<const NeedleMobility> needles);

  /// Takes the forces Cᵀ λ of solved rows as the present ones.
  void apply(const ConstraintRows& rows, std::span<const double> multiplier_n);

  /// Returns the displacement (m) that the present forces cause at `vertex`, loads excluded.
  [[nodiscard]] Vec3 displacement_m(std::int32_t vertex);

  /// Writes all displacements, 3n: `offset` (those of the loads) plus K⁻¹ Cᵀ λ, by one
  /// backward pass.
  void displacements_m(std::span<const double> offset, std::span<double> u);

  /// Archives the present forces, and with its caches the columns and the part of G that were not
  /// prepared: prepared ones are the same in every instance of a scene.
  void serialize(Archive& archive);

  [[nodiscard]] int cached_vertices() const;
  [[nodiscard]] std::uint64_t walks() const { return walks_; }

 private:
  int slot_of(std::int32_t vertex);
  int free_slot();
  void serialize_slots(Archive& archive);
  void walk_new(const ConstraintRows& rows);
  void walk(std::span<const std::int32_t> vertices);
  void forget(int slot);
  void make_pairs(std::span<const int> a, std::span<const int> b);
  void ensure_pairs();
  void grow(int capacity);
  void ensure_pair(int a, int b);
  [[nodiscard]] double* g_row(int row) {
    return g_.data() + static_cast<std::size_t>(row) * pitch_;
  }

  std::shared_ptr<const fem::CholeskyFactor> factor_;
  int capacity_ = 0;
  std::size_t pitch_ = 0;  ///< doubles from one row of G to the next
  int high_water_ = 0;     ///< slots beyond it were never used
  int prepared_ = 0;       ///< slots that are kept for good, the first
  std::uint64_t step_ = 0, walks_ = 0;
  std::vector<std::int32_t> slot_of_vertex_;  ///< −1 where not cached
  std::vector<fem::PathColumns> columns_;     ///< per slot; vertex −1 where free
  std::vector<std::uint64_t> last_used_;      ///< per slot
  std::vector<double> g_;                     ///< 3 capacity rows, `pitch_` apart
  std::vector<std::uint8_t> known_;           ///< capacity × capacity: pairs present in g_
  std::vector<std::int32_t> new_vertices_;    ///< of the present rows
  std::vector<fem::PathColumns*> new_columns_;
  std::vector<const fem::PathColumns*> columns_a_, columns_b_;
  std::vector<int> joining_, joining_prepared_, unprepared_;
  std::vector<double> new_blocks_;
  std::vector<int> paired_;                ///< slots whose pairs are all present
  std::vector<int> active_;                ///< slots of the present rows
  std::vector<int> entry_slot_;            ///< per entry of the present rows
  std::vector<int> order_;                 ///< the rows, by their last slot
  std::vector<int> entry_offset_;          ///< in that order: 3 × its slot
  std::vector<double> entry_coefficient_;  ///< likewise, 4 per entry, the last zero
  std::vector<std::int32_t> row_first_;    ///< likewise, m + 1: where a row's entries begin
  std::vector<double> products_;           ///< of one row with those before it
  std::vector<std::int64_t> row_width_;    ///< per row: columns of T that W needs of it
  std::vector<double> row_times_g_;        ///< T = C G, rows padded by one
  std::vector<Vec3> force_n_;              ///< per slot: Cᵀ λ
  std::vector<int> loaded_;                ///< slots with a force
  std::vector<fem::PathLoad> loads_;
  ComplianceMatrix w_;
};

}  // namespace sutured::constraints
