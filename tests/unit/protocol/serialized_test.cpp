// SPDX-License-Identifier: GPL-3.0-or-later
// Over real Cyclone DDS: what one participant writes as bytes, another takes as a sample.
#include "protocol/serialized.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <thread>
#include <vector>

#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::eventually;
using sutured::testing::own_session;

v1::ToolPose pose(std::uint64_t number) {
  v1::ToolPose sample{};
  sample.tool_id = tool_id("driver");
  sample.sequence_number = number;
  sample.orientation_xyzw[3] = 1.0;
  sample.jaw = 0.25F;
  return sample;
}

TEST(Serialized, TakesWhatATypedWriterSentAsXcdr1) {
  const Participant participant(own_session(), Channel::kControl);
  Writer<v1::ToolPose> writer(participant);
  SerializedReader reader(participant, topic<v1::ToolPose>(), {}, 8);
  ASSERT_TRUE(eventually([&] { return writer.matched() == 1; }));
  ASSERT_TRUE(writer.write(pose(1)));
  ASSERT_TRUE(writer.write(pose(2)));

  std::vector<SerializedSample> samples;
  ASSERT_TRUE(eventually([&] {
    reader.take_each([&](SerializedSample sample, const SampleInfo& info) {
      EXPECT_TRUE(info.valid);
      samples.push_back(std::move(sample));
    });
    return samples.size() == 2;
  }));
  const SampleCodec codec(participant, suture_v1_ToolPose_desc, "suture/tool/pose");
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(samples[i].bytes()[0], std::byte{0});
    EXPECT_EQ(samples[i].bytes()[1], std::byte{1});  // CDR, little endian
    v1::ToolPose got{};
    ASSERT_TRUE(codec.decode(samples[i].bytes(), got));
    EXPECT_EQ(got.sequence_number, i + 1);
    EXPECT_EQ(got.jaw, 0.25F);
  }
}

TEST(Serialized, WritesBytesThatATypedReaderTakes) {
  const Participant participant(own_session(), Channel::kControl);
  SerializedWriter writer(participant, topic<v1::ToolPose>());
  Reader<v1::ToolPose> reader(participant);
  const SampleCodec codec(participant, suture_v1_ToolPose_desc, "suture/tool/pose");
  ASSERT_TRUE(eventually([&] { return reader.matched() == 1; }));
  const v1::ToolPose sent = pose(5);
  const std::optional<SerializedSample> encoded = codec.encode(&sent);
  ASSERT_TRUE(encoded.has_value());
  ASSERT_TRUE(writer.write(encoded->bytes()));
  v1::ToolPose got{};
  SampleInfo info;
  ASSERT_TRUE(eventually([&] { return reader.take(got, info); }));
  EXPECT_EQ(got.sequence_number, 5U);
  EXPECT_EQ(reader.writer_guid(info.writer), writer.guid());
}

TEST(Serialized, RefusesBytesThatAreNotASample) {
  const Participant participant(own_session(), Channel::kControl);
  const SampleCodec codec(participant, suture_v1_Command_desc, "suture/command");
  const v1::Command command{};
  const SerializedSample good = codec.encode(&command).value();
  const std::vector<std::byte> bytes(good.bytes().begin(), good.bytes().end());
  const auto reads = [&](std::span<const std::byte> these) {
    v1::Command got{};
    return codec.decode(these, got);
  };
  EXPECT_TRUE(reads(bytes));

  for (std::size_t length = 0; length + 8 < bytes.size(); ++length) {  // cut short
    EXPECT_FALSE(reads(std::span(bytes).first(length))) << length;
  }
  std::vector<std::byte> header = bytes;
  header[1] = std::byte{0x55};  // an encoding that there is not
  EXPECT_FALSE(reads(header));
  std::vector<std::byte> kind = bytes;
  const std::size_t at = 4 + 16 + 8 + 8 + 8;  // header, requester, epoch, request, stamp
  kind[at] = std::byte{0xFF};                 // a command that there is not
  EXPECT_FALSE(reads(kind));
  std::vector<std::byte> name = bytes;
  name[at + 4] = std::byte{0xF0};  // a name longer than the message
  EXPECT_FALSE(reads(name));
}

TEST(Serialized, ASeparateParticipantIsServedOnItsOwnThread) {
  ParticipantOptions apart = own_session();
  apart.separate = true;
  const Participant here(own_session(), Channel::kControl);
  const Participant there(apart, Channel::kControl);
  std::atomic<std::thread::id> served{};
  EndpointCallbacks callbacks;
  callbacks.data_available = [&] { served = std::this_thread::get_id(); };
  Reader<v1::ToolPose> reader(here, std::move(callbacks));
  Writer<v1::ToolPose> writer(there);
  ASSERT_TRUE(eventually([&] { return writer.matched() == 1 && reader.matched() == 1; }));
  ASSERT_TRUE(eventually([&] {  // best effort: the first may come before the match is known
    writer.write(pose(1));
    return served.load() != std::thread::id();
  }));
  EXPECT_NE(served.load(), std::this_thread::get_id());
}

}  // namespace
}  // namespace suture
