// SPDX-License-Identifier: GPL-3.0-or-later
// A block of tissue, 20 × 20 × 10 mm, fixed below, with a needle, two drivers and a probe.
#pragma once

#include "scene/scene.hpp"
#include "simulation/simulation.hpp"
#include "support/block_mesh.hpp"

namespace sutured::testing {

enum BlockTool { kDriver = 0, kAssistant = 1, kProbe = 2, kBlockTools = 3 };

/// The top of the block is z = 0. A straight needle of 25 mm hangs above it, tip down at
/// (0.0011, 0.0007, 0.0005), its tail at z = 25.5 mm.
inline scene::Scene block_scene(int cells = 8) {
  scene::Scene scene;
  scene.name = "block";
  scene::Tissue tissue;
  tissue.name = "block";
  tissue.mesh = block_mesh(cells, cells, cells / 2, geometry::Vec3(0.02, 0.02, 0.01));
  for (auto& x : tissue.mesh.vertices_m) x -= geometry::Vec3(0.01, 0.01, 0.01);
  tissue.young_modulus_pa = 2.0e5;
  tissue.poisson_ratio = 0.45;
  scene::Prescribed fixed;
  for (std::size_t v = 0; v < tissue.mesh.vertices_m.size(); ++v)
    if (tissue.mesh.vertices_m[v][2] < -0.01 + 1e-9)
      fixed.vertices.push_back(static_cast<std::int32_t>(v));
  tissue.prescribed.push_back(fixed);
  scene.tissues.push_back(tissue);
  scene::Needle needle;
  needle.name = "needle";
  needle.shape = scene::NeedleShape::kStraight;
  needle.length_m = 0.025;
  needle.pose.position_m = geometry::Vec3(0.0011, 0.0007, 0.0255);
  needle.pose.orientation =
      Eigen::Quaterniond::FromTwoVectors(geometry::Vec3::UnitX(), -geometry::Vec3::UnitZ());
  scene.needles.push_back(needle);
  for (const char* name : {"driver", "assistant"}) {
    scene::Tool tool;
    tool.name = name;
    scene.tools.push_back(tool);
  }
  scene::Tool probe;
  probe.name = "probe";
  probe.kind = scene::ToolKind::kProbe;
  scene.tools.push_back(probe);
  return scene;
}

inline simulation::ToolInput tool_at(const geometry::Vec3& position_m, double jaw = 0.0) {
  simulation::ToolInput input;
  input.present = true;
  input.position_m = position_m;
  input.jaw = jaw;
  return input;
}

/// An arc needle of 4 mm radius before the block, tip down at x = −4 mm, with a thread.
inline scene::Scene swaged_scene(scene::ThreadTail tail) {
  using geometry::Vec3;
  scene::Scene scene = block_scene(6);
  scene.contact.enabled = false;
  scene::Needle& needle = scene.needles[0];
  needle.shape = scene::NeedleShape::kArc;
  needle.radius_m = 4e-3;
  needle.arc_deg = 180.0;
  needle.pose.position_m = Vec3(0.0, 4e-4, 1e-3);
  needle.pose.orientation = Eigen::AngleAxisd(0.5 * EIGEN_PI, Vec3::UnitX());
  scene.tissues[0].puncture_force_n = 0.02;
  scene.tissues[0].friction_n_s_per_m2 = 2.0;
  scene::Thread thread;
  thread.name = "thread";
  thread.needle = "needle";
  thread.tail = tail;
  thread.length_m = 0.05;
  scene.threads.push_back(thread);
  return scene;
}

}  // namespace sutured::testing
