// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/complementarity.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "constraints/blas.hpp"

namespace sutured::constraints {
namespace {

constexpr int kRoundsWithoutProgress = 10;
constexpr double kGapScale_m = 1e-3;

std::size_t at(int i) { return static_cast<std::size_t>(i); }

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

void ComplementaritySolver::factor(const ComplianceMatrix& w, std::span<const Bounds> bounds) {
  w_ = &w;
  m_ = w.size;
  bounds_.assign(bounds.begin(), bounds.end());
  bilateral_.clear();
  bounded_.clear();
  for (int i = 0; i < m_; ++i)
    (bounds_[at(i)].bilateral_unbounded() ? bilateral_ : bounded_).push_back(i);
  const int nb = static_cast<int>(bilateral_.size()), nu = static_cast<int>(bounded_.size());
  reduced_.resize(at(nb) * at(nb));
  for (int j = 0; j < nb; ++j)
    for (int i = 0; i < nb; ++i) reduced_[at(j) * at(nb) + at(i)] = w(bilateral_[at(i)], bilateral_[at(j)]);
  regularised_ = factor_regularised(nb, l_, reduced_);
  v_.resize(at(nb) * at(nu));
  for (int j = 0; j < nu; ++j)
    for (int i = 0; i < nb; ++i) v_[at(j) * at(nb) + at(i)] = w(bilateral_[at(i)], bounded_[at(j)]);
  blas::forward(nb, l_.data(), nb, v_.data(), nu, nb);
  s_.resize(at(nu) * at(nu));
  for (int j = 0; j < nu; ++j)
    for (int i = 0; i < nu; ++i) s_[at(j) * at(nu) + at(i)] = w(bounded_[at(i)], bounded_[at(j)]);
  blas::subtract_gram(nu, nb, v_.data(), nb, s_.data(), nu);
}

void ComplementaritySolver::condense(const double* j, int columns, std::vector<double>& half,
                                     std::vector<double>& condensed) const {
  const int nb = static_cast<int>(bilateral_.size()), nu = static_cast<int>(bounded_.size());
  half.resize(at(nb) * at(columns));
  condensed.resize(at(nu) * at(columns));
  for (int c = 0; c < columns; ++c) {
    for (int i = 0; i < nb; ++i) half[at(c) * at(nb) + at(i)] = j[at(c) * at(m_) + at(bilateral_[at(i)])];
    for (int i = 0; i < nu; ++i) condensed[at(c) * at(nu) + at(i)] = j[at(c) * at(m_) + at(bounded_[at(i)])];
  }
  blas::forward(nb, l_.data(), nb, half.data(), columns, nb);
  for (int c = 0; c < columns; ++c)
    blas::multiply_add(true, nb, nu, -1.0, v_.data(), nb, half.data() + at(c) * at(nb),
                       condensed.data() + at(c) * at(nu));
}

/// Solves S_FF λ_F = q_F − S_FA λ_A for the free rows F, the others being at a bound.
bool ComplementaritySolver::solve_free(std::span<const double> qs, std::span<double> lambda_u) {
  const int nu = static_cast<int>(bounded_.size()), nf = static_cast<int>(free_.size());
  if (nf == 0) return true;
  reduced_.resize(at(nf) * at(nf));
  reduced_rhs_.resize(at(nf));
  for (int j = 0; j < nf; ++j) {
    for (int i = j; i < nf; ++i)
      reduced_[at(j) * at(nf) + at(i)] = condensed_compliance(free_[at(i)], free_[at(j)]);
    double rhs = qs[at(free_[at(j)])];
    for (int k = 0; k < nu; ++k)
      if (state_u_[at(k)] != RowState::kFree && lambda_u[at(k)] != 0.0)
        rhs -= condensed_compliance(free_[at(j)], k) * lambda_u[at(k)];
    reduced_rhs_[at(j)] = rhs;
  }
  if (!blas::cholesky(nf, reduced_.data(), nf)) {
    double largest = 0.0;
    for (int j = 0; j < nf; ++j) largest = std::max(largest, condensed_compliance(free_[at(j)], free_[at(j)]));
    for (int j = 0; j < nf; ++j) {
      for (int i = j; i < nf; ++i)
        reduced_[at(j) * at(nf) + at(i)] = condensed_compliance(free_[at(i)], free_[at(j)]);
      reduced_[at(j) * at(nf) + at(j)] += 1e-9 * largest;
    }
    regularised_ = true;
    if (!blas::cholesky(nf, reduced_.data(), nf)) return false;
  }
  blas::forward(nf, reduced_.data(), nf, reduced_rhs_.data(), 1, nf);
  blas::backward(nf, reduced_.data(), nf, reduced_rhs_.data());
  for (int j = 0; j < nf; ++j) lambda_u[at(free_[at(j)])] = reduced_rhs_[at(j)];
  return true;
}

SolveReport ComplementaritySolver::solve(std::span<const double> q, std::span<double> lambda,
                                         std::span<RowState> state) {
  SolveReport report;
  const int nb = static_cast<int>(bilateral_.size()), nu = static_cast<int>(bounded_.size());
  half_q_.resize(at(nb));
  for (int i = 0; i < nb; ++i) half_q_[at(i)] = q[at(bilateral_[at(i)])];
  blas::forward(nb, l_.data(), nb, half_q_.data(), 1, std::max(nb, 1));
  qs_.resize(at(nu));
  double q_scale = 0.0;
  for (int i = 0; i < nu; ++i) {
    qs_[at(i)] = q[at(bounded_[at(i)])];
    q_scale = std::max(q_scale, std::abs(qs_[at(i)]));
  }
  blas::multiply_add(true, nb, nu, -1.0, v_.data(), nb, half_q_.data(), qs_.data());

  lambda_u_.assign(at(nu), 0.0);
  gap_u_.assign(at(nu), 0.0);
  state_u_.resize(at(nu));
  const auto bounds = [&](int i) -> const Bounds& { return bounds_[at(bounded_[at(i)])]; };
  for (int i = 0; i < nu; ++i) {
    RowState s = state[at(bounded_[at(i)])];
    if (s == RowState::kLower && bounds(i).lower_n == -kUnbounded) s = RowState::kFree;
    if (s == RowState::kUpper && bounds(i).upper_n == kUnbounded) s = RowState::kFree;
    state_u_[at(i)] = s;
  }
  // A row switches only when it is wrong by more than rounding can make it.
  const double gap_tolerance_m = 1e-12 * std::max(q_scale, kGapScale_m);
  int best = nu + 1, patience = kRoundsWithoutProgress;
  const int rounds_max = 50 + 20 * nu;
  for (;; ++report.pivoting_rounds) {
    free_.clear();
    for (int i = 0; i < nu; ++i) {
      if (state_u_[at(i)] == RowState::kFree) free_.push_back(i);
      else lambda_u_[at(i)] = state_u_[at(i)] == RowState::kLower ? bounds(i).lower_n : bounds(i).upper_n;
    }
    if (!solve_free(qs_, lambda_u_)) report.converged = false;
    double lambda_scale = 0.0;
    for (int i = 0; i < nu; ++i) lambda_scale = std::max(lambda_scale, std::abs(lambda_u_[at(i)]));
    const double lambda_tolerance_n = 1e-12 * lambda_scale;
    int wrong = 0, last_wrong = -1;
    const auto right_state = [&](int i) {
      const double l = lambda_u_[at(i)], w = gap_u_[at(i)];
      switch (state_u_[at(i)]) {
        case RowState::kFree:
          if (l < bounds(i).lower_n - lambda_tolerance_n) return RowState::kLower;
          if (l > bounds(i).upper_n + lambda_tolerance_n) return RowState::kUpper;
          return RowState::kFree;
        case RowState::kLower: return w < -gap_tolerance_m ? RowState::kFree : RowState::kLower;
        default: return w > gap_tolerance_m ? RowState::kFree : RowState::kUpper;
      }
    };
    for (int i = 0; i < nu; ++i) {
      double w = -qs_[at(i)];
      for (int k = 0; k < nu; ++k) w += condensed_compliance(i, k) * lambda_u_[at(k)];
      gap_u_[at(i)] = w;
      if (right_state(i) != state_u_[at(i)]) {
        ++wrong;
        last_wrong = i;
      }
    }
    if (wrong == 0) break;
    if (report.pivoting_rounds >= rounds_max) {
      report.converged = false;
      break;
    }
    bool block = true;
    if (wrong < best) {
      best = wrong;
      patience = kRoundsWithoutProgress;
    } else if (patience > 0) {
      --patience;
    } else {
      block = false;
    }
    if (block) {
      for (int i = 0; i < nu; ++i) state_u_[at(i)] = right_state(i);
    } else {
      state_u_[at(last_wrong)] = right_state(last_wrong);
    }
  }
  for (int i = 0; i < nu; ++i) {
    lambda_u_[at(i)] = std::clamp(lambda_u_[at(i)], bounds(i).lower_n, bounds(i).upper_n);
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
  double lambda_max = 0.0;
  for (int j = 0; j < m_; ++j) {
    lambda_max = std::max(lambda_max, std::abs(lambda[at(j)]));
    const double* column = w_->value.data() + at(j) * at(m_);
    for (int i = 0; i < m_; ++i) gap_[at(i)] += column[i] * lambda[at(j)];
  }
  if (lambda_max == 0.0) lambda_max = 1.0;
  for (int i = 0; i < m_; ++i) {
    gap_[at(i)] -= q[at(i)];
    const double up = (lambda[at(i)] - bounds_[at(i)].upper_n) / lambda_max;
    const double low = (lambda[at(i)] - bounds_[at(i)].lower_n) / lambda_max;
    const double miss = std::max(up, std::min(low, gap_[at(i)] / kGapScale_m));
    report.residual = std::max(report.residual, std::abs(miss));
  }
  report.regularised = regularised_;
  return report;
}

}  // namespace sutured::constraints
