// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/simulation.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "constraints/complementarity.hpp"
#include "constraints/held_rows.hpp"
#include "contact/tissue_contact.hpp"
#include "simulation/needle_body.hpp"
#include "simulation/response.hpp"
#include "simulation/thread_body.hpp"
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
// Surfaces that face each other at rest this near are a wound that will be closed: the compliance
// of their vertices is made at set-up, not in the step in which they meet.
constexpr double kPrepareDistance_m = 2e-3;
constexpr std::size_t kPreparedMax = 1536;
// Rows for which there is memory before the first step: two vessels that meet all around.
constexpr int kRowsReserved = 320;
// Holes that one needle goes through at a time: as many without allocating.
constexpr std::size_t kPuncturesReserved = 64;
constexpr int kRevisionsMax = 4;
constexpr int kIdleStepsMax = 512;
constexpr double kResidualMax = 1e-8;
// As far as a surgeon's file may go: what is squared or multiplied stays far from overflow.
constexpr double kFarthest_m = 1e6;

std::int64_t since(Clock::time_point start) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now() - start).count();
}

/// Sorts vertices along the longest side of their box.
void sort_along_longest_side(std::vector<std::int32_t>& vertices, std::span<const Vec3> x_m) {
  const auto at = [&](std::int32_t v) -> const Vec3& { return x_m[static_cast<std::size_t>(v)]; };
  Eigen::AlignedBox3d box;
  for (const std::int32_t v : vertices) box.extend(at(v));
  Eigen::Index axis = 0;
  if (!vertices.empty()) box.sizes().maxCoeff(&axis);
  std::sort(vertices.begin(), vertices.end(), [&](std::int32_t a, std::int32_t b) {
    return std::pair(at(a)[axis], a) < std::pair(at(b)[axis], b);
  });
}

}  // namespace

bool may_follow(const ToolInput& tool) noexcept {
  return (tool.position_m.array().abs() <= kFarthest_m).all() &&
         tool.orientation.coeffs().allFinite() && std::isfinite(tool.jaw);
}

struct Simulation::State {
  explicit State(const scene::Scene& s) : scene(s), tissue(scene) {
    for (std::size_t i = 0; i < scene.needles.size(); ++i)
      needles.emplace_back(scene, static_cast<int>(i));
    for (std::size_t i = 0; i < scene.tools.size(); ++i)
      tools.emplace_back(scene, static_cast<int>(i));
    threads.reserve(scene.threads.size());
    for (std::size_t i = 0; i < scene.threads.size(); ++i)
      threads.emplace_back(scene, static_cast<int>(i), tissue, needles);
    if (scene.contact.enabled) {
      std::vector<int> tissue_of;
      std::vector<double> modulus;
      for (std::size_t t = 0; t < tissue.surface().triangles.size(); ++t) {
        tissue_of.push_back(tissue.tissue_of_triangle(static_cast<std::int32_t>(t)));
        modulus.push_back(tissue.young_modulus_pa(tissue.surface().tet[t]));
      }
      contact.emplace(tissue.surface(), tissue.model().vertices_m, std::move(tissue_of),
                      std::move(modulus));
    }
    prepare_compliance();
    tissue.compliance().reserve(kRowsReserved);
    solver.reserve(kRowsReserved);
    inputs.resize(tools.size());
    moving.resize(tools.size());
    responses.resize(tools.size());
    needle_states.resize(needles.size());
    for (simulation::NeedleState& needle : needle_states)
      needle.punctures.reserve(kPuncturesReserved);
    thread_states.resize(scene.threads.size());
    mobilities.resize(needles.size());
    for (constraints::ConstraintRows* each : {&rows, &rows_before})
      each->reserve(kRowsReserved, 8 * kRowsReserved);
    events.reserve(64);
    pending_events.reserve(64);
    clear_world_changed();
    report_needles();
    report_threads();
  }

