// SPDX-License-Identifier: GPL-3.0-or-later
// What the gateway draws, of honest samples and of ones that lie, over real Cyclone DDS.
#include "gateway/scene_composer.hpp"

#include <foxglove_scene.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <chrono>
#include <limits>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "gateway/feed.hpp"
#include "protocol/topics.hpp"
#include "support/test_session.hpp"

/// For the codec to free what it has decoded.
template <>
const suture::TopicSpec& suture::topic<foxglove_SceneUpdate>() noexcept {
  static const TopicSpec spec{
      kComposedScene, Channel::kMesh, &foxglove_SceneUpdate_desc, false, false, 1, 0, 0};
  return spec;
}

namespace sutured::gateway {
namespace {

using Eigen::Vector3d;

/// One drawn thing, out of the memory of its sample.
struct Drawn {
  struct Line {
    double thickness_m = 0.0;
    std::vector<Vector3d> points_m;
    std::vector<Eigen::Vector4d> colours;
  };
  std::vector<foxglove_ArrowPrimitive> arrows;
  std::vector<foxglove_SpherePrimitive> spheres;
  std::vector<Line> lines, triangles;
  std::vector<std::uint32_t> indices;
};

Vector3d vector(const auto& wire) { return {wire.x, wire.y, wire.z}; }
Eigen::Vector4d rgba(const foxglove_Color& c) { return {c.r, c.g, c.b, c.a}; }
Vector3d direction(const foxglove_ArrowPrimitive& arrow) {
  const auto& q = arrow.pose.orientation;
  return Eigen::Quaterniond(q.w, q.x, q.y, q.z) * Vector3d::UnitX();
}
double length_m(const foxglove_ArrowPrimitive& arrow) {
  return arrow.shaft_length + arrow.head_length;
}

class SceneComposerTest : public ::testing::Test {
 protected:
  SceneComposerTest() { composer_.watch(true); }

  template <class T>
  void send(const T& sample) {
    suture::Writer<T> writer(mesh_);
    ASSERT_TRUE(testing::eventually([&] { return writer.matched() > 0; }));
    ASSERT_TRUE(writer.write(sample));
  }
  /// A tetrahedron's surface with these stresses.
  void send_body(std::vector<std::uint32_t> triangles, const std::vector<float>& stress_pa) {
    const std::vector<float> places(12, 0.01F);
    suture::v1::MeshTopology topology{};
    suture::set_text(topology.body, "left");
    suture::lend(topology.rest_position_m, std::span<const float>(places));
    suture::lend(topology.triangle, std::span<const std::uint32_t>(triangles));
    send(topology);
    suture::v1::MeshFrame frame{};
    suture::set_text(frame.body, "left");
    suture::lend(frame.position_m, std::span<const float>(places));
    suture::lend(frame.von_mises_pa, std::span<const float>(stress_pa));
    send(frame);
  }

  /// Composes an update and takes it apart, by the ids of its entities.
  std::map<std::string, Drawn> compose() {
    std::map<std::string, Drawn> all;
    const auto encoded = composer_.compose();
    EXPECT_TRUE(encoded);
    if (!encoded) return all;
    const auto copy_of = [](const auto& wire) {
      Drawn::Line copy;
      for (const auto& p : suture::span_of(wire.points)) copy.points_m.push_back(vector(p));
      for (const auto& c : suture::span_of(wire.colors)) copy.colours.push_back(rgba(c));
      return copy;
    };
    EXPECT_TRUE(
        codec_.with_decoded<foxglove_SceneUpdate>(encoded->bytes(), [&](const auto& update) {
          for (const foxglove_SceneEntity& entity : suture::span_of(update.entities)) {
            EXPECT_STREQ(entity.frame_id, "world");
            Drawn& drawn = all[entity.id];
            const auto arrows = suture::span_of(entity.arrows);
            drawn.arrows.assign(arrows.begin(), arrows.end());
            const auto spheres = suture::span_of(entity.spheres);
            drawn.spheres.assign(spheres.begin(), spheres.end());
            for (const auto& line : suture::span_of(entity.lines)) {
              EXPECT_EQ(line.type, foxglove_LINE_STRIP);
              drawn.lines.push_back(copy_of(line));
              drawn.lines.back().thickness_m = line.thickness;
            }
            for (const auto& list : suture::span_of(entity.triangles)) {
              drawn.triangles.push_back(copy_of(list));
              const auto indices = suture::span_of(list.indices);
              drawn.indices.assign(indices.begin(), indices.end());
            }
          }
        }));
    return all;
  }
  /// The picture of a tool that feels this force: three axes, and an arrow where it is felt.
  Drawn tool_with(const std::array<double, 3>& force_n) {
    suture::v1::ToolView tool{};
    suture::set_text(tool.tool, "driver");
    const Eigen::Quaterniond turn(kTurn);
    for (int i = 0; i < 3; ++i) tool.position_m[i] = kPlace_m[i];
    for (int i = 0; i < 4; ++i) tool.orientation_xyzw[i] = turn.coeffs()[i];
    std::copy(force_n.begin(), force_n.end(), tool.force_n);
    send(tool);
    return compose()["tool/driver"];
  }

