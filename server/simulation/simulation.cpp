// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/simulation.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "constraints/complementarity.hpp"
#include "simulation/needle_body.hpp"
#include "simulation/response.hpp"
#include "simulation/tissue_state.hpp"
#include "simulation/tool_body.hpp"

namespace sutured::simulation {
namespace {

using Clock = std::chrono::steady_clock;

// A tool moves at most this far in a substep; a turn counts at this arm. The wall's local stiffness
// makes more than that overshoot the puncture force.
constexpr double kSubstepMotion_m = 0.25e-3;
constexpr double kSubstepArm_m = 0.01;
constexpr int kSubstepsMax = 64;
// At display rate a step is cut at least this often: sticking depends on the way.
constexpr double kSlowStep_s = 1.0 / 60.0;
constexpr int kSlowSubsteps = 3;
// Things are taken into the problem when the motion of two substeps could bring them together.
constexpr double kReach_m = 2.0 * kSubstepMotion_m;
constexpr int kRevisionsMax = 4;
constexpr int kIdleStepsMax = 512;
constexpr double kResidualMax = 1e-6;

std::int64_t since(Clock::time_point start) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now() - start).count();
}

}  // namespace

struct Simulation::State {
  explicit State(const scene::Scene& s) : scene(s), tissue(scene) {
    for (std::size_t i = 0; i < scene.needles.size(); ++i)
      needles.emplace_back(scene, static_cast<int>(i));
    for (std::size_t i = 0; i < scene.tools.size(); ++i)
      tools.emplace_back(scene, static_cast<int>(i));
    inputs.resize(tools.size());
    moving.resize(tools.size());
    responses.resize(tools.size());
    needle_states.resize(needles.size());
    thread_states.resize(scene.threads.size());
    mobilities.resize(needles.size());
    rows.reserve(512, 2048);
    events.reserve(64);
    pending_events.reserve(64);
    report_needles();
  }

  scene::Scene scene;
  TissueState tissue;
  std::vector<NeedleBody> needles;
  std::vector<ToolBody> tools;
  std::vector<ToolInput> inputs, moving;
  std::vector<ToolResponse> responses;
  std::vector<simulation::NeedleState> needle_states;
  std::vector<simulation::ThreadState> thread_states;
  std::vector<ContactPoint> contact_points;
  std::vector<Event> events, pending_events;
  StepReport report;
  double time_s = 0.0;
  // Time is counted in steps from the last change of their length, so that it gathers no rounding.
  double base_s = 0.0, period_s = 0.0;
  std::uint64_t steps_since_base = 0;
  bool settled = true;

  constraints::ConstraintRows rows;
  constraints::ComplementaritySolver solver;
  ResponseBuilder response_builder;
  std::vector<constraints::NeedleMobility> mobilities;
  std::vector<constraints::Bounds> bounds;
  std::vector<double> target, lambda;
  std::vector<constraints::RowState> states;

  /// Brings tissue, paths and grips up to the last solve.
  void settle(std::vector<Event>& out) {
    if (settled) return;
    const auto start = Clock::now();
    tissue.refresh();
    report.backward_ns += since(start);
    const auto tracking = Clock::now();
    for (NeedleBody& needle : needles) needle.track(tissue, time_s, out);
    for (ToolBody& tool : tools) tool.commit(tissue, needles, time_s, out);
    report.track_ns += since(tracking);
    settled = true;
  }

  void build_rows() {
    rows.clear();
    for (NeedleBody& needle : needles) needle.add_rows(tissue, rows);
    for (ToolBody& tool : tools) tool.add_rows(tissue, needles, kReach_m, rows);
  }