  scene::Scene scene;
  TissueState tissue;
  std::vector<NeedleBody> needles;
  std::vector<ToolBody> tools;
  std::vector<ThreadBody> threads;
  std::optional<contact::TissueContact> contact;
  std::vector<ToolInput> inputs, moving;
  std::vector<ToolResponse> responses;
  std::vector<simulation::NeedleState> needle_states;
  std::vector<simulation::ThreadState> thread_states;
  std::vector<ContactPoint> contact_points;
  std::vector<std::pair<int, int>> touching, touching_now;  ///< tissues in contact, sorted
  std::vector<Event> events, pending_events;
  StepReport report;
  double time_s = 0.0;
  // Time is counted in steps from the last change of their length, so that it gathers no rounding.
  double base_s = 0.0, period_s = 0.0;
  std::uint64_t steps_since_base = 0;
  bool settled = true;
  int inverted_told = 0;

  constraints::ConstraintRows rows, rows_before;
  constraints::ComplementaritySolver solver;
  ResponseBuilder response_builder;
  std::vector<constraints::NeedleMobility> mobilities;
  std::vector<constraints::Bounds> bounds;
  std::vector<double> target, lambda;
  std::vector<constraints::RowState> states;
  std::vector<std::pair<std::uint64_t, constraints::RowState>> warm;  ///< by key

  /// Makes the compliance of what will surely be asked for: wounds, and threads in place.
  void prepare_compliance() {
    if (!contact) return;
    std::vector<std::int32_t> vertices =
        contact->facing_vertices(tissue.positions_m(), *tissue.view().tree, kPrepareDistance_m);
    vertices.resize(std::min(vertices.size(), kPreparedMax));
    // Along the longest side of their box: what meets then has numbers close together, and its rows
    // of W are short.
    sort_along_longest_side(vertices, tissue.positions_m());
    rows.clear();
    for (ThreadBody& thread : threads) thread.add_rows(needles, tools, rows);
    for (int i = 0; i < rows.size(); ++i)
      for (const auto& entry : rows.entries(rows[i]))
        if (std::find(vertices.begin(), vertices.end(), entry.vertex) == vertices.end())
          vertices.push_back(entry.vertex);
    rows.clear();
    tissue.compliance().prepare(vertices);
  }

  /// Brings tissue, paths and grips up to the last solve.
  void settle(std::vector<Event>& out) {
    if (settled) return;
    const auto start = Clock::now();
    tissue.refresh();
    report.backward_ns += since(start);
    const auto tracking = Clock::now();
    for (NeedleBody& needle : needles) needle.track(tissue, time_s, out);
    for (ToolBody& tool : tools) tool.commit(tissue, needles, time_s, out);
    for (ThreadBody& thread : threads) thread.update(tissue, needles, tools, time_s, out);
    report.track_ns += since(tracking);
    settled = true;
  }

  /// Counts the tets that are inside out, and tells when there are more than before.
  void look_for_inverted(std::vector<Event>& out) {
    const int count = tissue.inverted_tets();
    report.inverted_tets = std::max(report.inverted_tets, count);
    if (count > inverted_told) {
      const std::int32_t tet = tissue.first_inverted_tet();
      Vec3 centre = Vec3::Zero();
      for (const std::int32_t v : tissue.model().tets[static_cast<std::size_t>(tet)])
        centre += 0.25 * tissue.positions_m()[static_cast<std::size_t>(v)];
      const auto& body = tissue.bodies()[static_cast<std::size_t>(tissue.tissue_of_tet(tet))];
      out.push_back(
          {EventKind::kInverted, time_s, body.name, "", centre, static_cast<double>(count)});
    }
    inverted_told = count;
  }

  /// Returns whether the rows have the coefficients of those before.
  bool build_rows() {
    std::swap(rows, rows_before);
    rows.clear();
    for (NeedleBody& needle : needles) needle.add_rows(tissue, rows);
    for (ToolBody& tool : tools) tool.add_rows(tissue, needles, kReach_m, rows);
    for (ThreadBody& thread : threads) thread.add_rows(needles, tools, rows);
    if (contact) contact->add_rows(rows);
    return constraints::hold_coefficients(rows, rows_before, tissue.positions_m());
  }

