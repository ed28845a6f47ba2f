// SPDX-License-Identifier: GPL-3.0-or-later
#include "suture/viewer.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <limits>
#include <mutex>
#include <stdexcept>

#include "support/client_options.hpp"
#include "support/spring_server.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::eventually;
using sutured::testing::own_session;
using sutured::testing::SpringServer;

SessionOptions session_options() {
  return sutured::testing::client_options(own_session(), std::chrono::seconds(10));
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

TEST(Viewer, SeesThreadsAndContacts) {
  SpringServer server(server_options());
  const Participant mesh(own_session(), Channel::kMesh);
  Writer<v1::ThreadState> threads(mesh);
  Writer<v1::ContactState> contacts(mesh);
  std::mutex mutex;
  bool seen_thread = false, seen_contact = false;
  ViewerCallbacks callbacks;
  callbacks.on_thread = [&](const ThreadView& got) {
    const std::lock_guard lock(mutex);
    EXPECT_EQ(got.thread, "thread");
    EXPECT_EQ(got.length_m, 0.45);
    EXPECT_EQ(got.tension_n, 0.3);
    EXPECT_TRUE(got.taut);
    EXPECT_EQ(got.head, ThreadEnd::kSwaged);
    EXPECT_EQ(got.head_holder, "needle");
    EXPECT_EQ(got.tail, ThreadEnd::kAnchored);
    EXPECT_EQ(got.tail_holder, "vessel");
    EXPECT_STREQ(name_of(got.tail), "anchored");
    ASSERT_EQ(got.course_m.size(), 6U);
    EXPECT_EQ(got.course_m[5], 6.0);
    ASSERT_EQ(got.arc_length_m.size(), 2U);
    EXPECT_EQ(got.arc_length_m[1], 0.1);
    ASSERT_EQ(got.segment_tension_n.size(), 1U);
    ASSERT_EQ(got.punctures.size(), 1U);
    EXPECT_EQ(got.punctures[0].body, "vessel");
    EXPECT_TRUE(got.punctures[0].inward);
    seen_thread = true;
  };
  callbacks.on_contacts = [&](const ContactsView& got) {
    const std::lock_guard lock(mutex);
    EXPECT_EQ(got.step, 12U);
    ASSERT_EQ(got.points.size(), 1U);
    EXPECT_EQ(got.points[0].body, "vessel");
    EXPECT_EQ(got.points[0].other, "needle");
    EXPECT_EQ(got.points[0].normal, (Vector3{0, 0, 1}));
    EXPECT_EQ(got.points[0].force_n, 0.2);
    EXPECT_EQ(got.points[0].gap_m, 1e-6);
    seen_contact = true;
  };
  Viewer viewer(session_options(), callbacks);

  const std::vector<double> course{1, 2, 3, 4, 5, 6}, arc_length{0, 0.1}, tension{0.3};
  v1::Puncture puncture{};
  set_text(puncture.body, "vessel");
  puncture.inward = true;
  v1::ThreadState thread{};
  set_text(thread.thread, "thread");
  thread.length_m = 0.45;
  thread.tension_n = 0.3;
  thread.taut = true;
  thread.head = suture_v1_END_SWAGED;
  thread.tail = suture_v1_END_ANCHORED;
  set_text(thread.head_holder, "needle");
  set_text(thread.tail_holder, "vessel");
  lend(thread.course_m, std::span<const double>(course));
  lend(thread.arc_length_m, std::span<const double>(arc_length));
  lend(thread.segment_tension_n, std::span<const double>(tension));
  lend(thread.punctures, std::span<const v1::Puncture>(&puncture, 1));
  v1::ContactPoint point{};
  set_text(point.body, "vessel");
  set_text(point.other, "needle");
  point.normal[2] = 1.0;
  point.force_n = 0.2;
  point.gap_m = 1e-6;
  v1::ContactState contact{};
  contact.step = 12;
  lend(contact.points, std::span<const v1::ContactPoint>(&point, 1));
  EXPECT_TRUE(eventually([&] {
    threads.write(thread);  // best effort: until one arrives
    contacts.write(contact);
    const std::lock_guard lock(mutex);
    return seen_thread && seen_contact;
  }));
  viewer.close();
}

TEST(Viewer, SeesTheQualityThatWasToldBeforeItCame) {
  SpringServer server(server_options());
  const Participant mesh(own_session(), Channel::kMesh);
  Writer<v1::Quality> writer(mesh);
  v1::Bite bite{};
  set_text(bite.body, "vessel");
  bite.exit_m[1] = 0.5;
  bite.depth_m = 0.002;
  bite.edge_distance_m = 0.003;
  bite.spacing_m = std::numeric_limits<double>::quiet_NaN();
  bite.peak_force_n = 0.3;
  v1::Quality quality{};
  set_text(quality.thread, "thread");
  quality.epoch = 9;
  quality.elapsed_s = 1;
  quality.needle_path_m = 2;
  quality.peak_force_n = 3;
  quality.peak_principal_stress_pa = 4;
  quality.gap_start_m = 5;
  quality.gap_m = 6;
  quality.tension_n = 7;
  quality.bite_depth_mean_m = 8;
  quality.bite_depth_spread_m = 9;
  quality.bite_spacing_mean_m = 10;
  quality.bite_spacing_spread_m = 11;
  quality.handovers = 12;
  quality.needle_drops = 13;
  lend(quality.bites, std::span<const v1::Bite>(&bite, 1));
  ASSERT_TRUE(writer.write(quality));

  std::atomic<bool> seen{false};
  ViewerCallbacks callbacks;
  callbacks.on_quality = [&](const QualityView& got) {
    EXPECT_EQ(got.thread, "thread");
    EXPECT_EQ(got.epoch, 9U);
    EXPECT_EQ(got.elapsed_s, 1);
    EXPECT_EQ(got.needle_path_m, 2);
    EXPECT_EQ(got.peak_force_n, 3);
    EXPECT_EQ(got.peak_principal_stress_pa, 4);
    EXPECT_EQ(got.gap_start_m, 5);
    EXPECT_EQ(got.gap_m, 6);
    EXPECT_EQ(got.tension_n, 7);
    EXPECT_EQ(got.bite_depth_mean_m, 8);
    EXPECT_EQ(got.bite_depth_spread_m, 9);
    EXPECT_EQ(got.bite_spacing_mean_m, 10);
    EXPECT_EQ(got.bite_spacing_spread_m, 11);
    EXPECT_EQ(got.handovers, 12U);
    EXPECT_EQ(got.needle_drops, 13U);
    EXPECT_EQ(got.bites.size(), 1U);
    if (got.bites.empty()) return;
    EXPECT_EQ(got.bites[0].body, "vessel");
    EXPECT_EQ(got.bites[0].exit_m[1], 0.5);
    EXPECT_EQ(got.bites[0].depth_m, 0.002);
    EXPECT_EQ(got.bites[0].edge_distance_m, 0.003);
    EXPECT_TRUE(std::isnan(got.bites[0].spacing_m));
    EXPECT_EQ(got.bites[0].peak_force_n, 0.3);
    seen = true;
  };
  Viewer viewer(session_options(), callbacks);
  EXPECT_TRUE(eventually([&] { return seen.load(); }));
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
