// SPDX-License-Identifier: GPL-3.0-or-later
// What a thread does in the hands: it follows its needle, feeds through its bites, pulls, slips.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "geometry/closest_point.hpp"
#include "support/fem_model.hpp"
#include "support/hands.hpp"
#include "support/random_scene.hpp"
#include "thread/course.hpp"
#include "thread/segment.hpp"

namespace sutured::simulation {
namespace {

using geometry::Vec3;
using testing::Hands;
using testing::kAssistant;
using testing::kDriver;

/// The block with the needle out of the way and one thread: `bites` of 4 mm across x, 2 mm apart in
/// y, both ends free. Thread from tail to head: 30 mm, the bites, 30 mm.
scene::Scene stitched(int bites, scene::ThreadModel model = scene::ThreadModel::kOutside) {
  scene::Scene scene = testing::block_scene(6);
  scene.contact.enabled = false;  // one body: it does not touch itself
  scene.needles[0].pose.position_m += Vec3(0.05, 0.0, 0.0);
  for (scene::Tool& tool : scene.tools) tool.capture_radius_m = 0.001;
  scene::Thread thread;
  thread.name = "thread";
  thread.head = scene::ThreadHead::kFree;
  thread.tail = scene::ThreadTail::kFree;
  thread.model = model;
  thread.tail_length_m = 0.03;
  thread.tension_max_n = 2.0;
  for (int i = 0; i < bites; ++i) {
    const double y = 2e-3 * (i - 0.5 * (bites - 1)) + 3e-4;
    // To and fro, as a running suture.
    const double x = i % 2 == 0 ? 2.1e-3 : -2.1e-3;
    thread.punctures.push_back(testing::nearest_on_surface(scene, 0, Vec3(-x, y, 0.0)));
    thread.punctures.push_back(testing::nearest_on_surface(scene, 0, Vec3(x, y, 0.0)));
  }
  thread.length_m = 0.06 + 4.2e-3 * bites + 2e-3 * (bites - 1);
  scene.threads.push_back(thread);
  return scene;
}

Vec3 puncture(const Hands& hands, std::size_t i) {
  // Punctures are told from head to tail.
  const auto& all = hands.thread().punctures;
  return all[all.size() - 1 - i].position_m;
}

/// A jaw that has grasped: what it took moves with it while the tool does not turn.
struct Grip {
  Vec3 taken_m, tool_m;
  int tool;
  [[nodiscard]] Vec3 now_m(Hands& hands) const {
    return taken_m + hands.at(tool).position_m - tool_m;
  }
};

Grip take(Hands& hands, int tool, const Vec3& point_m) {
  hands.grasp(tool, point_m);
  return {hands.last(EventKind::kGrasp).position_m, hands.at(tool).position_m, tool};
}

/// Two hands at the two ends of a thread through its bites.
struct BothEnds {
  Grip tail, head;
  double length_m;  ///< of the thread between them
};

/// The driver draws 10 mm out at the tail, the assistant takes the head at its last puncture, and
/// both go to 7 mm from the tissue: a little more than the thread reaches.
BothEnds take_both_ends(Hands& hands) {
  hands.step();
  const std::size_t count = hands.thread().punctures.size();
  BothEnds ends;
  ends.tail = take(hands, kDriver, puncture(hands, 0));
  hands.move_by(kDriver, Vec3(-8e-3, 0.0, 6e-3), 0.05);
  hands.step(2);
  ends.head = take(hands, kAssistant, puncture(hands, count - 1));
  ends.length_m = 4.2e-3 * static_cast<double>(count / 2) +
                  2e-3 * static_cast<double>(count / 2 - 1) +
                  (ends.tail.now_m(hands) - puncture(hands, 0)).norm();
  // At the puncture itself the head's piece counts for the least that a piece does.
  ends.length_m += 0.5 * thread::kShortSegment_m;
  EXPECT_EQ(hands.thread().tension_n, 0.0);
  hands.move_by(kDriver, Vec3(4e-3, 0.0, -3e-3), 0.05);
  hands.move_by(kAssistant, Vec3(4e-3, 1e-3, 4e-3), 0.05);
  return ends;
}

TEST(Thread, IsDrawnFromTheStart) {
  Hands hands(stitched(2));
  EXPECT_EQ(hands.thread().punctures.size(), 4U);
  EXPECT_GE(hands.thread().course_m.size(), 5U);
  EXPECT_EQ(hands.thread().tension_n, 0.0);
  EXPECT_EQ(hands.thread().head, ThreadEnd::kFree);
  EXPECT_EQ(hands.thread().tail, ThreadEnd::kFree);
}

TEST(Thread, IsGraspedAtItsNearestPointOutsideTissue) {
  Hands hands(stitched(2));
  hands.step();
  // One hand lifts the stretch between the bites; the other grasps 0.4 mm beside it.
  hands.grasp(kAssistant, 0.5 * (puncture(hands, 1) + puncture(hands, 2)));
  ASSERT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  hands.move_by(kAssistant, Vec3(0.0, 0.0, 3e-3), 0.05);
  hands.step();
  const Vec3 a = puncture(hands, 1), b = hands.at(kAssistant).position_m;
  const Vec3 on_thread = a + 0.6 * (b - a);
  hands.grasp(kDriver, on_thread + 4e-4 * (b - a).normalized().unitOrthogonal());
  EXPECT_EQ(hands.last(EventKind::kGrasp).subject, "driver");
  EXPECT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  EXPECT_LT((hands.last(EventKind::kGrasp).position_m - on_thread).norm(), 1e-12);
  EXPECT_EQ(hands.force_n(kDriver).norm(), 0.0);  // a grasp starts without force
  hands.let_go(kDriver);
  EXPECT_EQ(hands.count(EventKind::kRelease), 1);
  // Over the middle of a bite there is only the surface: the thread lies inside.
  hands.grasp(kDriver, 0.5 * (puncture(hands, 0) + puncture(hands, 1)) + Vec3(0, 0, 1e-4));
  EXPECT_EQ(hands.last(EventKind::kGrasp).object, "block");
}

/// The oracle knows nothing of rows: two springs of the grips in series with the thread's own.
TEST(Thread, BetweenTwoJawsPullsAsTheirGripsGiveWay) {
  scene::Scene scene = stitched(0);
  scene.threads[0].needle = "needle";
  scene.threads[0].head = scene::ThreadHead::kSwaged;
  scene.tools[kAssistant].grip_stiffness_n_per_m = 500.0;
  scene.threads[0].length_m = 0.08;
  scene.needles[0].pose.orientation.setIdentity();
  Hands hands(scene);
  hands.step();
  // It hangs straight down from the needle's tail: 20 and 50 mm below it.
  const Vec3 tail = scene.needles[0].pose.position_m;
  hands.grasp(kDriver, tail - Vec3(0, 0, 0.02));
  hands.grasp(kAssistant, tail - Vec3(0, 0, 0.05));
  ASSERT_EQ(hands.count(EventKind::kGrasp), 2);
  hands.move_by(kAssistant, Vec3(0.004, 0.003, 0.01), 0.05);
  EXPECT_EQ(hands.thread().tension_n, 0.0);  // slack
  hands.move_by(kAssistant, Vec3(0.016, 0.007, 0.0), 0.05);
  for (int i = 0; i < 5; ++i) {
    hands.move_by(kAssistant, Vec3(4e-5, 0.0, -4e-5));
    const Vec3 way = hands.at(kAssistant).position_m - hands.at(kDriver).position_m;
    const double expected_n = std::max(0.0, way.norm() - 0.03) / (1.0 / 2000.0 + 1.0 / 500.0);
    EXPECT_NEAR(hands.thread().tension_n, expected_n, 1e-6 + 1e-5 * expected_n) << way.norm();
    EXPECT_LT((hands.force_n(kDriver) + hands.force_n(kAssistant)).norm(), 1e-12);
    EXPECT_LT((hands.force_n(kDriver) - expected_n * way.normalized()).norm(), 1e-5);
  }
  EXPECT_EQ(hands.thread().taut, hands.thread().tension_n > 0.0);
}

/// What a thread through one bite and its jaws should pull with, by a dense K⁻¹ and a search for
/// the tension at which the thread is as long as it is: no rows, no linearisation, no steps.
class DenseBite {
 public:
  DenseBite(Hands& hands, const BothEnds& ends)
      : path_(hands.scene.threads[0].model == scene::ThreadModel::kPath),
        length_m_(ends.length_m),
        from_(ends.tail.now_m(hands)),
        to_(ends.head.now_m(hands)) {
    const auto rest = hands.sim.rest_positions_m();
    std::vector<thread::MaterialPoint> points(2);
    for (std::size_t p = 0; p < 2; ++p) {
      const scene::Bite& bite = hands.scene.threads[0].punctures[p];
      points[p].count = 3;
      std::copy(bite.vertices.begin(), bite.vertices.end(), points[p].vertices.begin());
      points[p].weight.head<3>() = bite.barycentric;
    }
    if (path_) {
      const auto inner = thread::straight_course(rest, hands.sim.tets(), points[0].position(rest),
                                                 points[1].position(rest));
      points.insert(points.begin() + 1, inner.begin(), inner.end());
    }
    const Eigen::MatrixXd inverse =
        testing::dense_inverse(fem::assemble(assemble_model(hands.scene)));
    Eigen::MatrixXd c =
        Eigen::MatrixXd::Zero(3 * static_cast<Eigen::Index>(points.size()), inverse.rows());
    rest_.resize(c.rows());
    for (std::size_t p = 0; p < points.size(); ++p) {
      const auto row = 3 * static_cast<Eigen::Index>(p);
      for (int k = 0; k < points[p].count; ++k)
        c.block<3, 3>(row, 3 * points[p].vertices[static_cast<std::size_t>(k)]) +=
            points[p].weight[k] * Eigen::Matrix3d::Identity();
      rest_.segment<3>(row) = points[p].position(rest);
    }
    compliance_ = c * inverse * c.transpose();
  }

