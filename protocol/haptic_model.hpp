// SPDX-License-Identifier: Apache-2.0
// The 1 kHz view of a simulation: what a tool feels near the pose of the last step.
//
// A simulation steps at 30 Hz to 1 kHz. Between two steps the multipliers of the
// constraint rows are known functions of the tool's small motion, so the force at the
// hand needs no simulation: a plain value, copied to whoever renders it, is enough.
//
//     simulation step k ──▶ HapticModel k ──┬─▶ server's haptic loop ──▶ ToolForce
//                                           └─▶ DDS ──▶ SDK, on the device's machine
//
// Both ends evaluate it with the code below and nothing else.
#pragma once

#include <array>
#include <cstdint>
#include <span>

namespace suture {

/// A rigid pose: metres, and a unit quaternion in the order x, y, z, w.
struct Pose {
  std::array<double, 3> position_m{};
  std::array<double, 4> orientation_xyzw{0.0, 0.0, 0.0, 1.0};
};

/// A force in newtons and a torque in newton metres about the tool's origin, on the hand.
struct Wrench {
  std::array<double, 3> force_n{};
  std::array<double, 3> torque_nm{};
};

/// A small rigid motion: velocity (m) of the tool's origin, then rotation vector (rad).
using Twist = std::array<double, 6>;

/// Returns the motion from `reference` to `pose`, world axes:
///
///     ξ = (t, θ),   θ = log(q q_k⁻¹),   p − p_k = V(θ) t,   V(θ) = ∫₀¹ exp(s [θ]) ds
///
/// the one screw that, followed for a unit of time, leads from one to the other. So a turn about
/// the centre of a needle's arc is a multiple of the slide's twist however far it goes; with p −
/// p_k itself the chord's bend would be taken for a push across the needle. The rotation vector is
/// the short one, |θ| ≤ π.
[[nodiscard]] Twist motion_between(const Pose& reference, const Pose& pose) noexcept;

/// Returns where the motion `xi` leads from `reference`: what motion_between turns back into `xi`.
[[nodiscard]] Pose moved_by(const Pose& reference, const Twist& xi) noexcept;

inline constexpr int kModelRowsMax = 64;
inline constexpr int kModelOthersMax = 7;
inline constexpr int kModelPackedMax = kModelRowsMax * (kModelRowsMax + 1) / 2;

/// Where entry (i, j), i ≥ j, of a symmetric matrix lies in its packed lower triangle.
[[nodiscard]] constexpr int packed_index(int i, int j) noexcept { return i * (i + 1) / 2 + j; }

/// How a tool's model depends on the small motion ξ' of another tool since `reference`, which it
/// feels through the tissue, a needle or a thread:
///
///     w −= stiffness ξ',   gap −= jacobian ξ'
struct ModelCoupling {
  std::int32_t tool = -1;              ///< the other one, in the numbering of who holds the model
  Pose reference;                      ///< its pose in the model's step
  std::array<double, 36> stiffness{};  ///< B: the other tool's towards this one is Bᵀ
  Twist slide_gradient{};              ///< g': the needle slides by g'ᵀξ' more
  std::array<Twist, kModelRowsMax> jacobian{};  ///< a row each of the model's
};

/// What a tool feels, and how that changes with its small motion ξ since `reference`.
///
///     w(ξ)   = w_0 − A_0 ξ − Ĵᵀ λ(ξ)
///     gap(ξ) = S λ − q − Ĵ ξ,   0 ≤ λ ≤ λ_max,
///              gap ≥ 0 where λ = 0,  gap ≤ 0 where λ = λ_max,  gap = 0 between
///
/// A row i of friction, counted from the far side of its cone as every row is from zero, follows
/// the row n of its normal force with μ_i = `bound_slope` (Coulomb), and slips for good:
///
///     −d ≤ λ_i ≤ λ_max,i + d,   d = max(μ_i (λ_n − λ_n(0)), −λ_max,i / 2)
///     q_i ← q_i + gap_i  where λ_i is at a bound
///
/// What slips dissipates, whatever the bound does meanwhile. A friction that gave the slip back, as
/// a spring that saturates does, would gain energy for a hand that slides lightly and returns hard.
///
/// Every bilateral row is condensed into w_0 and A_0; the m rows are the unilateral ones
/// that may still switch. The slide s of a needle that is held is removed from all of it
/// (A_0 has P = I − s gᵀ applied, σ = gᵀξ is how far the needle slides), so A_0 and S are
/// symmetric and positive semidefinite and no closed motion of the hand gains energy.
///
/// World axes, SI units, wrenches about the tool's origin. Row-major 6 × 6 matrices in the
/// order (translation, rotation). A plain value: trivially copyable, about 46 kB.
struct HapticModel {
  std::uint64_t epoch = 0;          ///< renewed when the server starts or resets
  std::uint64_t sequence = 0;       ///< of the step, from 1; 0: there is no model
  std::int64_t stamp_ns = 0;        ///< when the poses of the step were taken, Unix epoch
  std::int64_t period_ns = 0;       ///< between steps, as asked for by the scene
  std::int64_t stale_after_ns = 0;  ///< without a successor for this long, forces fade

