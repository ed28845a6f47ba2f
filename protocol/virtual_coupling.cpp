// SPDX-License-Identifier: Apache-2.0
#include "protocol/virtual_coupling.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace suture {
namespace {

using Matrix6 = std::array<double, 36>;

double entry(const HapticModel& model, int i, int j) noexcept {
  return model.compliance_m_per_n[i >= j ? packed_index(i, j) : packed_index(j, i)];
}

Matrix6 product(const Matrix6& a, const Matrix6& b) noexcept {
  Matrix6 c{};
  for (int i = 0; i < 6; ++i)
    for (int k = 0; k < 6; ++k)
      for (int j = 0; j < 6; ++j) c[6 * i + j] += a[6 * i + k] * b[6 * k + j];
  return c;
}

Matrix6 transposed(const Matrix6& a) noexcept {
  Matrix6 t;
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) t[6 * i + j] = a[6 * j + i];
  return t;
}

Twist times(const Matrix6& a, const Twist& x) noexcept {
  Twist y{};
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) y[i] += a[6 * i + j] * x[j];
  return y;
}

Twist transposed_times(const Matrix6& a, const Twist& x) noexcept {
  Twist y{};
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) y[j] += a[6 * i + j] * x[i];
  return y;
}

/// Adds Ĵᵀ S⁻¹ Ĵ to `a`: forward substitution L Z = Ĵ, then Zᵀ Z. A row that the rows before
/// it make redundant adds nothing.
void add_all_rows(const HapticModel& model, Matrix6& a) noexcept {
  std::array<double, kModelPackedMax> factor;
  std::array<Twist, kModelRowsMax> z;
  for (int i = 0; i < model.rows; ++i) {
    double* row = &factor[packed_index(i, 0)];
    z[i] = model.jacobian[i];
    double pivot = entry(model, i, i);
    const double whole = pivot;
    for (int j = 0; j < i; ++j) {
      const double* other = &factor[packed_index(j, 0)];
      double sum = entry(model, i, j);
      for (int k = 0; k < j; ++k) sum -= row[k] * other[k];
      row[j] = other[j] > 0.0 ? sum / other[j] : 0.0;
      pivot -= row[j] * row[j];
      for (int k = 0; k < 6; ++k) z[i][k] -= row[j] * z[j][k];
    }
    const bool redundant = !(pivot > 1e-12 * whole);
    row[i] = redundant ? 0.0 : std::sqrt(pivot);
    for (double& value : z[i]) value = redundant ? 0.0 : value / row[i];
    for (int p = 0; p < 6; ++p)
      for (int q = 0; q < 6; ++q) a[6 * p + q] += z[i][p] * z[i][q];
  }
}

/// Diagonalises a symmetric matrix by Jacobi's rotations: a = V diag(values) Vᵀ.
void diagonalise(Matrix6& a, Matrix6& v, Twist& values) noexcept {
  constexpr int kSweeps = 12;  // converges quadratically: six suffice for 6 × 6
  v = {};
  for (int i = 0; i < 6; ++i) v[7 * i] = 1.0;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    double off = 0.0, diagonal = 0.0;
    for (int p = 0; p < 6; ++p) {
      diagonal += a[7 * p] * a[7 * p];
      for (int q = p + 1; q < 6; ++q) off += a[6 * p + q] * a[6 * p + q];
    }
    if (off <= 1e-28 * diagonal) break;
    for (int p = 0; p < 5; ++p)
      for (int q = p + 1; q < 6; ++q) {
        if (a[6 * p + q] == 0.0) continue;
        const double angle = (a[7 * q] - a[7 * p]) / (2.0 * a[6 * p + q]);
        const double t = std::copysign(1.0, angle) / (std::abs(angle) + std::hypot(1.0, angle));
        const double c = 1.0 / std::hypot(1.0, t), s = t * c;
        for (int k = 0; k < 6; ++k) {
          const double kp = a[6 * k + p], kq = a[6 * k + q];
          a[6 * k + p] = c * kp - s * kq;
          a[6 * k + q] = s * kp + c * kq;
        }
        for (int k = 0; k < 6; ++k) {
          const double pk = a[6 * p + k], qk = a[6 * q + k];
          a[6 * p + k] = c * pk - s * qk;
          a[6 * q + k] = s * pk + c * qk;
        }
        for (int k = 0; k < 6; ++k) {
          const double kp = v[6 * k + p], kq = v[6 * k + q];
          v[6 * k + p] = c * kp - s * kq;
          v[6 * k + q] = s * kp + c * kq;
        }
      }
  }
  for (int i = 0; i < 6; ++i) values[i] = a[7 * i];
}

/// Inverts by Gauss and Jordan with pivoting; false where `a` is singular.
bool invert(Matrix6 a, Matrix6& inverse) noexcept {
  inverse = {};
  for (int i = 0; i < 6; ++i) inverse[7 * i] = 1.0;
  for (int column = 0; column < 6; ++column) {
    int best = column;
    for (int r = column + 1; r < 6; ++r)
      if (std::abs(a[6 * r + column]) > std::abs(a[6 * best + column])) best = r;
    const double pivot = a[6 * best + column];
    if (!(std::abs(pivot) > 1e-9)) return false;
    for (int k = 0; k < 6; ++k) {
      std::swap(a[6 * best + k], a[6 * column + k]);
      std::swap(inverse[6 * best + k], inverse[6 * column + k]);
      a[6 * column + k] /= pivot;
      inverse[6 * column + k] /= pivot;
    }
    for (int r = 0; r < 6; ++r) {
      if (r == column) continue;
      const double factor = a[6 * r + column];
      for (int k = 0; k < 6; ++k) {
        a[6 * r + k] -= factor * a[6 * column + k];
        inverse[6 * r + k] -= factor * inverse[6 * column + k];
      }
    }
  }
  return true;
}

