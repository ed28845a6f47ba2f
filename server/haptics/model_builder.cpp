// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/model_builder.hpp"

namespace sutured::haptics {
namespace {

static_assert(simulation::CondensedProblem::kRowsMax == suture::kModelRowsMax);
static_assert(simulation::ToolResponse::kOthersMax == suture::kModelOthersMax);

using simulation::CondensedProblem;
using simulation::Mat6;
using simulation::Vec6;

suture::Wrench wrench_of(const Vec6& w) { return {{w[0], w[1], w[2]}, {w[3], w[4], w[5]}}; }

void set_matrix(std::array<double, 36>& to, const Mat6& from) {
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) to[6 * i + j] = from(i, j);
}

suture::Pose pose_of(const simulation::ToolInput& input) {
  const auto& p = input.position_m;
  const auto& q = input.orientation;
  return {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
}

void set_others(suture::HapticModel& model, const simulation::ToolResponse& response) {
  model.other_count = response.other_count;
  for (int k = 0; k < response.other_count; ++k) {
    const simulation::ToolCoupling& from = response.others[k];
    suture::ModelCoupling& to = model.others[k];
    to.tool = from.tool;
    to.reference = pose_of(from.reference);
    set_matrix(to.stiffness, from.stiffness);
    for (int j = 0; j < 6; ++j) to.slide_gradient[j] = from.slide_gradient[j];
    for (int i = 0; i < model.rows; ++i)
      for (int j = 0; j < 6; ++j) to.jacobian[i][j] = from.jacobian(i, j);
  }
}

void set_rows(suture::HapticModel& model, const CondensedProblem& problem) {
  const int rows = static_cast<int>(problem.offset_m.size());
  model.rows = rows;
  model.frozen_rows = problem.frozen_rows;
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j <= i; ++j)
      model.compliance_m_per_n[suture::packed_index(i, j)] =
          0.5 * (problem.compliance_m_per_n(i, j) + problem.compliance_m_per_n(j, i));
    for (int k = 0; k < 6; ++k) model.jacobian[i][k] = problem.jacobian(i, k);
    model.offset_m[i] = problem.offset_m[i];
    model.multiplier_n[i] = problem.multiplier_n[i];
    model.multiplier_max_n[i] = problem.multiplier_max_n[i];
    model.bound_row[i] = problem.bound_row[i];
    model.bound_slope[i] = problem.bound_slope[i];
  }
}

}  // namespace

void fill_model(const simulation::ToolResponse& response, suture::HapticModel& model) {
  model.reference = pose_of(response.reference);
  model.touching = response.touching;
  model.holding = response.held.kind != simulation::HeldKind::kNothing;
  for (int i = 0; i < 6; ++i) {
    model.slide_twist[i] = response.slide_twist[i];
    model.slide_gradient[i] = response.slide_gradient[i];
  }
  model.slide_stiffness = response.slide_stiffness;
  model.slide_friction_n = response.slide_friction_n;
  model.slide_drag_n_s_per_m = response.slide_drag_n_s_per_m;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) model.arm_moment_nm[3 * i + j] = response.arm_moment(i, j);

  model.bilateral_wrench = wrench_of(response.bilateral_wrench);
  set_matrix(model.bilateral_stiffness, response.bilateral_stiffness);
  set_rows(model, response.condensed);
  set_others(model, response);
  suture::complete_model(model);
}

}  // namespace sutured::haptics
