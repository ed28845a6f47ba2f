// SPDX-License-Identifier: GPL-3.0-or-later
#include "support/closure_scene.hpp"

#include <cmath>
#include <limits>
#include <stdexcept>

#include "geometry/closest_point.hpp"
#include "geometry/topology.hpp"
#include "support/tube_mesh.hpp"

namespace sutured::testing {
namespace {

using geometry::Vec3;

constexpr double kGap_m = 1.5e-3, kLength_m = 20e-3, kWall_m = 1.5e-3, kBite_m = 2e-3;
constexpr std::array<double, 2> kOuterRadius_m{6e-3, 5e-3};
// The layer at the far end over the one at the gap, per unit of length of the paper's nine layers.
const double kGrading = 9.0 * std::log(1.12);

/// Cells around the proximal and the distal vessel, through the wall, and along.
struct Cut {
  std::array<int, 2> around;
  int across, along;
};

Cut cut_of(ClosureMesh mesh) {
  switch (mesh) {
    case ClosureMesh::k1k6:
      return {{30, 24}, 2, 9};
    case ClosureMesh::k6k:
      return {{44, 36}, 3, 17};
    case ClosureMesh::k24k:
      return {{72, 60}, 4, 35};
    case ClosureMesh::k53k:
      return {{96, 80}, 5, 49};
  }
  throw std::invalid_argument("no such mesh");
}

/// Distance from the rim of layer boundary `share` of the way, by number, to the far end.
double graded_m(double share) {
  return kLength_m * std::expm1(kGrading * share) / std::expm1(kGrading);
}

/// The vessel `which`: 0 proximal, on the side of −z, 1 distal.
geometry::TetMesh vessel_mesh(const Cut& cut, std::size_t which) {
  geometry::TetMesh mesh = tube_mesh({kOuterRadius_m[which] - kWall_m, kOuterRadius_m[which], 0.0,
                                      1.0, cut.around[which], cut.across, cut.along});
  for (Vec3& x : mesh.vertices_m)
    x.z() = which == 0 ? -0.5 * kGap_m - graded_m(1.0 - x.z()) : 0.5 * kGap_m + graded_m(x.z());
  return mesh;
}

scene::Bite puncture_at(const scene::Tissue& tissue, int index, const Vec3& point_m) {
  const auto& x = tissue.mesh.vertices_m;
  const auto surface =
      geometry::boundary_surface(tissue.mesh.tets, geometry::tet_adjacency(tissue.mesh.tets));
  scene::Bite bite;
  bite.tissue = index;
  double nearest = std::numeric_limits<double>::infinity();
  for (const geometry::Triangle& t : surface.triangles) {
    const auto closest = geometry::closest_point_on_triangle(
        point_m, x[static_cast<std::size_t>(t[0])], x[static_cast<std::size_t>(t[1])],
        x[static_cast<std::size_t>(t[2])]);
    if (closest.squared_distance_m2 >= nearest) continue;
    nearest = closest.squared_distance_m2;
    bite.vertices = t;
    bite.barycentric = closest.barycentric;
  }
  return bite;
}

Vec3 position_m(const scene::Scene& scene, const scene::Bite& bite) {
  Vec3 sum = Vec3::Zero();
  for (std::size_t i = 0; i < 3; ++i)
    sum += bite.barycentric[static_cast<Eigen::Index>(i)] *
           scene.tissues[static_cast<std::size_t>(bite.tissue)]
               .mesh.vertices_m[static_cast<std::size_t>(bite.vertices[i])];
  return sum;
}

}  // namespace

std::string name_of(ClosureMesh mesh) {
  switch (mesh) {
    case ClosureMesh::k1k6:
      return "v1k6";
    case ClosureMesh::k6k:
      return "v6k";
    case ClosureMesh::k24k:
      return "v24k";
    case ClosureMesh::k53k:
      return "v53k";
  }
  throw std::invalid_argument("no such mesh");
}

Closure closure_scene(const ClosureOptions& options) {
  const int bites = options.punctures / 2;
  if (options.punctures % 2 != 0 || bites < 2)
    throw std::invalid_argument("a running suture has an even number of punctures, four at least");
  const Cut cut = cut_of(options.mesh);
  Closure closure;
  scene::Scene& scene = closure.scene;
  scene.name = "closure" + std::to_string(options.punctures);
  std::int32_t base = 0;
  for (std::size_t which = 0; which < 2; ++which) {
    scene::Tissue tissue;
    tissue.name = which == 0 ? "proximal" : "distal";
    tissue.mesh = vessel_mesh(cut, which);
    tissue.young_modulus_pa = 2.0e5;
    tissue.poisson_ratio = 0.45;
    scene::Prescribed fixed;
    for (std::size_t v = 0; v < tissue.mesh.vertices_m.size(); ++v) {
      const double depth = std::abs(tissue.mesh.vertices_m[v].z()) - 0.5 * kGap_m;
      if (depth > kLength_m - 1e-9) fixed.vertices.push_back(static_cast<std::int32_t>(v));
      if (depth < 1e-9) closure.rim[which].push_back(base + static_cast<std::int32_t>(v));
    }
    tissue.prescribed.push_back(fixed);
    base += static_cast<std::int32_t>(tissue.mesh.vertices_m.size());
    scene.tissues.push_back(std::move(tissue));
  }

  scene::Thread thread;
  thread.name = "suture";
  thread.ends = scene::ThreadEnds::kNone;
  thread.model = options.model;
  const double apart_deg = bites < 10 ? 30.0 : 360.0 / bites;
  for (int k = 0; k < bites; ++k) {
    const std::size_t which = k % 2 == 0 ? 0 : 1;
    const double angle = (4.0 + k * apart_deg) * EIGEN_PI / 180.0;
    const double z = (which == 0 ? -1.0 : 1.0) * (0.5 * kGap_m + kBite_m);
    const auto at = [&](double radius_m) {
      return puncture_at(scene.tissues[which], static_cast<int>(which),
                         {radius_m * std::cos(angle), radius_m * std::sin(angle), z});
    };
    const scene::Bite outside = at(kOuterRadius_m[which]),
                      lumen = at(kOuterRadius_m[which] - kWall_m);
    thread.punctures.push_back(which == 0 ? outside : lumen);
    thread.punctures.push_back(which == 0 ? lumen : outside);
  }
  const bool path = options.model == scene::ThreadModel::kPath;
  for (std::size_t i = 0; i + 1 < thread.punctures.size(); ++i)
    if (path || i % 2 == 1)
      closure.open_length_m +=
          (position_m(scene, thread.punctures[i + 1]) - position_m(scene, thread.punctures[i]))
              .norm();
  closure.closed_length_m = closure.open_length_m - (bites - 1) * options.shortening_m;
  closure.closed_at_s = options.shortening_m / options.speed_m_per_s;
  thread.length_program = {{0.0, closure.open_length_m},
                           {closure.closed_at_s, closure.closed_length_m}};
  scene.threads.push_back(std::move(thread));
  return closure;
}

double closing_shortening_m(int punctures) {
  if (punctures >= 50) return 1.79e-3;
  return punctures >= 20 ? 1.8e-3 : 2.5e-3;
}

scene::Scene hand_sewn_scene(int punctures) {
  ClosureOptions options;
  options.punctures = punctures;
  scene::Scene scene = closure_scene(options).scene;
  scene::Thread& thread = scene.threads[0];
  thread.ends = scene::ThreadEnds::kHeld;
  thread.head = scene::ThreadHead::kFree;
  thread.tail = scene::ThreadTail::kAnchored;
  thread.length_program.clear();
  thread.length_m = 0.12;
  thread.tension_max_n = 2.0;
  scene.tools.emplace_back().name = "driver";
  return scene;
}

double mean_gap_m(const Closure& closure, std::span<const geometry::Vec3> positions_m) {
  std::array<double, 2> z{};
  for (std::size_t which = 0; which < 2; ++which) {
    for (const auto v : closure.rim[which])
      z[which] += positions_m[static_cast<std::size_t>(v)].z();
    z[which] /= static_cast<double>(closure.rim[which].size());
  }
  return z[1] - z[0];
}

}  // namespace sutured::testing
