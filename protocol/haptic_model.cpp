// SPDX-License-Identifier: Apache-2.0
#include "protocol/haptic_model.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

#include "protocol/finite.hpp"

namespace suture {
namespace {

static_assert(std::is_trivially_copyable_v<HapticModel>, "a model travels through snapshots");

using Array3 = std::array<double, 3>;

Array3 cross(const Array3& a, const Array3& b) noexcept {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

bool finite(const Wrench& w) noexcept { return all_finite(w.force_n) && all_finite(w.torque_nm); }

bool finite(const Pose& p) noexcept {
  return all_finite(p.position_m) && all_finite(p.orientation_xyzw);
}

double dot(const Twist& a, const Twist& b) noexcept {
  double sum = 0.0;
  for (int i = 0; i < 6; ++i) sum += a[i] * b[i];
  return sum;
}

double compliance(const HapticModel& model, int i, int j) noexcept {
  return model.compliance_m_per_n[i >= j ? packed_index(i, j) : packed_index(j, i)];
}

// Gaps below this are closed: far under what a hand can feel at any tissue's stiffness.
constexpr double kGapTolerance_m = 1e-12;
// What is left after a slide is small, and so is its own slide: the second round is its last.
constexpr int kSlideRounds = 2;
// However the forces turn, a needle keeps so much of its stiffness against sliding on.
constexpr double kLeastShareOfStiffness = 0.5;
// Multipliers within this of a bound are on it.
constexpr double kMultiplierTolerance_n = 1e-10;

/// Dual of max(|t|, ℓ|θ|): the steepest a linear function with this gradient can change.
double dual_norm(const Twist& g, double length_m) noexcept {
  return std::hypot(g[0], g[1], g[2]) + std::hypot(g[3], g[4], g[5]) / length_m;
}

/// Returns where a slide by `slide_m` along itself leads a needle from the model's reference, and
/// with it the tool.
Pose slid(const HapticModel& model, double slide_m) noexcept {
  Twist along;
  for (int i = 0; i < 6; ++i) along[i] = slide_m * model.slide_twist[i];
  return moved_by(model.reference, along);
}

/// Splits the way to `pose` into a slide, however far, and what is left: exp(ξ − σ s) exp(σ s).
/// Returns ξ, with σ = gᵀξ; `xi` is the screw of the whole way. See ModelEvaluator::evaluate.
Twist slide_first(const HapticModel& model, const Pose& pose, const Twist& xi) noexcept {
  double slide_m = dot(model.slide_gradient, xi);
  Twist parted;
  for (int round = 0; round < kSlideRounds; ++round) {
    const Pose from = slid(model, slide_m);
    parted = motion_between(from, pose);
    // Of the point where the reference has its origin, about which the model's matrices are.
    Array3 arm;
    for (int i = 0; i < 3; ++i) arm[i] = model.reference.position_m[i] - from.position_m[i];
    const Array3 turned = cross({parted[3], parted[4], parted[5]}, arm);
    for (int i = 0; i < 3; ++i) parted[i] += turned[i];
    for (int i = 0; i < 6; ++i) parted[i] += slide_m * model.slide_twist[i];
    slide_m = dot(model.slide_gradient, parted);
  }
  return parted;
}

/// Adds what the model's linear part leaves out: see ModelEvaluator::evaluate. Returns how far the
/// needle slides by that, beside what `others` slide it.
double transport(const HapticModel& model, const Twist& xi, const Array3& bilateral_force_n,
                 Wrench& w) noexcept {
  const Array3 axis{model.slide_twist[0], model.slide_twist[1], model.slide_twist[2]};
  const Array3 spin{model.slide_twist[3], model.slide_twist[4], model.slide_twist[5]};
  const auto& m = model.arm_moment_nm;
  const auto arms_turned_by = [&](const Array3& theta) noexcept {
    const double trace = m[0] + m[4] + m[8];
    Array3 torque;
    for (int i = 0; i < 3; ++i) {
      torque[i] = -trace * theta[i];
      for (int j = 0; j < 3; ++j) torque[i] += m[3 * i + j] * theta[j];
    }
    return torque;
  };
  // What the force along the needle changes by when it and its tissue turn.
  const auto axial_turned_by = [&](const Array3& theta) noexcept {
    const Array3 turned = cross(theta, axis), turned_spin = cross(theta, spin);
    const Array3 torque = arms_turned_by(theta);
    double sum = 0.0;
    for (int i = 0; i < 3; ++i)
      sum += turned[i] * w.force_n[i] + turned_spin[i] * w.torque_nm[i] + spin[i] * torque[i];
    return sum;
  };

  Array3 theta{xi[3], xi[4], xi[5]};
  if (!(model.slide_stiffness > 0.0)) {
    const Array3 torque = arms_turned_by(theta);
    for (int i = 0; i < 3; ++i) w.torque_nm[i] += torque[i];
    return 0.0;
  }
  const double kappa = model.slide_stiffness, slide = dot(model.slide_gradient, xi);
  for (int i = 0; i < 3; ++i) theta[i] -= slide * spin[i];
  const double stiffness = std::max(kappa - axial_turned_by(spin), kLeastShareOfStiffness * kappa);
  const double further = -axial_turned_by(theta) / stiffness;
  for (int i = 0; i < 3; ++i) theta[i] -= further * spin[i];
  const Pose from = slid(model, slide + further);
  Array3 way;
  for (int i = 0; i < 3; ++i) way[i] = from.position_m[i] - model.reference.position_m[i];
  const Array3 turned = cross(theta, way);
  Array3 force = bilateral_force_n;
  for (int i = 0; i < 3; ++i) {
    way[i] += turned[i];
    force[i] += kappa * model.slide_gradient[i] * further;
    w.force_n[i] += kappa * model.slide_gradient[i] * further;
    w.torque_nm[i] += kappa * model.slide_gradient[i + 3] * further;
  }
  const Array3 left_behind = cross(way, force), torque = arms_turned_by(theta);
  for (int i = 0; i < 3; ++i) w.torque_nm[i] += torque[i] - left_behind[i];
  return slide + further;
}

}  // namespace

Pose moved_by(const Pose& reference, const Twist& xi) noexcept {
  const Array3 t{xi[0], xi[1], xi[2]}, theta{xi[3], xi[4], xi[5]};
  const double angle = std::hypot(theta[0], theta[1], theta[2]);
  // V(θ) = 1 + b [θ] + c [θ]², b = (1 − cos φ) / φ², c = (φ − sin φ) / φ³.
  const double half_sine = std::sin(0.5 * angle), square = angle * angle;
  const double b = angle > 1e-4 ? 2.0 * half_sine * half_sine / square : 0.5;
  const double c =
      angle > 1e-2 ? (angle - std::sin(angle)) / (square * angle) : 1.0 / 6.0 - square / 120.0;
  const Array3 once = cross(theta, t), twice = cross(theta, once);
  Pose pose;
  for (int i = 0; i < 3; ++i)
    pose.position_m[i] = reference.position_m[i] + t[i] + b * once[i] + c * twice[i];
  // exp(θ) q.
  const double scale = angle > 1e-9 ? half_sine / angle : 0.5;
  const double x = scale * theta[0], y = scale * theta[1], z = scale * theta[2];
  const double w = std::cos(0.5 * angle);
  const auto& [qx, qy, qz, qw] = reference.orientation_xyzw;
  pose.orientation_xyzw = {w * qx + x * qw + y * qz - z * qy, w * qy - x * qz + y * qw + z * qx,
                           w * qz + x * qy - y * qx + z * qw, w * qw - x * qx - y * qy - z * qz};
  return pose;
}

Twist motion_between(const Pose& reference, const Pose& pose) noexcept {
  const auto& [bx, by, bz, bw] = reference.orientation_xyzw;
  const auto& [ax, ay, az, aw] = pose.orientation_xyzw;
  // q q_k⁻¹ of unit quaternions.
  double x = -aw * bx + ax * bw - ay * bz + az * by;
  double y = -aw * by + ax * bz + ay * bw - az * bx;
  double z = -aw * bz - ax * by + ay * bx + az * bw;
  double w = aw * bw + ax * bx + ay * by + az * bz;
  if (w < 0.0) x = -x, y = -y, z = -z, w = -w;
  const double sine = std::hypot(x, y, z);
  // θ = 2 atan2(|v|, w) v / |v|, and 2 v as |v| → 0.
  const double scale = sine > 1e-9 ? 2.0 * std::atan2(sine, w) / sine : 2.0;
  const Array3 theta{scale * x, scale * y, scale * z};
  // t = V(θ)⁻¹ (p − p_k), V⁻¹ = 1 − ½ [θ] + c [θ]², c = (1 − φ sin φ / (2 (1 − cos φ))) / φ², and
  // with φ = |θ|, sin φ = 2 |v| w: φ sin φ / (2 (1 − cos φ)) = φ w / (2 |v|).
  const double angle = scale * sine;
  const double c = angle > 1e-2 ? (1.0 - angle * w / (2.0 * sine)) / (angle * angle)
                                : 1.0 / 12.0 + angle * angle / 720.0;
  const Array3 way{pose.position_m[0] - reference.position_m[0],
                   pose.position_m[1] - reference.position_m[1],
                   pose.position_m[2] - reference.position_m[2]};
  const Array3 once = cross(theta, way), twice = cross(theta, once);
  Twist xi;
  for (int i = 0; i < 3; ++i) xi[i] = way[i] - 0.5 * once[i] + c * twice[i];
  xi[3] = theta[0], xi[4] = theta[1], xi[5] = theta[2];
  return xi;
}

void ModelEvaluator::restart() noexcept {
  epoch_ = sequence_ = 0;
  factored_ = false;
  fresh_ = true;
  slip_ = {};
  drag_ = {};
}

void ModelEvaluator::begin(const HapticModel& model) noexcept {
  if (model.epoch != epoch_) drag_ = {};
  drag_.fresh = true;
  epoch_ = model.epoch;
  sequence_ = model.sequence;
  factored_ = false;
  fresh_ = true;
  for (int i = 0; i < model.rows; ++i) {
    const double lambda = model.multiplier_n[i];
    slip_[i] = 0.0;
    state_[i] = lambda <= kMultiplierTolerance_n                               ? Row::kZero
                : lambda >= model.multiplier_max_n[i] - kMultiplierTolerance_n ? Row::kUpper
                                                                               : Row::kFree;
  }
}

// Right-looking, by columns, so that the inner loop is a vector update. Returns false and
// leaves the offending row out of the free set where S_FF is not positive definite.
bool ModelEvaluator::factor(const HapticModel& model) noexcept {
  constexpr int kStride = kModelRowsMax;
  free_count_ = 0;
  for (int i = 0; i < model.rows; ++i)
    if (state_[i] == Row::kFree) free_[free_count_++] = i;
  for (int j = 0; j < free_count_; ++j)
    for (int i = j; i < free_count_; ++i)
      factor_[j * kStride + i] = compliance(model, free_[i], free_[j]);
  for (int j = 0; j < free_count_; ++j) {
    double* column = &factor_[j * kStride];
    const double pivot = column[j];
    if (!(pivot > 1e-12 * compliance(model, free_[j], free_[j]))) {
      state_[free_[j]] = Row::kZero;
      return false;
    }
    const double per_root = 1.0 / std::sqrt(pivot);
    for (int i = j; i < free_count_; ++i) column[i] *= per_root;
    for (int k = j + 1; k < free_count_; ++k) {
      double* __restrict next = &factor_[k * kStride];
      const double* __restrict done = column;
      const double scale = column[k];
      for (int i = k; i < free_count_; ++i) next[i] -= scale * done[i];
    }
  }
  factored_ = true;
  return true;
}

// x ← S_FF⁻¹ x, over the free rows.
void ModelEvaluator::solve_free(std::array<double, kModelRowsMax>& x) const noexcept {
  for (int j = 0; j < free_count_; ++j) {
    const double* column = &factor_[j * kModelRowsMax];
    x[j] /= column[j];
    for (int i = j + 1; i < free_count_; ++i) x[i] -= column[i] * x[j];
  }
  for (int j = free_count_ - 1; j >= 0; --j) {
    const double* column = &factor_[j * kModelRowsMax];
    double sum = x[j];
    for (int i = j + 1; i < free_count_; ++i) sum -= column[i] * x[i];
    x[j] = sum / column[j];
  }
}

// S_FF λ_F = (q + Ĵ ξ)_F − S_FB λ_B, with λ_B at its bounds.
void ModelEvaluator::solve(const HapticModel& model) noexcept {
  std::array<double, kModelRowsMax> x;
  for (int i = 0; i < model.rows; ++i)
    lambda_[i] = state_[i] == Row::kUpper ? upper_[i] : state_[i] == Row::kZero ? lower_[i] : 0.0;
  for (int a = 0; a < free_count_; ++a) x[a] = rhs_[free_[a]];
  for (int j = 0; j < model.rows; ++j) {
    if (lambda_[j] == 0.0) continue;
    for (int a = 0; a < free_count_; ++a) x[a] -= compliance(model, free_[a], j) * lambda_[j];
  }
  solve_free(x);
  for (int a = 0; a < free_count_; ++a) lambda_[free_[a]] = x[a];
}

// Counts the rows on the wrong side of their condition and says where each belongs.
int ModelEvaluator::violations(const HapticModel& model) noexcept {
  // All gaps in one pass over S as it is stored: row j gives to the rows before it, and takes.
  auto& gaps = gap_;
  for (int j = 0; j < model.rows; ++j) {
    const double* row = &model.compliance_m_per_n[packed_index(j, 0)];
    const double lambda = lambda_[j];
    std::array<double, 4> sum{};
    int i = 0;
    for (; i + 4 <= j; i += 4)
      for (int lane = 0; lane < 4; ++lane) {
        gaps[i + lane] += row[i + lane] * lambda;
        sum[lane] += row[i + lane] * lambda_[i + lane];
      }
    double rest = row[j] * lambda - rhs_[j];
    for (; i < j; ++i) {
      gaps[i] += row[i] * lambda;
      rest += row[i] * lambda_[i];
    }
    gaps[j] = (sum[0] + sum[1]) + (sum[2] + sum[3]) + rest;
  }

  int count = 0;
  residual_m_ = 0.0;
  for (int i = 0; i < model.rows; ++i) {
    wanted_[i] = state_[i];
    // A row without room (friction under a normal force of zero) is right at any gap.
    const bool no_room = upper_[i] - lower_[i] <= kMultiplierTolerance_n;
    if (no_room && state_[i] != Row::kFree) continue;
    if (state_[i] == Row::kFree) {
      const double under = lower_[i] - lambda_[i], over = lambda_[i] - upper_[i];
      if (under > kMultiplierTolerance_n || no_room) wanted_[i] = Row::kZero;
      if (over > kMultiplierTolerance_n && !no_room) wanted_[i] = Row::kUpper;
      if (wanted_[i] != state_[i])
        residual_m_ = std::max(residual_m_, compliance(model, i, i) * std::max(under, over));
    } else {
      const double gap = gaps[i];
      const double wrong = state_[i] == Row::kZero ? -gap : gap;
      if (wrong > kGapTolerance_m) {
        wanted_[i] = Row::kFree;
        residual_m_ = std::max(residual_m_, wrong);
      }
    }
    count += wanted_[i] != state_[i];
  }
  return count;
}

void ModelEvaluator::resolve(const HapticModel& model, const Twist& xi,
                             std::span<const Twist> others) noexcept {
  for (int i = 0; i < model.rows; ++i) rhs_[i] = model.offset_m[i] + dot(model.jacobian[i], xi);
  for (std::size_t k = 0; k < others.size(); ++k)
    for (int i = 0; i < model.rows; ++i) rhs_[i] += dot(model.others[k].jacobian[i], others[k]);
  bool follows = false;
  for (int i = 0; i < model.rows; ++i) {
    lower_[i] = 0.0;
    upper_[i] = model.multiplier_max_n[i];
    follows |= model.bound_slope[i] > 0.0;
  }
  if (!follows) {
    if (!settle(model, kPivotsMax)) ++fallbacks_;
    return;
  }

  for (int i = 0; i < model.rows; ++i) rhs_[i] -= slip_[i];
  const std::uint64_t before = pivots_;
  if (fresh_) (void)settle(model, kPivotsMax / 2);  // for bounds to start from
  fresh_ = false;
  follow(model);
  if (!settle(model, kPivotsMax - static_cast<int>(pivots_ - before))) {
    ++fallbacks_;
    return;
  }
  for (int i = 0; i < model.rows; ++i)
    if (model.bound_slope[i] > 0.0 && state_[i] != Row::kFree) slip_[i] -= gap_[i];
}

// Sets the bounds that follow other rows from the multipliers of the last solution.
void ModelEvaluator::follow(const HapticModel& model) noexcept {
  for (int i = 0; i < model.rows; ++i) {
    if (!(model.bound_slope[i] > 0.0)) continue;
    const int normal = model.bound_row[i];
    const double grown =
        std::max(model.bound_slope[i] * (lambda_[normal] - model.multiplier_n[normal]),
                 -0.5 * model.multiplier_max_n[i]);
    lower_[i] = -grown;
    upper_[i] = model.multiplier_max_n[i] + grown;
  }
}

// Solves for `rhs_` within the bounds, by at most so many pivots. Returns whether it did, or had to
// clamp.
bool ModelEvaluator::settle(const HapticModel& model, int pivots_most) noexcept {
  // A row found redundant while factoring leaves the set, so this ends.
  const auto solve_with_set = [&]() noexcept {
    bool redundant = false;
    while (!factored_) redundant |= !factor(model);
    solve(model);
    return !redundant;
  };
  bool exact = solve_with_set();
  int worst = violations(model);
  int fewest = worst + 1;
  for (int pivot = 0; worst > 0 && pivot < pivots_most; ++pivot) {
    ++pivots_;
    if (worst < fewest) {
      fewest = worst;
      state_ = wanted_;
    } else {
      // Exchanging all did not help: Murty's rule, one row, terminates across calls.
      for (int i = model.rows - 1; i >= 0; --i)
        if (wanted_[i] != state_[i]) {
          state_[i] = wanted_[i];
          break;
        }
    }
    factored_ = false;
    exact = solve_with_set();
    worst = violations(model);
  }
  exact &= worst == 0;
  for (int i = 0; i < model.rows; ++i) lambda_[i] = std::clamp(lambda_[i], lower_[i], upper_[i]);
  return exact;
}

Wrench ModelEvaluator::evaluate(const HapticModel& model, const Pose& pose,
                                std::span<const Pose> others, std::int64_t now_ns) noexcept {
  if (!model.touching) {
    drag_ = {};
    return {};
  }
  if (model.epoch != epoch_ || model.sequence != sequence_) begin(model);
  Twist xi = motion_between(model.reference, pose);
  if (model.slide_stiffness > 0.0) xi = slide_first(model, pose, xi);
  std::array<Twist, kModelOthersMax> motions;
  const std::size_t count = std::min(others.size(), static_cast<std::size_t>(model.other_count));
  for (std::size_t k = 0; k < count; ++k)
    motions[k] = motion_between(model.others[k].reference, others[k]);
  resolve(model, xi, {motions.data(), count});

  Wrench w = model.bilateral_wrench;
  const auto subtract = [&w](const std::array<double, 36>& stiffness,
                             const Twist& motion) noexcept {
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 6; ++j) {
        w.force_n[i] -= stiffness[6 * i + j] * motion[j];
        w.torque_nm[i] -= stiffness[6 * (i + 3) + j] * motion[j];
      }
  };
  subtract(model.bilateral_stiffness, xi);
  for (std::size_t k = 0; k < count; ++k) subtract(model.others[k].stiffness, motions[k]);
  const Array3 bilateral_force = w.force_n;
  for (int r = 0; r < model.rows; ++r) {
    if (lambda_[r] == 0.0) continue;
    for (int i = 0; i < 3; ++i) {
      w.force_n[i] -= model.jacobian[r][i] * lambda_[r];
      w.torque_nm[i] -= model.jacobian[r][i + 3] * lambda_[r];
    }
  }

