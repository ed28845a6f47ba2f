// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/complementarity.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "constraints/blas.hpp"
#include "fem/simd_kernel.hpp"

namespace sutured::constraints {
namespace {

constexpr int kRoundsWithoutProgress = 10;
constexpr double kGapScale_m = 1e-3;
// A row switches only when it is wrong by more than rounding can make it.
constexpr double kRounding = 1e-12;

std::size_t at(int i) { return static_cast<std::size_t>(i); }

/// sum += l column, and magnitude += |l column|.
SUTURED_KERNEL void add_column(const double* column, double l, int count, double* sum,
                               double* magnitude) {
#pragma omp simd
  for (int i = 0; i < count; ++i) {
    const double term = l * column[i];
    sum[i] += term;
    magnitude[i] += std::abs(term);
  }
}

/// Factors the lower triangle of `a` (n × n), adding to its diagonal only as much as it takes.
bool factor_regularised(int n, std::vector<double>& a, const std::vector<double>& original) {
  a = original;
  if (blas::cholesky(n, a.data(), std::max(n, 1))) return false;
  double trace = 0.0;
  for (int i = 0; i < n; ++i) trace += original[at(i) * at(n) + at(i)];
  for (double share = 1e-14;; share *= 100.0) {
    a = original;
    for (int i = 0; i < n; ++i) a[at(i) * at(n) + at(i)] += share * trace;
    if (blas::cholesky(n, a.data(), n) || share > 1.0) return true;
  }
}

}  // namespace

void ComplementaritySolver::reserve(int rows) {
  for (std::vector<double>* matrix : {&l_, &s_, &reduced_}) matrix->resize(at(rows) * at(rows));
  reduced_of_.reserve(at(rows));
  v_.resize(at(rows) * at(rows) / 4);  // n_B × n_U, n_B + n_U rows
}

bool ComplementaritySolver::same_bilateral(std::span<const Bounds> bounds) const {
  return std::equal(bounds.begin(), bounds.end(), bounds_.begin(), bounds_.end(),
                    [](const Bounds& a, const Bounds& b) {
                      return a.bilateral_unbounded() == b.bilateral_unbounded();
                    });
}

void ComplementaritySolver::factor(const ComplianceMatrix& w, std::span<const Bounds> bounds,
                                   bool kept) {
  const bool as_before = kept && w_ == &w && same_bilateral(bounds);
  w_ = &w;
  m_ = w.size;
  bounds_.assign(bounds.begin(), bounds.end());
  if (as_before) return;
  reduced_of_.clear();
  bilateral_.clear();
  bounded_.clear();
  for (int i = 0; i < m_; ++i)
    (bounds_[at(i)].bilateral_unbounded() ? bilateral_ : bounded_).push_back(i);
  const int nb = static_cast<int>(bilateral_.size()), nu = static_cast<int>(bounded_.size());
  reduced_.resize(at(nb) * at(nb));
  for (int j = 0; j < nb; ++j)
    for (int i = 0; i < nb; ++i)
      reduced_[at(j) * at(nb) + at(i)] = w(bilateral_[at(i)], bilateral_[at(j)]);
  bilateral_regularised_ = factor_regularised(nb, l_, reduced_);
  v_.resize(at(nb) * at(nu));
  for (int j = 0; j < nu; ++j)
    for (int i = 0; i < nb; ++i) v_[at(j) * at(nb) + at(i)] = w(bilateral_[at(i)], bounded_[at(j)]);
  blas::forward(nb, l_.data(), nb, v_.data(), nu, nb);
  s_.resize(at(nu) * at(nu));
  for (int j = 0; j < nu; ++j)
    for (int i = 0; i < nu; ++i) s_[at(j) * at(nu) + at(i)] = w(bounded_[at(i)], bounded_[at(j)]);
  blas::subtract_gram(nu, nb, v_.data(), nb, s_.data(), nu);
  for (int j = 0; j < nu; ++j)
    for (int i = 0; i < j; ++i) s_[at(j) * at(nu) + at(i)] = s_[at(i) * at(nu) + at(j)];
}

void ComplementaritySolver::condense(const double* j, int columns, std::vector<double>& half,
                                     std::vector<double>& condensed) const {
  const int nb = static_cast<int>(bilateral_.size()), nu = static_cast<int>(bounded_.size());
  half.resize(at(nb) * at(columns));
  condensed.resize(at(nu) * at(columns));
  for (int c = 0; c < columns; ++c) {
    for (int i = 0; i < nb; ++i)
      half[at(c) * at(nb) + at(i)] = j[at(c) * at(m_) + at(bilateral_[at(i)])];
    for (int i = 0; i < nu; ++i)
      condensed[at(c) * at(nu) + at(i)] = j[at(c) * at(m_) + at(bounded_[at(i)])];
  }
  blas::forward(nb, l_.data(), nb, half.data(), columns, nb);
  for (int c = 0; c < columns; ++c)
    blas::multiply_add(true, nb, nu, -1.0, v_.data(), nb, half.data() + at(c) * at(nb),
                       condensed.data() + at(c) * at(nu));
}

const Bounds& ComplementaritySolver::bounds_of(int i) const { return bounds_[at(bounded_[at(i)])]; }

/// Sets the rows that are not free to their bounds and solves S_FF λ_F = q_F − S_FA λ_A.
bool ComplementaritySolver::solve_free() {
  const int nu = static_cast<int>(bounded_.size());
  free_.clear();
  for (int i = 0; i < nu; ++i) {
    if (state_u_[at(i)] == RowState::kFree) {
      free_.push_back(i);
    } else {
      lambda_u_[at(i)] =
          state_u_[at(i)] == RowState::kLower ? bounds_of(i).lower_n : bounds_of(i).upper_n;
    }
  }
  const int nf = static_cast<int>(free_.size());
  if (nf == 0) return true;
  reduced_rhs_.resize(at(nf));
  double largest = 0.0;
  for (int j = 0; j < nf; ++j) {
    largest = std::max(largest, condensed_compliance(free_[at(j)], free_[at(j)]));
    double rhs = qs_[at(free_[at(j)])];
    for (int k = 0; k < nu; ++k)
      if (state_u_[at(k)] != RowState::kFree && lambda_u_[at(k)] != 0.0)
        rhs -= condensed_compliance(free_[at(j)], k) * lambda_u_[at(k)];
    reduced_rhs_[at(j)] = rhs;
  }
  if (free_ != reduced_of_ && !factor_free(largest)) return false;
  blas::forward(nf, reduced_.data(), nf, reduced_rhs_.data(), 1, nf);
  blas::backward(nf, reduced_.data(), nf, reduced_rhs_.data());
  for (int j = 0; j < nf; ++j) lambda_u_[at(free_[at(j)])] = reduced_rhs_[at(j)];
  return true;
}

/// Factors S_FF, with a share of its `largest` diagonal entry added where it takes one.
bool ComplementaritySolver::factor_free(double largest) {
  const int nf = static_cast<int>(free_.size());
  reduced_of_.clear();
  reduced_.resize(at(nf) * at(nf));
  for (const double shift : {0.0, 1e-9 * largest}) {
    for (int j = 0; j < nf; ++j) {
      for (int i = j; i < nf; ++i)
        reduced_[at(j) * at(nf) + at(i)] = condensed_compliance(free_[at(i)], free_[at(j)]);
      reduced_[at(j) * at(nf) + at(j)] += shift;
    }
    if (blas::cholesky(nf, reduced_.data(), nf)) {
      if (shift == 0.0) reduced_of_ = free_;
      return true;
    }
    regularised_ = true;
  }
  return false;
}

/// Where row i belongs, given its multiplier and its gap.
RowState ComplementaritySolver::right_state(int i) const {
  const double l = lambda_u_[at(i)], w = gap_u_[at(i)];
  const double lambda_tolerance_n = kRounding * lambda_scale_;
  const double gap_tolerance_m = kRounding * magnitude_u_[at(i)];
  switch (state_u_[at(i)]) {
    case RowState::kFree:
      if (l < bounds_of(i).lower_n - lambda_tolerance_n) return RowState::kLower;
      if (l > bounds_of(i).upper_n + lambda_tolerance_n) return RowState::kUpper;
      return RowState::kFree;
    case RowState::kLower:
      return w < -gap_tolerance_m ? RowState::kFree : RowState::kLower;
    case RowState::kUpper:
      return w > gap_tolerance_m ? RowState::kFree : RowState::kUpper;
  }
  return RowState::kFree;
}

/// Computes the gaps of the bounded rows and counts those on the wrong side.
int ComplementaritySolver::count_wrong() {
  const int nu = static_cast<int>(bounded_.size());
  lambda_scale_ = 0.0;
  for (int i = 0; i < nu; ++i) lambda_scale_ = std::max(lambda_scale_, std::abs(lambda_u_[at(i)]));
  for (int i = 0; i < nu; ++i) {
    gap_u_[at(i)] = -qs_[at(i)];
    magnitude_u_[at(i)] = std::abs(qs_[at(i)]);
  }
  for (int k = 0; k < nu; ++k) {
    const double l = lambda_u_[at(k)];
    if (l == 0.0) continue;
    add_column(s_.data() + at(k) * at(nu), l, nu, gap_u_.data(), magnitude_u_.data());
  }
  int wrong = 0;
  for (int i = 0; i < nu; ++i) wrong += right_state(i) != state_u_[at(i)];
  return wrong;
}

/// The primal active-set method on min ½ λᵀ S λ − qᵀ λ: every round either lowers the objective
/// or binds one more row, so no active set comes twice.
bool ComplementaritySolver::descend(int& rounds) {
  const int nu = static_cast<int>(bounded_.size());
  const int rounds_max = rounds + 100 + 20 * nu;
  for (int i = 0; i < nu; ++i) {
    const Bounds& b = bounds_of(i);
    lambda_u_[at(i)] = std::clamp(lambda_u_[at(i)], b.lower_n, b.upper_n);
    state_u_[at(i)] = lambda_u_[at(i)] == b.lower_n   ? RowState::kLower
                      : lambda_u_[at(i)] == b.upper_n ? RowState::kUpper
                                                      : RowState::kFree;
  }
  for (; rounds < rounds_max; ++rounds) {
    feasible_u_ = lambda_u_;
    if (!solve_free()) return false;
    // The longest step towards the minimiser over the free rows that stays within the bounds.
    double step = 1.0;
    int blocking = -1;
    for (const int i : free_) {
      const Bounds& b = bounds_of(i);
      const double from = feasible_u_[at(i)], to = lambda_u_[at(i)];
      const double bound = to < b.lower_n ? b.lower_n : to > b.upper_n ? b.upper_n : to;
      if (bound == to) continue;
      const double share = (bound - from) / (to - from);
      if (share < step) {
        step = share;
        blocking = i;
      }
    }
    if (blocking >= 0) {
      for (const int i : free_)
        lambda_u_[at(i)] = feasible_u_[at(i)] + step * (lambda_u_[at(i)] - feasible_u_[at(i)]);
      const bool low = lambda_u_[at(blocking)] <
                       0.5 * (bounds_of(blocking).lower_n + bounds_of(blocking).upper_n);
      state_u_[at(blocking)] = low ? RowState::kLower : RowState::kUpper;
      lambda_u_[at(blocking)] = low ? bounds_of(blocking).lower_n : bounds_of(blocking).upper_n;
      continue;
    }
    if (count_wrong() == 0) return true;
    int worst = -1;
    double most = 0.0;
    for (int i = 0; i < nu; ++i)
      if (state_u_[at(i)] != RowState::kFree && right_state(i) == RowState::kFree &&
          std::abs(gap_u_[at(i)]) > most) {
        most = std::abs(gap_u_[at(i)]);
        worst = i;
      }
    if (worst < 0) return true;
    state_u_[at(worst)] = RowState::kFree;
  }
  return false;
}

SolveReport ComplementaritySolver::solve(std::span<const double> q, std::span<double> lambda,
                                         std::span<RowState> state) {
  SolveReport report;
  regularised_ = bilateral_regularised_;
  const int nb = static_cast<int>(bilateral_.size()), nu = static_cast<int>(bounded_.size());
  half_q_.resize(at(nb));
  for (int i = 0; i < nb; ++i) half_q_[at(i)] = q[at(bilateral_[at(i)])];
  blas::forward(nb, l_.data(), nb, half_q_.data(), 1, std::max(nb, 1));
  qs_.resize(at(nu));
  for (int i = 0; i < nu; ++i) {
    qs_[at(i)] = q[at(bounded_[at(i)])];
  }
  blas::multiply_add(true, nb, nu, -1.0, v_.data(), nb, half_q_.data(), qs_.data());

  lambda_u_.assign(at(nu), 0.0);
  gap_u_.assign(at(nu), 0.0);
  magnitude_u_.assign(at(nu), 0.0);
  state_u_.resize(at(nu));
  for (int i = 0; i < nu; ++i) {
    RowState s = state[at(bounded_[at(i)])];
    if (s == RowState::kLower && bounds_of(i).lower_n == -kUnbounded) s = RowState::kFree;
    if (s == RowState::kUpper && bounds_of(i).upper_n == kUnbounded) s = RowState::kFree;
    state_u_[at(i)] = s;
  }
  // Block pivoting: fast, and nearly always enough.
  int best = nu + 1, patience = kRoundsWithoutProgress;
  bool solved = false;
  while (!solved && patience > 0) {
    if (!solve_free()) break;
    const int wrong = count_wrong();
    if (wrong == 0) {
      solved = true;
      break;
    }
    ++report.pivoting_rounds;
    if (wrong < best) {
      best = wrong;
      patience = kRoundsWithoutProgress;
    } else {
      --patience;
    }
    for (int i = 0; i < nu; ++i) state_u_[at(i)] = right_state(i);
  }
  if (!solved) report.converged = descend(report.pivoting_rounds);
  for (int i = 0; i < nu; ++i) {
    lambda_u_[at(i)] = std::clamp(lambda_u_[at(i)], bounds_of(i).lower_n, bounds_of(i).upper_n);
    lambda[at(bounded_[at(i)])] = lambda_u_[at(i)];
    state[at(bounded_[at(i)])] = state_u_[at(i)];
    report.active_bounded_rows += lambda_u_[at(i)] != 0.0;
  }
  // λ_B = L⁻ᵀ (L⁻¹ q_B − V λ_U)
  blas::multiply_add(false, nb, nu, -1.0, v_.data(), nb, lambda_u_.data(), half_q_.data());
  blas::backward(nb, l_.data(), std::max(nb, 1), half_q_.data());
  for (int i = 0; i < nb; ++i) {
    lambda[at(bilateral_[at(i)])] = half_q_[at(i)];
    state[at(bilateral_[at(i)])] = RowState::kFree;
  }

  // The residual is measured against W and q themselves, not against their condensation.
  gap_.assign(at(m_), 0.0);
  residual_scratch_.assign(at(m_), 0.0);
  double lambda_max = 0.0;
  for (int j = 0; j < m_; ++j) {
    lambda_max = std::max(lambda_max, std::abs(lambda[at(j)]));
    if (lambda[at(j)] != 0.0)
      add_column(w_->value.data() + at(j) * at(m_), lambda[at(j)], m_, gap_.data(),
                 residual_scratch_.data());
  }
  if (lambda_max == 0.0) lambda_max = 1.0;
  for (int i = 0; i < m_; ++i) {
    gap_[at(i)] -= q[at(i)];
    const double up = (lambda[at(i)] - bounds_[at(i)].upper_n) / lambda_max;
    const double low = (lambda[at(i)] - bounds_[at(i)].lower_n) / lambda_max;
    const double miss = std::max(up, std::min(low, gap_[at(i)] / kGapScale_m));
    // Not by the largest: one that is no number would be passed over.
    const bool finite = std::isfinite(lambda[at(i)]) && std::isfinite(gap_[at(i)]);
    report.residual = finite ? std::max(report.residual, std::abs(miss))
                             : std::numeric_limits<double>::infinity();
  }
  report.regularised = regularised_;
  return report;
}

}  // namespace sutured::constraints