  /// Named rows start as they ended the last solve, all others without force.
  [[nodiscard]] constraints::RowState warm_state(std::uint64_t key) const {
    if (key == 0) return constraints::RowState::kLower;
    const auto found = std::lower_bound(warm.begin(), warm.end(), key,
                                        [](const auto& a, std::uint64_t k) { return a.first < k; });
    return found != warm.end() && found->first == key ? found->second
                                                      : constraints::RowState::kLower;
  }
  void remember_states() {
    warm.clear();
    for (int i = 0; i < rows.size(); ++i)
      if (rows[i].key != 0 && states[static_cast<std::size_t>(i)] != constraints::RowState::kLower)
        warm.emplace_back(rows[i].key, states[static_cast<std::size_t>(i)]);
    std::sort(warm.begin(), warm.end());
  }

  void solve(bool held) {
    const auto start = Clock::now();
    for (std::size_t i = 0; i < needles.size(); ++i) mobilities[i] = needles[i].mobility();
    const auto& w = tissue.compliance().assemble(rows, mobilities, held);
    report.assemble_ns += since(start);
    const auto solving = Clock::now();
    const auto m = static_cast<std::size_t>(rows.size());
    bounds.resize(m);
    target.resize(m);
    lambda.assign(m, 0.0);
    states.assign(m, constraints::RowState::kFree);
    for (std::size_t i = 0; i < m; ++i) {
      const constraints::Row& row = rows[static_cast<int>(i)];
      bounds[i] = row.bounds;
      double q = row.target_m;
      for (const auto& entry : rows.entries(row))
        q -= entry.coefficient.dot(tissue.free_position_m(entry.vertex));
      target[i] = q;
      if (row.bounds.bilateral_unbounded()) continue;
      states[i] = warm_state(row.key);
    }
    solver.factor(w, bounds, tissue.compliance().kept());
    last_solve = solver.solve(target, lambda, states);
    // No force is better than one that is no number; it is told as any residual is.
    if (!std::isfinite(last_solve.residual)) {
      std::fill(lambda.begin(), lambda.end(), 0.0);
      std::fill(states.begin(), states.end(), constraints::RowState::kLower);
    }
    remember_states();
    report.solve_ns += since(solving);
  }

  constraints::SolveReport last_solve;