  const Vector3d kPlace_m{0.01, 0.02, 0.03};
  const Eigen::AngleAxisd kTurn{0.7, Vector3d(1, 2, 3).normalized()};
  suture::Participant mesh_{testing::own_session(), suture::Channel::kMesh};
  SceneComposer composer_{mesh_};
  suture::SampleCodec codec_{mesh_, foxglove_SceneUpdate_desc, suture::kComposedScene};
};

TEST_F(SceneComposerTest, DrawsStressesThatAreNoNumbersAsAtRest) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  send_body({0, 1, 2}, {kNan, -kInfinity, kInfinity, 5000.0F});
  const auto drawn = composer_.compose();
  ASSERT_TRUE(drawn);
  const auto* const text = reinterpret_cast<const char*>(drawn->bytes().data());
  const std::string bytes(text, drawn->bytes().size());
  // The scale is the largest number's: an infinity would stay in it for good.
  EXPECT_NE(bytes.find("5.000000"), std::string::npos);
}

TEST_F(SceneComposerTest, IsThereForWhoComesAgainAndRestsAfterAMinute) {
  send_body({0, 1, 2}, {1.0F, 1.0F, 1.0F, 1.0F});
  ASSERT_TRUE(composer_.compose());
  composer_.watch(false);
  const auto now = std::chrono::steady_clock::now();
  composer_.close_idle(now);
  EXPECT_FALSE(composer_.compose());
  composer_.watch(true);
  EXPECT_TRUE(composer_.compose()) << "without a word from the server";
  composer_.close_idle(now + 2 * kReaderStays);
  EXPECT_TRUE(composer_.reads()) << "it is watched";
  composer_.watch(false);
  composer_.close_idle(now + 2 * kReaderStays);
  EXPECT_FALSE(composer_.reads());
  composer_.watch(true);
  EXPECT_FALSE(composer_.compose()) << "nothing of a minute ago, and not an empty scene";
}

TEST_F(SceneComposerTest, DrawsNoTrianglesOfVerticesThatAreNotThere) {
  send_body({0, 1, 4}, {1.0F, 1.0F, 1.0F, 1.0F});
  EXPECT_TRUE(composer_.compose());
}

TEST_F(SceneComposerTest, DrawsAThreadAsALineOfItsTensionWithRingsAtItsPunctures) {
  const std::vector<double> course = {0, 0, 0, 0.01, 0, 0, 0.02, 0.005, 0};
  const std::vector<double> tension = {0.0, 2.0};
  std::vector<suture::v1::Puncture> punctures(2);
  punctures[0].position_m[0] = 0.01;
  punctures[1].position_m[1] = 0.005;
  suture::v1::ThreadState thread{};
  suture::set_text(thread.thread, "thread");
  thread.diameter_m = 2e-4;
  suture::lend(thread.course_m, std::span<const double>(course));
  suture::lend(thread.segment_tension_n, std::span<const double>(tension));
  suture::lend(thread.punctures, std::span<const suture::v1::Puncture>(punctures));
  send(thread);
  const Drawn drawn = compose()["thread/thread"];
  ASSERT_EQ(drawn.lines.size(), 1U);
  EXPECT_EQ(drawn.lines[0].thickness_m, 2e-4);
  ASSERT_EQ(drawn.lines[0].points_m.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i)
    EXPECT_EQ(drawn.lines[0].points_m[i], Vector3d(course[3 * i], course[3 * i + 1], 0.0));
  const auto& colours = drawn.lines[0].colours;
  ASSERT_EQ(colours.size(), 3U);
  EXPECT_GT(colours[0][2], colours[0][0]) << "slack is blue";
  EXPECT_GT(colours[1][0], colours[1][2] + 0.5) << "taut is red";
  ASSERT_EQ(drawn.spheres.size(), 2U);
  EXPECT_EQ(vector(drawn.spheres[0].pose.position), Vector3d(0.01, 0, 0));
  EXPECT_EQ(vector(drawn.spheres[1].pose.position), Vector3d(0, 0.005, 0));
  EXPECT_GT(drawn.spheres[0].size.x, thread.diameter_m) << "seen around the thread";
}

TEST_F(SceneComposerTest, DrawsANeedleWithItsPunctures) {
  const std::vector<double> course = {0, 0, 0, 0, 0, 0.025};
  std::vector<suture::v1::Puncture> punctures(1);
  punctures[0].position_m[2] = 0.004;
  suture::v1::NeedleState needle{};
  suture::set_text(needle.needle, "needle");
  needle.diameter_m = 4e-4;
  suture::lend(needle.course_m, std::span<const double>(course));
  suture::lend(needle.punctures, std::span<const suture::v1::Puncture>(punctures));
  send(needle);
  const Drawn drawn = compose()["needle/needle"];
  ASSERT_EQ(drawn.lines.size(), 1U);
  EXPECT_EQ(drawn.lines[0].points_m.back(), Vector3d(0, 0, 0.025));
  ASSERT_EQ(drawn.spheres.size(), 1U);
  EXPECT_EQ(vector(drawn.spheres[0].pose.position), Vector3d(0, 0, 0.004));
  EXPECT_GT(drawn.spheres[0].size.x, needle.diameter_m);
}

TEST_F(SceneComposerTest, DrawsContactsWhereTheyAreAndNoLongerThanTheyLast) {
  std::vector<suture::v1::ContactPoint> points(2);
  points[0].position_m[0] = 0.003;
  points[1].position_m[1] = 0.004;
  suture::v1::ContactState contacts{};
  suture::lend(contacts.points, std::span<const suture::v1::ContactPoint>(points));
  send(contacts);
  const Drawn drawn = compose()["contact"];
  ASSERT_EQ(drawn.spheres.size(), 2U);
  EXPECT_EQ(vector(drawn.spheres[0].pose.position), Vector3d(0.003, 0, 0));
  EXPECT_EQ(vector(drawn.spheres[1].pose.position), Vector3d(0, 0.004, 0));
  EXPECT_GT(drawn.spheres[0].size.x, 0.0);
  contacts.points = {};
  send(contacts);
  EXPECT_TRUE(compose()["contact"].spheres.empty());
}

TEST_F(SceneComposerTest, DrawsTheAxesOfAToolInRedGreenAndBlue) {
  const Drawn drawn = tool_with({0, 0, 0});
  ASSERT_EQ(drawn.arrows.size(), 3U) << "and no arrow of a force that is none";
  for (int axis = 0; axis < 3; ++axis) {
    const foxglove_ArrowPrimitive& arrow = drawn.arrows[static_cast<std::size_t>(axis)];
    EXPECT_EQ(vector(arrow.pose.position), kPlace_m);
    EXPECT_LT((direction(arrow) - kTurn * Vector3d::Unit(axis)).norm(), 1e-12) << axis;
    EXPECT_GT(length_m(arrow), 1e-3);
    Eigen::Index brightest = -1;
    rgba(arrow.color).head<3>().maxCoeff(&brightest);
    EXPECT_EQ(brightest, axis);
  }
}

TEST_F(SceneComposerTest, DrawsAForceAlongItselfAndTheLongerTheLarger) {
  for (const std::array<double, 3>& force_n :
       std::vector<std::array<double, 3>>{{0.3, -0.2, 0.5}, {0, 0, -1}, {-1, 0, 0}, {1, 0, 0}}) {
    const Drawn drawn = tool_with(force_n);
    ASSERT_EQ(drawn.arrows.size(), 4U);
    const Vector3d force(force_n[0], force_n[1], force_n[2]);
    EXPECT_EQ(vector(drawn.arrows[3].pose.position), kPlace_m);
    EXPECT_LT((direction(drawn.arrows[3]) - force.normalized()).norm(), 1e-9) << force.transpose();
    EXPECT_NEAR(length_m(drawn.arrows[3]), 0.01 * force.norm(), 1e-12) << "1 cm a newton";
  }
  EXPECT_NEAR(length_m(tool_with({0, 0.8, 0}).arrows.at(3)),
              2.0 * length_m(tool_with({0, 0.4, 0}).arrows.at(3)), 1e-12);
}

TEST_F(SceneComposerTest, ColoursVerticesByTheirStress) {
  send_body({0, 1, 2, 0, 2, 3}, {0.0F, 10e3F, 20e3F, 30e3F});
  const Drawn drawn = compose()["tissue/left"];
  ASSERT_EQ(drawn.triangles.size(), 1U);
  EXPECT_EQ(drawn.indices, (std::vector<std::uint32_t>{0, 1, 2, 0, 2, 3}));
  ASSERT_EQ(drawn.triangles[0].points_m.size(), 4U);
  EXPECT_NEAR(drawn.triangles[0].points_m[3].x(), 0.01, 1e-8);
  // The stops of the map: from tissue at rest over amber and red to dark red.
  const auto& colours = drawn.triangles[0].colours;
  ASSERT_EQ(colours.size(), 4U);
  const std::array<Eigen::Vector4d, 4> stops{
      {{0.90, 0.72, 0.68, 1}, {0.95, 0.75, 0.30, 1}, {0.88, 0.30, 0.12, 1}, {0.45, 0.03, 0.10, 1}}};
  for (std::size_t i = 0; i < 4; ++i)
    EXPECT_LT((colours[i] - stops[i]).norm(), 1e-6) << i << ": " << colours[i].transpose();

  // A vertex between two stops lies between their colours, and one whose stress falls goes back.
  send_body({0, 1, 2, 0, 2, 3}, {30e3F, 15e3F, 0.0F, 0.0F});
  const auto later = compose()["tissue/left"].triangles.at(0).colours;
  EXPECT_LT((later[0] - stops[3]).norm(), 1e-6);
  EXPECT_LT((later[1] - 0.5 * (stops[1] + stops[2])).norm(), 1e-6) << later[1].transpose();
  EXPECT_LT((later[3] - stops[0]).norm(), 1e-6);
}

}  // namespace
}  // namespace sutured::gateway
