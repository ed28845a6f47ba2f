// SPDX-License-Identifier: GPL-3.0-or-later
// Laws that hold on any scene and under any hands: balance, complementarity, energy.
#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "soak/checks.hpp"
#include "soak/hands.hpp"
#include "support/hands.hpp"

namespace sutured::simulation {
namespace {

using geometry::Vec3;
using testing::Hands;
using testing::kAssistant;
using testing::kDriver;
using testing::kProbe;
using testing::Random;
using testing::RandomTissue;

/// A random surgeon plays on a random scene while `each_step(hands)` looks on.
template <class EachStep>
void play(std::uint64_t seed, int steps, EachStep&& each_step) {
  Hands hands(testing::random_scene(seed));
  hands.step_s = 1.0 / hands.scene.rate_hz;
  soak::Surgeon surgeon(seed, seed % 2 == 0 ? soak::Temper::kSensible : soak::Temper::kWild,
                        hands.scene);
  for (int i = 0; i < steps; ++i) {
    hands.inputs = surgeon.next(hands.sim, hands.step_s);
    hands.step();
    surgeon.see(hands.sim.events());
    each_step(hands);
    if (::testing::Test::HasFatalFailure()) return;
  }
}

class LawsOfRandomSurgeons : public ::testing::TestWithParam<int> {
 protected:
  [[nodiscard]] std::uint64_t seed() const { return 5000 + static_cast<std::uint64_t>(GetParam()); }
};

/// K u against the rows' forces at each free degree of freedom, summed against what the fixture
/// carries, and against the hands and the needle's weak spring to its last pose (0.05 N/m, 5 N/m
/// where nobody holds it).
TEST_P(LawsOfRandomSurgeons, ActionEqualsReaction) {
  Vec3 needle_before = Vec3::Zero();
  bool first = true;
  play(seed(), 120, [&](Hands& hands) {
    const fem::Model model = assemble_model(hands.scene);
    const std::vector<double> internal_n = fem::internal_forces_n(model, hands.displacements_m());
    std::vector<double> rows_n;
    hands.sim.constraint_forces_n(rows_n);
    double scale_n = 1e-3;
    for (std::size_t dof = 0; dof < rows_n.size(); ++dof)
      scale_n = std::max({scale_n, std::abs(rows_n[dof]), std::abs(internal_n[dof])});
    Vec3 of_rows = Vec3::Zero(), of_fixture = Vec3::Zero(), of_loads = Vec3::Zero();
    for (std::size_t dof = 0; dof < rows_n.size(); ++dof) {
      const auto axis = static_cast<Eigen::Index>(dof % 3);
      of_rows[axis] += rows_n[dof];
      if (model.prescribed[dof]) {
        of_fixture[axis] += internal_n[dof] - rows_n[dof];
      } else {
        of_loads[axis] += model.load_n[dof];
        ASSERT_NEAR(internal_n[dof], rows_n[dof] + model.load_n[dof], 1e-9 * scale_n);
      }
    }
    ASSERT_LT((of_rows + of_loads + of_fixture).norm(), 1e-9 * scale_n);

    Vec3 of_tools = Vec3::Zero();
    for (std::size_t t = 0; t < hands.inputs.size(); ++t)
      of_tools += hands.force_n(static_cast<int>(t));
    const NeedleState& needle = hands.sim.needles()[0];
    // Only where the needle's last motion is known: one substep, and no slide given beforehand.
    if (!first && hands.sim.report().substeps == 1 &&
        hands.scene.needles[0].slide == scene::SlideRule::kEnergyConsistent) {
      const double spring_n_per_m = needle.holder >= 0 ? 0.05 : 5.0;
      const Vec3 of_spring = -spring_n_per_m * (needle.position_m - needle_before);
      ASSERT_LT((of_rows + of_tools - of_spring).norm(), 1e-9 * scale_n);
    }
    needle_before = needle.position_m;
    first = false;
  });
}

TEST_P(LawsOfRandomSurgeons, ComplementarityIsSolvedAndTensionIsNeverNegative) {
  int taut = 0;
  play(seed(), 250, [&](Hands& hands) {
    ASSERT_LE(hands.sim.report().complementarity_residual, 1e-8);
    for (const ThreadState& thread : hands.sim.threads()) {
      ASSERT_GE(thread.tension_n, 0.0);
      for (const double tension_n : thread.segment_tension_n) ASSERT_GE(tension_n, 0.0);
      taut += thread.taut;
    }
    for (const ContactPoint& contact : hands.sim.contacts()) ASSERT_GT(contact.force_n, 0.0);
  });
  RecordProperty("taut_steps", taut);
}

INSTANTIATE_TEST_SUITE_P(Seeds, LawsOfRandomSurgeons, ::testing::Range(0, 12));

/// Keeps the books of energy by the trapezoid rule: what hands and length programs put in, and what
/// is stored.
class Books {
 public:
  explicit Books(Hands& hands) : hands_(hands) { note(); }

