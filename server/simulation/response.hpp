// SPDX-License-Identifier: GPL-3.0-or-later
// What the tools feel between steps, condensed from the solved rows.
//
// With B the rows that cannot switch, U those that can, and X the columns of everything that moves
// without being solved for (Jᵗ of every tool, 6 each; k of every needle that slides freely), one
// symmetric matrix has it all, for all tools of a step:
//
//         ⎡ W_UU  X_U ⎤   ⎡ W_UB ⎤                            ⎡  S   X̂ ⎤
//     M = ⎢           ⎥ − ⎢      ⎥ W_BB⁻¹ [ W_BU  X_B ]    =  ⎢        ⎥
//         ⎣ X_Uᵀ   0  ⎦   ⎣ X_Bᵀ ⎦                            ⎣ X̂ᵀ  −G ⎦
//
// What follows are Schur complements of it, M ← M − m_p m_pᵀ / M_pp:
//
//     release   a row of B whose force has a bound (a tip that stands within its friction cone) may
//               switch: its unit column joins X, and trades places with its row.
//     slide     each k goes. With κ = G_kk and a = G_·k that takes a aᵀ / κ from G: the slide that
//               leaves the axial force where it is, σ = gᵀ ξ + …, g = −a / κ; for a rigid grip G P
//               with P = I − s sᵀG / (sᵀ G s).
//     choose    of more than kRowsMax rows those nearest to switching as this tool moves. The
//     others
//               keep their side: without force they are left out, in force they go as B did.
//
// Then A₀ = G_aa and Ĵ = X̂_a for tool a, coupled to tool b by G_ab and X̂_b. M is symmetric, so what
// b does to a is what a does to b. Offsets follow from the solved state.
#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include "constraints/complementarity.hpp"
#include "simulation/needle_body.hpp"
#include "simulation/tool_body.hpp"

namespace sutured::simulation {

/// Builds the responses of all tools from one solved problem. Allocates: only when a problem
/// outgrows every earlier one.
class ResponseBuilder {
 public:
  /// Fills `responses`, one per tool. `lambda` and the solver are of the same solve of `rows`.
  void build(const constraints::ConstraintRows& rows,
             const constraints::ComplementaritySolver& solver, std::span<const double> lambda,
             std::span<const NeedleBody> needles, std::span<const ToolBody> tools,
             std::span<ToolResponse> responses);

 private:
  /// A row that may switch, its multiplier counted from its lower bound.
  struct Candidate {
    int index = -1;  ///< in M
    double multiplier_n = 0.0, multiplier_max_n = 0.0, gap_m = 0.0;
    int row = -1, normal_row = -1;  ///< its constraint row, and that of its normal force
    double friction_coefficient = 0.0;
    double radius_m = 0.0;  ///< of the tool's motion within which it keeps its side
    [[nodiscard]] bool in_force() const {
      return multiplier_n > 0.0 && multiplier_n < multiplier_max_n;
    }
  };
  struct Slide {
    int needle = -1;
    double stiffness = 0.0;        ///< κ
    std::vector<double> gradient;  ///< g, for all tools
  };

  void find_columns();
  void assemble();
  void pivot(int index, bool exchange);
  void gather();
  void choose(int own);
  void extract();
  void build(int tool, ToolResponse& response);
  [[nodiscard]] double& m(int i, int j) {
    return m_[static_cast<std::size_t>(std::min(i, j)) * static_cast<std::size_t>(size_) +
              static_cast<std::size_t>(std::max(i, j))];
  }

  // Of the call.
  const constraints::ConstraintRows* rows_ = nullptr;
  const constraints::ComplementaritySolver* solver_ = nullptr;
  std::span<const double> lambda_;
  std::span<const NeedleBody> needles_;
  std::span<const ToolBody> tools_;
  std::vector<int> felt_;      ///< tools that touch a row
  std::vector<int> released_;  ///< rows of B that may switch
  std::vector<Slide> slides_;
  std::size_t slide_count_ = 0;
  // M: the solver's bounded rows, the tools' columns, the slides', the released rows'.
  int bounded_ = 0, columns_ = 0, size_ = 0;
  std::vector<double> m_, column_, x_, half_, condensed_;
  std::vector<Candidate> candidates_, chosen_, frozen_;
  // Of the present tool: M of its chosen rows and of the tools' columns, and scratch.
  std::vector<double> own_, factor_, right_;
};

}  // namespace sutured::simulation
