// SPDX-License-Identifier: GPL-3.0-or-later
#include "suture/viewer.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <stdexcept>

#include "support/spring_server.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::eventually;
using sutured::testing::own_session;
using sutured::testing::SpringServer;

SessionOptions session_options() {
  SessionOptions options;
  options.domain = own_session().domain;
  options.session = own_session().session;
  options.timeout = std::chrono::seconds(10);
  return options;
}

SpringServer::Options server_options() {
  SpringServer::Options options;
  options.session = own_session();
  return options;
}

TEST(Viewer, SeesMeshesNeedlesAndEvents) {
  SpringServer server(server_options());
  const Participant mesh(own_session(), Channel::kMesh);
  Writer<v1::MeshTopology> topologies(mesh);
  Writer<v1::MeshFrame> frames(mesh);
  Writer<v1::NeedleState> needles(mesh);

  const std::vector<std::uint32_t> vertices{4, 5, 6};
  const std::vector<std::uint32_t> triangle{0, 1, 2};
  const std::vector<float> positions{0, 0, 0, 1, 0, 0, 0, 1, 0};
  v1::TriangleGroup group{};
  set_text(group.name, "wall");
  group.triangle_count = 1;
  v1::MeshTopology topology{};
  set_text(topology.body, "vessel");
  topology.revision = 3;
  lend(topology.vertex, std::span<const std::uint32_t>(vertices));
  lend(topology.triangle, std::span<const std::uint32_t>(triangle));
  lend(topology.rest_position_m, std::span<const float>(positions));
  lend(topology.groups, std::span<const v1::TriangleGroup>(&group, 1));
  ASSERT_TRUE(topologies.write(topology));  // before the viewer: it is kept
  v1::Event event{};
  event.kind = suture_v1_EVENT_PUNCTURE;
  set_text(event.subject, "needle");
  event.value = 0.05;
  set_text(event.unit, "N");
  server.publish_event(event);

  std::mutex mutex;
  std::string seen_group, seen_event;
  std::vector<float> seen_positions;
  std::string seen_needle;
  ViewerCallbacks callbacks;
  callbacks.on_topology = [&](const MeshTopology& got) {
    const std::lock_guard lock(mutex);
    EXPECT_EQ(got.body, "vessel");
    EXPECT_EQ(got.vertex[2], 6U);
    EXPECT_EQ(got.triangle.size(), 3U);
    seen_group = got.groups.at(0).name;
  };
  callbacks.on_frame = [&](const MeshFrame& got) {
    const std::lock_guard lock(mutex);
    EXPECT_EQ(got.revision, 3U);
    EXPECT_EQ(got.von_mises_pa.size(), 3U);
    EXPECT_EQ(got.principal_pa.size(), 9U);
    EXPECT_EQ(got.principal_pa.back(), -2.0F);
    seen_positions.assign(got.position_m.begin(), got.position_m.end());
  };
  callbacks.on_needle = [&](const NeedleView& got) {
    const std::lock_guard lock(mutex);
    seen_needle = got.needle;
    EXPECT_TRUE(got.arc);
  };
  callbacks.on_event = [&](const Event& got) {
    const std::lock_guard lock(mutex);
    seen_event = got.kind + " " + got.subject;
  };
  Viewer viewer(session_options(), callbacks);

  v1::MeshFrame frame{};
  set_text(frame.body, "vessel");
  frame.revision = 3;
  lend(frame.position_m, std::span<const float>(positions));
  const std::vector<float> von_mises(3, 3.0F), principal{1, 0, -2, 1, 0, -2, 1, 0, -2};
  lend(frame.von_mises_pa, std::span<const float>(von_mises));
  lend(frame.principal_pa, std::span<const float>(principal));
  v1::NeedleState needle{};
  set_text(needle.needle, "needle");
  needle.shape = suture_v1_NEEDLE_ARC;
  EXPECT_TRUE(eventually([&] {
    frames.write(frame);  // best effort: until one arrives
    needles.write(needle);
    const std::lock_guard lock(mutex);
    return seen_group == "wall" && seen_event == "puncture needle" && seen_positions == positions &&
           seen_needle == "needle";
  }));
  viewer.close();
}

TEST(Viewer, HandsOnWhatACallbackThrows) {
  SpringServer server(server_options());
  std::atomic<bool> called{false};
  ViewerCallbacks callbacks;
  callbacks.on_status = [&](const Status&) {
    called = true;
    throw std::runtime_error("no more");
  };
  Viewer viewer(session_options(), callbacks);
  ASSERT_TRUE(eventually([&] { return called.load(); }));
  EXPECT_THROW(viewer.close(), std::runtime_error);
}

TEST(Viewer, NamesTheMissingServer) {
  SessionOptions options = session_options();
  options.timeout = std::chrono::milliseconds(50);
  try {
    const Viewer viewer(options, {});
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kNoServer);
  }
}

}  // namespace
}  // namespace suture
