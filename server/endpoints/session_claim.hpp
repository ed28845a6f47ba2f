// SPDX-License-Identifier: GPL-3.0-or-later
// One session has one server. Two that answered the same poses would each pull at the hand.
//
//     asks (600 ms) ──nobody serves or precedes──▶ holds ──first status with an epoch──▶ serves
//       │                                                                                 │
//       └──somebody does──▶ Error kServerRunning            one that precedes──▶ rival() ─┘
//
// The words are statuses with the epoch 0, which clients pass over: SERVER_STARTING while it asks,
// SERVER_RUNNING once it holds the session. Of two that ask, and of two that find each other
// serving (a network that was cut and is whole again), the one with the smaller GUID stays; who
// asks always gives way to who holds or serves. As a server listens on for as long as it asked
// alone, two that start within that time hear each other, whatever the order.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

#include "protocol/endpoint.hpp"

namespace sutured::endpoints {

/// Fills what says which server a status is of: protocol, server, session, host, process, scene.
void identify(suture::v1::ServerStatus& status, const suture::Guid& server,
              std::string_view session, std::string_view scene);

/// A server's right to its session, and the writer of its status.
///
/// Threads: the owner's; `rival` any one.
class SessionClaim {
 public:
  /// Asks for the session of `participant` for `patience`, and holds it then. Throws suture::Error
  /// kServerRunning, which names the other server.
  SessionClaim(const suture::Participant& participant, std::string_view scene,
               std::chrono::nanoseconds patience);

  [[nodiscard]] suture::Writer<suture::v1::ServerStatus>& status() noexcept { return status_; }
  [[nodiscard]] const suture::Guid& server() const noexcept { return guid_; }
  [[nodiscard]] std::int64_t started_ns() const noexcept { return started_ns_; }

  /// Looks for another server that serves this session by now and precedes this one. Returns what
  /// to tell people of it; empty: there is none.
  [[nodiscard]] std::string rival();

 private:
  void say(suture_v1_ServerState state, std::string_view scene);
  [[nodiscard]] std::string told(const suture::v1::ServerStatus& other) const;

  const suture::ParticipantOptions& options_;
  suture::Writer<suture::v1::ServerStatus> status_;
  suture::Reader<suture::v1::ServerStatus> others_;
  suture::Guid guid_{};
  std::int64_t started_ns_ = 0;
};

}  // namespace sutured::endpoints
