// SPDX-License-Identifier: GPL-3.0-or-later
// What waits to be sent to one web client: bounded, and the newest wins.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "protocol/serialized.hpp"

namespace sutured::gateway {

/// One WebSocket message.
struct Outgoing {
  bool text = false;
  std::string head;               ///< a text whole, or the first bytes of a binary message
  suture::SerializedSample body;  ///< the rest of a binary message

  [[nodiscard]] std::size_t size() const noexcept { return head.size() + body.bytes().size(); }
};

/// Holds messages for a client that reads slower than the scene changes.
///
/// Every instance of every subscription has a queue of its own of a stated depth, whose
/// oldest sample goes when a newer one comes: of a mesh only the latest frame waits. In
/// all at most `kBytesMax` wait; what comes then is dropped. Texts are few and must not be
/// lost: where more than `kTextsMax` wait the client is given up (`overrun`).
/// Threads: the gateway's.
class Outbox {
 public:
  static constexpr std::size_t kBytesMax = 32U << 20U;
  static constexpr std::size_t kQueuesMax = 1024;
  static constexpr std::size_t kTextsMax = 256;

  void push(std::string text);
  /// `instance` tells the things of one topic apart; `depth` ≥ 1.
  void push(std::uint32_t subscription, std::uint64_t instance, std::size_t depth,
            std::int64_t received_ns, suture::SerializedSample sample);
  /// Drops what waits for a subscription that has ended.
  void forget(std::uint32_t subscription);
  /// Takes the next message: texts first, then the queues in turn.
  [[nodiscard]] std::optional<Outgoing> pop();

  [[nodiscard]] std::size_t bytes() const noexcept { return bytes_; }
  [[nodiscard]] std::uint64_t dropped() const noexcept { return dropped_; }
  [[nodiscard]] bool overrun() const noexcept { return overrun_; }

 private:
  struct Waiting {
    std::int64_t received_ns;
    suture::SerializedSample sample;
  };
  using Key = std::pair<std::uint32_t, std::uint64_t>;

  std::deque<std::string> texts_;
  std::map<Key, std::deque<Waiting>> queues_;  // none of them empty
  std::deque<Key> turns_;                      // one a queue
  std::size_t bytes_ = 0;
  std::uint64_t dropped_ = 0;
  bool overrun_ = false;
};

}  // namespace sutured::gateway