  void solve(bool warm) {
    const auto start = Clock::now();
    for (std::size_t i = 0; i < needles.size(); ++i) mobilities[i] = needles[i].mobility();
    const auto& w = tissue.compliance().assemble(rows, mobilities);
    report.assemble_ns += since(start);
    const auto solving = Clock::now();
    const auto m = static_cast<std::size_t>(rows.size());
    bounds.resize(m);
    target.resize(m);
    lambda.assign(m, 0.0);
    // Bounded rows are few and come and go; those that are closed already start as carrying.
    states.assign(m, constraints::RowState::kFree);
    for (std::size_t i = 0; i < m; ++i) {
      const constraints::Row& row = rows[static_cast<int>(i)];
      bounds[i] = row.bounds;
      double q = row.target_m;
      for (const auto& entry : rows.entries(row))
        q -= entry.coefficient.dot(tissue.free_position_m(entry.vertex));
      target[i] = q;
      if (!row.bounds.bilateral_unbounded() && !warm) states[i] = constraints::RowState::kLower;
    }
    solver.factor(w, bounds);
    last_solve = solver.solve(target, lambda, states);
    report.solve_ns += since(solving);
  }

  constraints::SolveReport last_solve;

  void substep(double dt_s, double end_s) {
    settle(events);
    tissue.compliance().evict(kIdleStepsMax);
    for (std::size_t i = 0; i < tools.size(); ++i)
      tools[i].move(moving[i], tissue, needles, time_s, events);
    for (std::size_t n = 0; n < needles.size(); ++n) {
      std::optional<scene::Pose> target_pose;
      int holder = -1;
      for (std::size_t t = 0; t < tools.size(); ++t)
        if (const auto wanted = tools[t].needle_target(static_cast<int>(n))) {
          if (!target_pose) target_pose = wanted;
          holder = static_cast<int>(t);
        }
      needles[n].set_holder(holder);
      needles[n].begin(tissue, dt_s, holder >= 0, target_pose);
      needles[n].find_tip_contact(tissue, kReach_m);
    }
    for (int revision = 0;; ++revision) {
      build_rows();
      solve(revision > 0);
      const bool may_revise = revision < kRevisionsMax;
      bool good = true;
      for (NeedleBody& needle : needles) good = needle.read(rows, lambda, may_revise) && good;
      for (ToolBody& tool : tools) good = tool.read(rows, lambda, may_revise) && good;
      if (good) break;
    }
    for (NeedleBody& needle : needles) needle.commit(rows, lambda, states);
    tissue.apply(rows, lambda);
    settled = false;
    time_s = end_s;
    report.complementarity_residual =
        std::max(report.complementarity_residual, last_solve.residual);
    if (!(last_solve.residual <= kResidualMax))  // NaN too
      events.push_back(
          {EventKind::kSolverResidual, time_s, scene.name, "", Vec3::Zero(), last_solve.residual});
  }

  [[nodiscard]] int substeps_for(std::span<const ToolInput> target_inputs, double dt_s) const {
    double motion = 0.0;
    for (std::size_t i = 0; i < tools.size(); ++i) {
      const ToolInput &from = inputs[i], &to = target_inputs[i];
      if (!from.present || !to.present) continue;
      motion = std::max({motion, (to.position_m - from.position_m).norm(),
                         kSubstepArm_m * from.orientation.angularDistance(to.orientation)});
    }
    const int least = dt_s > kSlowStep_s ? kSlowSubsteps : 1;
    return std::clamp(static_cast<int>(std::ceil(motion / kSubstepMotion_m)), least, kSubstepsMax);
  }