  void substep(double dt_s, double end_s) {
    settle(events);
    look_for_inverted(events);
    tissue.compliance().evict(kIdleStepsMax);
    for (std::size_t i = 0; i < tools.size(); ++i)
      tools[i].move(moving[i], tissue, needles, threads, time_s, events);
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
      needles[n].find_contact(tissue, kReach_m);
    }
    for (ThreadBody& thread : threads) thread.follow(tissue, needles, tools, end_s);
    if (contact) {
      const auto start = Clock::now();
      contact->update(tissue.positions_m(), *tissue.view().tree);
      report.contact_ns += since(start);
    }
    for (int revision = 0;; ++revision) {
      solve(build_rows());
      const bool may_revise = revision < kRevisionsMax;
      bool good = true;
      for (NeedleBody& needle : needles) good = needle.read(rows, lambda, may_revise) && good;
      for (ToolBody& tool : tools) good = tool.read(rows, lambda, may_revise) && good;
      if (good) break;
    }
    for (NeedleBody& needle : needles) needle.commit(rows, lambda, states);
    for (ThreadBody& thread : threads)
      thread.commit(rows, lambda, solver.gap_m(), states, end_s, events);
    if (contact) contact->read(lambda);
    tissue.apply(rows, lambda);
    settled = false;
    time_s = end_s;
    report.complementarity_residual =
        std::max(report.complementarity_residual, last_solve.residual);
    if (last_solve.residual > kResidualMax)
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
    for (const ThreadBody& thread : threads)
      motion = std::max(motion, thread.programmed_motion_m(time_s, time_s + dt_s));
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
    for (const ThreadBody& thread : threads) changed = changed || thread.world_changed();
    response_builder.build(rows, solver, lambda, needles, tools, responses);
    for (std::size_t i = 0; i < tools.size(); ++i) {
      responses[i].world_changed = responses[i].world_changed || changed;
      responses[i].held = tools[i].held(tissue);
      report.contacts += tools[i].contacts();
    }
    clear_world_changed();
    report.model_ns += since(start);
    report.time_s = time_s;
    report.rows = rows.size();
    report.active_unilateral_rows = last_solve.active_bounded_rows;
    report_needles();
    report_threads();
    report_contacts();
    tell_contacts();
  }

  /// Call when the responses have told of it: what `settle` finds after that is for the next step.
  void clear_world_changed() {
    for (NeedleBody& needle : needles) needle.clear_world_changed();
    for (ToolBody& tool : tools) tool.clear_world_changed();
    for (ThreadBody& thread : threads) thread.clear_world_changed();
  }

  void constraint_forces_n(std::vector<double>& force_n) const {
    force_n.assign(3 * tissue.positions_m().size(), 0.0);
    for (int i = 0; i < rows.size(); ++i)
      for (const auto& entry : rows.entries(rows[i]))
        for (std::size_t axis = 0; axis < 3; ++axis)
          force_n[3 * static_cast<std::size_t>(entry.vertex) + axis] +=
              lambda[static_cast<std::size_t>(i)] *
              entry.coefficient[static_cast<Eigen::Index>(axis)];
  }

  [[nodiscard]] double row_energy_j() const {
    double sum = 0.0;
    for (int i = 0; i < rows.size(); ++i) {
      const double l = lambda[static_cast<std::size_t>(i)];
      sum += 0.5 * rows[i].compliance_m_per_n * l * l;
    }
    return sum;
  }

  void report_contacts() {
    contact_points.clear();
    for (std::size_t n = 0; n < needles.size(); ++n)
      for (const ShaftContact::Touch& touch : needles[n].shaft().touches()) {
        if (touch.force_n <= 0.0) continue;
        ContactPoint point;
        point.position_m = needle::position(tissue.view(), touch.at);
        point.normal = touch.normal;
        point.force_n = touch.force_n;
        point.gap_m = touch.gap_m;
        point.tissue = tissue.tissue_of_triangle(touch.at.triangle);
        point.needle = static_cast<int>(n);
        contact_points.push_back(point);
      }
    report.contacts += static_cast<int>(contact_points.size());
    report.contact_pairs = static_cast<int>(contact_points.size());
    if (!contact) return;
    const std::size_t needle_points = contact_points.size();
    const auto x = tissue.positions_m();
    for (const contact::Pair& pair : contact->pairs()) {
      if (pair.force_n <= 0.0) continue;
      ContactPoint point;
      // Half way between the two sides; the normal leaves the side that is named first.
      const bool edges = pair.kind == contact::PairKind::kEdgeEdge;
      for (std::size_t i = 0; i < 4; ++i)
        point.position_m += 0.5 * std::abs(pair.proximity.coefficient[i]) *
                            x[static_cast<std::size_t>(pair.vertices[i])];
      point.normal = pair.proximity.normal;
      point.force_n = pair.force_n;
      point.gap_m = pair.proximity.gap_m;
      point.tissue = contact->tissue_of(pair, !edges);
      point.other_tissue = contact->tissue_of(pair, edges);
      contact_points.push_back(point);
    }
    report.contacts += static_cast<int>(contact_points.size() - needle_points);
    report.contact_pairs += static_cast<int>(contact->pairs().size());
  }

  /// Tells when two tissues (or a tissue and itself) first touch, and when they part.
  void tell_contacts() {
    touching_now.clear();
    for (const ContactPoint& point : contact_points)
      if (point.needle < 0)
        touching_now.emplace_back(std::min(point.tissue, point.other_tissue),
                                  std::max(point.tissue, point.other_tissue));
    std::sort(touching_now.begin(), touching_now.end());
    touching_now.erase(std::unique(touching_now.begin(), touching_now.end()), touching_now.end());
    const auto tell = [&](EventKind kind, const auto& those, const auto& others) {
      for (const auto& pair : those) {
        if (std::binary_search(others.begin(), others.end(), pair)) continue;
        Event event{kind,
                    time_s,
                    scene.tissues[static_cast<std::size_t>(pair.first)].name,
                    scene.tissues[static_cast<std::size_t>(pair.second)].name,
                    Vec3::Zero(),
                    0.0};
        for (const ContactPoint& point : contact_points)
          if (point.needle < 0 && std::min(point.tissue, point.other_tissue) == pair.first &&
              std::max(point.tissue, point.other_tissue) == pair.second) {
            if (event.force_n == 0.0) event.position_m = point.position_m;
            event.force_n += point.force_n;
          }
        events.push_back(event);
      }
    };
    tell(EventKind::kContact, touching_now, touching);
    tell(EventKind::kContactLost, touching, touching_now);
    touching.swap(touching_now);
  }

  void report_threads() {
    for (std::size_t t = 0; t < threads.size(); ++t) threads[t].report(tissue, thread_states[t]);
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
    report_punctures();
  }

  /// Call where paths or tissue have changed since the needles were reported, too.
  void report_punctures() {
    for (std::size_t n = 0; n < needles.size(); ++n)
      needles[n].report_punctures(tissue, needle_states[n].punctures);
  }

  void serialize(Archive& archive) {
    // Given by the scene: scene_in. Of one step: moving, touching_now, rows_before, solver,
    // response_builder, mobilities, bounds, target, states, last_solve.
    auto& [scene_in, tissue_, needles_, tools_, threads_, contact_, inputs_, moving_, responses_,
           needle_states_, thread_states_, contact_points_, touching_, touching_now_, events_,
           pending_events_, report_, time, base, period, steps, settled_, inverted_told_, rows_,
           rows_before_, solver_, response_builder_, mobilities_, bounds_, target_, lambda_,
           states_, warm_, last_solve_] = *this;
    archive(tissue_);
    archive.fixed(needles_);
    archive.fixed(tools_);
    archive.fixed(threads_);
    if (contact_) archive(*contact_);
    archive.fixed(inputs_);
    archive.fixed(responses_);
    archive.fixed(needle_states_);
    archive.fixed(thread_states_);
    StepReport untimed = report_;
    untimed.track_ns = untimed.contact_ns = untimed.assemble_ns = untimed.solve_ns =
        untimed.backward_ns = untimed.model_ns = 0;
    archive(contact_points_, touching_, events_, pending_events_, untimed, time, base, period,
            steps, settled_, inverted_told_, rows_, lambda_, warm_);
    if (!archive.reads()) return;
    report_ = untimed;
    report_punctures();
  }

  void reset() {
    for (NeedleBody& needle : needles) needle.reset();
    for (ToolBody& tool : tools) tool.reset();
    tissue.reset();
    for (ThreadBody& thread : threads) thread.reset(tissue, needles);
    if (contact) contact->reset();
    contact_points.clear();
    touching.clear();
    settled = true;
    inverted_told = 0;
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
    warm.clear();
    clear_world_changed();
    report_needles();
    report_threads();
  }
};

