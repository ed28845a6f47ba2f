// SPDX-License-Identifier: GPL-3.0-or-later
// What the tissue says about its own state: stress, and tets turned inside out.
#include "simulation/tissue_state.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <random>

#include "fem/elements.hpp"
#include "support/block_scene.hpp"

namespace sutured::simulation {
namespace {

using fem::Mat3;
using geometry::Vec3;
using testing::kBlockTools;
using testing::kProbe;

Vec6 components(const Mat3& s) {
  return (Vec6() << s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(1, 2), s(2, 0)).finished();
}

/// Hooke's law, written for Young's modulus and Poisson's ratio.
Vec6 hooke_pa(const Mat3& gradient, double young_pa, double nu) {
  const Mat3 strain = 0.5 * (gradient + gradient.transpose());
  return components(young_pa / (1 + nu) *
                    (strain + nu / (1 - 2 * nu) * strain.trace() * Mat3::Identity()));
}

TEST(TissueState, StressOfAUniformStrainIsExactInEveryTetAndVertex) {
  scene::Scene scene = testing::block_scene(4);
  scene::Tissue& tissue = scene.tissues[0];
  Mat3 gradient;
  gradient << 0.02, 0.01, -0.01, 0.005, -0.015, 0.02, 0.01, -0.004, 0.03;
  tissue.prescribed.clear();
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> shift(-4e-4, 4e-4);
  const auto inside = [](const Vec3& x) {
    return std::abs(x[0]) < 0.0099 && std::abs(x[1]) < 0.0099 && x[2] < -1e-4 && x[2] > -0.0099;
  };
  for (std::size_t v = 0; v < tissue.mesh.vertices_m.size(); ++v) {
    Vec3& x = tissue.mesh.vertices_m[v];
    if (inside(x)) {
      x += Vec3(shift(random), shift(random), shift(random));
      continue;
    }
    scene::Prescribed held;
    held.vertices = {static_cast<std::int32_t>(v)};
    held.displacement_m = gradient * x;
    tissue.prescribed.push_back(held);
  }
  const TissueState state(scene);
  StressField field;
  state.compute_stress(field);
  ASSERT_EQ(field.tet_pa.size(), state.model().tets.size());
  ASSERT_EQ(field.vertex_pa.size(), state.model().vertices_m.size());
  const Vec6 expected_pa = hooke_pa(gradient, tissue.young_modulus_pa, tissue.poisson_ratio);
  // The factor's rounding, times 1 / h of the strain.
  for (const Vec6& s : field.tet_pa) EXPECT_LT((s - expected_pa).norm(), 1e-9 * expected_pa.norm());
  for (const Vec6& s : field.vertex_pa)
    EXPECT_LT((s - expected_pa).norm(), 1e-9 * expected_pa.norm());
}

/// The oracle takes strains from edge matrices, and every vertex its own tets one by one.
TEST(TissueState, StressAtAVertexIsTheMeanOfItsTetsByVolume) {
  scene::Scene scene = testing::block_scene(4);
  scene::Region stiff;
  for (std::int32_t t = 0; t < 60; ++t) stiff.tets.push_back(t);
  stiff.young_modulus_pa = 9.0e5;
  stiff.poisson_ratio = 0.2;
  scene.tissues[0].regions.push_back(stiff);
  Simulation sim(scene);
  std::vector<ToolInput> inputs(kBlockTools);
  for (double depth_m = 0.0; depth_m < 1e-3; depth_m += 1e-4) {
    inputs[kProbe] = testing::tool_at(Vec3(0.001, 0.002, 0.0015 - depth_m));
    sim.step(inputs, 0.004);
  }
  sim.update_displacements();
  StressField field;
  sim.compute_stress(field);
  const auto rest = sim.rest_positions_m(), now = sim.positions_m();
  std::vector<Vec6> tet_pa;
  std::vector<double> volume_m3;
  for (std::size_t t = 0; t < sim.tets().size(); ++t) {
    const auto& tet = sim.tets()[t];
    Mat3 before, after;
    for (int i = 0; i < 3; ++i) {
      const auto a = static_cast<std::size_t>(tet[0]), b = static_cast<std::size_t>(tet[i + 1]);
      before.col(i) = rest[b] - rest[a];
      after.col(i) = now[b] - now[a];
    }
    const bool in_region = t < 60;
    tet_pa.push_back(hooke_pa(after * before.inverse() - Mat3::Identity(),
                              in_region ? 9.0e5 : 2.0e5, in_region ? 0.2 : 0.45));
    volume_m3.push_back(before.determinant() / 6.0);
  }
  double largest_pa = 0.0;
  for (const Vec6& s : tet_pa) largest_pa = std::max(largest_pa, s.norm());
  ASSERT_GT(largest_pa, 1e3);
  // Strains here come from differences of positions: 1e-16 m over a millimetre, times E.
  const double tolerance_pa = 1e-9 * largest_pa;
  for (std::size_t t = 0; t < tet_pa.size(); ++t)
    EXPECT_LT((field.tet_pa[t] - tet_pa[t]).norm(), tolerance_pa);
  for (std::size_t v = 0; v < rest.size(); ++v) {
    Vec6 sum = Vec6::Zero();
    double volume = 0.0;
    for (std::size_t t = 0; t < tet_pa.size(); ++t)
      for (const std::int32_t corner : sim.tets()[t])
        if (static_cast<std::size_t>(corner) == v) {
          sum += volume_m3[t] * tet_pa[t];
          volume += volume_m3[t];
        }
    EXPECT_LT((field.vertex_pa[v] - sum / volume).norm(), tolerance_pa) << "vertex " << v;
  }
}

int inverted_tets(const Simulation& sim) {
  int count = 0;
  const auto x = sim.positions_m();
  for (const auto& tet : sim.tets()) {
    Mat3 edges;
    for (std::size_t i = 0; i < 3; ++i)
      edges.col(static_cast<Eigen::Index>(i)) =
          x[static_cast<std::size_t>(tet[i + 1])] - x[static_cast<std::size_t>(tet[0])];
    count += edges.determinant() <= 0.0;
  }
  return count;
}

TEST(TissueState, InvertedTetsAreCountedAndToldWhenTheyGrow) {
  Simulation sim(testing::block_scene(4));
  std::vector<ToolInput> inputs(kBlockTools);
  const Vec3 above(0.001, 0.002, 0.0025);
  int before = 0, told = 0, grown = 0, most = 0;
  std::vector<Event> tellings;
  const auto step = [&](double depth_m) {
    inputs[kProbe] = testing::tool_at(above - Vec3(0, 0, depth_m));
    sim.step(inputs, 0.004);
    ASSERT_EQ(sim.report().substeps, 1);
    for (const Event& event : sim.events())
      if (event.kind == EventKind::kInverted) tellings.push_back(event);
    // The step tells of the state that it started from; the next one would tell of this.
    EXPECT_EQ(sim.report().inverted_tets, before);
    grown += before > told;
    told = before;
    sim.update_displacements();
    before = inverted_tets(sim);
    EXPECT_EQ(sim.report().inverted_tets, std::max(told, before));
    most = std::max(most, before);
  };
  for (double depth_m = 0.0; depth_m < 0.012; depth_m += 2e-4) step(depth_m);
  ASSERT_GT(most, 3) << "the probe did not press hard enough for this test to mean anything";
  for (double depth_m = 0.012; depth_m > 0.0; depth_m -= 2e-4) step(depth_m);
  step(0.0);
  EXPECT_EQ(before, 0);
  EXPECT_GE(grown, 2);
  ASSERT_EQ(static_cast<int>(tellings.size()), grown);
  EXPECT_EQ(std::max_element(tellings.begin(), tellings.end(),
                             [](const auto& a, const auto& b) { return a.force_n < b.force_n; })
                ->force_n,
            most);
  for (const Event& event : tellings) {
    EXPECT_EQ(event.subject, "block");
    EXPECT_LT((event.position_m - above).head<2>().norm(), 0.01);
  }
  sim.reset();
  EXPECT_EQ(sim.report().inverted_tets, 0);
}

TEST(TissueState, TetsInvertedByTheSceneItselfAreToldAtTheFirstStep) {
  scene::Scene scene = testing::block_scene(4);
  scene::Prescribed pushed;  // the top, to below the bottom
  for (std::size_t v = 0; v < scene.tissues[0].mesh.vertices_m.size(); ++v)
    if (scene.tissues[0].mesh.vertices_m[v][2] > -1e-9)
      pushed.vertices.push_back(static_cast<std::int32_t>(v));
  pushed.displacement_m = Vec3(0, 0, -0.011);
  scene.tissues[0].prescribed.push_back(pushed);
  Simulation sim(scene);
  const std::vector<ToolInput> nothing(kBlockTools);
  for (int round = 0; round < 2; ++round) {
    sim.step(nothing, 0.004);
    ASSERT_EQ(sim.events().size(), 1U);
    EXPECT_EQ(sim.events()[0].kind, EventKind::kInverted);
    EXPECT_EQ(sim.events()[0].force_n, inverted_tets(sim));
    EXPECT_EQ(sim.report().inverted_tets, inverted_tets(sim));
    EXPECT_GT(inverted_tets(sim), 0);
    sim.step(nothing, 0.004);
    EXPECT_TRUE(sim.events().empty());
    sim.reset();
  }
}

}  // namespace
}  // namespace sutured::simulation
