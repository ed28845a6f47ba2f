// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/foxglove.hpp"

#include <algorithm>
#include <limits>
#include <nlohmann/json.hpp>

namespace sutured::gateway {
namespace {

using Json = nlohmann::json;

constexpr std::byte kMessageData{1};

template <class T>
void append_little_endian(std::string& bytes, T value) {
  for (std::size_t i = 0; i < sizeof(T); ++i)
    bytes.push_back(static_cast<char>((value >> (8 * i)) & 0xFFU));
}

std::string_view trimmed(std::string_view text) noexcept {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t')) text.remove_suffix(1);
  return text;
}

/// Thrown within this file only.
struct Fault {
  std::string reason;
};

std::uint32_t number_of(const Json& value, const char* what) {
  if (value.is_number_integer() && value >= 0 && value <= std::numeric_limits<std::uint32_t>::max())
    return value.get<std::uint32_t>();
  throw Fault{std::string("\"") + what + "\" must be a whole number from 0 to 4294967295"};
}

const Json& member(const Json& object, const char* name) {
  if (object.is_object())
    if (const auto found = object.find(name); found != object.end()) return *found;
  throw Fault{std::string("\"") + name + "\" is missing"};
}

const Json& list(const Json& object, const char* name) {
  const Json& value = member(object, name);
  if (!value.is_array()) throw Fault{std::string("\"") + name + "\" must be a list"};
  return value;
}

std::string text_in(const Json& object, const char* name) {
  const Json& value = member(object, name);
  if (!value.is_string()) throw Fault{std::string("\"") + name + "\" must be a text"};
  return value.get<std::string>();
}

std::vector<std::uint32_t> numbers(const Json& object, const char* name) {
  std::vector<std::uint32_t> values;
  for (const Json& value : list(object, name)) values.push_back(number_of(value, name));
  return values;
}

ClientText read_operation(const Json& message) {
  const std::string operation = text_in(message, "op");
  if (operation == "subscribe") {
    Subscribe subscribe;
    for (const Json& item : list(message, "subscriptions"))
      subscribe.items.push_back(
          {number_of(member(item, "id"), "id"), number_of(member(item, "channelId"), "channelId")});
    return subscribe;
  }
  if (operation == "unsubscribe") return Unsubscribe{numbers(message, "subscriptionIds")};
  if (operation == "advertise") {
    Advertise advertise;
    for (const Json& item : list(message, "channels"))
      advertise.items.push_back(
          {number_of(member(item, "id"), "id"), text_in(item, "topic"), text_in(item, "encoding")});
    return advertise;
  }
  if (operation == "unadvertise") return Unadvertise{numbers(message, "channelIds")};
  return Unsupported{operation.substr(0, 64)};
}

// Texts may hold what strangers wrote: whatever is not UTF-8 is replaced, not thrown at.
std::string dump(const Json& message) {
  return message.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace

std::optional<std::string_view> choose_subprotocol(std::string_view offered) noexcept {
  while (!offered.empty()) {
    const std::size_t comma = offered.find(',');
    const std::string_view one = trimmed(offered.substr(0, comma));
    const auto ours = std::find(std::begin(kSubprotocols), std::end(kSubprotocols), one);
    if (ours != std::end(kSubprotocols)) return *ours;
    if (comma == std::string_view::npos) break;
    offered.remove_prefix(comma + 1);
  }
  return std::nullopt;
}

std::string server_info(std::string_view name, std::string_view session_id) {
  return dump({{"op", "serverInfo"},
               {"name", name},
               {"capabilities", Json::array({"clientPublish"})},
               {"supportedEncodings", Json::array({"cdr"})},
               {"metadata", Json::object()},
               {"sessionId", session_id}});
}

std::string advertise(std::span<const Channel> channels) {
  Json list = Json::array();
  for (const Channel& channel : channels)
    list.push_back({{"id", channel.id},
                    {"topic", channel.topic},
                    {"encoding", "cdr"},
                    {"schemaName", channel.schema_name},
                    {"schema", channel.schema},
                    {"schemaEncoding", "omgidl"}});
  return dump({{"op", "advertise"}, {"channels", std::move(list)}});
}

std::string status(StatusLevel level, std::string_view message, std::string_view id) {
  Json text{{"op", "status"}, {"level", static_cast<int>(level)}, {"message", message}};
  if (!id.empty()) text["id"] = id;
  return dump(text);
}

std::string message_head(std::uint32_t subscription, std::int64_t time_ns) {
  std::string head(1, static_cast<char>(kMessageData));
  append_little_endian(head, subscription);
  append_little_endian(head, static_cast<std::uint64_t>(time_ns));
  return head;
}

ClientText parse_client_text(std::string_view text) {
  const Json message = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (message.is_discarded()) return Malformed{"a text message must be JSON"};
  try {
    return read_operation(message);
  } catch (const Fault& fault) {
    return Malformed{fault.reason};
  }
}

std::optional<ClientMessage> parse_client_binary(std::span<const std::byte> bytes) noexcept {
  constexpr std::size_t kHead = 5;
  if (bytes.size() < kHead || bytes[0] != kMessageData) return std::nullopt;
  std::uint32_t channel = 0;
  for (std::size_t i = 0; i < 4; ++i)
    channel |= std::to_integer<std::uint32_t>(bytes[1 + i]) << (8 * i);
  return ClientMessage{channel, bytes.subspan(kHead)};
}

}  // namespace sutured::gateway