  /// Searches for the tension where grips of `compliance_m_per_n` together give what is missing.
  double tension_n(double compliance_m_per_n) {
    double low = 0.0, high = 5.0;
    for (int k = 0; k < 50; ++k) {
      const double t = 0.5 * (low + high);
      (length_at(t) > length_m_ + t * compliance_m_per_n ? low : high) = t;
    }
    return 0.5 * (low + high);
  }

 private:
  /// Length of the thread where tension t has come to rest, by repeated directions.
  double length_at(double t) {
    Eigen::VectorXd x = rest_;
    double length_m = 0.0;
    for (int k = 0; k < 200; ++k) {
      Eigen::VectorXd pull = Eigen::VectorXd::Zero(x.size());
      length_m = 0.0;
      const Eigen::Index n = x.size() / 3;
      for (Eigen::Index p = 0; p <= n; ++p) {
        const Vec3 a = p > 0 ? Vec3(x.segment<3>(3 * p - 3)) : from_;
        const Vec3 b = p < n ? Vec3(x.segment<3>(3 * p)) : to_;
        if (!path_ && p == 1) {  // inside, a piece counts for its length at rest
          length_m += (rest_.segment<3>(3) - rest_.segment<3>(0)).norm();
          continue;
        }
        const auto piece = thread::segment_length(b - a);
        length_m += piece.length_m;
        if (p > 0) pull.segment<3>(3 * p - 3) += piece.gradient;
        if (p < n) pull.segment<3>(3 * p) -= piece.gradient;
      }
      x = 0.5 * (x + rest_ + t * compliance_ * pull);
    }
    return length_m;
  }

