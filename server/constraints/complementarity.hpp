// SPDX-License-Identifier: GPL-3.0-or-later
// The multipliers of a step: a mixed complementarity problem with bounds.
//
//     w = W λ − q,   lower ≤ λ ≤ upper
//     w_i ≥ 0 where λ_i = lower_i,   w_i ≤ 0 where λ_i = upper_i,   w_i = 0 between
//
// Unbounded (bilateral) rows B are condensed out once by Cholesky,
//
//     W_BB = L Lᵀ,   V = L⁻¹ W_BU,   S = W_UU − Vᵀ V,   q_S = q_U − Vᵀ L⁻¹ q_B
//
// and the bounded rows U are solved on S by block principal pivoting: every row on the wrong
// side of its bound or of its gap switches at once, while their number falls (Júdice & Pires 1994).
// When it has not fallen for ten rounds, the primal active-set method takes over, which lowers
// ½ λᵀ S λ − q_Sᵀ λ from round to round and so ends for every positive definite S; ε > 0 makes it
// so. The same L, V and S give the haptic model its condensed problem.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "constraints/compliance.hpp"
#include "constraints/rows.hpp"

namespace sutured::constraints {

/// Which side a row is on.
enum class RowState : std::uint8_t { kLower, kFree, kUpper };

/// How a solve went.
struct SolveReport {
  int pivoting_rounds = 0;
  int active_bounded_rows = 0;  ///< bounded rows that are not at λ = 0
  bool converged = true;        ///< false: `lambda` is the best found, and clamped to its bounds
  bool regularised = false;     ///< W was singular; a multiple of its trace was added
  /// max_i |mid(λ_i − upper_i, w_i · stiffness, λ_i − lower_i)| over λ_max, dimensionless:
  /// how far any row is from solving its own condition, gaps counted against 1 mm. Infinite where
  /// a multiplier or a gap is not finite.
  double residual = 0.0;
};

/// Factors a problem, solves it, and condenses further things onto its bounded rows.
///
/// Thread: simulation. Allocates: only when a problem outgrows every earlier one.
class ComplementaritySolver {
 public:
  /// Takes the memory for `rows` rows.
  void reserve(int rows);

  /// Takes W and the bounds of the rows and condenses the bilateral rows out. `kept` says that W is
  /// what it was in the call before: where the same rows are bilateral, so is all that follows.
  void factor(const ComplianceMatrix& w, std::span<const Bounds> bounds, bool kept = false);

  /// Solves for `lambda` (size m). `state` (size m) is the warm start and receives the result.
  SolveReport solve(std::span<const double> q, std::span<double> lambda, std::span<RowState> state);

  /// Returns w = W λ − q of the last solve, m, per row in the caller's order.
  [[nodiscard]] std::span<const double> gap_m() const { return gap_; }

  /// Rows of the factored problem, in the caller's numbering.
  [[nodiscard]] std::span<const int> bilateral() const { return bilateral_; }
  [[nodiscard]] std::span<const int> bounded() const { return bounded_; }

  /// Condenses the columns `j` (m × `columns`, column-major) onto the bounded rows:
  ///
  ///     half = L⁻¹ j_B            (so that halfᵀ half = j_Bᵀ W_BB⁻¹ j_B)
  ///     condensed = j_U − Vᵀ half
  void condense(const double* j, int columns, std::vector<double>& half,
                std::vector<double>& condensed) const;

  /// Returns S_ab for two bounded rows (positions in `bounded()`).
  [[nodiscard]] double condensed_compliance(int a, int b) const {
    return s_[static_cast<std::size_t>(b) * bounded_.size() + static_cast<std::size_t>(a)];
  }

 private:
  [[nodiscard]] const Bounds& bounds_of(int i) const;
  [[nodiscard]] RowState right_state(int i) const;
  [[nodiscard]] bool same_bilateral(std::span<const Bounds> bounds) const;
  bool solve_free();
  bool factor_free(double largest);
  int count_wrong();
  bool descend(int& rounds);

  int m_ = 0;
  const ComplianceMatrix* w_ = nullptr;
  std::vector<Bounds> bounds_;
  std::vector<int> bilateral_, bounded_;
  std::vector<double> l_;               ///< n_B × n_B, lower
  std::vector<double> v_;               ///< n_B × n_U
  std::vector<double> s_;               ///< n_U × n_U
  bool regularised_ = false;            ///< in this solve
  bool bilateral_regularised_ = false;  ///< in what `factor` made
  double lambda_scale_ = 0.0;
  std::vector<double> half_q_, qs_, lambda_u_, gap_u_, magnitude_u_, feasible_u_, reduced_,
      reduced_rhs_, gap_, residual_scratch_;
  std::vector<int> free_;
  std::vector<int> reduced_of_;  ///< the free rows whose factor `reduced_` is; empty: of none
  std::vector<RowState> state_u_;
};

}  // namespace sutured::constraints
