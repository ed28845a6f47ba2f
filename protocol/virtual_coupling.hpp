// SPDX-License-Identifier: Apache-2.0
// A virtual coupling for what is stiffer than a device can render: a spring between the hand
// and the pose at which the model is evaluated (the proxy), as soft as the device needs and
// only in the directions that need it.
//
// A device that samples at period T with damping b of its own renders a stiffness k stably up
// to about k ≤ 2 b / T (Colgate and Schenkel, 1997). Its maker knows k_max and says so in
// DeviceProfile; tissue lies far below, a needle in a grip or a probe on a fold may not.
#pragma once

#include "protocol/haptic_model.hpp"

namespace suture {

/// Puts a spring of compliance C in series with `model` wherever it is stiffer than
/// `max_stiffness_n_per_m`, and returns how stiff it was (N/m).
///
/// The proxy ξ_p stands where the coupling carries what the tissue gives there:
///
///     ξ_p = ξ + C w(ξ_p)                                                   (1)
///
/// The model is convex, so (1) has one solution, and needs no iteration: eliminated from the
/// model's own equations it leaves a model of the same form,
///
///     w_0' = Mᵀ w_0             A_0' = A_0 M           M = (I + C A_0)⁻¹    (2)
///     Ĵ'  = Ĵ M                 q'   = q + Ĵ M C w_0
///     S'  = S + Ĵ M C Ĵᵀ
///     B'  = Mᵀ B                J_o' = J_o − Ĵ M C B        of each other tool
///
/// with A_0' and S' symmetric and positive semidefinite as before: what is passive stays so.
/// It is done once a model, not once a tick.
///
/// C comes from the stiffest that any active set of the model can be, all rows free,
///
///     A_max = A_0 + Ĵᵀ S⁻¹ Ĵ ⪰ A of every active set
///
/// in coordinates (t, ℓθ), so that one limit serves both: A_max = V diag(a) Vᵀ,
/// C = V diag(max(0, 1/k − 1/a)) Vᵀ. Then A_max' has the eigenvalues min(a, k), no active set
/// is stiffer than k, and where a ≤ k nothing is changed. Torsion is limited to k ℓ².
///
/// The first-order corrections of ModelEvaluator::evaluate keep the hand's ξ: they are small
/// where the coupling acts, and it does not act along the slide, whose stiffness is zero.
///
/// `max_stiffness_n_per_m` is at the tool, in the world: a device's limit divided by
/// force_scale × motion_scale. Not positive or not finite: no limit. Completes the model
/// again where it changed it. Thread: any. Allocates: nothing. Cost: where nothing is too
/// stiff one Cholesky of S and a 6 × 6 eigenproblem, at most 30 µs at m = 64.
double couple_model(HapticModel& model, double max_stiffness_n_per_m) noexcept;

/// Holds the friction of `model` as it was in its step where following the speed of the slide
/// would damp the hand by more than `max_damping_n_s_per_m`.
///
/// The slide's c is the only damper of a model. The hand feels c g gᵀ, at most c |g|² in the
/// coordinates (t, ℓθ); so damping of a turn is limited to ℓ² times the limit. A device renders one
/// stably up to some strength (its velocity is a difference of positions, a tick late), and its
/// maker says so in DeviceProfile. A weaker c would not do: the force would fall from the step's
/// friction to the weaker one within each period, and buzz.
///
/// At the tool, in the world, as of `couple_model`. Not positive or not finite: no limit.
/// Thread: any. Allocates: nothing.
void limit_damping(HapticModel& model, double max_damping_n_s_per_m) noexcept;

}  // namespace suture
