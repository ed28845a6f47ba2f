// SPDX-License-Identifier: GPL-3.0-or-later
// Messages of Foxglove's WebSocket protocol (subprotocols foxglove.sdk.v1 and
// foxglove.websocket.v1), as far as this server speaks it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace sutured::gateway {

inline constexpr std::string_view kSubprotocols[] = {"foxglove.sdk.v1", "foxglove.websocket.v1"};

/// Returns the first of a client's `Sec-WebSocket-Protocol` list that we speak.
[[nodiscard]] std::optional<std::string_view> choose_subprotocol(std::string_view offered) noexcept;

// ------------------------------------------------------------------ to a client

/// A topic as it is offered.
struct Channel {
  std::uint32_t id = 0;
  std::string topic;
  std::string schema_name;  ///< `suture::v1::MeshFrame`
  std::string_view schema;  ///< text of the IDL file; must outlive the channel
};

enum class StatusLevel { kInfo = 0, kWarning = 1, kError = 2 };

[[nodiscard]] std::string server_info(std::string_view name, std::string_view session_id);
[[nodiscard]] std::string advertise(std::span<const Channel> channels);
/// `id` says to programs what `message` says to people; a later status of the same id takes the
/// place of this one. Empty: none.
[[nodiscard]] std::string status(StatusLevel level, std::string_view message,
                                 std::string_view id = {});
/// Returns the 13 bytes before a sample: opcode, subscription, time in ns.
[[nodiscard]] std::string message_head(std::uint32_t subscription, std::int64_t time_ns);

// ------------------------------------------------------------------ from a client

struct Subscribe {
  struct Item {
    std::uint32_t subscription, channel;
  };
  std::vector<Item> items;
};
struct Unsubscribe {
  std::vector<std::uint32_t> subscriptions;
};
/// A client wants to publish.
struct Advertise {
  struct Item {
    std::uint32_t channel;
    std::string topic, encoding;
  };
  std::vector<Item> items;
};
struct Unadvertise {
  std::vector<std::uint32_t> channels;
};
/// Well-formed, and of no use here (an operation that we do not offer).
struct Unsupported {
  std::string operation;
};
/// What is wrong with a message, for its sender.
struct Malformed {
  std::string reason;
};
using ClientText =
    std::variant<Subscribe, Unsubscribe, Advertise, Unadvertise, Unsupported, Malformed>;

/// Reads a text message of a client. Never throws but bad_alloc; any bytes are allowed.
[[nodiscard]] ClientText parse_client_text(std::string_view text);

struct ClientMessage {
  std::uint32_t channel;
  std::span<const std::byte> payload;
};
/// Reads a binary message of a client; nothing where it is none.
[[nodiscard]] std::optional<ClientMessage> parse_client_binary(
    std::span<const std::byte> bytes) noexcept;

}  // namespace sutured::gateway
