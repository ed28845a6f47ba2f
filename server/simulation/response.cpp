// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/response.hpp"

#include <algorithm>
#include <cmath>

#include "constraints/blas.hpp"

namespace sutured::simulation {
namespace {

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

double dot(const double* a, const double* b, int n) {
  double sum = 0.0;
  for (int i = 0; i < n; ++i) sum += a[i] * b[i];
  return sum;
}

}  // namespace

void ResponseBuilder::build(const constraints::ConstraintRows& rows,
                            const constraints::ComplementaritySolver& solver,
                            std::span<const double> lambda, std::span<const NeedleBody> needles,
                            const ToolBody& tool, int index, ToolResponse& response) {
  const int m = rows.size();
  response.reference = tool.input();
  response.wrench = tool.wrench();
  response.arm_moment = tool.arm_moment();
  response.touching = tool.touching();
  response.world_changed = tool.world_changed();
  response.slide_twist.setZero();
  response.slide_gradient.setZero();
  response.slide_friction_n = response.slide_stiffness = 0.0;
  response.stiffness.setZero();
  response.bilateral_stiffness.setZero();
  response.bilateral_wrench = response.wrench;
  CondensedProblem& problem = response.condensed;

  bool felt = false;
  columns_.assign(6 * at(m), 0.0);
  for (int i = 0; i < m; ++i)
    if (const Vec6* jacobian = rows[i].jacobian_of(index)) {
      felt = true;
      for (int c = 0; c < 6; ++c) columns_[at(c) * at(m) + at(i)] = (*jacobian)[c];
    }
  chosen_.clear();
  problem.frozen_rows = 0;
  if (felt) {
    solver.condense(columns_.data(), 6, half_, condensed_);
    const auto bounded = solver.bounded();
    const auto gap = solver.gap_m();
    // Rows with two finite bounds are slipping: their force is constant, they cannot switch.
    for (int u = 0; u < static_cast<int>(bounded.size()); ++u)
      if (rows[bounded[at(u)]].bounds.lower_n == 0.0) chosen_.push_back(u);
    if (static_cast<int>(chosen_.size()) > CondensedProblem::kRowsMax) {
      // The rows farthest from switching stay as they are.
      std::nth_element(chosen_.begin(), chosen_.begin() + CondensedProblem::kRowsMax, chosen_.end(),
                       [&](int a, int b) {
                         const auto margin = [&](int u) {
                           const int i = bounded[at(u)];
                           return lambda[at(i)] > 0.0
                                      ? lambda[at(i)] * solver.condensed_compliance(u, u)
                                      : gap[at(i)];
                         };
                         return margin(a) < margin(b);
                       });
      problem.frozen_rows = static_cast<int>(chosen_.size()) - CondensedProblem::kRowsMax;
      chosen_.resize(CondensedProblem::kRowsMax);
      std::sort(chosen_.begin(), chosen_.end());
    }
  }
  const int nb = static_cast<int>(solver.bilateral().size()),
            nu = static_cast<int>(solver.bounded().size());
  const int mh = static_cast<int>(chosen_.size());
  problem.compliance_m_per_n.resize(mh, mh);
  problem.jacobian.resize(mh, 6);
  problem.offset_m.resize(mh);
  problem.multiplier_n.resize(mh);
  problem.multiplier_max_n.resize(mh);
  if (!felt) return;

  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j)
      response.bilateral_stiffness(i, j) =
          dot(half_.data() + at(i) * at(nb), half_.data() + at(j) * at(nb), nb);
  for (int a = 0; a < mh; ++a) {
    const int row = solver.bounded()[at(chosen_[at(a)])];
    for (int c = 0; c < 6; ++c)
      problem.jacobian(a, c) = condensed_[at(c) * at(nu) + at(chosen_[at(a)])];
    for (int b = 0; b < mh; ++b)
      problem.compliance_m_per_n(a, b) =
          solver.condensed_compliance(chosen_[at(a)], chosen_[at(b)]);
    problem.multiplier_n[a] = lambda[at(row)];
    problem.multiplier_max_n[a] = rows[row].bounds.upper_n;
  }