  void step(std::span<const ToolInput> target_inputs, double dt_s) {
    events.clear();
    std::swap(events, pending_events);
    const std::uint64_t number = report.step + 1;
    report = {};
    report.step = number;
    report.substeps = substeps_for(target_inputs, dt_s);
    for (NeedleBody& needle : needles) needle.clear_world_changed();
    for (ToolBody& tool : tools) tool.clear_world_changed();
    if (dt_s != period_s) {
      base_s = time_s;
      period_s = dt_s;
      steps_since_base = 0;
    }
    const double start_s = time_s;
    const double end_s = base_s + static_cast<double>(++steps_since_base) * dt_s;
    for (int k = 1; k <= report.substeps; ++k) {
      const double share = static_cast<double>(k) / report.substeps;
      for (std::size_t i = 0; i < tools.size(); ++i) {
        moving[i] = target_inputs[i];
        if (!inputs[i].present || !target_inputs[i].present) continue;
        moving[i].position_m =
            inputs[i].position_m + share * (target_inputs[i].position_m - inputs[i].position_m);
        moving[i].orientation = inputs[i].orientation.slerp(share, target_inputs[i].orientation);
        if (k < report.substeps) moving[i].jaw = inputs[i].jaw;
      }
      substep(dt_s / report.substeps, k == report.substeps ? end_s : start_s + share * dt_s);
    }
    std::copy(target_inputs.begin(), target_inputs.end(), inputs.begin());

    const auto start = Clock::now();
    bool changed = false;
    for (const NeedleBody& needle : needles) changed = changed || needle.world_changed();
    for (std::size_t i = 0; i < tools.size(); ++i) {
      response_builder.build(rows, solver, lambda, needles, tools[i], static_cast<int>(i),
                             responses[i]);
      responses[i].world_changed = responses[i].world_changed || changed;
      responses[i].held = tools[i].held(tissue);
      report.contacts += tools[i].contacts();
    }
    report.model_ns += since(start);
    report.time_s = time_s;
    report.rows = rows.size();
    report.active_unilateral_rows = last_solve.active_bounded_rows;
    report_needles();
  }

  void report_needles() {
    for (std::size_t n = 0; n < needles.size(); ++n) {
      simulation::NeedleState& out = needle_states[n];
      out.position_m = needles[n].pose().position_m;
      out.orientation = needles[n].pose().orientation;
      out.holder = needles[n].holder();
      out.active_cells = 0;
      for (const auto& cell : needles[n].path().cells())
        out.active_cells += cell.active_length_m > 0.0;
      out.embedded_length_m = needles[n].path().embedded_length_m();
      out.tip_force_n = needles[n].tip().rows > 0 ? needles[n].tip().axial_force_n : 0.0;
      out.tip_inside = needles[n].path().tip_inside();
      report.contacts += needles[n].tip().pressing;
    }
  }

  void reset() {
    for (NeedleBody& needle : needles) needle.reset();
    for (ToolBody& tool : tools) tool.reset();
    tissue.reset();
    settled = true;
    std::fill(inputs.begin(), inputs.end(), ToolInput());
    for (ToolResponse& response : responses) {
      response = {};
      response.world_changed = true;
    }
    events.clear();
    pending_events.clear();
    report = {};
    time_s = base_s = period_s = 0.0;
    steps_since_base = 0;
    rows.clear();
    report_needles();
  }
};

Simulation::Simulation(const scene::Scene& scene) : state_(std::make_unique<State>(scene)) {}
Simulation::~Simulation() = default;
Simulation::Simulation(Simulation&&) noexcept = default;
Simulation& Simulation::operator=(Simulation&&) noexcept = default;

void Simulation::step(std::span<const ToolInput> tools, double dt_s) { state_->step(tools, dt_s); }
void Simulation::update_displacements() { state_->settle(state_->pending_events); }
void Simulation::reset() { state_->reset(); }
double Simulation::time_s() const { return state_->time_s; }
std::span<const ToolResponse> Simulation::responses() const { return state_->responses; }
std::span<const NeedleState> Simulation::needles() const { return state_->needle_states; }
std::span<const ThreadState> Simulation::threads() const { return state_->thread_states; }
std::span<const ContactPoint> Simulation::contacts() const { return state_->contact_points; }
std::span<const Event> Simulation::events() const { return state_->events; }
const StepReport& Simulation::report() const { return state_->report; }
std::span<const Body> Simulation::bodies() const { return state_->tissue.bodies(); }
std::span<const geometry::Vec3> Simulation::positions_m() const {
  return state_->tissue.positions_m();
}
std::span<const geometry::Vec3> Simulation::rest_positions_m() const {
  return state_->tissue.model().vertices_m;
}
std::span<const geometry::Tet> Simulation::tets() const { return state_->tissue.model().tets; }
void Simulation::vertex_stress_pa(std::span<double> stress) const {
  state_->tissue.vertex_stress_pa(stress);
}

}  // namespace sutured::simulation
