// SPDX-License-Identifier: GPL-3.0-or-later
// A simulation cut in two: what another instance goes on with is the state, whole, or nothing.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "soak/hands.hpp"
#include "support/block_scene.hpp"
#include "support/closure_scene.hpp"
#include "support/hands.hpp"
#include "support/random_scene.hpp"

namespace sutured::simulation {
namespace {

using Bytes = std::vector<std::byte>;
using Caches = Archive::Caches;

Bytes saved(Simulation& simulation, Caches caches = Caches::kKept) {
  Bytes bytes;
  Archive archive = Archive::writing(bytes, caches);
  archive(simulation);
  return bytes;
}

void restore(Simulation& simulation, std::span<const std::byte> bytes) {
  Archive archive = Archive::reading(bytes);
  archive(simulation);
  archive.expect_end();
}

/// Steps and what came of them, displacements brought up to date now and then, as a display does.
struct Recording {
  std::vector<std::vector<ToolInput>> inputs;
  std::vector<Bytes> after;  ///< the whole state behind each step
};

void play_step(Simulation& simulation, const Recording& recording, std::size_t step, double dt_s) {
  simulation.step(recording.inputs[step], dt_s);
  if (step % 3 == 1) simulation.update_displacements();
}

/// Returns the first step behind the cut that comes out otherwise, or the number of steps.
std::size_t first_difference(Simulation& simulation, const Recording& recording, std::size_t cut,
                             double dt_s) {
  restore(simulation, recording.after[cut]);
  if (saved(simulation) != recording.after[cut]) return cut;
  for (std::size_t step = cut + 1; step < recording.inputs.size(); ++step) {
    play_step(simulation, recording, step, dt_s);
    if (saved(simulation) != recording.after[step]) return step;
  }
  return recording.inputs.size();
}

class RandomSurgeon : public ::testing::TestWithParam<std::uint64_t> {};

TEST_P(RandomSurgeon, GoesOnToTheBitFromAnyStep) {
  const scene::Scene scene = testing::random_scene(GetParam());
  const double dt_s = 1.0 / scene.rate_hz;
  constexpr std::size_t kSteps = 150;
  Recording recording;
  Simulation simulation(scene);
  soak::Surgeon surgeon(GetParam(),
                        GetParam() % 2 == 0 ? soak::Temper::kSensible : soak::Temper::kWild, scene);
  for (std::size_t step = 0; step < kSteps; ++step) {
    recording.inputs.push_back(surgeon.next(simulation, dt_s));
    play_step(simulation, recording, step, dt_s);
    surgeon.see(simulation.events());
    recording.after.push_back(saved(simulation));
  }
  Simulation fresh(scene);
  EXPECT_EQ(first_difference(fresh, recording, 0, dt_s), kSteps);
  // Back, and back again, in an instance that has seen other steps.
  for (std::size_t cut : {110, 71, 25, 140})
    EXPECT_EQ(first_difference(fresh, recording, cut, dt_s), kSteps) << "cut at " << cut;
  EXPECT_EQ(first_difference(simulation, recording, 50, dt_s), kSteps);
}

INSTANTIATE_TEST_SUITE_P(Seeds, RandomSurgeon, ::testing::Range<std::uint64_t>(1, 11));

/// The paper's closure: threads in place, prepared columns, hundreds of contact rows that come and
/// go.
TEST(Checkpoint, AClosureGoesOnToTheBit) {
  testing::ClosureOptions options;
  options.shortening_m = testing::closing_shortening_m(20);
  options.speed_m_per_s = 30e-3;  // closed by step 20 or so: at rest, rows are held
  const scene::Scene scene = testing::closure_scene(options).scene;
  const double dt_s = 1.0 / scene.rate_hz;
  Recording recording;
  Simulation simulation(scene);
  recording.inputs.resize(120);
  for (std::size_t step = 0; step < recording.inputs.size(); ++step) {
    play_step(simulation, recording, step, dt_s);
    recording.after.push_back(saved(simulation));
  }
  EXPECT_GT(simulation.report().active_unilateral_rows, 10);
  Simulation other(scene);
  for (std::size_t cut : {7, 33, 50, 112})
    EXPECT_EQ(first_difference(other, recording, cut, dt_s), recording.inputs.size());
}

/// Without the caches the state is smaller, and goes on up to rounding.
TEST(Checkpoint, WithoutCachesForcesAreTheSameUpToRounding) {
  testing::Hands hands(testing::block_scene());
  hands.grasp(testing::kDriver, {0.0011, 0.0007, 0.0205});
  hands.move_by(testing::kDriver, {0.0, 0.0, -0.004});
  hands.move_by(testing::kDriver, {0.0005, 0.0, 0.0});
  ASSERT_TRUE(hands.sim.needles()[0].tip_inside);
  ASSERT_GT(hands.force_n(0).norm(), 1e-3);
  const Bytes whole = saved(hands.sim), light = saved(hands.sim, Caches::kLeftOut);
  EXPECT_LT(light.size(), whole.size());  // how much smaller depends on the scene
  Simulation other(hands.scene);
  restore(other, light);
  EXPECT_EQ(saved(other, Caches::kLeftOut), light);
  // What is shown and not archived is there again.
  ASSERT_EQ(other.needles()[0].punctures.size(), 1U);
  hands.sim.update_displacements();
  other.update_displacements();
  EXPECT_LT(
      (other.needles()[0].punctures[0].position_m - hands.sim.needles()[0].punctures[0].position_m)
          .norm(),
      1e-9);
  for (int i = 0; i < 20; ++i) {
    hands.at(0).position_m.x() += 2e-5;
    hands.step();
    other.step(hands.inputs, hands.step_s);
  }
  // K's condition is some 1e4: rounding of 1e-16 shows below 1e-9 of the force.
  EXPECT_LT((other.responses()[0].wrench - hands.response(0).wrench).head<3>().norm(),
            1e-7 * hands.force_n(0).norm());
}

/// Expects the same thread in both: the same bites at the same rest positions, now within
/// `tolerance_m` of each other, and the same holders of its ends.
void expect_same_bites(const ThreadState& actual, const ThreadState& expected, double tolerance_m) {
  ASSERT_EQ(actual.punctures.size(), expected.punctures.size());
  for (std::size_t i = 0; i < expected.punctures.size(); ++i) {
    const ThreadPuncture &a = actual.punctures[i], &b = expected.punctures[i];
    EXPECT_EQ(a.tissue, b.tissue) << i;
    EXPECT_EQ(a.inward, b.inward) << i;
    EXPECT_EQ(a.rest_position_m, b.rest_position_m) << i;
    EXPECT_LE((a.position_m - b.position_m).norm(), tolerance_m) << i;
    EXPECT_LE(std::abs(a.arc_length_m - b.arc_length_m), tolerance_m) << i;
  }
  EXPECT_EQ(actual.head, expected.head);
  EXPECT_EQ(actual.head_holder, expected.head_holder);
  EXPECT_EQ(actual.tail, expected.tail);
  EXPECT_EQ(actual.tail_holder, expected.tail_holder);
  EXPECT_EQ(actual.taut, expected.taut);
}

/// Returns how far apart the tissues of both lie at most.
double farthest_m(Simulation& first, Simulation& second) {
  first.update_displacements();
  second.update_displacements();
  double farthest = 0.0;
  for (std::size_t v = 0; v < first.positions_m().size(); ++v)
    farthest = std::max(farthest, (first.positions_m()[v] - second.positions_m()[v]).norm());
  return farthest;
}

/// Some hundredfold what rounding comes to, of movements of a millimetre and more.
constexpr double kRounding_m = 1e-12;

/// What a server resumes from: two vessels half pulled together by a thread through twenty
/// punctures, which goes on pulling.
TEST(Checkpoint, WithoutCachesAClosureIsPulledOn) {
  testing::ClosureOptions options;
  options.shortening_m = testing::closing_shortening_m(20);
  options.speed_m_per_s = 30e-3;
  const testing::Closure closure = testing::closure_scene(options);
  const double dt_s = 1.0 / closure.scene.rate_hz;
  Simulation simulation(closure.scene);
  for (int i = 0; i < 10; ++i) simulation.step({}, dt_s);
  simulation.update_displacements();
  const double cut_gap_m = testing::mean_gap_m(closure, simulation.positions_m());
  Simulation other(closure.scene);
  restore(other, saved(simulation, Caches::kLeftOut));
  ASSERT_EQ(other.threads()[0].punctures.size(), 20U);
  expect_same_bites(other.threads()[0], simulation.threads()[0], 0.0);
  for (int i = 0; i < 20; ++i) {
    simulation.step({}, dt_s);
    other.step({}, dt_s);
    ASSERT_LT(farthest_m(other, simulation), kRounding_m) << "step " << i;
    expect_same_bites(other.threads()[0], simulation.threads()[0], kRounding_m);
    const double tension_n = simulation.threads()[0].tension_n;
    EXPECT_NEAR(other.threads()[0].tension_n, tension_n, 1e-9 * tension_n);
  }
  EXPECT_LT(testing::mean_gap_m(closure, simulation.positions_m()), cut_gap_m - 3e-4);
  EXPECT_GT(simulation.report().active_unilateral_rows, 0);  // rims that meet
}

/// Bites that the scene knows nothing of: the needle has made them, and the hand pulls the thread
/// taut through them.
TEST(Checkpoint, WithoutCachesAThreadKeepsTheBitesOfItsNeedle) {
  testing::Hands hands(testing::swaged_scene(scene::ThreadTail::kAnchored));
  const double half_m = EIGEN_PI * 4e-3;
  hands.grasp(testing::kDriver, hands.on_needle(0.05));
  hands.along(testing::kDriver, 1.03 * half_m, 0.03);
  hands.grasp(testing::kAssistant, hands.on_needle(0.97));
  hands.let_go(testing::kDriver);
  hands.along(testing::kAssistant, 1.05 * half_m, 0.03);
  hands.move_by(testing::kAssistant, {0.0, 0.0, 0.040}, 0.05);
  ASSERT_EQ(hands.thread().punctures.size(), 2U);
  ASSERT_FALSE(hands.thread().taut);
  Simulation other(hands.scene);
  ASSERT_EQ(other.threads()[0].punctures.size(), 0U);
  restore(other, saved(hands.sim, Caches::kLeftOut));
  expect_same_bites(other.threads()[0], hands.thread(), 0.0);
  const auto step_both = [&] {
    hands.step();
    other.step(hands.inputs, hands.step_s);
    ASSERT_LT(farthest_m(other, hands.sim), kRounding_m);
    expect_same_bites(other.threads()[0], hands.thread(), kRounding_m);
  };
  for (int i = 0; i < 40; ++i) {
    hands.at(testing::kAssistant).position_m.z() += 2e-4;
    step_both();
  }
  EXPECT_TRUE(hands.thread().taut);
  const double tension_n = hands.thread().tension_n;
  EXPECT_GT(tension_n, 0.01);
  EXPECT_NEAR(other.threads()[0].tension_n, tension_n, 1e-9 * tension_n);
}

TEST(Checkpoint, OneThatEndsEarlyLeavesTheStart) {
  testing::Hands hands(testing::random_scene(4));
  const Bytes start = saved(hands.sim);
  hands.step(5);
  const Bytes whole = saved(hands.sim);
  for (std::size_t size = 1; size < whole.size(); size += 1 + whole.size() / 97) {
    EXPECT_THROW(restore(hands.sim, std::span(whole).first(size)), ArchiveError) << size;
    EXPECT_EQ(hands.sim.time_s(), 0.0);
  }
  hands.sim.reset();
  hands.step(5);
  EXPECT_EQ(saved(hands.sim), whole);
}

TEST(Checkpoint, OneOfAnotherSceneIsRefused) {
  Simulation first(testing::random_scene(4)), second(testing::random_scene(5));
  EXPECT_THROW(restore(second, saved(first)), ArchiveError);
}

}  // namespace
}  // namespace sutured::simulation