  for (int n = 0; n < static_cast<int>(needles.size()); ++n) {
    const NeedleBody& needle = needles[at(n)];
    if (!needle.slides_freely()) continue;
    slide_.assign(at(m), 0.0);
    double friction = 0.0;
    for (int i = 0; i < m; ++i)
      if (rows[i].needle == n) {
        slide_[at(i)] = rows[i].slide;
        friction -= rows[i].slide * lambda[at(i)];
      }
    solver.condense(slide_.data(), 1, slide_half_, slide_condensed_);
    const double kappa = dot(slide_half_.data(), slide_half_.data(), nb);
    if (kappa <= 0.0) continue;
    Vec6 a;
    for (int c = 0; c < 6; ++c) a[c] = dot(half_.data() + at(c) * at(nb), slide_half_.data(), nb);
    response.bilateral_stiffness -= a * a.transpose() / kappa;
    for (int i = 0; i < mh; ++i) {
      const double ki = slide_condensed_[at(chosen_[at(i)])];
      problem.jacobian.row(i) -= (ki / kappa) * a.transpose();
      for (int j = 0; j < mh; ++j)
        problem.compliance_m_per_n(i, j) += ki * slide_condensed_[at(chosen_[at(j)])] / kappa;
    }
    if (tool.needle() != n) continue;
    const Vec6 twist = needle.curve().slide_twist(needle.pose());
    response.slide_twist.tail<3>() = twist.tail<3>();
    const Vec3 arm = response.reference.position_m - needle.pose().position_m;
    response.slide_twist.head<3>() = twist.head<3>() + Vec3(twist.tail<3>()).cross(arm);
    response.slide_gradient = -a / kappa;
    response.slide_stiffness = kappa;
    response.slide_friction_n = -friction;
  }

  // The rows that carry force now, with their part of the stiffness: A = A₀ + Ĵ_Fᵀ S_FF⁻¹ Ĵ_F.
  response.stiffness = response.bilateral_stiffness;
  int nf = 0;
  std::array<int, CondensedProblem::kRowsMax> free;
  for (int i = 0; i < mh; ++i)
    if (problem.multiplier_n[i] > 0.0 && problem.multiplier_n[i] < problem.multiplier_max_n[i])
      free[at(nf++)] = i;
  if (nf > 0) {
    half_.resize(at(nf) * at(nf));
    columns_.resize(6 * at(nf));
    for (int j = 0; j < nf; ++j) {
      for (int i = j; i < nf; ++i)
        half_[at(j) * at(nf) + at(i)] = problem.compliance_m_per_n(free[at(i)], free[at(j)]);
      for (int c = 0; c < 6; ++c)
        columns_[at(c) * at(nf) + at(j)] = problem.jacobian(free[at(j)], c);
    }
    if (blas::cholesky(nf, half_.data(), nf)) {
      blas::forward(nf, half_.data(), nf, columns_.data(), 6, nf);
      for (int i = 0; i < 6; ++i)
        for (int j = 0; j < 6; ++j)
          response.stiffness(i, j) += dot(&columns_[at(i) * at(nf)], &columns_[at(j) * at(nf)], nf);
    }
  }

  // Offsets that reproduce the solved state at ξ = 0: gap = S λ − q, w = w₀ − Ĵᵀ λ.
  const auto gap = solver.gap_m();
  for (int i = 0; i < mh; ++i) {
    double q = -gap[at(solver.bounded()[at(chosen_[at(i)])])];
    for (int j = 0; j < mh; ++j) q += problem.compliance_m_per_n(i, j) * problem.multiplier_n[j];
    problem.offset_m[i] = q;
    response.bilateral_wrench += problem.multiplier_n[i] * problem.jacobian.row(i).transpose();
  }

  // The paper's slide instead: P = I − s Sᵀ, not symmetric, kept for comparison.
  if (tool.needle() >= 0 && needles[at(tool.needle())].least_squares()) {
    const NeedleBody& needle = needles[at(tool.needle())];
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
