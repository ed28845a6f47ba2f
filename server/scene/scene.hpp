// SPDX-License-Identifier: GPL-3.0-or-later
// What a scene file says, checked and with its meshes read: plain values.
// `read_scene` makes one, `build_simulation` turns one into a simulation.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "geometry/tet_mesh.hpp"

namespace sutured::scene {

using geometry::Vec3;

/// A rigid transform; maps coordinates of the named frame to the world.
struct Pose {
  Vec3 position_m = Vec3::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
};

/// Another material in one physical volume of the mesh.
struct Region {
  std::string group;
  std::vector<std::int32_t> tets;  ///< of the tissue's mesh; no tet lies in two regions
  double young_modulus_pa = 0.0;
  double poisson_ratio = 0.0;
};

/// A displacement imposed on vertices of the tissue, zero for fixed ones.
/// Axes are of the world; a free axis carries the load instead. A vertex may stand in several;
/// no two of them disagree about an axis.
struct Prescribed {
  std::vector<std::int32_t> vertices;  ///< of the tissue's mesh
  std::array<bool, 3> axes{true, true, true};
  Vec3 displacement_m = Vec3::Zero();
};

/// A dead load: `force_n[i]` acts on vertex `vertices[i]` of the tissue's mesh.
struct NodalLoad {
  std::vector<std::int32_t> vertices;
  std::vector<Vec3> force_n;
};

struct Tissue {
  std::string name;
  std::string mesh_path;
  std::string mesh_format;  ///< "MSH 2.2, text"
  double scale = 1.0;       ///< metres per unit of the file; `mesh` is in metres
  geometry::TetMesh mesh;
  double young_modulus_pa = 0.0;
  double poisson_ratio = 0.0;
  double density_kg_per_m3 = 1000.0;  ///< matters under gravity only
  double puncture_force_n = 0.05;
  double friction_n_s_per_m2 = 20.0;          ///< viscous, per metre of embedded needle
  double static_friction_n_per_m = 2.0;       ///< holds a needle that nobody holds
  double surface_friction_coefficient = 0.5;  ///< of the tip's friction cone
  std::vector<Region> regions;
  std::vector<Prescribed> prescribed;
  std::vector<NodalLoad> loads;
};

enum class NeedleShape { kStraight, kArc };
enum class SlideRule { kEnergyConsistent, kLeastSquares };

struct Needle {
  std::string name;
  NeedleShape shape = NeedleShape::kArc;
  double radius_m = 0.008;  ///< of the arc
  double arc_deg = 180.0;
  double length_m = 0.025;  ///< along the needle's axis; of an arc: radius times angle
  double diameter_m = 0.0006;
  Pose pose;
  SlideRule slide = SlideRule::kEnergyConsistent;
};

enum class ToolKind { kDriver, kProbe };

/// The device's frame in the world, and how the hand's motion is scaled into it.
struct Workspace {
  Pose pose;
  double motion_scale = 1.0;
  double force_scale = 1.0;
  int clutch_button = -1;  ///< bit of ToolPose.buttons, or -1 for none
};

struct Tool {
  std::string name;
  ToolKind kind = ToolKind::kDriver;
  double capture_radius_m = 0.003;
  double probe_radius_m = 0.002;
  double max_force_n = 3.3;
  double max_torque_nm = 0.1;
  double max_force_slew_n_per_s = 500.0;
  double max_torque_slew_nm_per_s = 15.0;
  double stale_after_ms = 15.0;
  double grip_stiffness_n_per_m = 2000.0;
  double grip_stiffness_nm_per_rad = 0.5;
  double grip_force_max_n = 5.0;
  double grip_torque_max_nm = 0.05;
  double max_speed_m_per_s = 2.0;  ///< in the device's frame; beyond it a pose is a jump
  Workspace workspace;
};

/// Where a thread passes a tissue's surface: a material point of a boundary face.
struct Bite {
  int tissue = -1;                          ///< index into Scene::tissues
  geometry::Triangle vertices{-1, -1, -1};  ///< of the tissue's mesh, wound outward
  Vec3 barycentric = Vec3::Zero();          ///< of `vertices`; none negative, sum 1
};

enum class ThreadTail { kAnchored, kFree };  ///< knotted at the first puncture, or nowhere
enum class ThreadEnds { kHeld, kNone };      ///< ruled by needle and tail, or by nobody
enum class ThreadHead { kSwaged, kFree };    ///< crimped into a needle, or cut off
/// Where the tension acts: at the punctures only (the paper), or along the whole bite.
enum class ThreadModel { kOutside, kPath };

struct TimedLength {
  double time_s = 0.0;
  double length_m = 0.0;
};

struct Thread {
  std::string name;
  std::string needle;  ///< the one it is swaged to; empty where `ends` is kNone
  double length_m = 0.45;
  ThreadTail tail = ThreadTail::kAnchored;
  ThreadEnds ends = ThreadEnds::kHeld;
  ThreadHead head = ThreadHead::kSwaged;
  ThreadModel model = ThreadModel::kOutside;
  double diameter_m = 0.0003;   ///< for the eye
  double tension_max_n = 0.5;   ///< a pull beyond it is clamped
  double tail_length_m = 0.03;  ///< before the first of `punctures`, where the tail is free
  std::vector<Bite> punctures;  ///< from tail to head, two a bite
  std::vector<TimedLength> length_program;  ///< ascending times; empty for none
};

/// One side of a wound: a part of a tissue's surface.
struct WoundEdge {
  int tissue = -1;  ///< index into Scene::tissues
  std::string group;
  std::vector<geometry::Triangle> triangles;  ///< of the tissue's mesh
  std::vector<std::int32_t> vertices;         ///< used by `triangles`, sorted
};

/// Two edges that are to be sewn together: what the gap is measured between.
struct Wound {
  std::string name;
  std::array<WoundEdge, 2> edges;
};

struct Contact {
  bool enabled = true;
};

struct Scene {
  std::string name;
  std::string path;
  double rate_hz = 250.0;
  Vec3 gravity_m_per_s2 = Vec3::Zero();
  std::vector<Tissue> tissues;
  std::vector<Needle> needles;
  std::vector<Thread> threads;
  std::vector<Tool> tools;
  std::vector<Wound> wounds;
  Contact contact;
  std::vector<std::string> notes;  ///< what a reader of the scene should know, a sentence each
};

}  // namespace sutured::scene