  Pose reference;                                ///< the tool's pose in that step
  Wrench wrench;                                 ///< w_k = w(0)
  std::array<double, 36> stiffness{};            ///< A: w = w_k − A ξ within `radius_m`
  Wrench bilateral_wrench;                       ///< w_0
  std::array<double, 36> bilateral_stiffness{};  ///< A_0
  std::array<double, 9> arm_moment_nm{};  ///< M = Σ r fᵀ over the bilateral forces f at arms r

  Twist slide_twist{};            ///< s, zero when nothing slides
  Twist slide_gradient{};         ///< g = A s / κ of the stiffness A before the slide's removal
  double slide_stiffness = 0.0;   ///< κ = sᵀ A s > 0; zero: nothing slides
  double slide_friction_n = 0.0;  ///< f: axial force left along s, at ξ = 0
  /// c: the friction is viscous, f = −c dσ/dt; zero: f stays as it was in the step.
  double slide_drag_n_s_per_m = 0.0;

  double characteristic_length_m = 0.01;  ///< ℓ of the norm max(|t|, ℓ|θ|)
  double radius_m = 0.0;  ///< of ξ in that norm, within which no row switches; may be +inf

  bool touching = false;  ///< false: the wrench is exactly zero
  bool holding = false;   ///< the jaw holds something
  /// Of the last step in which the world changed by a contact, puncture, grasp or release; 0: none.
  /// After `sequence` of the model shown before, the force takes the ramp instead of the blend:
  /// also where the model of that very step was overtaken and never shown.
  std::uint64_t changed_sequence = 0;

  std::int32_t rows = 0;         ///< m
  std::int32_t frozen_rows = 0;  ///< rows beyond `kModelRowsMax`, held at their state
  std::array<double, kModelPackedMax> compliance_m_per_n{};  ///< S, packed lower triangle
  std::array<Twist, kModelRowsMax> jacobian{};               ///< Ĵ
  std::array<double, kModelRowsMax> offset_m{};              ///< q
  std::array<double, kModelRowsMax> multiplier_n{};          ///< λ(0)
  std::array<double, kModelRowsMax> multiplier_max_n{};      ///< λ_max, +inf where unbounded
  std::array<std::int32_t, kModelRowsMax> bound_row{};       ///< n, where `bound_slope` > 0
  std::array<double, kModelRowsMax> bound_slope{};           ///< μ, 0: the bounds are fixed

  std::int32_t other_count = 0;
  std::array<ModelCoupling, kModelOthersMax> others{};  ///< the first `other_count`
};

/// Evaluates one tool's models, keeping the last active set as the next one's start.
///
/// At each pose the complementarity problem of the model is solved again: from the last
/// active set (of the last pose, or at a new model the set of its `multiplier_n`) by block
/// principal pivoting with a single-row safeguard, at most `kPivotsMax` changes of the set
/// a call. Where that does not suffice the last set stands, λ is clamped into
/// its bounds, the call is counted, and the next call continues from there. So no row ever
/// pulls, not even for one tick.
///
/// A bound that follows another row takes that row's multiplier of the call before (at 1 kHz one
/// millisecond late), so S stays the matrix of the problem, symmetric. A model's first call, which
/// has none before it, solves twice, within the same number of changes.
///
/// Thread: one at a time. Allocates: nothing. Cost: O(m²), and one Cholesky of the free
/// rows for each change of the set (m = 64: tens of microseconds).
class ModelEvaluator {
 public:
  static constexpr int kPivotsMax = 4;

  /// Returns the wrench that `model` gives at `pose`; zero where it touches nothing.
  ///
  /// A needle that slides follows its own curve, however far: the way to `pose` is taken as a slide
  /// by σ and what is left, η, which is small,
  ///
  ///     pose = exp(η) exp(σ s) reference,   gᵀη = 0,   ξ = η + σ s
  ///
  /// (as one screw, half of the bracket [σ s, η] would count as a push across the needle). w(ξ) of
  /// the model is taken with the arms and the axis of the reference pose. Tissue held by a needle
  /// rides along with η, and the axis turns with it. A bilateral force f at arm r is therefore
  /// found at r + θ' × r, θ' the rotation of η, and the origin is o = exp(θ') (exp(σ s) − 1) away
  /// from it, so the torque about the *present* origin carries
  ///
  ///     Δτ = Σ (θ' × r − o) × f = B θ' − o × Σ f,   B = M − tr(M) I,   M = Σ r fᵀ
  ///
  /// (forces that turn with the needle, arms that grow as it leaves its tissue behind), and the
  /// needle slides on by δ until the force along its present axis is again the friction:
  ///
  ///     e(θ) = (θ × s_t)·f + (θ × s_θ)·τ + s_θ·B θ
  ///     δ = −e(θ') / (κ − e(s_θ)),   Δw = κ g δ,   σ = gᵀξ + δ,   θ' ← θ' − δ s_θ
  ///
  /// That is the slide which leaves the axial force where it was in the step. The friction is
  /// viscous, though, f = −c dζ/dt for the slide ζ that there is, and what f differs by reaches
  /// the hand as g (f − f_k). With f = f_k + κ (ζ − σ) and an implicit step over the time Δt since
  /// the call before, that is, without knowing any velocity,
  ///
  ///     f ← (f − κ Δσ) / (1 + κ Δt / c)
  ///
  /// a spring κ in series with a damper c, both positive: no loop of the hand gains from it. f is
  /// carried from one model to the next, as the needle's motion is.
  ///
  /// With all of these the model is exact to first order about any loaded reference. A
  /// translation without slide adds nothing: origin and forces move together. Unilateral
  /// rows, which let their tangents go, keep the arms of the reference.
  ///
  /// `others[i]` is where the tool of `model.others[i]` is now; one that is not given counts as
  /// where it was in the model's step. A stale one holds its last pose.
  ///
  /// `now_ns` is any monotonic clock, for the friction of a needle that slides; where it is
  /// kNoClock that stays as it was in the model's step.
  [[nodiscard]] Wrench evaluate(const HapticModel& model, const Pose& pose,
                                std::span<const Pose> others = {},
                                std::int64_t now_ns = kNoClock) noexcept;
  static constexpr std::int64_t kNoClock = INT64_MIN;

