// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/quality.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "geometry/closest_point.hpp"
#include "geometry/topology.hpp"
#include "support/block_scene.hpp"

namespace sutured::simulation {
namespace {

using testing::kAssistant;
using testing::kBlockTools;
using testing::kDriver;
using testing::kProbe;
using testing::tool_at;

constexpr double kGap_m = 0.002;
constexpr double kFace_m = 0.01;  // x of the first block's edge

/// The faces of a block's boundary at x = `x_m`.
scene::WoundEdge edge_at(const scene::Tissue& tissue, int index, double x_m) {
  scene::WoundEdge edge;
  edge.tissue = index;
  const auto adjacency = geometry::tet_adjacency(tissue.mesh.tets);
  for (const auto& t : geometry::boundary_surface(tissue.mesh.tets, adjacency).triangles) {
    const auto on_edge = [&](std::int32_t v) {
      return std::abs(tissue.mesh.vertices_m[static_cast<std::size_t>(v)].x() - x_m) < 1e-9;
    };
    if (!std::all_of(t.begin(), t.end(), on_edge)) continue;
    edge.triangles.push_back(t);
    edge.vertices.insert(edge.vertices.end(), t.begin(), t.end());
  }
  std::sort(edge.vertices.begin(), edge.vertices.end());
  edge.vertices.erase(std::unique(edge.vertices.begin(), edge.vertices.end()), edge.vertices.end());
  return edge;
}

/// Two blocks side by side along x, 2 mm apart, with a thread on the needle above them.
scene::Scene two_blocks(bool wound = true) {
  scene::Scene scene = testing::block_scene(4);
  scene::Tissue other = scene.tissues[0];
  other.name = "other";
  for (auto& x : other.mesh.vertices_m) x.x() += 0.02 + kGap_m;
  scene.tissues.push_back(other);
  scene::Thread thread;
  thread.name = "thread";
  thread.needle = "needle";
  thread.tail = scene::ThreadTail::kFree;
  scene.threads.push_back(thread);
  if (wound)
    scene.wounds.push_back(
        {"cut",
         {edge_at(scene.tissues[0], 0, kFace_m), edge_at(scene.tissues[1], 1, kFace_m + kGap_m)}});
  return scene;
}

/// A meter that is shown what a test makes up.
class Quality : public ::testing::Test {
 protected:
  explicit Quality(scene::Scene s = two_blocks())
      : scene(std::move(s)), sim(scene), meter(scene, sim) {
    positions.assign(sim.rest_positions_m().begin(), sim.rest_positions_m().end());
    needles.assign(sim.needles().begin(), sim.needles().end());
  }

  void watch() {
    time_s += 0.004;
    meter.watch(view());
    events.clear();
  }
  void measure() { meter.measure(view()); }
  [[nodiscard]] QualityView view() const {
    return {time_s, responses, needles, threads, events, positions};
  }
  [[nodiscard]] const ThreadQuality& figures() const { return meter.threads()[0]; }

  /// The tools that hold the needle.
  void held_by(std::initializer_list<int> tools) {
    for (auto& response : responses) response.held = {};
    for (const int tool : tools)
      responses[static_cast<std::size_t>(tool)].held = {HeldKind::kNeedle, 0};
    watch();
  }
  void pull(int tool, double force_n) {
    responses[static_cast<std::size_t>(tool)].wrench.head<3>() = Vec3(0, 0, force_n);
  }
  void happens(EventKind kind, const char* tissue, const Vec3& position_m) {
    events.push_back({kind, time_s, "needle", tissue, position_m, 0.05});
  }

  /// Adds a bite at the head's end: where its needle went in and came out, at rest, and its course.
  void bite(int tissue, const Vec3& entry, const Vec3& exit, std::vector<Vec3> course = {}) {
    ThreadState& thread = threads[0];
    constexpr double kLength_m = 0.01;
    for (auto& puncture : thread.punctures) puncture.arc_length_m += 2.0 * kLength_m;
    for (auto& s : thread.arc_length_m) s += 2.0 * kLength_m;
    thread.punctures.insert(thread.punctures.begin(), {tissue, exit, exit, kLength_m, true});
    thread.punctures.insert(thread.punctures.begin() + 1,
                            {tissue, entry, entry, 2.0 * kLength_m, false});
    std::reverse(course.begin(), course.end());  // given from entry to exit
    thread.course_m.insert(thread.course_m.begin(), course.begin(), course.end());
    std::vector<double> arcs;
    for (std::size_t i = 0; i < course.size(); ++i)
      arcs.push_back(kLength_m * (1.0 + (static_cast<double>(i) + 1.0) /
                                            (static_cast<double>(course.size()) + 1.0)));
    thread.arc_length_m.insert(thread.arc_length_m.begin(), arcs.begin(), arcs.end());
  }

