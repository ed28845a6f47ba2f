// SPDX-License-Identifier: GPL-3.0-or-later
// What contact and thread owe a closure, step by step at 250 Hz: no tissue in tissue, by an oracle
// that shares no code with the search; an end of all motion; a thread of the length it was given.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <tuple>
#include <utility>

#include "geometry/closest_point.hpp"
#include "geometry/topology.hpp"
#include "simulation/simulation.hpp"
#include "support/block_mesh.hpp"
#include "support/closure_scene.hpp"
#include "support/penetration.hpp"
#include "thread/course.hpp"

namespace sutured {
namespace {

using geometry::Vec3;

// The budgets of contact.
constexpr double kMoving_m = 100e-6, kSettled_m = 20e-6;
// In so many steps without any change of what is asked, a step moves less than this.
constexpr int kSettlingSteps = 20;
constexpr double kStill_m = 1e-7;
// Of the largest multiplier, gaps against a millimetre: rounding is 1e-13.
constexpr double kResidualMax = 1e-8;
constexpr double kStep_s = 1.0 / 250.0;

/// What a run showed.
struct Course {
  double moving_m = 0.0, settled_m = 0.0;  ///< deepest penetration
  double motion_m = 0.0;                   ///< largest in a step, once still
  double residual = 0.0;
  double tension_least_n = 0.0;
  int touching = 0;  ///< pairs that carry force at the end
};

/// Steps a simulation and keeps what is worst.
class Watch {
 public:
  explicit Watch(simulation::Simulation& sim)
      : sim_(sim), last_(sim.positions_m().begin(), sim.positions_m().end()) {}

  void step(std::span<const simulation::ToolInput> tools, bool settled) {
    sim_.step(tools, kStep_s);
    sim_.update_displacements();
    course.residual = std::max(course.residual, sim_.report().complementarity_residual);
    for (const auto& thread : sim_.threads())
      for (const double tension_n : thread.segment_tension_n)
        course.tension_least_n = std::min(course.tension_least_n, tension_n);
    const auto x = sim_.positions_m();
    double motion_m = 0.0;
    for (std::size_t v = 0; v < x.size(); ++v) {
      motion_m = std::max(motion_m, (x[v] - last_[v]).norm());
      last_[v] = x[v];
    }
    const testing::Penetration deep = testing::measure_penetration(x, sim_.tets());
    double& deepest_m = settled ? course.settled_m : course.moving_m;
    deepest_m = std::max({deepest_m, deep.vertex_depth_m, deep.edge_depth_m});
    if (settled) course.motion_m = std::max(course.motion_m, motion_m);
    course.touching = static_cast<int>(sim_.contacts().size());
  }

  Course course;

