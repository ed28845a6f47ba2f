// SPDX-License-Identifier: GPL-3.0-or-later
// One client's protocol against real DDS; only the socket is left out.
#include "gateway/client.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <set>

#include "support/test_session.hpp"

namespace sutured::gateway {
namespace {

using testing::eventually;
using ::testing::HasSubstr;
using testing::own_session;
using Json = nlohmann::json;

/// The feed of a session, as the gateway hands it to clients.
class FeedSource : public ChannelSource {
 public:
  FeedSource(const suture::Participant& control, const suture::Participant& mesh)
      : feed(control, mesh, [] {}) {}
  [[nodiscard]] std::span<const Channel> channels() const override { return feed.channels(); }
  void subscribe(std::uint32_t channel) override { feed.subscribe(channel); }
  void unsubscribe(std::uint32_t channel) override { feed.unsubscribe(channel); }
  void retained(std::uint32_t channel,
                const std::function<void(const Delivery&)>& use) const override {
    feed.retained(channel, use);
  }
  Feed feed;
};

class ClientTest : public ::testing::Test {
 protected:
  [[nodiscard]] static Grant everything() {
    Grant grant;
    grant.rights.command = grant.rights.drive_all = true;
    return grant;
  }
  [[nodiscard]] static Grant rights_to(std::string_view tool) {
    Grant grant;
    grant.rights.tools.push_back(suture::tool_id(tool));
    return grant;
  }
  void drain(Client& client) {
    source_.feed.drain([&](const Delivery& delivery) { client.deliver(delivery); });
  }
  [[nodiscard]] std::uint32_t channel(std::string_view topic) const {
    for (const Channel& channel : source_.channels())
      if (channel.topic == topic) return channel.id;
    ADD_FAILURE() << "no channel " << topic;
    return 0;
  }
  static void subscribe(Client& client, std::uint32_t subscription, std::uint32_t channel) {
    client.on_text(
        Json{{"op", "subscribe"},
             {"subscriptions", Json::array({{{"id", subscription}, {"channelId", channel}}})}}
            .dump());
  }
  static void offer(Client& client, std::uint32_t channel, const char* topic) {
    client.on_text(
        Json{{"op", "advertise"},
             {"channels",
              Json::array(
                  {{{"id", channel}, {"topic", topic}, {"encoding", "cdr"}, {"schemaName", "x"}}})}}
            .dump());
  }
  static void publish(Client& client, std::uint32_t channel, std::span<const std::byte> payload) {
    std::vector<std::byte> message{std::byte{1}};
    for (int i = 0; i < 4; ++i) message.push_back(static_cast<std::byte>(channel >> (8 * i)));
    message.insert(message.end(), payload.begin(), payload.end());
    client.on_binary(message);
  }
  [[nodiscard]] suture::SerializedSample pose(std::string_view tool, std::uint32_t flags = 0) {
    suture::v1::ToolPose pose{};
    pose.tool_id = suture::tool_id(tool);
    pose.orientation_xyzw[3] = 1.0;
    pose.flags = flags;
    return ports_.pose.encode(&pose).value();
  }
  /// Takes texts until one is a status; null where none is.
  static Json next_status(Client& client) {
    while (const auto message = client.next()) {
      if (!message->text) continue;
      Json json = Json::parse(message->head);
      if (json["op"] == "status") return json;
    }
    return nullptr;
  }
  /// Its message, or "".
  static std::string status_of(Client& client) {
    const Json status = next_status(client);
    return status.is_null() ? "" : status["message"];
  }

