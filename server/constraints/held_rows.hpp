// SPDX-License-Identifier: GPL-3.0-or-later
// Rows of a tissue at rest, whose compliance need not be made again (ADR 0051).
#pragma once

#include <span>

#include "constraints/rows.hpp"

namespace sutured::constraints {

/// By no more than that may a coefficient C (weights of vertices in unit directions) change, and by
/// that share a compliance ε, to be held.
inline constexpr double kHeldChange = 1e-6;

/// Gives `rows` the coefficients and the compliances of `before`, where these are the same rows and
/// none of either has changed by more than kHeldChange; and each the target b with which its gap at
/// the tissue's `positions_m` stays what it is but for ε λ. All rows or none: returns whether it
/// did. Rows of needles are never held, since a needle's mobility is of each step.
[[nodiscard]] bool hold_coefficients(ConstraintRows& rows, const ConstraintRows& before,
                                     std::span<const Vec3> positions_m);

}  // namespace sutured::constraints
