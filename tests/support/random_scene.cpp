// SPDX-License-Identifier: GPL-3.0-or-later
#include "support/random_scene.hpp"

#include <cmath>

#include "geometry/closest_point.hpp"
#include "geometry/topology.hpp"
#include "needle/curve.hpp"
#include "support/block_mesh.hpp"
#include "support/tube_mesh.hpp"

namespace sutured::testing {
namespace {

using geometry::Vec3;

constexpr double kTubeRadius_m = 5e-3;
constexpr double kTubeWall_m = 1.2e-3;

/// Fixes the vertices of `tissue` for which `holds` is true.
template <class Predicate>
void fix(scene::Tissue& tissue, Predicate&& holds) {
  scene::Prescribed fixed;
  for (std::size_t v = 0; v < tissue.mesh.vertices_m.size(); ++v)
    if (holds(tissue.mesh.vertices_m[v])) fixed.vertices.push_back(static_cast<std::int32_t>(v));
  tissue.prescribed.push_back(std::move(fixed));
}

}  // namespace

scene::Bite nearest_on_surface(const scene::Scene& scene, int tissue, const Vec3& target_m) {
  const geometry::TetMesh& mesh = scene.tissues[static_cast<std::size_t>(tissue)].mesh;
  const auto surface = geometry::boundary_surface(mesh.tets, geometry::tet_adjacency(mesh.tets));
  scene::Bite best;
  best.tissue = tissue;
  double nearest = std::numeric_limits<double>::infinity();
  for (const geometry::Triangle& t : surface.triangles) {
    const auto x = [&](std::size_t i) { return mesh.vertices_m[static_cast<std::size_t>(t[i])]; };
    const auto closest = geometry::closest_point_on_triangle(target_m, x(0), x(1), x(2));
    if (closest.squared_distance_m2 >= nearest) continue;
    nearest = closest.squared_distance_m2;
    best.vertices = t;
    best.barycentric = closest.barycentric;
  }
  return best;
}

scene::Scene random_tissue(Random& random, RandomTissue kind) {
  scene::Scene scene;
  scene::Tissue tissue;
  tissue.young_modulus_pa = std::exp(random.in(std::log(5e4), std::log(5e5)));
  tissue.poisson_ratio = random.in(0.3, 0.48);
  tissue.puncture_force_n = random.in(0.01, 0.08) * std::sqrt(tissue.young_modulus_pa / 2e5);
  tissue.friction_n_s_per_m2 = random.chance(0.1) ? 0.0 : random.in(1.0, 40.0);
  tissue.static_friction_n_per_m = random.in(0.5, 5.0);
  tissue.surface_friction_coefficient = random.in(0.1, 0.8);
  const auto add = [&](std::string name, geometry::TetMesh mesh, auto&& holds) {
    tissue.name = std::move(name);
    tissue.mesh = std::move(mesh);
    tissue.prescribed.clear();
    fix(tissue, holds);
    scene.tissues.push_back(tissue);
  };
  switch (kind) {
    case RandomTissue::kBlock: {
      const int cells = random.one_of({4, 6});
      auto mesh = block_mesh(cells, cells, cells / 2, Vec3(0.02, 0.02, 0.01));
      for (Vec3& x : mesh.vertices_m) x -= Vec3(0.01, 0.01, 0.01);
      add("block", std::move(mesh), [](const Vec3& x) { return x[2] < -0.01 + 1e-9; });
      break;
    }
    case RandomTissue::kTubes: {
      const double gap_m = random.in(2e-4, 2.5e-3);
      TubeShape shape;
      shape.inner_radius_m = kTubeRadius_m - kTubeWall_m;
      shape.outer_radius_m = kTubeRadius_m;
      shape.around = random.one_of({8, 12});
      shape.along = 4;
      shape.bottom_m = -8e-3 - 0.5 * gap_m;
      shape.top_m = -0.5 * gap_m;
      add("lower", tube_mesh(shape), [&](const Vec3& x) { return x[2] < shape.bottom_m + 1e-9; });
      TubeShape upper = shape;
      upper.bottom_m = 0.5 * gap_m;
      upper.top_m = 8e-3 + 0.5 * gap_m;
      add("upper", tube_mesh(upper), [&](const Vec3& x) { return x[2] > upper.top_m - 1e-9; });
      break;
    }
    case RandomTissue::kSlit: {
      const double gap_m = random.in(2e-4, 2e-3);
      const int cells = random.one_of({3, 4});
      for (const double side : {-1.0, 1.0}) {
        auto mesh = block_mesh(cells, cells + 1, cells - 1, Vec3(0.008, 0.012, 0.006));
        for (Vec3& x : mesh.vertices_m)
          x += Vec3(side < 0 ? -0.008 - 0.5 * gap_m : 0.5 * gap_m, -0.006, -0.006);
        add(side < 0 ? "left" : "right", std::move(mesh), [&](const Vec3& x) {
          return std::abs(x[0]) > 0.008 + 0.5 * gap_m - 1e-9 || x[2] < -0.006 + 1e-9;
        });
      }
      break;
    }
  }
  return scene;
}

std::vector<scene::Bite> random_stitches(Random& random, const scene::Scene& scene,
                                         RandomTissue kind, int stitches) {
  std::vector<scene::Bite> punctures;
  const auto add = [&](int tissue, const Vec3& target) {
    punctures.push_back(nearest_on_surface(scene, tissue, target));
  };
  for (int i = 0; i < stitches; ++i) {
    const double share = stitches > 1 ? static_cast<double>(i) / (stitches - 1) : 0.5;
    if (kind == RandomTissue::kTubes) {
      // In through the outer wall, out through the end; the other tube the other way round.
      const double angle = 2.0 * EIGEN_PI * 0.8 * share + random.in(-0.1, 0.1);
      const Vec3 radial(std::cos(angle), std::sin(angle), 0.0);
      const double reach = random.in(1e-3, 3e-3);
      add(0, 2.0 * kTubeRadius_m * radial - Vec3(0, 0, reach + 1e-3));
      add(0, (kTubeRadius_m - 0.5 * kTubeWall_m) * radial);
      add(1, (kTubeRadius_m - 0.5 * kTubeWall_m) * radial);
      add(1, 2.0 * kTubeRadius_m * radial + Vec3(0, 0, reach + 1e-3));
    } else {
      const double y = std::lerp(-4e-3, 4e-3, share) + random.in(-3e-4, 3e-4);
      if (kind == RandomTissue::kBlock) {
        const double x = random.in(-5e-3, 0.0), bite = random.in(1.5e-3, 5e-3);
        add(0, Vec3(x, y, 1e-3));
        add(0, Vec3(x + bite, y + random.in(-1e-3, 1e-3), 1e-3));
      } else {
        const double depth = random.in(1e-3, 4e-3), reach = random.in(1.5e-3, 5e-3);
        add(0, Vec3(-reach - 1e-3, y, 1e-3));
        add(0, Vec3(0, y, -depth));
        add(1, Vec3(0, y, -depth));
        add(1, Vec3(reach + 1e-3, y, 1e-3));
      }
    }
  }
  return punctures;
}

void place_needle(Random& random, RandomTissue kind, scene::Needle& needle) {
  Vec3 tip, into, bow;
  const double above = random.in(2e-4, 2e-3);
  if (kind == RandomTissue::kTubes) {
    const double angle = random.in(0.0, 2.0 * EIGEN_PI);
    const Vec3 radial(std::cos(angle), std::sin(angle), 0.0);
    tip = (kTubeRadius_m + above) * radial - Vec3(0, 0, random.in(1.5e-3, 4e-3));
    into = -radial;
    bow = Vec3::UnitZ();
  } else {
    tip = Vec3(random.in(-4.5e-3, -1.5e-3), random.in(-3e-3, 3e-3), above);
    into = -Vec3::UnitZ();
    bow = Vec3::UnitX();
  }
  into = (into + random.in(-0.2, 0.6) * bow + 0.1 * random.direction()).normalized();
  bow = (bow - into * into.dot(bow)).normalized();
  const needle::Curve curve = needle::Curve::of(needle);
  const scene::Pose local;
  const Vec3 tangent = curve.tangent(local, curve.length_m());
  const Vec3 end = curve.point(local, curve.length_m());
  const Vec3 inward = curve.is_arc() ? Vec3(-end.normalized()) : Vec3::UnitY();
  Eigen::Matrix3d from, to;
  from << tangent, inward, tangent.cross(inward);
  to << into, bow, into.cross(bow);
  needle.pose.orientation = Eigen::Quaterniond(Eigen::Matrix3d(to * from.transpose())).normalized();
  needle.pose.position_m = tip - needle.pose.orientation * end;
}

scene::Scene random_scene(std::uint64_t seed) {
  Random random(seed);
  const auto kind =
      random.one_of({RandomTissue::kBlock, RandomTissue::kTubes, RandomTissue::kSlit});
  scene::Scene scene = random_tissue(random, kind);
  scene.name = "random " + std::to_string(seed);
  scene.contact.enabled = !random.chance(0.15);
  if (random.chance(0.2)) scene.gravity_m_per_s2 = {0.0, 0.0, -9.81};
  scene.rate_hz = random.one_of({1000.0, 250.0, 250.0, 100.0, 60.0, 30.0});

  scene::Needle needle;
  needle.name = "needle";
  needle.shape = random.chance(0.6) ? scene::NeedleShape::kArc : scene::NeedleShape::kStraight;
  needle.radius_m = random.in(3e-3, 8e-3);
  needle.arc_deg = random.in(100.0, 220.0);
  needle.length_m = random.in(8e-3, 2.5e-2);
  needle.diameter_m = random.in(2e-4, 8e-4);
  if (random.chance(0.1)) needle.slide = scene::SlideRule::kLeastSquares;
  place_needle(random, kind, needle);
  scene.needles.push_back(needle);

  const auto thread = [&](const std::string& name, const std::string& hangs_on) {
    scene::Thread made;
    made.name = name;
    made.model = random.chance(0.5) ? scene::ThreadModel::kOutside : scene::ThreadModel::kPath;
    made.tail = random.chance(0.5) ? scene::ThreadTail::kAnchored : scene::ThreadTail::kFree;
    made.head = hangs_on.empty() ? scene::ThreadHead::kFree : scene::ThreadHead::kSwaged;
    made.needle = hangs_on;
    made.length_m = random.in(0.05, 0.3);
    made.tail_length_m = random.in(0.0, 0.03);
    made.tension_max_n = random.in(0.1, 2.0);
    const int stitches = random.chance(0.35) && !hangs_on.empty() ? 0 : 1 + random.below(5);
    made.punctures = random_stitches(random, scene, kind, stitches);
    scene.threads.push_back(made);
  };
  if (random.chance(0.85)) thread("thread", random.chance(0.75) ? "needle" : "");
  if (random.chance(0.25)) thread("other", "");
  if (random.chance(0.15)) {
    // One that nobody holds, drawn tight by a program.
    thread("program", "");
    scene::Thread& made = scene.threads.back();
    made.ends = scene::ThreadEnds::kNone;
    if (made.punctures.size() < 4) made.punctures = random_stitches(random, scene, kind, 2);
    double length = 0.0;
    const auto place = [&](const scene::Bite& bite) {
      Vec3 sum = Vec3::Zero();
      for (std::size_t i = 0; i < 3; ++i)
        sum += bite.barycentric[static_cast<Eigen::Index>(i)] *
               scene.tissues[static_cast<std::size_t>(bite.tissue)]
                   .mesh.vertices_m[static_cast<std::size_t>(bite.vertices[i])];
      return sum;
    };
    for (std::size_t i = 1; i < made.punctures.size(); ++i)
      if (made.model == scene::ThreadModel::kPath || i % 2 == 0)
        length += (place(made.punctures[i]) - place(made.punctures[i - 1])).norm();
    made.length_program = {{0.0, length}, {random.in(0.2, 2.0), random.in(0.3, 1.0) * length}};
  }

  for (const char* name : {"driver", "assistant", "probe"}) {
    scene::Tool tool;
    tool.name = name;
    tool.capture_radius_m = random.in(1e-3, 4e-3);
    tool.probe_radius_m = random.in(0.5e-3, 3e-3);
    tool.grip_stiffness_n_per_m = random.in(500.0, 4000.0);
    tool.grip_stiffness_nm_per_rad = random.in(0.1, 1.0);
    tool.grip_force_max_n = random.in(0.2, 5.0);
    tool.grip_torque_max_nm = random.in(0.002, 0.05);
    scene.tools.push_back(tool);
  }
  scene.tools.back().kind = scene::ToolKind::kProbe;
  return scene;
}

}  // namespace sutured::testing
