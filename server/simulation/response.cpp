// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/response.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "constraints/blas.hpp"

namespace sutured::simulation {
namespace {

// The arm at which a turn counts as a motion, in what is near to switching.
constexpr double kArm_m = 0.01;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

/// Returns how far a tool may move at least before a function of its motion with this slope has
/// changed by `distance`.
double radius_of(double distance, const Vec6& slope) {
  const double steepest = slope.head<3>().norm() + slope.tail<3>().norm() / kArm_m;
  return std::max(distance, 0.0) / std::max(steepest, 1e-300);
}

}  // namespace

void ResponseBuilder::build(const constraints::ConstraintRows& rows,
                            const constraints::ComplementaritySolver& solver,
                            std::span<const double> lambda, std::span<const NeedleBody> needles,
                            std::span<const ToolBody> tools, std::span<ToolResponse> responses) {
  rows_ = &rows;
  solver_ = &solver;
  lambda_ = lambda;
  needles_ = needles;
  tools_ = tools;
  find_columns();
  if (!felt_.empty()) assemble();
  for (std::size_t i = 0; i < tools.size(); ++i) build(static_cast<int>(i), responses[i]);
}

void ResponseBuilder::find_columns() {
  felt_.clear();
  released_.clear();
  slide_count_ = 0;
  for (int t = 0; t < static_cast<int>(tools_.size()); ++t)
    for (int i = 0; i < rows_->size(); ++i)
      if ((*rows_)[i].jacobian_of(t) != nullptr) {
        felt_.push_back(t);
        break;
      }
  if (felt_.empty()) return;
  for (int n = 0; n < static_cast<int>(needles_.size()); ++n) {
    if (!needles_[at(n)].slides_freely()) continue;
    if (slides_.size() == slide_count_) slides_.emplace_back();
    slides_[slide_count_++].needle = n;
  }
  for (int i = 0; i < rows_->size(); ++i)
    if ((*rows_)[i].friction_of >= 0 && (*rows_)[i].bounds.bilateral_unbounded())
      released_.push_back(i);
}

void ResponseBuilder::assemble() {
  const int rows = rows_->size();
  const int nb = static_cast<int>(solver_->bilateral().size());
  bounded_ = static_cast<int>(solver_->bounded().size());
  columns_ = 6 * static_cast<int>(felt_.size());
  const int first_released = columns_ + static_cast<int>(slide_count_);
  const int all_columns = first_released + static_cast<int>(released_.size());
  size_ = bounded_ + all_columns;

  x_.assign(at(all_columns) * at(rows), 0.0);
  const auto x = [&](int column, int row) -> double& {
    return x_[at(column) * at(rows) + at(row)];
  };
  for (int i = 0; i < rows; ++i) {
    const constraints::Row& row = (*rows_)[i];
    for (int f = 0; 6 * f < columns_; ++f)
      if (const Vec6* jacobian = row.jacobian_of(felt_[at(f)]))
        for (int c = 0; c < 6; ++c) x(6 * f + c, i) = (*jacobian)[c];
    for (int s = 0; s < static_cast<int>(slide_count_); ++s)
      if (row.needle == slides_[at(s)].needle) x(columns_ + s, i) = row.slide;
  }
  // The two rows of a tip are turned, so that the first lies along the force they carry.
  for (int r = 0; r < static_cast<int>(released_.size()); r += 2) {
    const int first = released_[at(r)], second = released_[at(r + 1)];
    const double along = lambda_[at(first)], across = lambda_[at(second)];
    const double force = std::hypot(along, across);
    const double cosine = force > 0.0 ? along / force : 1.0;
    const double sine = force > 0.0 ? across / force : 0.0;
    x(first_released + r, first) = cosine, x(first_released + r, second) = sine;
    x(first_released + r + 1, first) = -sine, x(first_released + r + 1, second) = cosine;
  }
  solver_->condense(x_.data(), all_columns, half_, condensed_);

  m_.assign(at(size_) * at(size_), 0.0);
  for (int j = 0; j < bounded_; ++j) {
    double* column = &m_[at(j) * at(size_)];
    for (int i = j; i < bounded_; ++i) column[i] = solver_->condensed_compliance(i, j);
    for (int c = 0; c < all_columns; ++c)
      column[bounded_ + c] = condensed_[at(c) * at(bounded_) + at(j)];
  }
  blas::subtract_gram(all_columns, nb, half_.data(), nb, &m_[at(bounded_) * at(size_ + 1)], size_);
  for (int r = bounded_ + first_released; r < size_; ++r) pivot(r, true);
  for (int s = 0; s < static_cast<int>(slide_count_); ++s) {
    Slide& slide = slides_[at(s)];
    const int k = bounded_ + columns_ + s;
    slide.stiffness = -m(k, k);
    if (slide.stiffness <= 0.0) continue;
    slide.gradient.resize(at(columns_));
    for (int c = 0; c < columns_; ++c) slide.gradient[at(c)] = m(k, bounded_ + c) / slide.stiffness;
    pivot(k, false);
  }
  gather();
}

/// M ← M − m_p m_pᵀ / M_pp; with `exchange`, row and column p then are those of the row that its
/// unit column stood for.
void ResponseBuilder::pivot(int index, bool exchange) {
  const double p = m(index, index);
  column_.resize(at(size_));
  for (int i = 0; i < size_; ++i) column_[at(i)] = m(i, index);
  for (int j = 0; j < size_; ++j) {
    const double scale = column_[at(j)] / p;
    if (scale == 0.0) continue;
    double* to = &m_[at(j) * at(size_)];
    for (int i = j; i < size_; ++i) to[i] -= scale * column_[at(i)];
  }
  for (int i = 0; i < size_; ++i) m(i, index) = exchange ? column_[at(i)] / p : 0.0;
  if (exchange) m(index, index) = -1.0 / p;
}

// The rows that may switch. A force that may have either sign is counted from its lower bound, so
// that every row has 0 ≤ λ ≤ λ_max.
void ResponseBuilder::gather() {
  candidates_.clear();
  for (int u = 0; u < bounded_; ++u) {
    const int i = solver_->bounded()[at(u)];
    const constraints::Row& row = (*rows_)[i];
    Candidate candidate;
    candidate.index = u;
    candidate.row = i;
    if (row.bounds.lower_n == 0.0) {
      candidate.multiplier_n = lambda_[at(i)];
      candidate.multiplier_max_n = row.bounds.upper_n;
      candidate.gap_m = solver_->gap_m()[at(i)];
    } else if (row.friction_of >= 0) {
      // A tip that slips does not come back by what it has slipped: its gap starts at zero.
      candidate.multiplier_n = lambda_[at(i)] - row.bounds.lower_n;
      candidate.multiplier_max_n = row.bounds.upper_n - row.bounds.lower_n;
      candidate.normal_row = row.friction_of;
      candidate.friction_coefficient = row.friction_coefficient;
    } else {
      continue;  // a grip that slips: its force is constant, it cannot switch
    }
    candidates_.push_back(candidate);
  }
  const int first_released = size_ - static_cast<int>(released_.size());
  for (int r = 0; r < static_cast<int>(released_.size()); ++r) {
    const constraints::Row& row = (*rows_)[released_[at(r)]];
    const double cone = row.friction_coefficient * std::max(lambda_[at(row.friction_of)], 0.0);
    const double force =
        r % 2 == 0 ? std::hypot(lambda_[at(released_[at(r)])], lambda_[at(released_[at(r + 1)])])
                   : 0.0;
    Candidate candidate;
    candidate.index = first_released + r;
    candidate.multiplier_n = std::min(force, cone) + cone;
    candidate.multiplier_max_n = 2.0 * cone;
    candidate.normal_row = row.friction_of;
    candidate.friction_coefficient = row.friction_coefficient;
    candidates_.push_back(candidate);
  }
}

/// Fills `chosen_`, and `frozen_` with those left that are in force.
void ResponseBuilder::choose(int own) {
  constexpr int kMax = CondensedProblem::kRowsMax;
  chosen_ = candidates_;
  frozen_.clear();
  if (static_cast<int>(candidates_.size()) <= kMax) return;
  // dλ_F/dξ = S_FF⁻¹ Ĵ_F, and what that does to the gaps of the others.
  const auto others = std::partition(chosen_.begin(), chosen_.end(),
                                     [](const Candidate& c) { return c.in_force(); });
  const int nf = static_cast<int>(others - chosen_.begin());
  factor_.resize(at(nf) * at(nf));
  right_.resize(6 * at(nf));
  for (int j = 0; j < nf; ++j) {
    for (int i = j; i < nf; ++i)
      factor_[at(j) * at(nf) + at(i)] = m(chosen_[at(i)].index, chosen_[at(j)].index);
    for (int c = 0; c < 6; ++c)
      right_[at(c) * at(nf) + at(j)] = m(chosen_[at(j)].index, bounded_ + own + c);
  }
  if (blas::cholesky(nf, factor_.data(), nf)) {
    blas::forward(nf, factor_.data(), nf, right_.data(), 6, nf);
    for (int c = 0; c < 6; ++c)
      blas::backward(nf, factor_.data(), nf, right_.data() + at(c) * at(nf));
  }
  for (int i = 0; i < static_cast<int>(chosen_.size()); ++i) {
    Candidate& row = chosen_[at(i)];
    Vec6 slope;
    double distance = 0.0;
    if (i < nf) {
      for (int c = 0; c < 6; ++c) slope[c] = right_[at(c) * at(nf) + at(i)];
      distance = std::min(row.multiplier_n, row.multiplier_max_n - row.multiplier_n);
    } else {
      for (int c = 0; c < 6; ++c) {
        slope[c] = -m(row.index, bounded_ + own + c);
        for (int j = 0; j < nf; ++j)
          slope[c] += m(row.index, chosen_[at(j)].index) * right_[at(c) * at(nf) + at(j)];
      }
      distance = std::abs(row.gap_m);
    }
    row.radius_m = radius_of(distance, slope);
  }
  std::nth_element(chosen_.begin(), chosen_.begin() + kMax, chosen_.end(),
                   [](const Candidate& a, const Candidate& b) { return a.radius_m < b.radius_m; });
  for (auto row = chosen_.begin() + kMax; row != chosen_.end(); ++row)
    if (row->in_force()) frozen_.push_back(*row);
  chosen_.resize(kMax);
}

/// Fills `own_`: M of the chosen rows and the tools' columns, the frozen rows eliminated.
void ResponseBuilder::extract() {
  const int mh = static_cast<int>(chosen_.size()), n = mh + columns_;
  const auto index = [&](int i) { return i < mh ? chosen_[at(i)].index : bounded_ + (i - mh); };
  own_.resize(at(n) * at(n));
  for (int j = 0; j < n; ++j)
    for (int i = j; i < n; ++i) own_[at(j) * at(n) + at(i)] = m(index(i), index(j));
  const int ne = static_cast<int>(frozen_.size());
  factor_.resize(at(ne) * at(ne));
  right_.resize(at(ne) * at(n));
  for (int j = 0; j < ne; ++j)
    for (int i = j; i < ne; ++i)
      factor_[at(j) * at(ne) + at(i)] = m(frozen_[at(i)].index, frozen_[at(j)].index);
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < ne; ++i) right_[at(j) * at(ne) + at(i)] = m(frozen_[at(i)].index, index(j));
  if (!blas::cholesky(ne, factor_.data(), ne)) return;  // redundant: their force stays
  blas::forward(ne, factor_.data(), ne, right_.data(), n, ne);
  blas::subtract_gram(n, ne, right_.data(), ne, own_.data(), n);
}

