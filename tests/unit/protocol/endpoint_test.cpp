// SPDX-License-Identifier: GPL-3.0-or-later
// Over real Cyclone DDS: two participants of one process, which meet as two processes would.
#include "protocol/endpoint.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <mutex>
#include <numeric>

#include "support/heap_guard.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::eventually;
using sutured::testing::HeapGuard;
using sutured::testing::own_session;

TEST(Endpoint, CarriesAPoseUnchanged) {
  const Participant participant(own_session(), Channel::kControl);
  Writer<v1::ToolPose> writer(participant);
  Reader<v1::ToolPose> reader(participant);
  ASSERT_TRUE(eventually([&] { return writer.matched() == 1; }));

  v1::ToolPose sent{};
  sent.tool_id = tool_id("driver");
  sent.sequence_number = 7;
  sent.stamp_ns = -3;
  sent.flags = suture_v1_POSE_IN_WORLD;
  for (int i = 0; i < 3; ++i) sent.position_m[i] = 0.1 * (i + 1);
  sent.orientation_xyzw[3] = 1.0;
  sent.jaw = 0.5F;
  ASSERT_TRUE(writer.write(sent));

  v1::ToolPose got{};
  SampleInfo info;
  ASSERT_TRUE(eventually([&] { return reader.take(got, info); }));
  EXPECT_TRUE(info.valid);
  EXPECT_TRUE(info.writers_alive);
  EXPECT_EQ(got.tool_id, tool_id("driver"));
  EXPECT_EQ(got.sequence_number, 7U);
  EXPECT_EQ(got.stamp_ns, -3);
  EXPECT_EQ(got.flags, std::uint32_t{suture_v1_POSE_IN_WORLD});
  EXPECT_EQ(got.position_m[2], sent.position_m[2]);
  EXPECT_EQ(got.jaw, 0.5F);
  EXPECT_EQ(reader.writer_guid(info.writer), writer.guid());
  EXPECT_NE(writer.guid(), kNobody);
}

TEST(Endpoint, TakesAndWritesPosesAndForcesWithoutAllocating) {
  if (!HeapGuard::active()) GTEST_SKIP() << "sanitizers bring their own malloc";
  const Participant participant(own_session(), Channel::kControl);
  Writer<v1::ToolPose> pose_writer(participant);
  Writer<v1::ToolForce> force_writer(participant);
  Reader<v1::ToolForce> force_reader(participant);

  // As a server does it: the force is written within the arrival of the pose.
  struct Answer {
    Reader<v1::ToolPose>* reader = nullptr;
    Writer<v1::ToolForce>* writer = nullptr;
    v1::ToolPose pose{};
    v1::ToolForce force{};
    std::atomic<int> answered{0};
    std::atomic<std::uint64_t> allocations{0};
    std::atomic<bool> counting{false};
  } answer;
  EndpointCallbacks callbacks;
  std::atomic<Reader<v1::ToolPose>*> ready{nullptr};
  callbacks.data_available = [&] {
    Reader<v1::ToolPose>* const reader = ready.load();
    if (reader == nullptr) return;
    const HeapGuard guard;
    SampleInfo info;
    while (reader->take(answer.pose, info)) {
      if (!info.valid) continue;
      answer.force.tool_id = answer.pose.tool_id;
      answer.force.pose_sequence = answer.pose.sequence_number;
      answer.writer->write(answer.force);
    }
    if (answer.counting) answer.allocations += guard.allocations();
    ++answer.answered;
  };
  answer.writer = &force_writer;
  Reader<v1::ToolPose> pose_reader(participant, std::move(callbacks));
  ready = &pose_reader;
  ASSERT_TRUE(
      eventually([&] { return pose_writer.matched() == 1 && force_writer.matched() == 1; }));

  v1::ToolPose pose{};
  v1::ToolForce force{};
  SampleInfo info;
  pose.tool_id = tool_id("driver");
  pose.orientation_xyzw[3] = 1.0;
  const auto exchange = [&] {
    const int before = answer.answered;
    ++pose.sequence_number;
    pose_writer.write(pose);
    while (answer.answered == before) std::this_thread::yield();
    while (force_reader.take(force, info)) {
    }
  };
  for (int i = 0; i < 100; ++i) exchange();  // instances, buffers

  // Cyclone fills its pools as its threads happen to meet, so a buffer may be added late. What a
  // message costs shows in every round: one without any allocation says that it costs none.
  std::uint64_t fewest = ~std::uint64_t{0};
  for (int round = 0; round < 5 && fewest > 0; ++round) {
    answer.allocations = 0;
    answer.counting = true;
    const HeapGuard guard;
    for (int i = 0; i < 1000; ++i) exchange();
    fewest = std::min(fewest, guard.allocations() + answer.allocations.load());
    answer.counting = false;
  }
  EXPECT_EQ(fewest, 0U);
  EXPECT_EQ(force.pose_sequence, pose.sequence_number);
}

