// SPDX-License-Identifier: GPL-3.0-or-later
// What a tool feels between steps, condensed from the solved rows.
//
// With B the rows that cannot switch and U those that can, Jᵗ the tool's columns and k the slide of
// a needle that slides freely:
//
//     A₀ = Jᵗ_Bᵀ W_BB⁻¹ Jᵗ_B        Ĵ = Jᵗ_U − W_UB W_BB⁻¹ Jᵗ_B       S = W_UU − W_UB W_BB⁻¹ W_BU
//     a  = Jᵗ_Bᵀ W_BB⁻¹ k_B          k̂ = k_U − W_UB W_BB⁻¹ k_B          κ = k_Bᵀ W_BB⁻¹ k_B
//
// A slide that leaves the axial force where it is obeys σ = gᵀ ξ + …, g = −a / κ, and removing it
// is one symmetric update,
//
//     A₀ − a aᵀ / κ     Ĵ − k̂ aᵀ / κ     S + k̂ k̂ᵀ / κ
//
// which for a rigid grip is A P with P = I − s sᵀA / (sᵀ A s). Offsets follow from the solved
// state.
#pragma once

#include <span>
#include <vector>

#include "constraints/complementarity.hpp"
#include "simulation/needle_body.hpp"
#include "simulation/tool_body.hpp"

namespace sutured::simulation {

/// Builds the responses of all tools from one solved problem. Allocates: only at first.
class ResponseBuilder {
 public:
  /// Fills `response` for tool `index`. `lambda` and the solver are of the same solve.
  void build(const constraints::ConstraintRows& rows,
             const constraints::ComplementaritySolver& solver, std::span<const double> lambda,
             std::span<const NeedleBody> needles, const ToolBody& tool, int index,
             ToolResponse& response);

 private:
  std::vector<double> columns_, half_, condensed_;
  std::vector<double> slide_, slide_half_, slide_condensed_;
  std::vector<int> chosen_;
};

}  // namespace sutured::simulation