  /// Forgets the active set: the next call starts from its model's.
  void restart() noexcept;

  /// Returns how many calls ended with a clamped multiplier.
  [[nodiscard]] std::uint64_t fallbacks() const noexcept { return fallbacks_; }
  /// Returns how often the set was changed.
  [[nodiscard]] std::uint64_t pivots() const noexcept { return pivots_; }
  /// Returns the multipliers of the last call (N), `rows` of them.
  [[nodiscard]] const std::array<double, kModelRowsMax>& multipliers_n() const noexcept {
    return lambda_;
  }
  /// Returns the worst violation of the last call's complementarity, as a gap (m).
  [[nodiscard]] double residual_m() const noexcept { return residual_m_; }

 private:
  friend void complete_model(HapticModel& model) noexcept;
  enum class Row : std::uint8_t { kZero, kFree, kUpper };

  void begin(const HapticModel& model) noexcept;
  bool factor(const HapticModel& model) noexcept;
  void solve(const HapticModel& model) noexcept;
  void solve_free(std::array<double, kModelRowsMax>& x) const noexcept;
  int violations(const HapticModel& model) noexcept;
  void resolve(const HapticModel& model, const Twist& xi, std::span<const Twist> others) noexcept;
  bool settle(const HapticModel& model, int pivots_most) noexcept;
  void drag(const HapticModel& model, double slide_m, std::int64_t now_ns, Wrench& w) noexcept;
  void follow(const HapticModel& model) noexcept;

  std::uint64_t epoch_ = 0, sequence_ = 0;
  std::uint64_t fallbacks_ = 0, pivots_ = 0;
  double residual_m_ = 0.0;
  int free_count_ = 0;
  bool factored_ = false;
  bool fresh_ = true;  // no call with this model yet
  std::array<Row, kModelRowsMax> state_{};
  std::array<Row, kModelRowsMax> wanted_{};
  std::array<std::int32_t, kModelRowsMax> free_{};       // indices of the free rows
  std::array<double, kModelRowsMax> rhs_{}, lambda_{};   // q + Ĵ ξ, λ
  std::array<double, kModelRowsMax> lower_{}, upper_{};  // bounds of λ in this call
  std::array<double, kModelRowsMax> gap_{}, slip_{};     // gap, and how far q has slipped
  struct Drag {
    double friction_n = 0.0;  // f
    double slide_m = 0.0;     // σ of the call before, of this model
    std::int64_t at_ns = kNoClock;
    bool slides = false;  // false: f is not known yet
    bool fresh = true;    // no σ of this model yet
  };
  Drag drag_;
  // Column j of the Cholesky factor of S_FF starts at j · kModelRowsMax.
  std::array<double, kModelRowsMax * kModelRowsMax> factor_{};
};

/// Returns the wrench of `model` at `pose` from the model alone, with no earlier active set.
[[nodiscard]] Wrench evaluate(const HapticModel& model, const Pose& pose,
                              std::span<const Pose> others = {}) noexcept;

/// Says whether every number of `model` that is in use is finite and its rows refer to rows of it.
/// Whatever else it may be, evaluating it does not poison what an evaluator keeps between models.
[[nodiscard]] bool is_sound(const HapticModel& model) noexcept;

/// Completes a model whose `bilateral_…` fields and rows are set: `wrench`, `stiffness`
/// (A = A_0 + Ĵ_Fᵀ S_FF⁻¹ Ĵ_F over the free rows F) and `radius_m`.
///
/// In the norm max(|t|, ℓ|θ|) a linear function a + gᵀξ keeps its sign while
/// |ξ| < |a| / (|g_t| + |g_θ| / ℓ); the radius is the least of these over the free rows'
/// distances to 0 and λ_max and the other rows' gaps.
void complete_model(HapticModel& model) noexcept;

}  // namespace suture