TEST(Endpoint, GivesALateJoinerAllKeptEvents) {
  const Participant early(own_session(), Channel::kControl);
  Writer<v1::Event> writer(early);
  v1::Event event{};
  for (int i = 1; i <= 1200; ++i) {
    event.sequence_number = static_cast<std::uint64_t>(i);
    ASSERT_TRUE(writer.write(event));
  }
  const Participant late(own_session(), Channel::kControl);
  Reader<v1::Event> reader(late);
  std::vector<std::uint64_t> got;
  ASSERT_TRUE(eventually([&] {
    reader.take_each([&](const v1::Event& kept, const SampleInfo& info) {
      if (info.valid) got.push_back(kept.sequence_number);
    });
    return got.size() >= 1000;
  })) << got.size();
  std::vector<std::uint64_t> expected(1000);
  std::iota(expected.begin(), expected.end(), 201U);
  EXPECT_EQ(got, expected);
}

TEST(Endpoint, CarriesAMeshOfAMegabyte) {
  const Participant participant(own_session(), Channel::kMesh);
  Writer<v1::MeshFrame> writer(participant);
  Reader<v1::MeshFrame> reader(participant);
  WaitSet waitset;
  waitset.attach(reader);
  ASSERT_TRUE(eventually([&] { return writer.matched() == 1; }));

  std::vector<float> positions(250'000);
  std::iota(positions.begin(), positions.end(), 0.0F);
  v1::MeshFrame frame{};
  set_text(frame.body, "vessel");
  lend(frame.position_m, std::span<const float>(positions));
  bool equal = false;
  // Best effort: a frame may be lost, a later one arrives.
  ASSERT_TRUE(eventually([&] {
    EXPECT_TRUE(writer.write(frame));
    if (!waitset.wait(std::chrono::milliseconds(200))) return false;
    return reader.take_each([&](const v1::MeshFrame& got, const SampleInfo& info) {
      if (!info.valid) return;
      const auto view = span_of(got.position_m);
      equal = std::equal(view.begin(), view.end(), positions.begin(), positions.end());
    }) > 0;
  }));
  EXPECT_TRUE(equal);
}

TEST(Endpoint, RefusesSequencesBeyondTheirBound) {
  const Participant participant(own_session(), Channel::kControl);
  Writer<v1::HapticModel> writer(participant);
  const std::vector<double> offsets(65);
  v1::HapticModel model{};
  set_text(model.tool, "driver");
  lend(model.offset_m, std::span<const double>(offsets));
  EXPECT_FALSE(writer.write(model));
  lend(model.offset_m, std::span<const double>(offsets).first(64));
  EXPECT_TRUE(writer.write(model));
}

TEST(Endpoint, TellsWhenTheOtherSideComesAndGoes) {
  const Participant participant(own_session(), Channel::kControl);
  std::atomic<int> matched{-1};
  EndpointCallbacks callbacks;
  callbacks.matched = [&](int current) { matched = current; };
  Reader<v1::ToolPose> reader(participant, std::move(callbacks));
  {
    const Participant other(own_session(), Channel::kControl);
    Writer<v1::ToolPose> writer(other);
    ASSERT_TRUE(eventually([&] { return matched == 1; }));
    v1::ToolPose pose{};
    pose.tool_id = tool_id("driver");
    ASSERT_TRUE(eventually([&] { return writer.matched() == 1; }));
    writer.write(pose);
    SampleInfo info;
    ASSERT_TRUE(eventually([&] { return reader.take(pose, info); }));
  }
  ASSERT_TRUE(eventually([&] { return matched == 0; }));
  v1::ToolPose pose{};
  SampleInfo info;
  ASSERT_TRUE(eventually([&] { return reader.take(pose, info); }));
  EXPECT_FALSE(info.valid);
  EXPECT_FALSE(info.writers_alive);
}

TEST(Endpoint, NamesThePolicyThatKeepsAPeerAway) {
  const Participant participant(own_session(), Channel::kControl);
  std::mutex mutex;
  std::string policy;
  EndpointCallbacks callbacks;
  callbacks.incompatible_qos = [&](const std::string& name) {
    const std::lock_guard lock(mutex);
    policy = name;
  };
  const Writer<v1::ToolForce> writer(participant, std::move(callbacks));

  // A stranger that asks for more than best effort.
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  const dds_entity_t topic = dds_create_topic(participant.handle(), &suture_v1_ToolForce_desc,
                                              "suture/tool/force", nullptr, nullptr);
  const dds_entity_t stranger = dds_create_reader(participant.subscriber(), topic, qos, nullptr);
  dds_delete_qos(qos);
  ASSERT_GT(stranger, 0);
  EXPECT_TRUE(eventually([&] {
    const std::lock_guard lock(mutex);
    return policy == "reliability";
  }));
}

TEST(WaitSet, EndsItsWaitWhenWoken) {
  const Participant participant(own_session(), Channel::kMesh);
  WaitSet waitset;
  std::thread waker([&] { waitset.wake(); });
  EXPECT_FALSE(waitset.wait(std::chrono::hours(1)));
  waker.join();
}

}  // namespace
}  // namespace suture