  /// Steps once, and counts the work.
  void step() {
    const auto inputs = last_inputs_;
    const auto wrenches = wrench_;
    const auto tensions = tension_n_;
    const auto lengths = length_m_;
    hands_.step();
    note();
    for (std::size_t t = 0; t < inputs.size(); ++t) {
      const Vec3 way = last_inputs_[t].position_m - inputs[t].position_m;
      const Vec3 turn =
          needle::rotation_vector(last_inputs_[t].orientation * inputs[t].orientation.conjugate());
      const Vec6 sum = wrenches[t] + wrench_[t];
      const double work = -0.5 * (sum.head<3>().dot(way) + sum.tail<3>().dot(turn));
      work_j_ += work;
      moved_j_ += std::abs(work);
    }
    for (std::size_t t = 0; t < lengths.size(); ++t)
      if (hands_.scene.threads[t].ends == scene::ThreadEnds::kNone)
        work_j_ -= 0.5 * (tensions[t] + tension_n_[t]) * (length_m_[t] - lengths[t]);
  }

  /// ½ uᵀ K u + ½ Σ ε λ², where no loads act.
  [[nodiscard]] double stored_j() {
    const auto u = hands_.displacements_m();
    const auto f = fem::internal_forces_n(assemble_model(hands_.scene), u);
    return 0.5 * std::inner_product(u.begin(), u.end(), f.begin(), 0.0) + hands_.sim.row_energy_j();
  }
  [[nodiscard]] double work_j() const { return work_j_; }
  /// Work there and back, counted positive.
  [[nodiscard]] double moved_j() const { return moved_j_; }

 private:
  void note() {
    last_inputs_ = hands_.inputs;
    wrench_.clear();
    for (const ToolResponse& response : hands_.sim.responses()) wrench_.push_back(response.wrench);
    tension_n_.clear();
    length_m_.clear();
    for (const ThreadState& thread : hands_.sim.threads()) {
      tension_n_.push_back(thread.tension_n);
      length_m_.push_back(thread.length_m);
    }
  }

  Hands& hands_;
  std::vector<ToolInput> last_inputs_;
  std::vector<Vec6> wrench_;
  std::vector<double> tension_n_, length_m_;
  double work_j_ = 0.0, moved_j_ = 0.0;
};

/// A random tissue with strong hands and without a needle in the way.
class EnergyIsTheWorkDone : public ::testing::TestWithParam<int> {
 protected:
  EnergyIsTheWorkDone()
      : random_(7000 + static_cast<std::uint64_t>(GetParam())),
        kind_(static_cast<RandomTissue>(GetParam() % 3)),
        scene_(testing::random_tissue(random_, kind_)) {
    scene::Scene block = testing::block_scene(2);
    scene_.needles = block.needles;
    scene_.needles[0].pose.position_m = Vec3(0.2, 0.2, 0.2);
    scene_.tools = block.tools;
    for (scene::Tool& tool : scene_.tools) tool.grip_force_max_n = 100.0;
    scene_.contact.enabled = false;
  }

  void stitch(int stitches, scene::ThreadModel model) {
    scene::Thread thread;
    thread.name = "thread";
    thread.punctures = testing::random_stitches(random_, scene_, kind_, stitches);
    thread.model = model;
    thread.head = scene::ThreadHead::kFree;
    thread.tail = scene::ThreadTail::kAnchored;
    thread.tension_max_n = 100.0;
    thread.length_m = 0.2;
    scene_.threads.push_back(thread);
  }
  [[nodiscard]] Vec3 some_surface() {
    const auto& mesh = scene_.tissues[0].mesh;
    const auto v =
        static_cast<std::size_t>(random_.below(static_cast<int>(mesh.vertices_m.size())));
    const scene::Bite bite = testing::nearest_on_surface(scene_, 0, mesh.vertices_m[v]);
    Vec3 sum = Vec3::Zero();
    for (std::size_t i = 0; i < 3; ++i)
      sum += bite.barycentric[static_cast<Eigen::Index>(i)] *
             mesh.vertices_m[static_cast<std::size_t>(bite.vertices[i])];
    return sum;
  }
  [[nodiscard]] scene::ThreadModel model() const {
    return GetParam() % 2 == 0 ? scene::ThreadModel::kOutside : scene::ThreadModel::kPath;
  }