  double slide_m = transport(model, xi, bilateral_force, w);
  for (std::size_t k = 0; k < count; ++k)
    slide_m += dot(model.others[k].slide_gradient, motions[k]);
  drag(model, slide_m, now_ns, w);
  return w;
}

// The viscous friction of a needle that slides: see `evaluate`.
void ModelEvaluator::drag(const HapticModel& model, double slide_m, std::int64_t now_ns,
                          Wrench& w) noexcept {
  if (!(model.slide_stiffness > 0.0 && model.slide_drag_n_s_per_m > 0.0) || now_ns == kNoClock) {
    drag_ = {};
    return;
  }
  if (!drag_.slides) drag_.friction_n = model.slide_friction_n;
  const double moved_m = drag_.fresh ? 0.0 : slide_m - drag_.slide_m;
  const double elapsed_s =
      drag_.slides ? 1e-9 * static_cast<double>(std::max<std::int64_t>(now_ns - drag_.at_ns, 0))
                   : 0.0;
  drag_.friction_n = (drag_.friction_n - model.slide_stiffness * moved_m) /
                     (1.0 + model.slide_stiffness * elapsed_s / model.slide_drag_n_s_per_m);
  drag_.slide_m = slide_m;
  drag_.at_ns = now_ns;
  drag_.slides = true;
  drag_.fresh = false;
  const double more_n = drag_.friction_n - model.slide_friction_n;
  for (int i = 0; i < 3; ++i) {
    w.force_n[i] += more_n * model.slide_gradient[i];
    w.torque_nm[i] += more_n * model.slide_gradient[i + 3];
  }
}

Wrench evaluate(const HapticModel& model, const Pose& pose, std::span<const Pose> others) noexcept {
  ModelEvaluator evaluator;
  return evaluator.evaluate(model, pose, others);
}

bool is_sound(const HapticModel& m) noexcept {
  if (m.rows < 0 || m.rows > kModelRowsMax || m.other_count < 0 || m.other_count > kModelOthersMax)
    return false;
  bool good = finite(m.wrench) && finite(m.bilateral_wrench) && all_finite(m.stiffness) &&
              all_finite(m.bilateral_stiffness) && all_finite(m.arm_moment_nm) &&
              all_finite(m.slide_twist) && all_finite(m.slide_gradient) &&
              std::isfinite(m.slide_stiffness) && std::isfinite(m.slide_friction_n) &&
              std::isfinite(m.slide_drag_n_s_per_m) && finite(m.reference);
  const int packed = m.rows * (m.rows + 1) / 2;
  for (int i = 0; i < packed; ++i) good &= std::isfinite(m.compliance_m_per_n[i]);
  for (int i = 0; i < m.rows; ++i)
    good &= all_finite(m.jacobian[i]) && std::isfinite(m.offset_m[i]) &&
            std::isfinite(m.multiplier_n[i]) && m.multiplier_max_n[i] >= 0.0 &&
            std::isfinite(m.bound_slope[i]) && m.bound_row[i] >= 0 && m.bound_row[i] < m.rows;
  for (int k = 0; k < m.other_count; ++k) {
    const ModelCoupling& other = m.others[k];
    good &=
        all_finite(other.stiffness) && all_finite(other.slide_gradient) && finite(other.reference);
    for (int i = 0; i < m.rows; ++i) good &= all_finite(other.jacobian[i]);
  }
  return good;
}

void complete_model(HapticModel& model) noexcept {
  ModelEvaluator at_rest;
  at_rest.begin(model);
  // Not a tick: a model that was coupled starts from multipliers that are not its own.
  constexpr std::uint64_t kCallsMax = 8;
  for (std::uint64_t call = 0; call < kCallsMax && at_rest.fallbacks_ == call; ++call)
    at_rest.resolve(model, Twist{}, {});
  model.wrench = model.bilateral_wrench;
  for (int r = 0; r < model.rows; ++r) {
    for (int i = 0; i < 3; ++i) {
      model.wrench.force_n[i] -= model.jacobian[r][i] * at_rest.lambda_[r];
      model.wrench.torque_nm[i] -= model.jacobian[r][i + 3] * at_rest.lambda_[r];
    }
  }

  // dλ/dξ, a row per row; zero where λ is at a bound.
  std::array<Twist, kModelRowsMax> gradient{};
  for (int k = 0; k < 6; ++k) {
    std::array<double, kModelRowsMax> x;
    for (int a = 0; a < at_rest.free_count_; ++a) x[a] = model.jacobian[at_rest.free_[a]][k];
    at_rest.solve_free(x);
    for (int a = 0; a < at_rest.free_count_; ++a) gradient[at_rest.free_[a]][k] = x[a];
  }
  model.stiffness = model.bilateral_stiffness;
  for (int r = 0; r < model.rows; ++r)
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j)
        model.stiffness[6 * i + j] += model.jacobian[r][i] * gradient[r][j];