/// |g|² in the coordinates (t, ℓθ): what a spring or damper along the slide is at the hand, of one.
double gradient_squared(const HapticModel& model) noexcept {
  double sum = 0.0;
  for (int i = 0; i < 6; ++i)
    sum += std::pow(model.slide_gradient[i] / (i < 3 ? 1.0 : model.characteristic_length_m), 2);
  return sum;
}

}  // namespace

double couple_model(HapticModel& model, double max_stiffness_n_per_m) noexcept {
  if (!(max_stiffness_n_per_m > 0.0) || !std::isfinite(max_stiffness_n_per_m)) return 0.0;
  if (!model.touching) return 0.0;

  // Symmetric part: a least-squares slide leaves A_0 a little skew, and that part as it is.
  Matrix6 symmetric, skew;
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) {
      const double here = model.bilateral_stiffness[6 * i + j];
      const double there = model.bilateral_stiffness[6 * j + i];
      symmetric[6 * i + j] = 0.5 * (here + there);
      skew[6 * i + j] = 0.5 * (here - there);
    }
  const double length_m = model.characteristic_length_m;
  const auto unit = [length_m](int i) { return i < 3 ? 1.0 : 1.0 / length_m; };

  Matrix6 stiffest = symmetric;
  add_all_rows(model, stiffest);
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) stiffest[6 * i + j] *= unit(i) * unit(j);
  Matrix6 axes;
  Twist stiffness;
  diagonalise(stiffest, axes, stiffness);
  const double largest = *std::max_element(stiffness.begin(), stiffness.end());
  // At a turn of the hand the friction of a needle is as stiff as the tissue that it drags along.
  const double dragged = model.slide_stiffness * gradient_squared(model);
  if (largest + dragged > max_stiffness_n_per_m) model.slide_drag_n_s_per_m = 0.0;
  // A model that was coupled already is at the limit, but for rounding.
  if (!(largest > max_stiffness_n_per_m * (1.0 + 1e-9))) return largest;

  Matrix6 coupling{};
  for (int e = 0; e < 6; ++e) {
    const double softer = 1.0 / max_stiffness_n_per_m - 1.0 / std::max(stiffness[e], 1e-300);
    if (!(softer > 0.0) || !(stiffness[e] > max_stiffness_n_per_m)) continue;
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j)
        coupling[6 * i + j] += softer * axes[6 * i + e] * axes[6 * j + e] * unit(i) * unit(j);
  }
  Matrix6 to_invert = product(coupling, symmetric), m;
  for (int i = 0; i < 6; ++i) to_invert[7 * i] += 1.0;
  if (!invert(to_invert, m)) return largest;

  const Matrix6 series = product(m, coupling);  // M C
  const Twist w{model.bilateral_wrench.force_n[0],   model.bilateral_wrench.force_n[1],
                model.bilateral_wrench.force_n[2],   model.bilateral_wrench.torque_nm[0],
                model.bilateral_wrench.torque_nm[1], model.bilateral_wrench.torque_nm[2]};
  const Twist shift = times(series, w);
  const Twist coupled = transposed_times(m, w);
  for (int i = 0; i < 3; ++i) {
    model.bilateral_wrench.force_n[i] = coupled[i];
    model.bilateral_wrench.torque_nm[i] = coupled[i + 3];
  }
  for (int o = 0; o < model.other_count; ++o) {
    ModelCoupling& other = model.others[o];
    const Matrix6 drawn = product(series, other.stiffness);  // M C B
    for (int i = 0; i < model.rows; ++i) {
      const Twist along = transposed_times(drawn, model.jacobian[i]);
      for (int k = 0; k < 6; ++k) other.jacobian[i][k] -= along[k];
    }
    other.stiffness = product(transposed(m), other.stiffness);
  }
  for (int i = 0; i < model.rows; ++i) {
    const Twist along = times(series, model.jacobian[i]);
    for (int j = 0; j <= i; ++j)
      for (int k = 0; k < 6; ++k)
        model.compliance_m_per_n[packed_index(i, j)] += model.jacobian[j][k] * along[k];
  }
  for (int i = 0; i < model.rows; ++i) {
    for (int k = 0; k < 6; ++k) model.offset_m[i] += model.jacobian[i][k] * shift[k];
    model.jacobian[i] = transposed_times(m, model.jacobian[i]);
  }
  model.bilateral_stiffness = product(symmetric, m);
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < i; ++j) {
      double& lower = model.bilateral_stiffness[6 * i + j];
      double& upper = model.bilateral_stiffness[6 * j + i];
      lower = upper = 0.5 * (lower + upper);
    }
  for (int i = 0; i < 36; ++i) model.bilateral_stiffness[i] += skew[i];
  complete_model(model);
  return largest;
}

void limit_damping(HapticModel& model, double max_damping_n_s_per_m) noexcept {
  const double felt_n_s_per_m = model.slide_drag_n_s_per_m * gradient_squared(model);
  if (max_damping_n_s_per_m > 0.0 && felt_n_s_per_m > max_damping_n_s_per_m)
    model.slide_drag_n_s_per_m = 0.0;
}

}  // namespace suture
