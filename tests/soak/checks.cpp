// SPDX-License-Identifier: GPL-3.0-or-later
#include "soak/checks.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdarg>
#include <cstdio>

namespace sutured::soak {
namespace {

using geometry::Vec3;
using simulation::Event;
using simulation::EventKind;
using simulation::Simulation;
using simulation::ThreadState;
using simulation::ToolResponse;

// A bound of a multiplier is kept to the last bits; a force adds three of them.
constexpr double kRounding = 1e-9;
// Far beyond anything that bounded forces and hands do in these scenes.
constexpr double kFarAway_m = 10.0;

[[gnu::format(printf, 1, 2)]] std::string text(const char* format, ...) {
  char buffer[256];
  va_list arguments;
  va_start(arguments, format);
  std::vsnprintf(buffer, sizeof buffer, format, arguments);
  va_end(arguments);
  return buffer;
}

std::optional<std::string> fault_of_response(const scene::Tool& tool, const ToolResponse& r) {
  const auto& c = r.condensed;
  if (!r.wrench.allFinite() || !r.stiffness.allFinite() || !r.bilateral_wrench.allFinite() ||
      !r.bilateral_stiffness.allFinite() || !r.slide_twist.allFinite() ||
      !r.slide_gradient.allFinite() || !r.arm_moment.allFinite() ||
      !std::isfinite(r.slide_friction_n) || !std::isfinite(r.slide_drag_n_s_per_m) ||
      !std::isfinite(r.slide_stiffness) || !c.compliance_m_per_n.allFinite() ||
      !c.jacobian.allFinite() || !c.offset_m.allFinite() || !c.multiplier_n.allFinite())
    return "the response of " + tool.name + " is not finite";
  for (Eigen::Index i = 0; i < c.multiplier_n.size(); ++i)
    if (!(c.multiplier_n[i] >= 0.0) ||
        !(c.multiplier_n[i] <= c.multiplier_max_n[i] * (1.0 + kRounding)))
      return text("a multiplier of %s is %g N, of %g at most", tool.name.c_str(), c.multiplier_n[i],
                  c.multiplier_max_n[i]);
  if (!r.touching && !r.wrench.isZero(0.0)) return tool.name + " touches nothing and feels a force";
  const double force = r.wrench.head<3>().norm();
  if (tool.kind == scene::ToolKind::kDriver && force > tool.grip_force_max_n * (1.0 + kRounding))
    return text("%s holds by %.6g N, of %.6g at most", tool.name.c_str(), force,
                tool.grip_force_max_n);
  return std::nullopt;
}

std::optional<std::string> fault_of_thread(const scene::Thread& description, const ThreadState& t) {
  const char* const name = description.name.c_str();
  if (!std::isfinite(t.length_m) || !std::isfinite(t.slack_m) || !std::isfinite(t.overlength_m) ||
      t.slack_m < 0.0 || t.overlength_m < 0.0)
    return text("thread %s: length %g, slack %g, overlength %g m", name, t.length_m, t.slack_m,
                t.overlength_m);
  if (!(t.tension_n >= 0.0 && t.tension_n <= description.tension_max_n * (1.0 + kRounding)))
    return text("thread %s: tension %g N, of %g at most", name, t.tension_n,
                description.tension_max_n);
  if (t.taut != (t.tension_n > 0.0))
    return text("thread %s: taut %d at %g N", name, t.taut, t.tension_n);
  if (t.course_m.size() != t.arc_length_m.size() ||
      (!t.course_m.empty() && t.segment_tension_n.size() + 1 != t.course_m.size()))
    return text("thread %s: %zu points, %zu places, %zu tensions", name, t.course_m.size(),
                t.arc_length_m.size(), t.segment_tension_n.size());
  for (const Vec3& x : t.course_m)
    if (!(x.norm() < kFarAway_m)) return text("thread %s: its course is not finite", name);
  for (std::size_t i = 0; i < t.arc_length_m.size(); ++i) {
    const double before = i > 0 ? t.arc_length_m[i - 1] : 0.0;
    if (!(t.arc_length_m[i] >= before - 1e-9))
      return text("thread %s: point %zu of its course lies at %g m, after %g", name, i,
                  t.arc_length_m[i], before);
  }
  double largest = 0.0;
  for (const double n : t.segment_tension_n) {
    if (!(n >= 0.0)) return text("thread %s: a piece carries %g N", name, n);
    largest = std::max(largest, n);
  }
  if (largest > t.tension_n)
    return text("thread %s: a piece carries %g N, the thread %g", name, largest, t.tension_n);
  if (t.punctures.size() > 1)
    for (std::size_t i = 1; i < t.punctures.size(); ++i)
      if (!(t.punctures[i].arc_length_m >= t.punctures[i - 1].arc_length_m - 1e-9))
        return text("thread %s: puncture %zu lies at %g m, after %g", name, i,
                    t.punctures[i].arc_length_m, t.punctures[i - 1].arc_length_m);
  return std::nullopt;
}

class Hasher {
 public:
  explicit Hasher(std::uint64_t hash) : hash_(hash) {}
  void add(std::uint64_t word) {
    hash_ = (hash_ ^ word) * 0x100000001B3ULL;
    hash_ ^= hash_ >> 32;
  }
  void add(double value) { add(std::bit_cast<std::uint64_t>(value)); }
  void add(int value) { add(static_cast<std::uint64_t>(static_cast<std::int64_t>(value))); }
  void add(bool value) { add(static_cast<std::uint64_t>(value)); }
  template <class Derived>
  void add(const Eigen::MatrixBase<Derived>& matrix) {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j)
      for (Eigen::Index i = 0; i < matrix.rows(); ++i) add(matrix(i, j));
  }
  void add(const std::string& value) {
    for (const char c : value) add(static_cast<int>(c));
  }
  [[nodiscard]] std::uint64_t hash() const { return hash_; }

