// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/foxglove.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <random>

namespace sutured::gateway {
namespace {

using Json = nlohmann::json;

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span(text));
}

TEST(Foxglove, ChoosesTheClientsFirstSubprotocolThatItSpeaks) {
  EXPECT_EQ(choose_subprotocol("foxglove.sdk.v1, foxglove.websocket.v1"), "foxglove.sdk.v1");
  EXPECT_EQ(choose_subprotocol("x,\tfoxglove.websocket.v1"), "foxglove.websocket.v1");
  EXPECT_EQ(choose_subprotocol("foxglove.sdk.v2"), std::nullopt);
  EXPECT_EQ(choose_subprotocol(""), std::nullopt);
  EXPECT_EQ(choose_subprotocol(",,,"), std::nullopt);
}

TEST(Foxglove, AdvertisesChannelsWithTheirSchemas) {
  const std::vector<Channel> channels{
      {1, "suture/event", "suture::v1::Event", "module suture {};"}};
  const Json message = Json::parse(advertise(channels));
  EXPECT_EQ(message["op"], "advertise");
  EXPECT_EQ(message["channels"][0], (Json{{"id", 1},
                                          {"topic", "suture/event"},
                                          {"encoding", "cdr"},
                                          {"schemaName", "suture::v1::Event"},
                                          {"schema", "module suture {};"},
                                          {"schemaEncoding", "omgidl"}}));
}

TEST(Foxglove, HeadsAMessageInLittleEndian) {
  const std::string head = message_head(0x01020304, 0x1112131415161718);
  const std::string expected("\x01\x04\x03\x02\x01\x18\x17\x16\x15\x14\x13\x12\x11", 13);
  EXPECT_EQ(head, expected);
}

TEST(Foxglove, ReadsWhatClientsSay) {
  const ClientText subscribe = parse_client_text(
      R"({"op":"subscribe","subscriptions":[{"id":7,"channelId":3},{"id":8,"channelId":4}]})");
  const auto* items = std::get_if<Subscribe>(&subscribe);
  ASSERT_NE(items, nullptr);
  ASSERT_EQ(items->items.size(), 2U);
  EXPECT_EQ(items->items[1].subscription, 8U);
  EXPECT_EQ(items->items[1].channel, 4U);

  const ClientText advertised = parse_client_text(
      R"({"op":"advertise","channels":[{"id":1,"topic":"t","encoding":"cdr","schemaName":"s"}]})");
  ASSERT_NE(std::get_if<Advertise>(&advertised), nullptr);
  const ClientText other = parse_client_text(R"({"op":"getParameters","parameterNames":[]})");
  ASSERT_NE(std::get_if<Unsupported>(&other), nullptr);
  EXPECT_EQ(std::get<Unsupported>(other).operation, "getParameters");
}

TEST(Foxglove, NamesWhatIsWrong) {
  const auto reason = [](const char* text) {
    const ClientText message = parse_client_text(text);
    const auto* malformed = std::get_if<Malformed>(&message);
    return malformed == nullptr ? std::string("nothing") : malformed->reason;
  };
  EXPECT_EQ(reason("{"), "a text message must be JSON");
  EXPECT_EQ(reason("[]"), "\"op\" is missing");
  EXPECT_EQ(reason(R"({"op":1})"), "\"op\" must be a text");
  EXPECT_EQ(reason(R"({"op":"subscribe"})"), "\"subscriptions\" is missing");
  EXPECT_EQ(reason(R"({"op":"subscribe","subscriptions":{}})"), "\"subscriptions\" must be a list");
  EXPECT_EQ(reason(R"({"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]})"),
            "\"id\" must be a whole number from 0 to 4294967295");
  EXPECT_EQ(reason(R"({"op":"subscribe","subscriptions":[{"id":1e3,"channelId":1}]})"),
            "\"id\" must be a whole number from 0 to 4294967295");
  EXPECT_EQ(reason(R"({"op":"subscribe","subscriptions":[{"id":4294967296,"channelId":1}]})"),
            "\"id\" must be a whole number from 0 to 4294967295");
}

TEST(Foxglove, ReadsBinaryMessagesAndNothingElse) {
  const std::string good("\x01\x09\x00\x00\x00payload", 12);
  const auto message = parse_client_binary(bytes_of(good));
  ASSERT_TRUE(message);
  EXPECT_EQ(message->channel, 9U);
  EXPECT_EQ(message->payload.size(), 7U);
  EXPECT_FALSE(parse_client_binary(bytes_of(good.substr(0, 4))));
  EXPECT_FALSE(parse_client_binary(bytes_of("\x02" + good.substr(1))));
  EXPECT_FALSE(parse_client_binary({}));
}

TEST(Foxglove, SurvivesEveryMutationOfAMessage) {
  const std::string good =
      R"({"op":"advertise","channels":[{"id":1,"topic":"suture/tool/pose","encoding":"cdr"}]})";
  std::mt19937 random(7);
  int malformed = 0;
  for (int i = 0; i < 20000; ++i) {
    std::string text = good;
    const int changes = 1 + static_cast<int>(random() % 4);
    for (int k = 0; k < changes; ++k)
      text[random() % text.size()] = static_cast<char>(random() % 256);
    if (random() % 4 == 0) text.resize(random() % text.size());
    malformed += std::holds_alternative<Malformed>(parse_client_text(text)) ? 1 : 0;
    const std::string echo = status(StatusLevel::kError, text);  // strangers' bytes in a reply
    EXPECT_TRUE(Json::accept(echo)) << echo;
  }
  EXPECT_GT(malformed, 10000);
}

}  // namespace
}  // namespace sutured::gateway