  Random random_;
  RandomTissue kind_;
  scene::Scene scene_;
};

// 1 %: the trapezoid rule over some hundred steps, and normals that are those of the step before.
constexpr double kEnergyTolerance = 0.01;

TEST_P(EnergyIsTheWorkDone, ByAHandThatHoldsTissue) {
  Hands hands(scene_);
  hands.grasp(kDriver, some_surface());
  ASSERT_EQ(hands.count(EventKind::kGrasp), 1);
  Books books(hands);
  double most_j = 0.0;
  for (int leg = 0; leg < 4; ++leg) {
    const Vec3 way = 1.5e-3 * random_.direction();
    for (int i = 0; i < 60; ++i) {
      hands.at(kDriver).position_m += way / 60.0;
      books.step();
    }
    most_j = std::max(most_j, books.stored_j());
    EXPECT_NEAR(books.stored_j(), books.work_j(), kEnergyTolerance * most_j) << "leg " << leg;
  }
  EXPECT_GT(most_j, 1e-7);
}

TEST_P(EnergyIsTheWorkDone, ByAJawThatPullsThread) {
  stitch(2, model());
  Hands hands(scene_);
  hands.step();
  hands.grasp(kDriver, hands.thread().punctures.front().position_m);
  ASSERT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  const Vec3 out = hands.thread().punctures.front().position_m;
  const Vec3 away = (out - Vec3(0.0, 0.0, out[2]) + Vec3(0, 0, 2e-3)).normalized();
  // Slack, as the thread was laid, until it reaches: no force, no work.
  Books books(hands);
  double most_j = 0.0;
  for (int i = 0; i < 400 && hands.thread().tension_n < 0.3; ++i) {
    hands.at(kDriver).position_m += 1e-5 * away;
    books.step();
  }
  ASSERT_GT(hands.thread().tension_n, 0.05);
  for (int leg = 0; leg < 3; ++leg) {
    most_j = std::max(most_j, books.stored_j());
    EXPECT_NEAR(books.stored_j(), books.work_j(), kEnergyTolerance * most_j) << "leg " << leg;
    const Vec3 way = (leg == 1 ? -3e-4 : 2e-4) * away + 3e-4 * random_.direction();
    for (int i = 0; i < 50; ++i) {
      hands.at(kDriver).position_m += way / 50.0;
      books.step();
    }
  }
  EXPECT_GT(most_j, 1e-7);
  EXPECT_EQ(hands.count(EventKind::kLimit) + hands.count(EventKind::kGripSlip), 0);
}

TEST_P(EnergyIsTheWorkDone, ByALengthProgram) {
  bool touching = false;
  for (const bool contact : {false, true}) {
    scene::Scene scene = scene_;
    stitch(3, model());
    scene.threads = std::exchange(scene_.threads, {});
    scene.contact.enabled = contact;
    scene::Thread& thread = scene.threads[0];
    thread.ends = scene::ThreadEnds::kNone;
    const double length_m = Hands(scene).thread().length_m;
    thread.length_program = {{0.0, length_m}, {1.0, 0.75 * length_m}, {1.2, 0.75 * length_m}};
    Hands hands(scene, 0.002);
    Books books(hands);
    double most_j = 0.0;
    for (int i = 0; i < 600; ++i) {
      books.step();
      if (i % 100 != 99) continue;
      most_j = std::max(most_j, books.stored_j());
      EXPECT_NEAR(books.stored_j(), books.work_j(), kEnergyTolerance * most_j)
          << "step " << i << (contact ? ", with contact" : "");
    }
    EXPECT_GT(hands.thread().tension_n, 1e-3);
    EXPECT_EQ(hands.count(EventKind::kLimit), 0);
    touching = touching || (contact && hands.sim.report().contacts > 3);
  }
  EXPECT_EQ(touching, kind_ != RandomTissue::kBlock);  // tubes and slits close
}

TEST_P(EnergyIsTheWorkDone, ByAProbeThatPresses) {
  Hands hands(scene_);
  // Before the middle of a free side.
  Vec3 at(random_.in(-3e-3, 3e-3), random_.in(-3e-3, 3e-3), 0.0), out = Vec3::UnitZ();
  if (kind_ == RandomTissue::kSlit) at[0] -= 6e-3;
  if (kind_ == RandomTissue::kTubes) {
    const double angle = random_.in(0.0, 2.0 * EIGEN_PI);
    out = Vec3(std::cos(angle), std::sin(angle), 0.0);
    at = 5e-3 * out - Vec3(0.0, 0.0, 5e-3);
  }
  const double radius_m = hands.scene.tools[kProbe].probe_radius_m;
  hands.at(kProbe) = testing::tool_at(at + (radius_m + 1e-5) * out);
  hands.step();
  ASSERT_EQ(hands.force_n(kProbe).norm(), 0.0);
  Books books(hands);
  double most_j = 0.0;
  for (int leg = 0; leg < 3; ++leg) {
    const Vec3 way =
        leg == 1 ? Vec3(2e-4 * random_.direction()) : Vec3((leg == 0 ? -6e-4 : 3e-4) * out);
    for (int i = 0; i < 300; ++i) {
      hands.at(kProbe).position_m += way / 300.0;
      books.step();
    }
    most_j = std::max(most_j, books.stored_j());
    EXPECT_NEAR(books.stored_j(), books.work_j(), kEnergyTolerance * most_j) << "leg " << leg;
  }
  EXPECT_GT(most_j, 1e-7);
}

/// Less than what pierces, and within the cone of friction: the tip stands where it came down.
TEST_P(EnergyIsTheWorkDone, ByANeedleWhoseTipPresses) {
  scene::Scene scene = testing::block_scene();
  scene.tissues[0].puncture_force_n = 10.0;
  const Vec3 tail(random_.in(-3e-3, 3e-3), random_.in(-3e-3, 3e-3), 0.0205);
  scene.needles[0].pose.position_m += tail - Vec3(0.0011, 0.0007, 0.0205);
  Hands hands(scene);
  hands.grasp(kDriver, tail);
  while (hands.force_n(kDriver).norm() < 1e-3) hands.move_by(kDriver, Vec3(0, 0, -1e-5));
  Books books(hands);
  const double begun_j = books.stored_j();
  double most_j = 0.0;
  for (int leg = 0; leg < 3; ++leg) {
    const Vec3 way =
        leg == 1 ? Vec3(2e-5 * random_.direction()) : Vec3(0, 0, leg == 0 ? -2e-4 : 1e-4);
    for (int i = 0; i < 300; ++i) {
      hands.at(kDriver).position_m += way / 300.0;
      books.step();
    }
    most_j = std::max(most_j, books.stored_j());
    EXPECT_NEAR(books.stored_j() - begun_j, books.work_j(), kEnergyTolerance * most_j)
        << "leg " << leg;
  }
  EXPECT_GT(most_j, 1e-7);
  EXPECT_GT(hands.force_n(kDriver).norm(), 0.01);
  EXPECT_EQ(hands.count(EventKind::kPuncture), 0);
}

INSTANTIATE_TEST_SUITE_P(Seeds, EnergyIsTheWorkDone, ::testing::Range(0, 6));

/// Takes a tool round a closed loop in `steps` steps and returns the work of the hand: an ellipse
/// in the plane of `a` and `b`, tilting to and fro by `tilt`, forwards or backwards.
struct Loop {
  Vec3 a, b, tilt;
  bool forwards;
};

struct LoopWork {
  double hand_j = 0.0;   ///< what the hand put in
  double moved_j = 0.0;  ///< work there and back, counted positive
};

LoopWork work_of(Hands& hands, int tool, const Loop& loop, int steps) {
  const ToolInput home = hands.at(tool);
  Books books(hands);
  for (int i = 1; i <= steps; ++i) {
    const double angle = (loop.forwards ? 2.0 : -2.0) * EIGEN_PI * i / steps;
    ToolInput& input = hands.at(tool);
    input.position_m =
        home.position_m + std::sin(angle) * loop.a + (1.0 - std::cos(angle)) * loop.b;
    const Vec3 turn = std::sin(angle + 1.0) * loop.tilt - std::sin(1.0) * loop.tilt;
    const double size = turn.norm();
    input.orientation =
        size > 0.0 ? Eigen::Quaterniond(Eigen::AngleAxisd(size, turn / size)) * home.orientation
                   : home.orientation;
    if (i == steps) input = home;
    books.step();
  }
  return {books.work_j(), books.moved_j()};
}

// 1 % of what went there and back: the trapezoid rule over 400 steps, and a first loop that
// settles.
constexpr double kLoopTolerance = 0.01;

class ALoopGivesTheHandNoEnergy : public ::testing::TestWithParam<bool> {};

TEST_P(ALoopGivesTheHandNoEnergy, WithANeedleInTissue) {
  Hands hands(testing::block_scene());
  const Vec3 tail(0.0011, 0.0007, 0.0205);
  hands.grasp(kDriver, tail);
  hands.move(kDriver, tail - Vec3(0, 0, 0.006));
  hands.move_by(kDriver, Vec3(3e-4, 0, 0));
  hands.step(200);
  ASSERT_TRUE(hands.sim.needles()[0].tip_inside);
  const Loop loops[] = {{Vec3(3e-4, 0, 0), Vec3(0, 2e-4, 0), Vec3(0, 0, 0), GetParam()},
                        {Vec3(2e-4, 1e-4, 0), Vec3(0, 1e-4, 3e-4), Vec3(0, 0, 0), GetParam()},
                        {Vec3(0, 0, 3e-4), Vec3(2e-4, 0, 0), Vec3(0.02, 0.03, 0.01), GetParam()}};
  for (const Loop& loop : loops) {
    (void)work_of(hands, kDriver, loop, 400);
    const LoopWork work = work_of(hands, kDriver, loop, 400);
    EXPECT_GT(work.moved_j, 1e-7);
    EXPECT_GT(work.hand_j, -kLoopTolerance * work.moved_j);
  }
}

/// Nothing rubs: what goes in comes out.
TEST_P(ALoopGivesTheHandNoEnergy, WithATautThread) {
  for (const auto model : {scene::ThreadModel::kOutside, scene::ThreadModel::kPath}) {
    Random random(31);
    scene::Scene scene = testing::random_tissue(random, RandomTissue::kSlit);
    const scene::Scene block = testing::block_scene(2);
    scene.needles = block.needles;
    scene.needles[0].pose.position_m = Vec3(0.2, 0.2, 0.2);
    scene.tools = block.tools;
    scene.contact.enabled = false;
    scene::Thread thread;
    thread.name = "thread";
    thread.punctures = testing::random_stitches(random, scene, RandomTissue::kSlit, 3);
    thread.model = model;
    thread.head = scene::ThreadHead::kFree;
    thread.tension_max_n = 10.0;
    thread.length_m = 0.2;
    scene.threads.push_back(thread);
    Hands hands(scene);
    hands.step();
    hands.grasp(kDriver, hands.thread().punctures.front().position_m);
    ASSERT_EQ(hands.last(EventKind::kGrasp).object, "thread");
    hands.move_by(kDriver, Vec3(3e-3, 0.0, 3e-3));
    ASSERT_GT(hands.thread().tension_n, 0.05);
    const Loop loop{Vec3(3e-4, 0, 3e-4), Vec3(0, 3e-4, 0), Vec3(0.02, 0.0, 0.03), GetParam()};
    (void)work_of(hands, kDriver, loop, 400);
    const LoopWork work = work_of(hands, kDriver, loop, 400);
    EXPECT_GT(work.moved_j, 1e-6);
    EXPECT_LT(std::abs(work.hand_j), kLoopTolerance * work.moved_j);
    EXPECT_GT(hands.thread().tension_n, 0.05);
  }
}

TEST_P(ALoopGivesTheHandNoEnergy, WithTheTipOnTheSurface) {
  scene::Scene scene = testing::block_scene();
  scene.tissues[0].puncture_force_n = 10.0;  // never
  Hands hands(scene);
  const Vec3 tail(0.0011, 0.0007, 0.0205);
  hands.grasp(kDriver, tail);
  hands.move(kDriver, tail - Vec3(0, 0, 0.001));
  hands.step(200);
  ASSERT_GT(hands.force_n(kDriver).norm(), 0.01);
  // Within the cone it stands, beyond it slides and rubs, and it lifts and comes down again.
  const Loop stands{Vec3(3e-5, 0, 0), Vec3(0, 2e-5, 1e-5), Vec3::Zero(), GetParam()};
  const Loop slides{Vec3(1.5e-3, 0, 0), Vec3(0, 1e-3, 0), Vec3::Zero(), GetParam()};
  const Loop lifts{Vec3(2e-4, 0, 0), Vec3(0, 0, 5e-4), Vec3::Zero(), GetParam()};
  for (const Loop& loop : {stands, slides, lifts}) {
    (void)work_of(hands, kDriver, loop, 400);
    const LoopWork work = work_of(hands, kDriver, loop, 400);
    EXPECT_GT(work.moved_j, 1e-9);
    const double rubbed = loop.a[0] > 1e-3 ? 0.1 : -kLoopTolerance;
    EXPECT_GT(work.hand_j, rubbed * work.moved_j);
  }
  EXPECT_EQ(hands.count(EventKind::kPuncture), 0);
}

INSTANTIATE_TEST_SUITE_P(BothWays, ALoopGivesTheHandNoEnergy, ::testing::Bool());

}  // namespace
}  // namespace sutured::simulation