 private:
  std::uint64_t hash_;
};

void add_bodies(Hasher& h, const Simulation& sim) {
  for (const auto& needle : sim.needles()) {
    h.add(needle.position_m);
    h.add(needle.orientation.coeffs());
    h.add(needle.holder);
    h.add(needle.active_cells);
    h.add(needle.embedded_length_m);
    h.add(needle.tip_force_n);
    h.add(needle.tip_inside);
  }
  for (const ThreadState& t : sim.threads()) {
    h.add(t.tension_n);
    h.add(t.slack_m);
    h.add(t.overlength_m);
    for (const Vec3& x : t.course_m) h.add(x);
    for (const double s : t.arc_length_m) h.add(s);
    for (const auto& puncture : t.punctures) h.add(puncture.position_m);
  }
}

}  // namespace

int count_inverted(const Simulation& sim) {
  int count = 0;
  const auto x = sim.positions_m();
  for (const geometry::Tet& tet : sim.tets()) {
    const auto p = [&](std::size_t i) -> const Vec3& {
      return x[static_cast<std::size_t>(tet[i])];
    };
    Eigen::Matrix3d edges;
    edges << p(1) - p(0), p(2) - p(0), p(3) - p(0);
    count += !(edges.determinant() > 0.0);
  }
  return count;
}

std::optional<std::string> fault_of(const scene::Scene& scene, const Simulation& sim,
                                    bool displaced) {
  for (std::size_t i = 0; i < scene.tools.size(); ++i)
    if (auto fault = fault_of_response(scene.tools[i], sim.responses()[i])) return fault;
  for (std::size_t i = 0; i < scene.threads.size(); ++i)
    if (auto fault = fault_of_thread(scene.threads[i], sim.threads()[i])) return fault;
  for (const auto& needle : sim.needles()) {
    if (!(needle.position_m.norm() < kFarAway_m) || !std::isfinite(needle.tip_force_n) ||
        !(needle.embedded_length_m >= 0.0))
      return "the needle is nowhere";
    if (!(std::abs(needle.orientation.norm() - 1.0) < 1e-9))
      return text("the needle's quaternion has length %.12g", needle.orientation.norm());
  }
  for (const auto& contact : sim.contacts())
    if (!contact.position_m.allFinite() || !(contact.force_n > 0.0) ||
        !std::isfinite(contact.force_n) || !std::isfinite(contact.gap_m) ||
        !(std::abs(contact.normal.norm() - 1.0) < 1e-9))
      return text("a contact of %g N at a gap of %g m", contact.force_n, contact.gap_m);
  for (const Event& event : sim.events())
    if (!event.position_m.allFinite() || !std::isfinite(event.time_s) || event.time_s < 0.0 ||
        event.time_s > sim.time_s() ||
        (!std::isfinite(event.force_n) && event.kind != EventKind::kSolverResidual))
      return text("event %d at %g s, force %g N", static_cast<int>(event.kind), event.time_s,
                  event.force_n);
  const double residual = sim.report().complementarity_residual;
  const bool told = std::any_of(sim.events().begin(), sim.events().end(), [](const Event& e) {
    return e.kind == EventKind::kSolverResidual;
  });
  if (!(residual <= kSilentResidualMax) && !told)
    return text("a residual of %g that no event speaks of", residual);
  if (!displaced) return std::nullopt;
  for (const Vec3& x : sim.positions_m())
    if (!(x.norm() < kFarAway_m)) return "a vertex is nowhere";
  const int inverted = count_inverted(sim);
  if (inverted > sim.report().inverted_tets)
    return text("%d tets are inside out, %d were reported", inverted, sim.report().inverted_tets);
  return std::nullopt;
}

std::uint64_t hash_of(const Simulation& sim, std::uint64_t hash) {
  Hasher h(hash);
  for (const ToolResponse& r : sim.responses()) {
    h.add(r.wrench);
    h.add(r.stiffness);
    h.add(r.bilateral_wrench);
    h.add(r.bilateral_stiffness);
    h.add(r.condensed.compliance_m_per_n);
    h.add(r.condensed.jacobian);
    h.add(r.condensed.offset_m);
    h.add(r.condensed.multiplier_n);
    h.add(r.condensed.multiplier_max_n);
    h.add(r.condensed.bound_slope);
    h.add(r.slide_twist);
    h.add(r.slide_friction_n);
    h.add(r.slide_drag_n_s_per_m);
    h.add(r.slide_gradient);
    h.add(r.slide_stiffness);
    h.add(r.arm_moment);
    h.add(r.touching);
    h.add(r.world_changed);
  }
  add_bodies(h, sim);
  for (const auto& contact : sim.contacts()) {
    h.add(contact.normal);
    h.add(contact.force_n);
    h.add(contact.gap_m);
  }
  for (const Event& event : sim.events()) {
    h.add(static_cast<int>(event.kind));
    h.add(event.time_s);
    h.add(event.subject);
    h.add(event.object);
    h.add(event.position_m);
    h.add(event.force_n);
  }
  const auto& report = sim.report();
  h.add(report.substeps);
  h.add(report.rows);
  h.add(report.active_unilateral_rows);
  h.add(report.contacts);
  h.add(report.complementarity_residual);
  return h.hash();
}

std::uint64_t hash_of_places(const Simulation& sim) {
  Hasher h(0);
  for (const Vec3& x : sim.positions_m()) h.add(x);
  add_bodies(h, sim);
  return h.hash();
}

}  // namespace sutured::soak
