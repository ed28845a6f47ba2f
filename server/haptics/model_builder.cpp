// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/model_builder.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <numeric>
#include <vector>

namespace sutured::haptics {
namespace {

using simulation::CondensedProblem;
using simulation::Mat6;
using simulation::Vec6;

constexpr double kOnBound_n = 1e-10;

suture::Wrench wrench_of(const Vec6& w) { return {{w[0], w[1], w[2]}, {w[3], w[4], w[5]}}; }

void set_matrix(std::array<double, 36>& to, const Mat6& from) {
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) to[6 * i + j] = from(i, j);
}

void set_rows(suture::HapticModel& model, const CondensedProblem& problem) {
  const int rows = static_cast<int>(problem.offset_m.size());
  model.rows = rows;
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j <= i; ++j)
      model.compliance_m_per_n[suture::packed_index(i, j)] =
          0.5 * (problem.compliance_m_per_n(i, j) + problem.compliance_m_per_n(j, i));
    for (int k = 0; k < 6; ++k) model.jacobian[i][k] = problem.jacobian(i, k);
    model.offset_m[i] = problem.offset_m[i];
    model.multiplier_n[i] = problem.multiplier_n[i];
    model.multiplier_max_n[i] = problem.multiplier_max_n[i];
  }
}

struct Reduced {
  CondensedProblem problem;
  Vec6 wrench;
  Mat6 stiffness;
};

Reduced freeze_farthest(const simulation::ToolResponse& response) {
  const CondensedProblem& all = response.condensed;
  const int rows = static_cast<int>(all.offset_m.size());
  const Eigen::VectorXd gap = all.compliance_m_per_n * all.multiplier_n - all.offset_m;
  std::vector<double> slack_m(rows);
  std::vector<int> order(rows);
  std::iota(order.begin(), order.end(), 0);
  for (int i = 0; i < rows; ++i) {
    const double lambda = all.multiplier_n[i], room = all.multiplier_max_n[i] - lambda;
    slack_m[i] = lambda <= kOnBound_n || room <= kOnBound_n
                     ? std::abs(gap[i])
                     : std::min(lambda, room) * all.compliance_m_per_n(i, i);
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return slack_m[a] < slack_m[b]; });
  std::vector<int> kept(order.begin(), order.begin() + suture::kModelRowsMax), free, upper;
  std::sort(kept.begin(), kept.end());
  for (int a = suture::kModelRowsMax; a < rows; ++a) {
    const int i = order[a];
    if (all.multiplier_n[i] <= kOnBound_n) continue;
    (all.multiplier_max_n[i] - all.multiplier_n[i] <= kOnBound_n ? upper : free).push_back(i);
  }

  Eigen::VectorXd offset = all.offset_m;
  Vec6 wrench = response.bilateral_wrench;
  for (const int i : upper) {
    offset -= all.compliance_m_per_n.col(i) * all.multiplier_max_n[i];
    wrench -= all.jacobian.row(i).transpose() * all.multiplier_max_n[i];
  }
  Reduced result{{all.compliance_m_per_n(kept, kept), all.jacobian(kept, Eigen::all), offset(kept),
                  all.multiplier_n(kept), all.multiplier_max_n(kept)},
                 wrench,
                 response.bilateral_stiffness};
  if (free.empty()) return result;
  const Eigen::LLT<Eigen::MatrixXd> s_ff(all.compliance_m_per_n(free, free));
  const Eigen::MatrixXd j_f = all.jacobian(free, Eigen::all);
  const Eigen::MatrixXd s_kf = all.compliance_m_per_n(kept, free);
  const Eigen::VectorXd q = s_ff.solve(offset(free));
  const Eigen::MatrixXd j = s_ff.solve(j_f);
  result.problem.compliance_m_per_n -= s_kf * s_ff.solve(s_kf.transpose());
  result.problem.jacobian -= s_kf * j;
  result.problem.offset_m -= s_kf * q;
  result.wrench -= j_f.transpose() * q;
  result.stiffness += j_f.transpose() * j;
  return result;
}

}  // namespace

void fill_model(const simulation::ToolResponse& response, suture::HapticModel& model) {
  const auto& p = response.reference.position_m;
  const auto& q = response.reference.orientation;
  model.reference = {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
  model.touching = response.touching;
  model.world_changed = response.world_changed;
  for (int i = 0; i < 6; ++i) {
    model.slide_twist[i] = response.slide_twist[i];
    model.slide_gradient[i] = response.slide_gradient[i];
  }
  model.slide_stiffness = response.slide_stiffness;
  model.slide_friction_n = response.slide_friction_n;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) model.arm_moment_nm[3 * i + j] = response.arm_moment(i, j);

  const auto rows = response.condensed.offset_m.size();
  if (rows <= suture::kModelRowsMax) {
    model.frozen_rows = 0;
    model.bilateral_wrench = wrench_of(response.bilateral_wrench);
    set_matrix(model.bilateral_stiffness, response.bilateral_stiffness);
    set_rows(model, response.condensed);
  } else {
    const Reduced reduced = freeze_farthest(response);
    model.frozen_rows = static_cast<std::int32_t>(rows) - suture::kModelRowsMax;
    model.bilateral_wrench = wrench_of(reduced.wrench);
    set_matrix(model.bilateral_stiffness, reduced.stiffness);
    set_rows(model, reduced.problem);
  }
  suture::complete_model(model);
}

}  // namespace sutured::haptics
