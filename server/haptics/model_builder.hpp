// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "protocol/haptic_model.hpp"
#include "simulation/types.hpp"

namespace sutured::haptics {

/// Fills `model` with what `response` says near its reference pose; leaves epoch,
/// sequence, stamp and period alone.
///
/// Beyond `kModelRowsMax` rows the ones farthest from switching (multipliers in metres of
/// their own compliance, gaps in metres) are frozen as they are and counted: rows at
/// λ = 0 are left out, rows at λ_max become constant forces, and free rows f are
/// condensed like bilateral ones:
///
///     S' = S − S_·f S_ff⁻¹ S_f·        q' = q − S_·f S_ff⁻¹ q_f
///     Ĵ' = Ĵ − S_·f S_ff⁻¹ Ĵ_f         w_0' = w_0 − Ĵ_fᵀ S_ff⁻¹ q_f
///     A_0' = A_0 + Ĵ_fᵀ S_ff⁻¹ Ĵ_f
///
/// Thread: simulation. Allocates: only beyond `kModelRowsMax` rows.
void fill_model(const simulation::ToolResponse& response, suture::HapticModel& model);

}  // namespace sutured::haptics
