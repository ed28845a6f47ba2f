// SPDX-License-Identifier: GPL-3.0-or-later
// A simulation cut in two: what another instance goes on with is the state, whole, or nothing.
#include <gtest/gtest.h>

#include <algorithm>
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
  for (int i = 0; i < 20; ++i) {
    hands.at(0).position_m.x() += 2e-5;
    hands.step();
    other.step(hands.inputs, hands.step_s);
  }
  // K's condition is some 1e4: rounding of 1e-16 shows below 1e-9 of the force.
  EXPECT_LT((other.responses()[0].wrench - hands.response(0).wrench).head<3>().norm(),
            1e-7 * hands.force_n(0).norm());
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
