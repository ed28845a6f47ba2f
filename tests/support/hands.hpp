// SPDX-License-Identifier: GPL-3.0-or-later
// Hands that a test moves step by step over a simulated scene.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "fem/stiffness.hpp"
#include "needle/curve.hpp"
#include "simulation/simulation.hpp"
#include "simulation/tissue_state.hpp"
#include "support/block_scene.hpp"

namespace sutured::testing {

/// A scene, its simulation, and where its tools are.
class Hands {
 public:
  using Vec3 = geometry::Vec3;
  using Vec6 = simulation::Vec6;

  explicit Hands(scene::Scene s, double dt_s = 0.004)
      : scene(std::move(s)), sim(scene), inputs(scene.tools.size()), step_s(dt_s) {}

  void step(int count = 1) {
    for (int i = 0; i < count; ++i) {
      sim.step(inputs, step_s);
      events.insert(events.end(), sim.events().begin(), sim.events().end());
    }
  }
  /// Moves a tool in a straight line.
  void move(int tool, const Vec3& to, double speed_m_per_s = 0.01) {
    const Vec3 from = at(tool).position_m;
    const int count =
        std::max(1, static_cast<int>(std::ceil((to - from).norm() / (speed_m_per_s * step_s))));
    for (int i = 1; i <= count; ++i) {
      at(tool).position_m = from + (to - from) * i / count;
      step();
    }
  }
  void move_by(int tool, const Vec3& way, double speed_m_per_s = 0.01) {
    move(tool, at(tool).position_m + way, speed_m_per_s);
  }
  /// Moves a tool along the first needle's own curve, towards the tip where `distance_m` > 0.
  void along(int tool, double distance_m, double speed_m_per_s = 0.01) {
    const needle::Curve curve = needle::Curve::of(scene.needles[0]);
    const int count = static_cast<int>(std::ceil(std::abs(distance_m) / (speed_m_per_s * step_s)));
    for (int i = 0; i < count; ++i) {
      const auto& state = sim.needles()[0];
      const scene::Pose pose{state.position_m, state.orientation};
      const Vec6 twist = curve.slide_twist(pose) * (distance_m / count);
      simulation::ToolInput& input = at(tool);
      const scene::Pose moved =
          needle::moved({pose.position_m, Eigen::Quaterniond::Identity()}, twist);
      input.position_m =
          moved.position_m + moved.orientation * (input.position_m - pose.position_m);
      input.orientation = (moved.orientation * input.orientation).normalized();
      step();
    }
  }
  void grasp(int tool, const Vec3& point) {
    at(tool) = tool_at(point, 0.0);
    step();
    at(tool).jaw = 1.0;
    step();
  }
  void let_go(int tool) {
    at(tool).jaw = 0.0;
    step();
  }

  [[nodiscard]] simulation::ToolInput& at(int tool) {
    return inputs[static_cast<std::size_t>(tool)];
  }
  [[nodiscard]] int count(simulation::EventKind kind) const {
    return static_cast<int>(
        std::count_if(events.begin(), events.end(), [&](const auto& e) { return e.kind == kind; }));
  }
  /// Precondition: there was one.
  [[nodiscard]] const simulation::Event& last(simulation::EventKind kind) const {
    return *std::find_if(events.rbegin(), events.rend(),
                         [&](const auto& e) { return e.kind == kind; });
  }
  [[nodiscard]] const simulation::ToolResponse& response(int tool) const {
    return sim.responses()[static_cast<std::size_t>(tool)];
  }
  [[nodiscard]] Vec3 force_n(int tool) const { return response(tool).wrench.head<3>(); }
  [[nodiscard]] const simulation::ThreadState& thread(int index = 0) const {
    return sim.threads()[static_cast<std::size_t>(index)];
  }

  /// A point of the first needle, from its tail (0) to its tip (1).
  [[nodiscard]] Vec3 on_needle(double share) const {
    const needle::Curve curve = needle::Curve::of(scene.needles[0]);
    const auto& state = sim.needles()[0];
    return curve.point({state.position_m, state.orientation}, share * curve.length_m());
  }

  /// Returns the displacements of all vertices, 3n, brought up to the last step.
  [[nodiscard]] std::vector<double> displacements_m() {
    sim.update_displacements();
    std::vector<double> u;
    for (std::size_t v = 0; v < sim.positions_m().size(); ++v)
      for (Eigen::Index i = 0; i < 3; ++i)
        u.push_back(sim.positions_m()[v][i] - sim.rest_positions_m()[v][i]);
    return u;
  }
  /// Returns K u less the loads at all degrees of freedom: what constraints put on free ones, what
  /// the fixture puts on fixed ones.
  [[nodiscard]] std::vector<double> external_forces_n() {
    const fem::Model model = simulation::assemble_model(scene);
    std::vector<double> f = fem::internal_forces_n(model, displacements_m());
    for (std::size_t dof = 0; dof < f.size(); ++dof) f[dof] -= model.load_n[dof];
    return f;
  }
  /// Returns the sum of what the fixed vertices are held with, N.
  [[nodiscard]] Vec3 reaction_n() {
    const fem::Model model = simulation::assemble_model(scene);
    const auto f = external_forces_n();
    Vec3 sum = Vec3::Zero();
    for (std::size_t dof = 0; dof < f.size(); ++dof)
      if (model.prescribed[dof]) sum[static_cast<Eigen::Index>(dof % 3)] += f[dof];
    return sum;
  }

  scene::Scene scene;
  simulation::Simulation sim;
  std::vector<simulation::ToolInput> inputs;
  std::vector<simulation::Event> events;
  double step_s;
};

}  // namespace sutured::testing
