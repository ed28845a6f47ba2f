// SPDX-License-Identifier: GPL-3.0-or-later
// The compliance W of constraint rows, without a single solve with K.
//
//     W = C K⁻¹ Cᵀ + ε + J M Jᵀ + β k kᵀ          (paper eq. 1, Schur complement)
//
//   K⁻¹ only between the vertices of rows: G of each part of the tissue, inverse_blocks.hpp
//   M   6 × 6 mobility of a needle (m/N …): its own six unknowns condensed
//   β   slide compliance of a needle (m/N)
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "archive/archive.hpp"
#include "constraints/inverse_blocks.hpp"
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
  /// nothing cached. Cost for V vertices of one part: V²/2 products of paths, 72 V² bytes of G, and
  /// their paths.
  void prepare(std::span<const std::int32_t> vertices);

  /// Takes the memory for `rows` rows and for some vertices that are not prepared. Call after
  /// `prepare`.
  void reserve(int rows);

  /// Forgets vertices unused for `idle_steps_max` calls of `assemble`.
  void evict(int idle_steps_max);
  /// Forgets all vertices but the prepared, and forces: what follows comes out to the bit as after
  /// construction.
  void clear();

  /// Condenses the tissue and the needles onto `rows`. Cost: three products for each entry and each
  /// vertex in use of its part; nearly none where `held` says that the coefficients of all rows are
  /// those of the call before, and no needle's (held_rows.hpp).
  const ComplianceMatrix& assemble(const ConstraintRows& rows,
                                   std::span<const NeedleMobility> needles, bool held = false);
  /// Returns whether the last call of `assemble` left W as it was.
  [[nodiscard]] bool kept() const { return kept_; }

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
  [[nodiscard]] std::uint64_t walks() const;

 private:
  /// A part of the tissue, and what of the present rows lies in it.
  struct Part {
    InverseBlocks inverse;
    std::vector<std::int32_t> new_vertices;  ///< not walked yet
    std::vector<int> active;                 ///< slots, sorted
    // The entries that lie here, row by row in the order of `order_`:
    std::vector<int> slot;                  ///< per entry
    std::vector<double> coefficient;        ///< 3 per entry
    std::vector<std::int32_t> first_entry;  ///< m + 1: where a row's entries begin
    std::vector<std::int64_t> width;        ///< per row: columns of T that W needs of it
    std::int64_t offset = 0;                ///< of the part's columns in a row of T
  };
  [[nodiscard]] Part& part_of(std::int32_t vertex) {
    return parts_[static_cast<std::size_t>(part_of_[static_cast<std::size_t>(vertex)])];
  }
  void take_vertices(const ConstraintRows& rows);
  void order_rows(const ConstraintRows& rows);
  void multiply_by_inverse(Part& part);
  void multiply_by_rows(const ConstraintRows& rows);
  void add_needles(const ConstraintRows& rows, std::span<const NeedleMobility> needles);

  std::shared_ptr<const fem::CholeskyFactor> factor_;
  std::vector<std::int32_t> part_of_;  ///< per vertex
  std::vector<Part> parts_;
  std::uint64_t step_ = 0;
  std::vector<int> entry_slot_;             ///< per entry of the present rows, in its part
  std::vector<int> order_;                  ///< the rows, by their last slot
  std::vector<int> last_slot_;              ///< per row
  std::vector<std::int32_t> entry_offset_;  ///< in that order: where its columns of T begin
  std::vector<double> entry_coefficient_;   ///< likewise, 4 per entry, the last zero
  std::vector<std::int32_t> first_entry_;   ///< likewise, m + 1: where a row's entries begin
  std::vector<double> products_;            ///< of four rows with those before them
  std::vector<double> row_times_g_;         ///< T = C G, in that order; part after part
  std::int64_t row_pitch_ = 0;              ///< from one row of T to the next
  std::vector<Vec3> force_n_;               ///< per vertex: Cᵀ λ
  std::vector<std::int32_t> loaded_;        ///< vertices with a force, sorted
  std::vector<std::uint8_t> is_loaded_;     ///< per vertex
  std::vector<fem::PathLoad> loads_;
  bool known_ = false, kept_ = false;  ///< W is of the call before; the last one kept it
  ComplianceMatrix w_;
};

}  // namespace sutured::constraints