void NeedleState::serialize(Archive& archive) {
  auto& [position, turn, tool, cells, embedded, tip_force, inside, shown] = *this;
  archive(position, turn, tool, cells, embedded, tip_force, inside);
}

Simulation::Simulation(const scene::Scene& scene) : state_(std::make_unique<State>(scene)) {}
Simulation::~Simulation() = default;
Simulation::Simulation(Simulation&&) noexcept = default;
Simulation& Simulation::operator=(Simulation&&) noexcept = default;

void Simulation::step(std::span<const ToolInput> tools, double dt_s) {
  if (!std::all_of(tools.begin(), tools.end(),
                   [](const ToolInput& tool) { return !tool.present || may_follow(tool); }))
    throw std::invalid_argument("a tool's place is not finite, or beyond 1000 km");
  state_->step(tools, dt_s);
}
void Simulation::update_displacements() {
  state_->settle(state_->pending_events);
  state_->report_punctures();  // they are shown on the tissue as it is now
  state_->look_for_inverted(state_->pending_events);
}
void Simulation::reset() { state_->reset(); }
void Simulation::serialize(Archive& archive) {
  try {
    state_->serialize(archive);
  } catch (...) {
    if (archive.reads()) state_->reset();
    throw;
  }
}
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
void Simulation::compute_stress(StressField& field) const { state_->tissue.compute_stress(field); }
void Simulation::constraint_forces_n(std::vector<double>& force_n) const {
  state_->constraint_forces_n(force_n);
}
double Simulation::row_energy_j() const { return state_->row_energy_j(); }

}  // namespace sutured::simulation
