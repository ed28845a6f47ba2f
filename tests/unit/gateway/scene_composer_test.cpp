// SPDX-License-Identifier: GPL-3.0-or-later
// What the gateway draws of samples that lie, over real Cyclone DDS.
#include "gateway/scene_composer.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <limits>
#include <vector>

#include "gateway/feed.hpp"
#include "support/test_session.hpp"

namespace sutured::gateway {
namespace {

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

  suture::Participant mesh_{testing::own_session(), suture::Channel::kMesh};
  SceneComposer composer_{mesh_};
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

}  // namespace
}  // namespace sutured::gateway