  bool path_;
  double length_m_;
  Vec3 from_, to_;
  Eigen::VectorXd rest_;
  Eigen::MatrixXd compliance_;
};

class ThreadOfEachModel : public ::testing::TestWithParam<scene::ThreadModel> {};

TEST_P(ThreadOfEachModel, ThroughOneBitePullsBothHandsAsADenseEquilibriumSays) {
  Hands hands(stitched(1, GetParam()));
  const BothEnds ends = take_both_ends(hands);
  for (const double further_m : {0.0, 5e-4, 5e-4}) {
    hands.move_by(kAssistant, further_m * Vec3(1.0, -0.5, 1.0));
    hands.step(20);
    DenseBite oracle(hands, ends);
    const double expected_n = oracle.tension_n(2.0 / 2000.0 + 1e-9);
    ASSERT_GT(expected_n, 0.01);
    // Steps settle to 1e-9; where the path crosses many cells its inner points add up.
    EXPECT_NEAR(hands.thread().tension_n, expected_n, 1e-5 * expected_n);
    for (const Grip& grip : {ends.tail, ends.head}) {
      const bool tail = grip.tool == kDriver;
      const Vec3 way = puncture(hands, tail ? 0 : 1) - grip.now_m(hands);
      EXPECT_LT((hands.force_n(grip.tool) - expected_n * way.normalized()).norm(),
                1e-5 * expected_n);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Models, ThreadOfEachModel,
                         ::testing::Values(scene::ThreadModel::kOutside,
                                           scene::ThreadModel::kPath));

TEST(Thread, LyingOnTissueIsGraspedBeforeIt) {
  Hands hands(stitched(2));
  hands.step();
  const Vec3 a = puncture(hands, 1), b = puncture(hands, 2);
  hands.grasp(kDriver, a + 0.37 * (b - a) + Vec3(0.0, 0.0, 1e-4));
  EXPECT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  // Beyond its thickness the tissue is nearer.
  hands.grasp(kAssistant, a + 0.37 * (b - a) + Vec3(3e-4, 0.0, 0.0));
  EXPECT_EQ(hands.last(EventKind::kGrasp).object, "block");
}

/// A second hand takes a taut thread on its way to the first: neither feels a jump, and when the
/// first lets go, the second has the load.
TEST(Thread, TakenWhileItIsTautPassesItsTensionFromHandToHand) {
  scene::Scene scene = stitched(1);
  scene.threads[0].tail = scene::ThreadTail::kAnchored;
  scene.threads[0].length_m = 0.02;
  Hands hands(scene);
  hands.step();
  // Out with 6 mm of slack first, so that there is something to take.
  Vec3 exit = puncture(hands, 1);
  hands.grasp(kDriver, exit + Vec3(0.0, 0.0, -7e-3));  // the free head hangs down
  ASSERT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  hands.move(kDriver, exit + Vec3(5e-3, 0.0, 4e-3), 0.2);
  hands.move_by(kDriver, Vec3(1.2e-3, 0.0, 1e-3));
  hands.step(50);
  const double tension_n = hands.thread().tension_n;
  ASSERT_GT(tension_n, 0.02);
  exit = puncture(hands, 1);
  const Vec3 held = exit + 0.4 * (hands.at(kDriver).position_m - exit);
  const Vec3 force_n = hands.force_n(kDriver);
  hands.grasp(kAssistant, held);
  ASSERT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  // The thread is straight within what 1 mm of jaw radius lets it bend.
  EXPECT_NEAR(hands.thread().tension_n, tension_n, 1e-3 * tension_n);
  EXPECT_LT((hands.force_n(kDriver) - force_n).norm(), 1e-3 * tension_n);
  EXPECT_LT(hands.force_n(kAssistant).norm(), 1e-2 * tension_n);
  hands.let_go(kDriver);
  hands.step(20);
  EXPECT_LT((hands.force_n(kAssistant) - force_n).norm(), 1e-2 * tension_n);
}

TEST(Thread, ThatWasDrawnOutStaysDrawnOut) {
  Hands hands(stitched(1));
  hands.step();
  const Grip grip = take(hands, kDriver, puncture(hands, 0));
  hands.move_by(kDriver, Vec3(-8e-3, 0.0, 6e-3), 0.05);
  hands.step(2);
  EXPECT_EQ(hands.thread().tension_n, 0.0);  // nobody holds the head
  const auto tail_out_m = [&] {
    return hands.thread().length_m - hands.thread().punctures.back().arc_length_m;
  };
  const double drawn_m = 0.03 + (grip.now_m(hands) - puncture(hands, 0)).norm();
  EXPECT_NEAR(tail_out_m(), drawn_m, 1e-9);
  hands.let_go(kDriver);
  hands.step(3);
  EXPECT_NEAR(tail_out_m(), drawn_m, 1e-9);
}

TEST(Thread, TellsOnceThatItIsTautAndOnceThatItIsSlack) {
  Hands hands(stitched(1));
  take_both_ends(hands);
  hands.step(10);
  EXPECT_EQ(hands.count(EventKind::kTaut), 1);
  EXPECT_EQ(hands.count(EventKind::kSlack), 0);
  EXPECT_EQ(hands.thread().slack_m, 0.0);
  EXPECT_LT(hands.thread().overlength_m, 1e-9);  // what the grips give way is not overlength
  hands.move_by(kAssistant, Vec3(-2e-3, 0.0, -2e-3));
  hands.step(10);
  EXPECT_EQ(hands.thread().tension_n, 0.0);
  EXPECT_FALSE(hands.thread().taut);
  EXPECT_GT(hands.thread().slack_m, 5e-4);
  EXPECT_EQ(hands.force_n(kAssistant).norm(), 0.0);
  EXPECT_EQ(hands.count(EventKind::kTaut), 1);
  EXPECT_EQ(hands.count(EventKind::kSlack), 1);
  hands.move_by(kAssistant, Vec3(2e-3, 0.0, 2e-3));
  EXPECT_EQ(hands.count(EventKind::kTaut), 2);
}

TEST(Thread, SlipsThroughAJawAtItsForceAndOffItsEnd) {
  scene::Scene scene = stitched(1);
  scene.tools[kAssistant].grip_force_max_n = 0.2;
  scene.threads[0].tail = scene::ThreadTail::kAnchored;
  scene.threads[0].length_m = 0.012;
  Hands hands(scene);
  hands.step();
  const Vec3 out = puncture(hands, 1);
  hands.grasp(kAssistant, out);
  double peak_n = 0.0;
  for (int i = 0; i < 250; ++i) {
    hands.move_by(kAssistant, Vec3(2e-5, 0.0, 2e-5));
    peak_n = std::max(peak_n, hands.force_n(kAssistant).norm());
    ASSERT_LE(hands.force_n(kAssistant).norm(), 0.2);
    ASSERT_LE(hands.thread().tension_n, 0.2);
  }
  EXPECT_GT(peak_n, 0.19);
  EXPECT_EQ(hands.count(EventKind::kGripSlip), 1);
  EXPECT_EQ(hands.last(EventKind::kGripSlip).subject, "assistant");
  EXPECT_EQ(hands.last(EventKind::kGripSlip).object, "thread");
  EXPECT_EQ(hands.count(EventKind::kRelease), 0);
  // What has slipped through is not taken back.
  hands.move_by(kAssistant, Vec3(-1e-3, 0.0, -1e-3));
  hands.step(5);
  EXPECT_EQ(hands.thread().tension_n, 0.0);
  // 12 mm of thread, 4.2 of them in the bite: it ends 7.8 mm behind the exit.
  hands.move_by(kAssistant, Vec3(5e-3, 0.0, 5e-3));
  EXPECT_EQ(hands.count(EventKind::kRelease), 1);
  EXPECT_EQ(hands.force_n(kAssistant).norm(), 0.0);
  EXPECT_NEAR((hands.last(EventKind::kRelease).position_m - out).norm(), 7.8e-3, 1.5e-3);
}

TEST(Thread, PulledBeyondItsLimitIsClampedToldAndRecovers) {
  scene::Scene scene = stitched(1);
  scene.threads[0].tail = scene::ThreadTail::kAnchored;
  scene.threads[0].tension_max_n = 0.3;
  Hands hands(scene);
  hands.step();
  hands.grasp(kAssistant, puncture(hands, 1));
  const Vec3 start = hands.at(kAssistant).position_m;
  for (int round = 1; round <= 2; ++round) {
    hands.move(kAssistant, start + Vec3(2e-2, 0.0, 2e-2), 0.05);
    hands.step(5);
    EXPECT_EQ(hands.thread().tension_n, 0.3);
    EXPECT_EQ(hands.count(EventKind::kLimit), round);
    EXPECT_EQ(hands.last(EventKind::kLimit).subject, "thread");
    EXPECT_GT(hands.thread().overlength_m, 1e-3);
    EXPECT_NEAR(hands.force_n(kAssistant).norm(), 0.3, 1e-6);
    hands.move(kAssistant, start, 0.05);
    hands.step(5);
    EXPECT_EQ(hands.thread().tension_n, 0.0);
    EXPECT_EQ(hands.thread().overlength_m, 0.0);
  }
  EXPECT_EQ(hands.count(EventKind::kGripSlip), 0);
}

TEST(Thread, WithAFreeTailComesOutBiteByBite) {
  scene::Scene scene = stitched(3);
  scene.threads[0].tail_length_m = 0.003;
  Hands hands(scene);
  hands.step();
  std::vector<Vec3> entries;
  for (const std::size_t i : {0U, 2U, 4U}) entries.push_back(puncture(hands, i));
  hands.grasp(kAssistant, puncture(hands, 5));
  std::size_t before = 6;
  for (int i = 0; i < 400; ++i) {
    hands.move_by(kAssistant, Vec3(5e-5, 0.0, 5e-5), 0.05);
    const std::size_t now = hands.thread().punctures.size();
    ASSERT_TRUE(now == before || now + 2 == before);
    before = now;
    EXPECT_EQ(hands.thread().tension_n, 0.0);  // without friction nothing holds it
  }
  EXPECT_EQ(before, 0U);
  std::vector<Event> told;
  for (const Event& event : hands.events)
    if (event.kind == EventKind::kUnthread) told.push_back(event);
  ASSERT_EQ(told.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(told[i].subject, "thread");
    EXPECT_EQ(told[i].object, "block");
    EXPECT_LT((told[i].position_m - entries[i]).norm(), 1e-9);
  }
}

/// A jaw behind the bite that goes is before the one that stays: it has the tail in hand.
TEST(Thread, DrawnOutOfItsFirstBiteLiesTautFromTheJawToTheNext) {
  scene::Scene scene = stitched(2);
  scene.threads[0].tail_length_m = 0.003;
  Hands hands(scene);
  hands.step();
  const Grip grip = take(hands, kDriver, puncture(hands, 1));
  hands.move_by(kDriver, Vec3(8e-3, 0.0, 6e-3), 0.05);
  hands.step(2);
  ASSERT_EQ(hands.count(EventKind::kUnthread), 1);
  ASSERT_EQ(hands.thread().punctures.size(), 2U);
  // It was taken 3 mm and a bite of 4.2 mm from its end.
  const double from_tail_m = hands.thread().length_m - hands.thread().punctures.back().arc_length_m;
  EXPECT_NEAR(from_tail_m, 7.2e-3 + (grip.now_m(hands) - puncture(hands, 0)).norm(), 1e-9);
}

TEST(Thread, WithAFreeHeadComesOutAtItsHead) {
  scene::Scene scene = stitched(2);
  scene.threads[0].length_m = 0.03 + 2 * 4.2e-3 + 2e-3 + 0.004;
  Hands hands(scene);
  hands.step();
  hands.grasp(kDriver, puncture(hands, 0));
  hands.move_by(kDriver, Vec3(-1.2e-2, 0.0, 1.2e-2), 0.05);
  EXPECT_EQ(hands.count(EventKind::kUnthread), 2);
  EXPECT_EQ(hands.thread().punctures.size(), 0U);
}

TEST(Thread, WithAnAnchoredTailHolds) {
  scene::Scene scene = stitched(3);
  scene.threads[0].tail = scene::ThreadTail::kAnchored;
  Hands hands(scene);
  hands.step();
  hands.grasp(kAssistant, puncture(hands, 5));
  hands.move_by(kAssistant, Vec3(2e-3, 0.0, 2e-3), 0.02);
  EXPECT_EQ(hands.count(EventKind::kUnthread), 0);
  EXPECT_EQ(hands.thread().punctures.size(), 6U);
  EXPECT_GT(hands.thread().tension_n, 0.02);
  EXPECT_EQ(hands.thread().tail, ThreadEnd::kAnchored);
  EXPECT_EQ(hands.thread().head, ThreadEnd::kHeld);
  EXPECT_EQ(hands.thread().head_holder, kAssistant);
}

/// One pull, one tension: what is drawn of a span carries what the span does.
TEST(Thread, CarriesOneTensionAlongASpan) {
  Hands hands(stitched(2, scene::ThreadModel::kPath));
  take_both_ends(hands);
  for (int i = 0; i < 20; ++i) {
    hands.move_by(kAssistant, Vec3(3e-5, 0.0, 3e-5));
    const ThreadState& thread = hands.thread();
    ASSERT_EQ(thread.segment_tension_n.size() + 1, thread.course_m.size());
    int carrying = 0;
    for (const double tension_n : thread.segment_tension_n) {
      ASSERT_TRUE(tension_n == 0.0 || tension_n == thread.tension_n);
      carrying += tension_n > 0.0;
    }
    EXPECT_GE(carrying, 5);  // the hands' pieces and at least three between
  }
}

TEST(Thread, ThatDoublesBackOverAJawPullsItByNoMoreThanItsGrip) {
  scene::Scene scene = stitched(2);
  scene.threads[0].tail = scene::ThreadTail::kAnchored;
  scene.threads[0].tension_max_n = 2.0;
  scene.tools[kDriver].grip_force_max_n = 0.4;
  Hands hands(scene);
  hands.step();
  // The assistant holds the head still; the driver lifts the stretch between the bites.
  hands.grasp(kAssistant, puncture(hands, 3));
  hands.grasp(kDriver, 0.5 * (puncture(hands, 1) + puncture(hands, 2)));
  ASSERT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  double peak_n = 0.0;
  for (int i = 0; i < 300; ++i) {
    hands.move_by(kDriver, Vec3(0.0, 0.0, 4e-5));
    peak_n = std::max(peak_n, hands.force_n(kDriver).norm());
    ASSERT_LE(hands.force_n(kDriver).norm(), 0.4);
  }
  EXPECT_GT(peak_n, 0.37);
}

TEST(Thread, SlackBesideAnotherLeavesItAlone) {
  scene::Scene one = stitched(1);
  scene::Scene two = one;
  two.threads.push_back(two.threads[0]);
  two.threads[1].name = "other";
  for (std::size_t i = 0; i < 2; ++i)
    two.threads[1].punctures[i] =
        testing::nearest_on_surface(two, 0, Vec3(i == 0 ? -3e-3 : 3e-3, -4e-3, 0.0));
  two.threads[1].tail = scene::ThreadTail::kAnchored;
  Hands alone(one), both(two);
  take_both_ends(alone);
  take_both_ends(both);
  alone.move_by(kAssistant, Vec3(5e-4, 0.0, 5e-4));
  both.move_by(kAssistant, Vec3(5e-4, 0.0, 5e-4));
  EXPECT_GT(both.thread(0).tension_n, 0.05);
  EXPECT_NEAR(both.thread(0).tension_n, alone.thread().tension_n, 1e-12);
  EXPECT_EQ(both.thread(1).tension_n, 0.0);
  EXPECT_EQ(both.thread(1).punctures.size(), 2U);
}

TEST(Thread, StartsAgainToTheBitAfterAReset) {
  scene::Scene scene = stitched(2, scene::ThreadModel::kPath);
  scene.threads[0].tail_length_m = 0.012;
  Hands hands(scene);
  const ThreadState start = hands.thread();
  const auto play = [&] {
    hands.inputs.assign(hands.inputs.size(), {});
    take_both_ends(hands);
    const double tension_n = hands.thread().tension_n;
    hands.let_go(kDriver);
    hands.move_by(kAssistant, Vec3(1.5e-2, 0.0, 1.5e-2), 0.05);  // unthreads the first bite
    return std::pair(tension_n, hands.thread().course_m);
  };
  const auto first = play();
  EXPECT_GT(first.first, 1e-3);
  EXPECT_EQ(hands.thread().punctures.size(), 2U);
  hands.sim.reset();
  EXPECT_EQ(hands.thread().course_m, start.course_m);
  EXPECT_EQ(hands.thread().arc_length_m, start.arc_length_m);
  EXPECT_EQ(hands.thread().punctures.size(), 4U);
  EXPECT_EQ(hands.thread().tension_n, 0.0);
  EXPECT_EQ(play(), first);
}

TEST(Thread, PulledTautIsFeltInTheNextStepAsItsResponsePredicts) {
  for (const Vec3& motion : {Vec3(2e-5, 0, 0), Vec3(0, 3e-5, 0), Vec3(1e-5, 1e-5, 2e-5)}) {
    Hands hands(stitched(2, scene::ThreadModel::kPath));
    take_both_ends(hands);
    hands.move_by(kAssistant, Vec3(3e-4, 0.0, 3e-4));
    hands.step(20);
    const ToolResponse response = hands.response(kAssistant);
    ASSERT_GT(response.wrench.head<3>().norm(), 0.05);
    hands.at(kAssistant).position_m += motion;
    hands.step();
    const Vec3 change = hands.force_n(kAssistant) - response.wrench.head<3>();
    const Vec3 predicted =
        -(response.stiffness * (Vec6() << motion, Vec3::Zero()).finished()).head<3>();
    EXPECT_GT(change.norm(), 1e-4);
    EXPECT_LT((predicted - change).norm(), 0.02 * change.norm()) << motion.transpose();
  }
}

TEST(Thread, FollowsItsNeedleThroughABiteAndOutAgain) {
  Hands hands(testing::swaged_scene(scene::ThreadTail::kAnchored));
  const double half_m = EIGEN_PI * 4e-3;
  hands.grasp(kDriver, hands.on_needle(0.05));
  EXPECT_EQ(hands.thread().punctures.size(), 0U);
  EXPECT_EQ(hands.thread().head, ThreadEnd::kSwaged);
  hands.along(kDriver, 1.03 * half_m, 0.03);
  EXPECT_EQ(hands.count(EventKind::kPuncture), 1);
  EXPECT_EQ(hands.count(EventKind::kExit), 1);
  EXPECT_EQ(hands.thread().punctures.size(), 0U);  // the tail is before the tissue still
  // The other hand takes the tip and draws the needle through.
  hands.grasp(kAssistant, hands.on_needle(0.97));
  hands.let_go(kDriver);
  hands.along(kAssistant, 0.5 * half_m, 0.03);
  ASSERT_EQ(hands.thread().punctures.size(), 1U);  // in, not out yet
  const Vec3 entry = hands.thread().punctures[0].rest_position_m;
  EXPECT_NEAR(entry[0], -4e-3, 5e-4);
  EXPECT_NEAR(entry[2], 0.0, 1e-9);
  EXPECT_FALSE(hands.thread().punctures[0].inward);  // from head to tail it leaves there
  // Drawn back, the needle takes its own hole, and the bite goes.
  hands.along(kAssistant, -0.5 * half_m, 0.03);
  EXPECT_EQ(hands.thread().punctures.size(), 0U);
  EXPECT_EQ(hands.count(EventKind::kPuncture), 1);
  EXPECT_EQ(hands.count(EventKind::kUnthread), 0);
  hands.along(kAssistant, 1.05 * half_m, 0.03);
  ASSERT_EQ(hands.thread().punctures.size(), 2U);
  EXPECT_EQ(hands.sim.needles()[0].active_cells, 0);
  EXPECT_LT((hands.thread().punctures[1].rest_position_m - entry).norm(), 1e-9);
  EXPECT_NEAR(hands.thread().punctures[0].rest_position_m[0], 4e-3, 5e-4);
  EXPECT_EQ(hands.count(EventKind::kPuncture), 1);
  // The knot holds: 50 mm of thread less the bite, and no more.
  EXPECT_EQ(hands.thread().tail, ThreadEnd::kAnchored);
  EXPECT_EQ(hands.thread().tension_n, 0.0);
  hands.move_by(kAssistant, Vec3(0.0, 0.0, 0.046), 0.05);
  hands.step(20);
  EXPECT_EQ(hands.count(EventKind::kTaut), 1);
  EXPECT_GT(hands.thread().tension_n, 0.01);
}

TEST(Thread, ThatIsFreeFollowsItsNeedleOutOfTheTissue) {
  scene::Scene scene = testing::swaged_scene(scene::ThreadTail::kFree);
  scene.threads[0].length_m = 0.02;
  Hands hands(scene);
  const double half_m = EIGEN_PI * 4e-3;
  hands.grasp(kDriver, hands.on_needle(0.05));
  hands.along(kDriver, 1.03 * half_m, 0.03);
  hands.grasp(kAssistant, hands.on_needle(0.97));
  hands.let_go(kDriver);
  hands.along(kAssistant, 1.1 * half_m, 0.03);
  ASSERT_EQ(hands.thread().punctures.size(), 2U);
  hands.move_by(kAssistant, Vec3(0.0, 0.0, 0.03), 0.05);
  EXPECT_EQ(hands.count(EventKind::kUnthread), 1);
  EXPECT_EQ(hands.thread().punctures.size(), 0U);
  EXPECT_EQ(hands.thread().tension_n, 0.0);
  hands.step(300);  // until the weak spring to the needle's last pose has let go
  EXPECT_LT(hands.force_n(kAssistant).norm(), 1e-9);
}

TEST(Thread, BetweenNeedleAndJawPullsBothHandsAlike) {
  Hands hands(testing::swaged_scene(scene::ThreadTail::kFree));
  // The needle stands clear of the tissue, its thread hangs from its tail.
  hands.grasp(kDriver, hands.on_needle(0.5));
  hands.move_by(kDriver, Vec3(0.0, 0.0, 0.02), 0.1);
  const Vec3 tail = hands.on_needle(0.0);
  hands.grasp(kAssistant, tail - Vec3(0.0, 0.0, 0.01));
  ASSERT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  hands.move_by(kAssistant, Vec3(2e-3, 1e-3, -1e-3), 0.05);
  hands.step(400);  // until the weak spring to the needle's last pose has let go
  const double tension_n = hands.thread().tension_n;
  EXPECT_GT(tension_n, 0.05);
  const Vec3 way = (hands.at(kAssistant).position_m - hands.on_needle(0.0)).normalized();
  EXPECT_LT((hands.force_n(kAssistant) + tension_n * way).norm(), 1e-3 * tension_n);
  EXPECT_LT((hands.force_n(kDriver) + hands.force_n(kAssistant)).norm(), 1e-6 * tension_n);
  // About one point the wrenches balance too: the forces lie on one line.
  const Vec3 arm = hands.at(kAssistant).position_m - hands.at(kDriver).position_m;
  const Vec3 torque_nm = hands.response(kDriver).wrench.tail<3>() +
                         hands.response(kAssistant).wrench.tail<3>() +
                         arm.cross(hands.force_n(kAssistant));
  EXPECT_LT(torque_nm.norm(), 1e-6 * tension_n);
}

/// A jaw that holds the tail when the needle makes the first bite keeps it: no knot forms behind
/// it.
TEST(Thread, HeldByItsTailIsNotKnottedBehindTheJaw) {
  Hands hands(testing::swaged_scene(scene::ThreadTail::kAnchored));
  hands.grasp(kDriver, hands.on_needle(0.05));
  hands.grasp(kAssistant, hands.on_needle(0.0) - Vec3(0.0, 0.0, 0.03));
  ASSERT_EQ(hands.last(EventKind::kGrasp).object, "thread");
  hands.move(kAssistant, Vec3(-8e-3, 0.0, 4e-3), 0.1);
  for (int i = 0; i < 20; ++i) {
    hands.along(kDriver, 0.08 * EIGEN_PI * 4e-3, 0.03);
    ASSERT_LT(hands.thread().tension_n, 0.05) << i;  // there are 30 mm for a way of 15
  }
  EXPECT_EQ(hands.thread().punctures.size(), 1U);
  EXPECT_EQ(hands.count(EventKind::kLimit), 0);
  EXPECT_EQ(hands.thread().tail, ThreadEnd::kHeld);
}

}  // namespace
}  // namespace sutured::simulation