  scene::Scene scene;
  Simulation sim;
  QualityMeter meter;
  double time_s = 0.0;
  std::vector<ToolResponse> responses = std::vector<ToolResponse>(kBlockTools);
  std::vector<NeedleState> needles;
  std::vector<ThreadState> threads = std::vector<ThreadState>(1);
  std::vector<Event> events;
  std::vector<Vec3> positions;
};

// ------------------------------------------------------------------ the gap

TEST_F(Quality, TheGapOfParallelEdgesIsTheirDistance) {
  EXPECT_NEAR(figures().gap_start.max_m, kGap_m, 1e-15);
  EXPECT_NEAR(figures().gap_start.mean_m, kGap_m, 1e-15);
  const std::size_t first = static_cast<std::size_t>(sim.bodies()[1].first_vertex);
  for (std::size_t v = first; v < positions.size(); ++v) positions[v].x() -= 0.0015;
  measure();
  EXPECT_NEAR(figures().gap.max_m, 0.0005, 1e-15);
  EXPECT_NEAR(figures().gap.mean_m, 0.0005, 1e-15);
  EXPECT_NEAR(meter.gaps()[0].max_m, 0.0005, 1e-15);
  EXPECT_NEAR(figures().gap_start.max_m, kGap_m, 1e-15);  // as it was
}

TEST_F(Quality, TheGapMatchesASearchOfAllTriangles) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> shift_m(-5e-4, 5e-4);
  for (auto& x : positions) x += Vec3(shift_m(random), shift_m(random), shift_m(random));
  measure();
  const scene::Wound& wound = scene.wounds[0];
  double sum = 0.0, most = 0.0;
  int count = 0;
  const auto place = [&](const scene::WoundEdge& edge, std::int32_t v) -> const Vec3& {
    return positions[static_cast<std::size_t>(
        sim.bodies()[static_cast<std::size_t>(edge.tissue)].first_vertex + v)];
  };
  for (std::size_t i = 0; i < 2; ++i) {
    const scene::WoundEdge &from = wound.edges[i], &to = wound.edges[1 - i];
    for (const std::int32_t v : from.vertices) {
      double nearest = std::numeric_limits<double>::infinity();
      for (const auto& t : to.triangles)
        nearest =
            std::min(nearest, geometry::closest_point_on_triangle(place(from, v), place(to, t[0]),
                                                                  place(to, t[1]), place(to, t[2]))
                                  .squared_distance_m2);
      sum += std::sqrt(nearest);
      most = std::max(most, std::sqrt(nearest));
      ++count;
    }
  }
  ASSERT_EQ(count, 2 * 5 * 3);  // of a face of 4 × 2 squares
  EXPECT_NEAR(figures().gap.max_m, most, 1e-14);
  EXPECT_NEAR(figures().gap.mean_m, sum / count, 1e-14);
}

class QualityWithoutWound : public Quality {
 protected:
  QualityWithoutWound() : Quality(two_blocks(false)) {}
};

TEST_F(QualityWithoutWound, ThereIsNoGapAndNoEdge) {
  bite(0, Vec3(0, 0, 0), Vec3(0.004, 0, 0));
  measure();
  EXPECT_TRUE(std::isnan(figures().gap.max_m));
  EXPECT_TRUE(std::isnan(figures().gap_start.mean_m));
  ASSERT_EQ(figures().bites.size(), 1U);
  EXPECT_TRUE(std::isnan(figures().bites[0].edge_distance_m));
}

// ------------------------------------------------------------------ bites

TEST_F(Quality, ABiteIsJudgedAtRest) {
  // The block is carried off, turned and stretched: an affine map, so its points are known exactly.
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(0.7, Vec3(1, 2, 3).normalized()).toRotationMatrix() *
      Vec3(1.2, 0.9, 1.1).asDiagonal();
  const Vec3 away(0.1, -0.2, 0.3);
  const auto carried = [&](const Vec3& x) { return Vec3(turn * x + away); };
  for (std::size_t v = 0; v < positions.size(); ++v)
    positions[v] = carried(sim.rest_positions_m()[v]);
  bite(0, Vec3(-0.004, 0.001, 0), Vec3(0.003, 0.001, 0),
       {carried({-0.003, 0.001, -0.001}), carried({-0.001, 0.001, -0.0032}),
        carried({0.002, 0.001, -0.002})});
  measure();
  ASSERT_EQ(figures().bites.size(), 1U);
  const BiteFigures& bite = figures().bites[0];
  EXPECT_EQ(bite.tissue, 0);
  EXPECT_EQ(bite.entry_m, Vec3(-0.004, 0.001, 0));
  EXPECT_EQ(bite.exit_m, Vec3(0.003, 0.001, 0));
  EXPECT_NEAR(bite.depth_m, 0.0032, 1e-12);         // under the top, z = 0
  EXPECT_NEAR(bite.edge_distance_m, 0.007, 1e-12);  // from the exit to the face at 10 mm
  EXPECT_TRUE(std::isnan(bite.spacing_m));          // the first
  EXPECT_TRUE(std::isnan(bite.peak_force_n));       // nobody saw it being made
}

TEST_F(Quality, ABiteWithoutADrawnCourseIsTakenStraight) {
  // Under the line the top is 0.4 s away and the side (1 − s): deepest where both are as near.
  bite(0, Vec3(0, 0, 0), Vec3(0.01, 0, -0.004));
  measure();
  ASSERT_EQ(figures().bites.size(), 1U);
  EXPECT_NEAR(figures().bites[0].depth_m, 0.01 * 0.4 / 1.4, 0.1e-3);  // sampled at 16 points
  EXPECT_NEAR(figures().bites[0].edge_distance_m, 0.0, 1e-12);
}

TEST_F(Quality, SpacingIsTakenAlongOneTissue) {
  bite(0, Vec3(0.002, 0, 0), Vec3(0.008, 0, 0));
  bite(1, Vec3(0.014, 0, 0), Vec3(0.018, 0, 0));
  bite(0, Vec3(0.002, 0.003, 0), Vec3(0.008, 0.003, 0));
  bite(1, Vec3(0.014, 0.004, 0), Vec3(0.018, 0.004, 0));
  bite(0, Vec3(0.002, 0.004, 0), Vec3(0.008, 0.004, 0));
  measure();
  const auto& bites = figures().bites;
  ASSERT_EQ(bites.size(), 5U);
  EXPECT_TRUE(std::isnan(bites[0].spacing_m));
  EXPECT_TRUE(std::isnan(bites[1].spacing_m));
  EXPECT_NEAR(bites[2].spacing_m, 0.003, 1e-15);
  EXPECT_NEAR(bites[3].spacing_m, 0.004, 1e-15);
  EXPECT_NEAR(bites[4].spacing_m, 0.001, 1e-15);
  EXPECT_NEAR(bites[1].edge_distance_m, 0.002, 1e-12);  // of the other edge, at 12 mm
  EXPECT_NEAR(figures().spacing_m.mean, 0.008 / 3.0, 1e-15);
  const double mean = 0.008 / 3.0;
  EXPECT_NEAR(figures().spacing_m.deviation,
              std::sqrt((std::pow(0.003 - mean, 2) + std::pow(0.004 - mean, 2) +
                         std::pow(0.001 - mean, 2)) /
                        3.0),
              1e-15);
}

TEST(SpreadOf, LeavesOutWhatIsNoNumber) {
  const std::vector<double> values{1.0, kNoFigure, 2.0, 3.0};
  EXPECT_DOUBLE_EQ(spread_of(values).mean, 2.0);
  EXPECT_DOUBLE_EQ(spread_of(values).deviation, std::sqrt(2.0 / 3.0));
  EXPECT_TRUE(std::isnan(spread_of({}).mean));
}

TEST_F(Quality, ABiteThatTheThreadHasLeftIsGone) {
  bite(0, Vec3(0.002, 0, 0), Vec3(0.008, 0, 0));
  bite(0, Vec3(0.002, 0.003, 0), Vec3(0.008, 0.003, 0));
  measure();
  ASSERT_EQ(figures().bites.size(), 2U);
  threads[0].punctures.resize(2);  // the tail was drawn out of the first
  measure();
  ASSERT_EQ(figures().bites.size(), 1U);
  EXPECT_EQ(figures().bites[0].entry_m, Vec3(0.002, 0.003, 0));
  EXPECT_TRUE(std::isnan(figures().bites[0].spacing_m));
}

TEST_F(Quality, AnOpenBiteIsNone) {
  threads[0].punctures = {{0, Vec3::Zero(), Vec3::Zero(), 0.01, false}};  // the needle is inside
  measure();
  EXPECT_TRUE(figures().bites.empty());
}

TEST_F(Quality, ABitesPeakForceIsThatOfItsMaking) {
  const Vec3 entry(-0.004, 0, 0);
  pull(kDriver, 0.9);  // in the air
  held_by({kDriver});
  needles[0].tip_force_n = 0.04;
  pull(kDriver, 0.05);
  watch();
  happens(EventKind::kPuncture, "block", entry + Vec3(0, 0.0002, -0.0001));
  needles[0].tip_inside = true;
  needles[0].embedded_length_m = 0.001;
  pull(kDriver, 0.02);
  watch();
  pull(kDriver, 0.3);
  watch();
  happens(EventKind::kExit, "block", Vec3(0.004, 0, 0));
  needles[0].tip_inside = false;
  needles[0].tip_force_n = 0.0;
  pull(kDriver, 0.1);
  watch();
  pull(kDriver, 0.8);  // the rest of the needle follows
  watch();
  bite(0, entry, Vec3(0.004, 0, 0));
  bite(0, Vec3(-0.004, 0.006, 0), Vec3(0.004, 0.006, 0));  // of another making
  measure();
  ASSERT_EQ(figures().bites.size(), 2U);
  EXPECT_DOUBLE_EQ(figures().bites[0].peak_force_n, 0.3);
  EXPECT_TRUE(std::isnan(figures().bites[1].peak_force_n));
}

// ------------------------------------------------------------------ the needle

TEST_F(Quality, TheTipsWayAddsUp) {
  watch();
  needles[0].position_m += Vec3(0.003, 0, 0.004);
  watch();
  needles[0].position_m -= Vec3(0.003, 0, 0.004);
  watch();
  EXPECT_NEAR(figures().needle_path_m, 0.01, 1e-15);
  EXPECT_NEAR(figures().elapsed_s, 0.012, 1e-15);
  // Turned by 90° about its tail: the tip goes straight, as seen from step to step.
  needles[0].orientation =
      Eigen::Quaterniond(Eigen::AngleAxisd(EIGEN_PI / 2, Vec3::UnitX())) * needles[0].orientation;
  watch();
  EXPECT_NEAR(figures().needle_path_m, 0.01 + std::sqrt(2.0) * 0.025, 1e-12);
}

TEST_F(Quality, AHandOverIsANeedleThatAnotherToolHas) {
  held_by({kDriver});
  held_by({kDriver, kAssistant});
  EXPECT_EQ(figures().handovers, 0U);  // both have it
  held_by({kDriver});
  EXPECT_EQ(figures().handovers, 0U);  // the other let go again
  held_by({kDriver, kAssistant});
  held_by({kAssistant});
  EXPECT_EQ(figures().handovers, 1U);
  held_by({kDriver});  // within one step
  EXPECT_EQ(figures().handovers, 2U);
  EXPECT_EQ(figures().needle_drops, 0U);
}

TEST_F(Quality, TissueMayHoldTheNeedleBetweenTwoTools) {
  held_by({kDriver});
  needles[0].embedded_length_m = 0.005;
  held_by({});
  held_by({kDriver});
  EXPECT_EQ(figures().handovers, 0U);
  held_by({});
  held_by({kAssistant});
  EXPECT_EQ(figures().handovers, 1U);
  EXPECT_EQ(figures().needle_drops, 0U);
}

TEST_F(Quality, ADropIsANeedleThatNothingHolds) {
  held_by({});  // it starts on no tool: that is no drop
  EXPECT_EQ(figures().needle_drops, 0U);
  held_by({kDriver});
  held_by({});
  held_by({});
  EXPECT_EQ(figures().needle_drops, 1U);
  held_by({kAssistant});  // picked up, not handed over
  EXPECT_EQ(figures().handovers, 0U);
  held_by({});
  EXPECT_EQ(figures().needle_drops, 2U);
}

TEST_F(Quality, OnlyForceOnTissueCounts) {
  const auto peak = [&] {
    watch();
    return figures().peak_force_n;
  };
  pull(kDriver, 5.0);
  held_by({kDriver});
  EXPECT_EQ(peak(), 0.0);  // in the air
  needles[0].tip_force_n = 0.01;
  pull(kDriver, 0.1);
  EXPECT_DOUBLE_EQ(peak(), 0.1);
  needles[0].tip_force_n = 0.0;
  needles[0].embedded_length_m = 0.001;
  pull(kDriver, 0.2);
  EXPECT_DOUBLE_EQ(peak(), 0.2);
  needles[0].embedded_length_m = 0.0;
  threads[0].tension_n = 0.1;  // it pulls the thread
  pull(kDriver, 0.3);
  EXPECT_DOUBLE_EQ(peak(), 0.3);
  EXPECT_EQ(figures().tension_n, 0.1);
  responses[kAssistant].held = {HeldKind::kTissue, 1};
  pull(kAssistant, 0.4);
  EXPECT_DOUBLE_EQ(peak(), 0.4);
  responses[kAssistant].held = {HeldKind::kThread, 0};
  pull(kAssistant, 0.5);
  EXPECT_DOUBLE_EQ(peak(), 0.5);
  responses[kProbe].touching = true;
  pull(kProbe, 0.6);
  EXPECT_DOUBLE_EQ(peak(), 0.6);
}

TEST_F(Quality, TheLargestStressThatWasGivenStays) {
  EXPECT_TRUE(std::isnan(figures().peak_principal_stress_pa));
  meter.note_principal_stress(2e4);
  meter.note_principal_stress(1e4);
  EXPECT_EQ(figures().peak_principal_stress_pa, 2e4);
}

TEST_F(Quality, ThePeakOfTheStressIsThatOfTheSurface) {
  StressField stress;
  stress.vertex_pa.assign(positions.size(), Vec6::Zero());
  const Body& body = sim.bodies()[1];
  const auto at = [](std::int32_t v) { return static_cast<std::size_t>(v); };
  stress.vertex_pa[at(body.first_vertex + body.surface_vertices[3])][1] = 100.0;  // yy
  std::int32_t inside = 0;  // a vertex that no surface uses
  while (std::binary_search(body.surface_vertices.begin(), body.surface_vertices.end(), inside))
    ++inside;
  ASSERT_LT(inside, body.vertex_count);
  stress.vertex_pa[at(body.first_vertex + inside)][1] = 200.0;
  EXPECT_NEAR(peak_principal_stress_pa(stress, sim.bodies()), 100.0, 1e-9);
}

// ------------------------------------------------------------------ as a whole

TEST_F(Quality, AResetForgetsEverything) {
  const ThreadQuality before = figures();
  held_by({kDriver});
  needles[0].position_m.x() += 0.01;
  held_by({kAssistant});
  held_by({});
  bite(0, Vec3(0.002, 0, 0), Vec3(0.008, 0, 0));
  positions[static_cast<std::size_t>(sim.bodies()[1].first_vertex)].x() += 0.01;
  measure();
  meter.note_principal_stress(1.0);
  EXPECT_TRUE(differs(before, figures()));
  meter.reset();
  EXPECT_FALSE(differs(before, figures()));
  EXPECT_EQ(figures().elapsed_s, 0.0);
  held_by({kAssistant});
  EXPECT_EQ(figures().handovers, 0U);
  EXPECT_EQ(figures().needle_path_m, 0.0);
}

TEST_F(Quality, TimeAloneIsNoDifference) {
  ThreadQuality a = figures(), b = a;
  b.elapsed_s += 1.0;
  b.gap.max_m += 1e-9;
  EXPECT_FALSE(differs(a, b));
  b.gap.max_m += 2e-6;
  EXPECT_TRUE(differs(a, b));
  b = a;
  b.gap.max_m = kNoFigure;
  EXPECT_TRUE(differs(a, b));
  b = a;
  b.handovers = 1;
  EXPECT_TRUE(differs(a, b));
  a.bites.resize(1);
  b = a;
  EXPECT_FALSE(differs(a, b));
  b.bites[0].depth_m += 1e-3;
  EXPECT_TRUE(differs(a, b));
}

TEST_F(Quality, ARealPunctureShowsInTheFigures) {
  std::vector<ToolInput> inputs(kBlockTools);
  const Vec3 tail(0.0011, 0.0007, 0.0205);
  const auto step = [&](double z_m, double jaw) {
    inputs[kDriver] = tool_at(tail - Vec3(0, 0, z_m), jaw);
    sim.step(inputs, 0.004);
    meter.watch(quality_view(sim));
  };
  step(0.0, 0.0);
  step(0.0, 1.0);
  double z_m = 0.0;
  while (z_m < 0.005) step(z_m += 4e-5, 1.0);
  sim.update_displacements();
  meter.measure(quality_view(sim));
  ASSERT_TRUE(sim.needles()[0].tip_inside);
  EXPECT_GT(figures().peak_force_n, 0.9 * scene.tissues[0].puncture_force_n);
  EXPECT_LT(figures().peak_force_n, 3.0 * scene.tissues[0].puncture_force_n);
  // The grip gives way by F / 2000 N/m, a few hundredths of a millimetre, and comes back.
  EXPECT_NEAR(figures().needle_path_m, z_m, 2e-4);
  EXPECT_EQ(figures().needle_drops, 0U);
  EXPECT_NEAR(figures().gap.max_m, kGap_m, 5e-4);  // the block gives way under the needle
}

}  // namespace
}  // namespace sutured::simulation