  suture::Participant control_{own_session(), suture::Channel::kControl};
  suture::Participant mesh_{own_session(), suture::Channel::kMesh};
  HandPorts ports_{control_};
  FeedSource source_{control_, mesh_};
};

TEST_F(ClientTest, IsToldWhatThereIs) {
  Client client(source_, ports_, everything(), "now");
  const Json info = Json::parse(client.next()->head);
  EXPECT_EQ(info["op"], "serverInfo");
  EXPECT_EQ(info["sessionId"], "now");
  const Json advertised = Json::parse(client.next()->head);
  EXPECT_EQ(advertised["op"], "advertise");
  EXPECT_EQ(advertised["channels"].size(), suture::all_topics().size());
  EXPECT_THAT(advertised["channels"][0]["schema"].get<std::string>(),
              HasSubstr("@final struct ToolPose {"));
  EXPECT_FALSE(client.next());
}

TEST_F(ClientTest, GetsSamplesAsTheyTravel) {
  Client client(source_, ports_, everything(), "");
  subscribe(client, 42, channel("suture/tool/pose"));
  suture::SerializedWriter writer(control_, suture::topic<suture::v1::ToolPose>());
  const suture::SerializedSample sent = pose("left");
  ASSERT_TRUE(writer.write(sent.bytes()));
  std::optional<Outgoing> got;
  ASSERT_TRUE(eventually([&] {
    drain(client);
    while (auto message = client.next())
      if (!message->text) got = std::move(message);
    return got.has_value();
  }));
  EXPECT_EQ(got->head.substr(0, 5), std::string("\x01\x2a\x00\x00\x00", 5));
  EXPECT_TRUE(std::ranges::equal(got->body.bytes(), sent.bytes()));
}

TEST_F(ClientTest, GetsWhatWasSaidBeforeItCame) {
  suture::Writer<suture::v1::Event> events(control_);
  suture::v1::Event event{};
  for (int i = 0; i < 5; ++i) {
    event.sequence_number = static_cast<std::uint64_t>(i);
    ASSERT_TRUE(events.write(event));
  }
  Client early(source_, ports_, everything(), "");
  ASSERT_TRUE(eventually([&] {
    drain(early);
    int kept = 0;
    source_.feed.retained(channel("suture/event"), [&](const Delivery&) { ++kept; });
    return kept == 5;
  }));
  Client late(source_, ports_, everything(), "");
  subscribe(late, 1, channel("suture/event"));
  int got = 0;
  while (const auto message = late.next()) got += message->text ? 0 : 1;
  EXPECT_EQ(got, 5);
}

TEST_F(ClientTest, ReadsATopicOfTheForceThreadsWhileSomebodyListensAndAMinuteMore) {
  suture::Writer<suture::v1::ToolForce> forces(control_);
  EXPECT_EQ(forces.matched(), 0);
  Feed& feed = source_.feed;
  const auto now = std::chrono::steady_clock::now();
  for (int visits = 0; visits < 3; ++visits) {
    Client client(source_, ports_, everything(), "");
    subscribe(client, 1, channel("suture/tool/force"));
    feed.close_idle(now + 2 * kReaderStays);  // it is listened to
    EXPECT_TRUE(eventually([&] { return forces.matched() == 1; }));
  }
  feed.close_idle(now + kReaderStays / 2);
  EXPECT_TRUE(feed.reads(channel("suture/tool/force")));
  feed.close_idle(now + 2 * kReaderStays);
  EXPECT_TRUE(eventually([&] { return forces.matched() == 0; }));
  EXPECT_TRUE(feed.reads(channel("suture/status"))) << "what late joiners get stays";
}

TEST_F(ClientTest, DrivesAToolAsADeviceOfItsOwn) {
  suture::Reader<suture::v1::ToolPose> poses(control_);
  std::optional<Client> client;
  client.emplace(source_, ports_, everything(), "");
  offer(*client, 3, "suture/tool/pose");
  suture::v1::ToolPose got{};
  suture::SampleInfo info;
  ASSERT_TRUE(eventually([&] {
    publish(*client, 3,
            pose("left", suture_v1_POSE_RENDER_DEVICE | suture_v1_POSE_IN_WORLD).bytes());
    return poses.take(got, info) && info.valid;
  }));
  EXPECT_EQ(got.tool_id, suture::tool_id("left"));
  EXPECT_EQ(got.flags, std::uint32_t{suture_v1_POSE_IN_WORLD}) << "the server renders";
  EXPECT_EQ(status_of(*client), "");

  // What it tells of itself goes by the writer of its poses.
  const std::optional<suture::Guid> hand = poses.writer_guid(info.writer);
  suture::Reader<suture::v1::DeviceProfile> profiles(control_);
  offer(*client, 4, "suture/tool/device");
  suture::v1::DeviceProfile profile{};
  suture::set_text(profile.tool, "left");
  profile.pointer = true;
  publish(*client, 4, ports_.profile.encode(&profile)->bytes());
  suture::v1::DeviceProfile told{};
  ASSERT_TRUE(eventually([&] { return profiles.take(told, info); }));
  EXPECT_TRUE(told.pointer);
  EXPECT_EQ(suture::guid_of(told.device), hand);

  client.reset();
  EXPECT_TRUE(eventually([&] { return poses.matched() == 0; })) << "the lease would end";
}

TEST_F(ClientTest, LeavesAToolWithGoodbye) {
  suture::Reader<suture::v1::ToolPose> poses(control_);
  Client client(source_, ports_, everything(), "");
  offer(client, 3, "suture/tool/pose");
  publish(client, 3, pose("left").bytes());
  ASSERT_TRUE(eventually([&] { return poses.matched() == 1; }));
  suture::v1::ToolPose got{};
  suture::SampleInfo info;
  std::set<std::uint64_t> writers;
  // Taken and left again and again it stays one writer: Cyclone DDS keeps something of each.
  for (int i = 0; i < 5; ++i) {
    publish(client, 3, pose("left").bytes());
    publish(client, 3, pose("left", suture_v1_POSE_GOODBYE).bytes());
    ASSERT_TRUE(eventually([&] {
      while (poses.take(got, info))
        if (info.valid && got.flags == suture_v1_POSE_GOODBYE) return true;
      return false;
    }));
    writers.insert(info.writer);
  }
  EXPECT_EQ(writers.size(), 1U);
}

TEST_F(ClientTest, GetsAChannelOnce) {
  Client client(source_, ports_, everything(), "");
  subscribe(client, 1, channel("suture/event"));
  EXPECT_EQ(status_of(client), "");
  subscribe(client, 2, channel("suture/event"));
  EXPECT_THAT(status_of(client), HasSubstr("is subscribed already"));
  client.on_text(R"({"op":"unsubscribe","subscriptionIds":[1]})");
  subscribe(client, 2, channel("suture/event"));
  EXPECT_EQ(status_of(client), "");
}

TEST_F(ClientTest, DoesOnlyWhatItsTokenAllows) {
  Client client(source_, ports_, rights_to("left"), "");
  offer(client, 3, "suture/tool/pose");
  offer(client, 4, "suture/tool/device");
  offer(client, 5, "suture/command");
  publish(client, 3, pose("left").bytes());
  EXPECT_EQ(status_of(client), "");
  publish(client, 3, pose("right").bytes());
  const Json refused = next_status(client);
  EXPECT_THAT(refused["message"].get<std::string>(),
              HasSubstr("does not allow to drive that tool"));
  EXPECT_EQ(refused["id"], "may-not-drive");
  suture::v1::DeviceProfile profile{};
  suture::set_text(profile.tool, "right");
  publish(client, 4, ports_.profile.encode(&profile)->bytes());
  EXPECT_THAT(status_of(client), HasSubstr("suture/tool/device: your token"));

  suture::Reader<suture::v1::Command> commands(control_);
  ASSERT_TRUE(eventually([&] { return ports_.commands.matched() == 1; }));
  suture::v1::Command command{};
  command.kind = suture_v1_COMMAND_RESET;
  publish(client, 5, ports_.command.encode(&command)->bytes());
  EXPECT_THAT(status_of(client), HasSubstr("does not allow commands"));
  command.kind = suture_v1_COMMAND_STOP;
  publish(client, 5, ports_.command.encode(&command)->bytes());
  suture::v1::Command got{};
  suture::SampleInfo info;
  ASSERT_TRUE(eventually([&] { return commands.take(got, info); })) << "a stop is never refused";
  EXPECT_EQ(got.kind, suture_v1_COMMAND_STOP);
  EXPECT_EQ(suture::guid_of(got.requester), ports_.commands.guid());
}

TEST_F(ClientTest, IsToldOnceWhatItDoesWrong) {
  Client client(source_, ports_, everything(), "");
  static_cast<void>(status_of(client));
  publish(client, 9, pose("left").bytes());
  EXPECT_EQ(status_of(client), "channel 9 was not advertised");
  publish(client, 9, pose("left").bytes());
  EXPECT_EQ(status_of(client), "") << "the same again";
  offer(client, 3, "suture/tool/force");
  EXPECT_THAT(status_of(client), HasSubstr("clients may publish suture/tool/pose"));
  offer(client, 3, "suture/tool/pose");
  publish(client, 3, pose("left").bytes().first(40));
  EXPECT_THAT(status_of(client), HasSubstr("not a suture::v1::ToolPose"));
  subscribe(client, 1, 1);
  subscribe(client, 1, 2);
  EXPECT_EQ(status_of(client), "subscription 1 is in use");
  EXPECT_FALSE(client.closing());
}

TEST_F(ClientTest, ClosesWhoGoesOn) {
  Client client(source_, ports_, everything(), "");
  for (int i = 0; i < Client::kFaultsMax; ++i) client.on_text("nonsense");
  ASSERT_TRUE(client.closing());
  EXPECT_EQ(client.closing()->code, 1008);
}

TEST_F(ClientTest, ClosesWhoFloods) {
  Client client(source_, ports_, everything(), "");
  offer(client, 3, "suture/tool/pose");
  const auto sample = pose("left");
  int sent = 0;
  while (!client.closing() && sent < 1'000'000) {
    publish(client, 3, sample.bytes());
    ++sent;
  }
  ASSERT_TRUE(client.closing());
  EXPECT_EQ(client.closing()->reason, "too many messages a second");
  EXPECT_GE(sent, 4000) << "a device of 4 kHz may come";
}

TEST_F(ClientTest, SurvivesRandomMessages) {
  std::mt19937 random(11);
  const auto sample = pose("left");
  for (int round = 0; round < 50; ++round) {
    Client client(source_, ports_, everything(), "");
    offer(client, 3, "suture/tool/pose");
    for (int i = 0; i < 90; ++i) {
      std::vector<std::byte> bytes(sample.bytes().begin(), sample.bytes().end());
      for (int k = 0; k < 3; ++k) bytes[random() % bytes.size()] = static_cast<std::byte>(random());
      bytes.resize(random() % (bytes.size() + 1));
      publish(client, 3 + random() % 2, bytes);
    }
    EXPECT_FALSE(client.closing());
  }
}

}  // namespace
}  // namespace sutured::gateway
