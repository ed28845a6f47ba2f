// SPDX-License-Identifier: GPL-3.0-or-later
// The shaft of a needle against tissue from outside.
#include "simulation/shaft_contact.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "needle/curve.hpp"
#include "support/block_scene.hpp"

namespace sutured::simulation {
namespace {

using geometry::Vec3;
using testing::kBlockTools;
using testing::kDriver;
using testing::tool_at;

constexpr double kStep_s = 0.004;

/// The block with its needle lying flat above it, along x, over the middle.
scene::Scene lying_needle() {
  scene::Scene scene = testing::block_scene();
  scene.needles[0].length_m = 0.012;
  scene.needles[0].pose.position_m = Vec3(-0.006, 0.0004, 0.0012);
  scene.needles[0].pose.orientation = Eigen::Quaterniond::Identity();
  scene.tools[kDriver].max_force_n = 10.0;
  return scene;
}

/// The least distance from the needle's axis to the surface, by points strewn over all triangles;
/// the end behind the tip is left out, which has contact of its own.
double clearance_m(const Simulation& sim, const scene::Scene& scene) {
  constexpr int kStrewn = 12;
  const auto curve = needle::Curve::of(scene.needles[0]);
  const scene::Pose pose{sim.needles()[0].position_m, sim.needles()[0].orientation};
  double least = 1.0;
  for (const auto& triangle : sim.bodies()[0].surface) {
    const auto corner = [&](std::size_t i) {
      return sim.positions_m()[static_cast<std::size_t>(triangle[i])];
    };
    for (int i = 0; i <= kStrewn; ++i)
      for (int j = 0; i + j <= kStrewn; ++j) {
        const double u = static_cast<double>(i) / kStrewn, v = static_cast<double>(j) / kStrewn;
        const Vec3 p = (1.0 - u - v) * corner(0) + u * corner(1) + v * corner(2);
        const double s = curve.nearest(pose, p);
        if (s < curve.length_m() - 1.5e-3)
          least = std::min(least, (curve.point(pose, s) - p).norm());
      }
  }
  return least;
}

TEST(ShaftContact, ALyingNeedleIsPressedIntoTheSurfaceButNotThroughIt) {
  const scene::Scene scene = lying_needle();
  Simulation sim(scene);
  std::vector<ToolInput> inputs(kBlockTools);
  inputs[kDriver] = tool_at(Vec3(-0.001, 0.0004, 0.0012));
  sim.step(inputs, kStep_s);
  inputs[kDriver].jaw = 1.0;
  sim.step(inputs, kStep_s);
  ASSERT_EQ(sim.needles()[0].holder, static_cast<int>(kDriver));
  double previous_n = 0.0;
  for (int i = 0; i < 150; ++i) {  // 3 mm down at 5 mm/s
    inputs[kDriver].position_m.z() -= 2e-5;
    sim.step(inputs, kStep_s);
    sim.update_displacements();
    previous_n = sim.responses()[kDriver].wrench[2];
    // The radius is 0.3 mm: rows give way by 1e-4 m/N, and surface may bulge between their points.
    ASSERT_GT(clearance_m(sim, scene), 0.15e-3) << "step " << i;
  }
  EXPECT_GT(previous_n, 0.05) << "the hand is pushed up";
  EXPECT_FALSE(sim.contacts().empty());
  EXPECT_TRUE(std::all_of(sim.contacts().begin(), sim.contacts().end(),
                          [](const ContactPoint& p) { return p.needle == 0 && p.force_n > 0.0; }));
  // What the contacts push up with is what the hand carries, less the needle's weak spring.
  Vec3 sum = Vec3::Zero();
  for (const ContactPoint& p : sim.contacts()) sum += p.force_n * p.normal;
  EXPECT_NEAR(sum.z(), previous_n, 0.02 * previous_n);
}

TEST(ShaftContact, AShaftInItsOwnHoleIsNotPushedOut) {
  const scene::Scene scene = testing::block_scene();
  Simulation sim(scene);
  std::vector<ToolInput> inputs(kBlockTools);
  inputs[kDriver] = tool_at(Vec3(0.0011, 0.0007, 0.0205));
  sim.step(inputs, kStep_s);
  inputs[kDriver].jaw = 1.0;
  sim.step(inputs, kStep_s);
  for (int i = 0; i < 160; ++i) {  // 8 mm down at 12.5 mm/s, through the top
    inputs[kDriver].position_m.z() -= 5e-5;
    sim.step(inputs, kStep_s);
  }
  ASSERT_TRUE(sim.needles()[0].tip_inside);
  EXPECT_TRUE(sim.contacts().empty());
}

}  // namespace
}  // namespace sutured::simulation