void ResponseBuilder::build(int tool, ToolResponse& response) {
  const ToolBody& body = tools_[at(tool)];
  response.reference = body.input();
  response.wrench = body.wrench();
  response.arm_moment = body.arm_moment();
  response.touching = body.touching();
  response.world_changed = body.world_changed();
  response.slide_twist.setZero();
  response.slide_gradient.setZero();
  response.slide_friction_n = response.slide_stiffness = response.slide_drag_n_s_per_m = 0.0;
  response.stiffness.setZero();
  response.bilateral_stiffness.setZero();
  response.bilateral_wrench = response.wrench;
  response.other_count = 0;
  CondensedProblem& problem = response.condensed;

  const auto found = std::find(felt_.begin(), felt_.end(), tool);
  const bool felt = found != felt_.end();
  const int own = 6 * static_cast<int>(found - felt_.begin());
  chosen_.clear();
  problem.frozen_rows = 0;
  if (felt) {
    choose(own);
    problem.frozen_rows = static_cast<int>(candidates_.size() - chosen_.size());
    extract();
  }
  const int mh = static_cast<int>(chosen_.size()), n = mh + columns_;
  problem.compliance_m_per_n.resize(mh, mh);
  problem.jacobian.resize(mh, 6);
  problem.offset_m.resize(mh);
  problem.multiplier_n.resize(mh);
  problem.multiplier_max_n.resize(mh);
  problem.bound_slope.resize(mh);
  if (!felt) return;

  const auto entry = [&](int i, int j) {
    return own_[at(std::min(i, j)) * at(n) + at(std::max(i, j))];
  };
  for (int i = 0; i < mh; ++i)
    for (int j = 0; j < mh; ++j) problem.compliance_m_per_n(i, j) = entry(i, j);
  const auto take = [&](int columns, Mat6& stiffness, auto& jacobian) {
    jacobian.resize(mh, 6);
    for (int c = 0; c < 6; ++c) {
      for (int i = 0; i < 6; ++i) stiffness(i, c) = -entry(mh + own + i, mh + columns + c);
      for (int i = 0; i < mh; ++i) jacobian(i, c) = entry(i, mh + columns + c);
    }
  };
  take(own, response.bilateral_stiffness, problem.jacobian);
  for (int f = 0; 6 * f < columns_; ++f) {
    if (6 * f == own) continue;
    assert(response.other_count < ToolResponse::kOthersMax);  // a scene has no more tools
    ToolCoupling& other = response.others[at(response.other_count++)];
    other.tool = felt_[at(f)];
    other.slide_gradient.setZero();
    other.reference = tools_[at(other.tool)].input();
    take(6 * f, other.stiffness, other.jacobian);
  }

  for (std::size_t s = 0; s < slide_count_; ++s) {
    const Slide& slide = slides_[s];
    if (body.needle() != slide.needle || slide.stiffness <= 0.0) continue;
    const NeedleBody& needle = needles_[at(slide.needle)];
    const Vec6 twist = needle.curve().slide_twist(needle.pose());
    const Vec3 arm = response.reference.position_m - needle.pose().position_m;
    response.slide_twist.tail<3>() = twist.tail<3>();
    response.slide_twist.head<3>() = twist.head<3>() + Vec3(twist.tail<3>()).cross(arm);
    for (int c = 0; c < 6; ++c) response.slide_gradient[c] = slide.gradient[at(own + c)];
    for (int k = 0, f = 0; 6 * f < columns_; ++f) {
      if (6 * f == own) continue;
      for (int c = 0; c < 6; ++c)
        response.others[at(k)].slide_gradient[c] = slide.gradient[at(6 * f + c)];
      ++k;
    }
    response.slide_stiffness = slide.stiffness;
    response.slide_drag_n_s_per_m = needle.slide_drag_n_s_per_m();
    for (int i = 0; i < rows_->size(); ++i)
      if ((*rows_)[i].needle == slide.needle)
        response.slide_friction_n += (*rows_)[i].slide * lambda_[at(i)];
  }

  // The rows that carry force now, with their part of the stiffness: A = A₀ + Ĵ_Fᵀ S_FF⁻¹ Ĵ_F.
  response.stiffness = response.bilateral_stiffness;
  int nf = 0;
  std::array<int, CondensedProblem::kRowsMax> in_force;
  for (int i = 0; i < mh; ++i)
    if (chosen_[at(i)].in_force()) in_force[at(nf++)] = i;
  factor_.resize(at(nf) * at(nf));
  right_.resize(6 * at(nf));
  for (int j = 0; j < nf; ++j) {
    for (int i = j; i < nf; ++i)
      factor_[at(j) * at(nf) + at(i)] = entry(in_force[at(i)], in_force[at(j)]);
    for (int c = 0; c < 6; ++c)
      right_[at(c) * at(nf) + at(j)] = problem.jacobian(in_force[at(j)], c);
  }
  if (nf > 0 && blas::cholesky(nf, factor_.data(), nf)) {
    blas::forward(nf, factor_.data(), nf, right_.data(), 6, nf);
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j)
        for (int k = 0; k < nf; ++k)
          response.stiffness(i, j) +=
              right_[at(i) * at(nf) + at(k)] * right_[at(j) * at(nf) + at(k)];
  }

  // Offsets that reproduce the solved state at ξ = 0: gap = S λ − q, w = w₀ − Ĵᵀ λ.
  for (int i = 0; i < mh; ++i) {
    problem.multiplier_n[i] = chosen_[at(i)].multiplier_n;
    problem.multiplier_max_n[i] = chosen_[at(i)].multiplier_max_n;
  }
  // A cone whose normal row is frozen stays as it is.
  for (int i = 0; i < mh; ++i) {
    const Candidate& row = chosen_[at(i)];
    const auto normal =
        std::find_if(chosen_.begin(), chosen_.end(), [&](const Candidate& candidate) {
          return candidate.row >= 0 && candidate.row == row.normal_row;
        });
    const bool follows = normal != chosen_.end();
    problem.bound_row[at(i)] = follows ? static_cast<int>(normal - chosen_.begin()) : 0;
    problem.bound_slope[i] = follows ? row.friction_coefficient : 0.0;
  }
  for (int i = 0; i < mh; ++i) {
    double q = -chosen_[at(i)].gap_m;
    for (int j = 0; j < mh; ++j) q += problem.compliance_m_per_n(i, j) * problem.multiplier_n[j];
    problem.offset_m[i] = q;
    response.bilateral_wrench += problem.multiplier_n[i] * problem.jacobian.row(i).transpose();
  }

  // The paper's slide instead: P = I − s Sᵀ, not symmetric, kept for comparison.
  if (body.needle() >= 0 && needles_[at(body.needle())].least_squares()) {
    const NeedleBody& needle = needles_[at(body.needle())];
    const Vec6 gradient = needle.least_squares_gradient(response.reference.position_m);
    const Vec6 twist = needle.curve().slide_twist(needle.pose());
    Vec6 s = twist;
    s.head<3>() +=
        Vec3(twist.tail<3>()).cross(response.reference.position_m - needle.pose().position_m);
    const Mat6 projection = Mat6::Identity() - s * gradient.transpose();
    response.stiffness *= projection;
    response.bilateral_stiffness *= projection;
    problem.jacobian *= projection;
    response.slide_twist = s;
  }
}

}  // namespace sutured::simulation