  double radius = std::numeric_limits<double>::infinity();
  const auto limit_to = [&](double distance, const Twist& slope) {
    const double steepest = dual_norm(slope, model.characteristic_length_m);
    if (steepest > 0.0) radius = std::min(radius, std::max(distance, 0.0) / steepest);
  };
  for (int r = 0; r < model.rows; ++r) {
    const double lambda = at_rest.lambda_[r];
    const bool follows = model.bound_slope[r] > 0.0;
    if (at_rest.state_[r] == ModelEvaluator::Row::kFree) {
      Twist to_lower = gradient[r], to_upper = gradient[r];
      if (follows)
        for (int i = 0; i < 6; ++i) {
          const double grown = model.bound_slope[r] * gradient[model.bound_row[r]][i];
          to_lower[i] += grown, to_upper[i] -= grown;
        }
      limit_to(lambda - at_rest.lower_[r], to_lower);
      limit_to(at_rest.upper_[r] - lambda, to_upper);
      continue;
    }
    double gap = -model.offset_m[r];
    Twist slope{};
    for (int i = 0; i < 6; ++i) slope[i] = -model.jacobian[r][i];
    for (int j = 0; j < model.rows; ++j) {
      gap += compliance(model, r, j) * at_rest.lambda_[j];
      for (int i = 0; i < 6; ++i) slope[i] += compliance(model, r, j) * gradient[j][i];
    }
    limit_to(follows ? 0.0 : std::abs(gap), slope);  // what slips sticks as soon as it turns back
  }
  model.radius_m = radius;
}

}  // namespace suture