 private:
  simulation::Simulation& sim_;
  std::vector<Vec3> last_;
};

void expect_within_bounds(const Course& course) {
  EXPECT_LE(course.moving_m, kMoving_m);
  EXPECT_LE(course.settled_m, kSettled_m);
  EXPECT_LE(course.residual, kResidualMax);
  EXPECT_GE(course.tension_least_n, 0.0);
  EXPECT_GT(course.touching, 0) << "nothing touches: the bounds say nothing";
}

void print(const std::string& name, const Course& course) {
  std::printf(
      "%-24s deepest %.1f um moving, %.1f um settled; a still step %.1g m; residual %.1g; %d "
      "pairs\n",
      name.c_str(), 1e6 * course.moving_m, 1e6 * course.settled_m, course.motion_m, course.residual,
      course.touching);
}

/// What a piece of thread counts for, by its definition: below s = 0.1 mm, d² / 2 s + s / 2.
double counted_length_m(const Vec3& from, const Vec3& to) {
  constexpr double s = 1e-4;
  const double d = (to - from).norm();
  return d >= s ? d : 0.5 * (d * d / s + s);
}

struct Pull {
  int punctures;
  double tightness;  ///< 1: closed
  scene::ThreadModel model;
};

std::string name_of(const Pull& pull) {
  return std::to_string(pull.punctures) +
         (pull.model == scene::ThreadModel::kPath ? "AlongThePath" : "Outside") +
         (pull.tightness > 1.0 ? "PulledTight" : "");
}
void PrintTo(const Pull& pull, std::ostream* out) { *out << name_of(pull); }

class Closure : public ::testing::TestWithParam<Pull> {};

/// Where the thread passes the surfaces now, from tail to head.
std::vector<Vec3> points_of(const scene::Scene& scene, std::span<const simulation::Body> bodies,
                            std::span<const Vec3> positions_m) {
  std::vector<Vec3> points;
  for (const scene::Bite& bite : scene.threads[0].punctures) {
    const auto& body = bodies[static_cast<std::size_t>(bite.tissue)];
    Vec3 sum = Vec3::Zero();
    for (std::size_t i = 0; i < 3; ++i)
      sum += bite.barycentric[static_cast<Eigen::Index>(i)] *
             positions_m[static_cast<std::size_t>(body.first_vertex + bite.vertices[i])];
    points.push_back(sum);
  }
  return points;
}

/// The counted length of the thread through its punctures: from bite to bite, and within them where
/// the tension acts there, cell by cell of the straight way at rest.
double length_through(std::span<const Vec3> points, const scene::Scene& scene,
                      const simulation::Simulation& sim) {
  const auto x = sim.positions_m(), rest = sim.rest_positions_m();
  const auto at_rest = points_of(scene, sim.bodies(), rest);
  double sum = 0.0;
  for (std::size_t i = 0; i + 1 < points.size(); ++i) {
    const bool inside = i % 2 == 0;
    if (inside && scene.threads[0].model == scene::ThreadModel::kOutside) continue;
    Vec3 from = points[i];
    if (inside) {
      for (const auto& point :
           thread::straight_course(rest, sim.tets(), at_rest[i], at_rest[i + 1])) {
        const Vec3 to = point.position(x);
        sum += counted_length_m(std::exchange(from, to), to);
      }
    }
    sum += counted_length_m(from, points[i + 1]);
  }
  return sum;
}

TEST_P(Closure, KeepsApartSettlesAndKeepsTheThreadsLength) {
  const Pull& pull = GetParam();
  testing::ClosureOptions options;
  options.punctures = pull.punctures;
  options.model = pull.model;
  options.shortening_m = pull.tightness * testing::closing_shortening_m(pull.punctures);
  const testing::Closure closure = testing::closure_scene(options);
  simulation::Simulation sim(closure.scene);
  Watch watch(sim);
  const int moving = static_cast<int>(std::ceil(closure.closed_at_s / kStep_s));
  for (int step = 1; step <= moving + kSettlingSteps; ++step) watch.step({}, false);
  // An over-tight thread ends its motion as well, if later.
  const bool tight = pull.tightness > 1.0;
  for (int step = 0; tight && step < 2 * kSettlingSteps; ++step) watch.step({}, false);
  for (int step = 0; step < 2 * kSettlingSteps; ++step) watch.step({}, true);

  expect_within_bounds(watch.course);
  EXPECT_LE(watch.course.motion_m, kStill_m);
  const simulation::ThreadState& thread = sim.threads()[0];
  EXPECT_GT(thread.tension_n, 0.0);
  EXPECT_EQ(sim.report().inverted_tets, 0);
  const auto points = points_of(closure.scene, sim.bodies(), sim.positions_m());
  EXPECT_NEAR(length_through(points, closure.scene, sim), closure.closed_length_m, 1e-9);
  // And so do the punctures that viewers are told, from head to tail.
  std::vector<Vec3> told;
  for (const auto& puncture : thread.punctures) told.insert(told.begin(), puncture.position_m);
  ASSERT_EQ(told.size(), points.size());
  EXPECT_NEAR(length_through(told, closure.scene, sim), closure.closed_length_m, 1e-9);
  print(name_of(pull), watch.course);
  std::printf("%-24s %.4f N, mean gap %.3f mm\n", "", thread.tension_n,
              1e3 * testing::mean_gap_m(closure, sim.positions_m()));
}

using scene::ThreadModel;
// Twice the closing tension: 1.3 and 1.25 times the shortening.
INSTANTIATE_TEST_SUITE_P(
    Anastomosis, Closure,
    ::testing::Values(Pull{4, 1.0, ThreadModel::kOutside}, Pull{20, 1.0, ThreadModel::kOutside},
                      Pull{50, 1.0, ThreadModel::kOutside}, Pull{20, 1.0, ThreadModel::kPath},
                      Pull{50, 1.0, ThreadModel::kPath}, Pull{20, 1.3, ThreadModel::kOutside},
                      Pull{50, 1.25, ThreadModel::kOutside}),
    [](const auto& pull) { return name_of(pull.param); });

/// The tensions are those that an independent prototype of the method needed on the same vessels;
/// its contact rests on other thicknesses and its mesh is another, hence a tenth.
TEST(Closure, TensionIsThatOfThePrototype) {
  for (const auto& [punctures, tension_n] : {std::pair(20, 0.115), std::pair(50, 0.058)}) {
    testing::ClosureOptions options;
    options.punctures = punctures;
    options.shortening_m = testing::closing_shortening_m(punctures);
    const testing::Closure closure = testing::closure_scene(options);
    simulation::Simulation sim(closure.scene);
    for (int step = 0; step < 130; ++step) sim.step({}, kStep_s);
    sim.update_displacements();
    EXPECT_NEAR(sim.threads()[0].tension_n, tension_n, 0.1 * tension_n);
    // Closed: less than a tenth of the gap is left, or the rims have turned in by as much.
    EXPECT_LT(std::abs(testing::mean_gap_m(closure, sim.positions_m())), 0.15e-3);
  }
}

/// The oracle sees what contact prevents: without it the same closures break every bound.
TEST(Closure, WithoutContactTheVesselsReachIntoEachOther) {
  testing::ClosureOptions options;
  options.punctures = 50;
  options.shortening_m = testing::closing_shortening_m(50);
  testing::Closure closure = testing::closure_scene(options);
  closure.scene.contact.enabled = false;
  simulation::Simulation sim(closure.scene);
  for (int step = 0; step < 130; ++step) sim.step({}, kStep_s);
  sim.update_displacements();
  const auto deep = testing::measure_penetration(sim.positions_m(), sim.tets());
  EXPECT_GT(std::max(deep.vertex_depth_m, deep.edge_depth_m), kMoving_m);
}

TEST(ClosureScene, MeshesAreRefinementsOfThePapers) {
  for (const auto& [mesh, vertices, tets] :
       {std::tuple(testing::ClosureMesh::k1k6, 1620U, 5832U),
        std::tuple(testing::ClosureMesh::k6k, 5760U, 24480U),
        std::tuple(testing::ClosureMesh::k24k, 23760U, 110880U),
        std::tuple(testing::ClosureMesh::k53k, 52800U, 258720U)}) {
    testing::ClosureOptions options;
    options.mesh = mesh;
    std::size_t v = 0, t = 0;
    const testing::Closure closure = testing::closure_scene(options);
    for (const auto& tissue : closure.scene.tissues) {
      v += tissue.mesh.vertices_m.size();
      t += tissue.mesh.tets.size();
    }
    EXPECT_EQ(v, vertices);
    EXPECT_EQ(t, tets);
  }
}

// --- A body that meets itself. Its soft modes take twice the steps to come to rest. ---

/// A strip of `cells` cubes bent along a plane curve: `at(s, t)` of the way along it and across it,
/// both from 0 to 1; as wide as `width_m` along z, from 0.
template <typename Curve>
scene::Scene bent_strip(const std::array<int, 3>& cells, double width_m, Curve&& at) {
  scene::Scene scene;
  scene.name = "strip";
  scene::Tissue tissue;
  tissue.name = "strip";
  tissue.mesh = testing::block_mesh(cells[0], cells[1], cells[2]);
  for (Vec3& x : tissue.mesh.vertices_m) {
    const Eigen::Vector2d p = at(x[0], x[1]);
    x = Vec3(p[0], p[1], width_m * x[2]);
  }
  for (geometry::Tet& tet : tissue.mesh.tets) {
    const auto& x = tissue.mesh.vertices_m;
    const auto corner = [&](std::size_t i) -> const Vec3& {
      return x[static_cast<std::size_t>(tet[i])];
    };
    if (geometry::signed_volume(corner(0), corner(1), corner(2), corner(3)) < 0.0)
      std::swap(tet[2], tet[3]);
  }
  tissue.young_modulus_pa = 2.0e5;
  tissue.poisson_ratio = 0.45;
  scene.tissues.push_back(std::move(tissue));
  return scene;
}

void fix(scene::Tissue& tissue, const std::function<bool(const Vec3&)>& where) {
  scene::Prescribed fixed;
  for (std::size_t v = 0; v < tissue.mesh.vertices_m.size(); ++v)
    if (where(tissue.mesh.vertices_m[v])) fixed.vertices.push_back(static_cast<std::int32_t>(v));
  tissue.prescribed.push_back(fixed);
}

simulation::ToolInput probe_at(const Vec3& position_m) {
  simulation::ToolInput input;
  input.present = true;
  input.position_m = position_m;
  return input;
}

/// Presses a probe along `way_m` at 5 mm/s, and holds it.
Course press(const scene::Scene& scene, const Vec3& from_m, const Vec3& way_m) {
  simulation::Simulation sim(scene);
  Watch watch(sim);
  const int moving = static_cast<int>(std::ceil(way_m.norm() / (5e-3 * kStep_s)));
  for (int step = 0; step <= moving; ++step) {
    const simulation::ToolInput probe = probe_at(from_m + way_m * step / moving);
    watch.step({&probe, 1}, false);
  }
  const simulation::ToolInput probe = probe_at(from_m + way_m);
  for (int step = 0; step < 4 * kSettlingSteps; ++step)
    watch.step({&probe, 1}, step >= 2 * kSettlingSteps);
  return watch.course;
}

scene::Tool probe_tool() {
  scene::Tool probe;
  probe.name = "probe";
  probe.kind = scene::ToolKind::kProbe;
  return probe;
}

/// A hairpin: two legs of 12 mm, 1.5 mm thick, 2 mm apart, joined by a half ring. The lower one
/// is fixed below; the probe presses the end of the upper one on it.
TEST(SelfContact, AHairpinPressedTogetherKeepsApart) {
  constexpr double kLeg = 12e-3, kInner = 1e-3, kThick = 1.5e-3;
  constexpr double kTurn = EIGEN_PI * (kInner + 0.5 * kThick), kAll = 2.0 * kLeg + kTurn;
  scene::Scene scene = bent_strip({32, 2, 6}, 5e-3, [&](double share, double across) {
    const double s = share * kAll, r = kInner + across * kThick;
    if (s < kLeg) return Eigen::Vector2d(kLeg - s, -r);
    if (s > kLeg + kTurn) return Eigen::Vector2d(s - kLeg - kTurn, r);
    const double angle = EIGEN_PI * (s - kLeg) / kTurn;
    return Eigen::Vector2d(-r * std::sin(angle), -r * std::cos(angle));
  });
  fix(scene.tissues[0], [&](const Vec3& x) { return x.y() < -kInner - kThick + 1e-9; });
  scene.tools.push_back(probe_tool());
  // The probe's sphere of 2 mm stands on the upper leg, and goes down by the gap: the end of the
  // leg lies flat on the lower one, and half of the way to the ring with it.
  const Vec3 from(9.3e-3, kInner + kThick + 2e-3, 2.4e-3);
  const Course course = press(scene, from, {0.0, -2.0e-3, 0.0});
  expect_within_bounds(course);
  EXPECT_LE(course.motion_m, kStill_m);
  print("hairpin", course);
}

/// A C: a ring of 8 mm with a mouth of 2 mm, fixed at its back; a thread through both lips pulls
/// the mouth shut.
TEST(SelfContact, ACPulledShutKeepsApart) {
  constexpr double kMiddle = 8e-3, kThick = 3e-3, kHalfMouth_deg = 7.0;
  scene::Scene scene = bent_strip({36, 3, 6}, 6e-3, [&](double share, double across) {
    const double angle =
        std::lerp(kHalfMouth_deg, 360.0 - kHalfMouth_deg, share) * EIGEN_PI / 180.0;
    const double r = kMiddle + (across - 0.5) * kThick;
    return Eigen::Vector2d(r * std::cos(angle), r * std::sin(angle));
  });
  scene::Tissue& tissue = scene.tissues[0];
  fix(tissue, [](const Vec3& x) { return x.x() < -7e-3; });
  // A bite through each lip, 24° from the middle of the mouth, near mid-width.
  scene::Thread thread;
  thread.name = "thread";
  thread.ends = scene::ThreadEnds::kNone;
  const auto surface =
      geometry::boundary_surface(tissue.mesh.tets, geometry::tet_adjacency(tissue.mesh.tets));
  const auto puncture = [&](double angle_deg, double radius_m) {
    const double a = angle_deg * EIGEN_PI / 180.0;
    const Vec3 place(radius_m * std::cos(a), radius_m * std::sin(a), 3.2e-3);
    scene::Bite bite;
    bite.tissue = 0;
    double nearest = 1.0;
    for (const auto& t : surface.triangles) {
      const auto x = [&](std::size_t i) {
        return tissue.mesh.vertices_m[static_cast<std::size_t>(t[i])];
      };
      const auto closest = geometry::closest_point_on_triangle(place, x(0), x(1), x(2));
      if (closest.squared_distance_m2 >= nearest) continue;
      nearest = closest.squared_distance_m2;
      bite.vertices = t;
      bite.barycentric = closest.barycentric;
    }
    thread.punctures.push_back(bite);
  };
  puncture(24.0, kMiddle + 0.5 * kThick);
  puncture(24.0, kMiddle - 0.5 * kThick);
  puncture(-24.0, kMiddle - 0.5 * kThick);
  puncture(-24.0, kMiddle + 0.5 * kThick);
  const double open_m = 2.0 * (kMiddle - 0.5 * kThick) * std::sin(24.0 * EIGEN_PI / 180.0);
  constexpr double kShut_m = 2.6e-3;
  thread.length_program = {{0.0, open_m}, {kShut_m / 5e-3, open_m - kShut_m}};
  scene.threads.push_back(thread);

  simulation::Simulation sim(scene);
  Watch watch(sim);
  const int moving = static_cast<int>(std::ceil(kShut_m / 5e-3 / kStep_s));
  for (int step = 0; step < moving + 4 * kSettlingSteps; ++step)
    watch.step({}, step >= moving + 2 * kSettlingSteps);
  expect_within_bounds(watch.course);
  EXPECT_LE(watch.course.motion_m, kStill_m);
  print("C", watch.course);
}

}  // namespace
}  // namespace sutured
