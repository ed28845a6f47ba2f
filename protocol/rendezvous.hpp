// SPDX-License-Identifier: Apache-2.0
// How a client finds the server of its session, and what it learns where it does not.
#pragma once

#include <chrono>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/force_shaping.hpp"
#include "protocol/participant.hpp"

namespace suture {

/// Names a session for people: `session "class-a"`, or `the default session`.
[[nodiscard]] std::string session_text(std::string_view session);

/// Names the state of a server for people: "running".
[[nodiscard]] const char* name_of(v1::ServerState state) noexcept;

/// One tool of a server's scene.
struct ServerTool {
  std::string name;
  std::string kind;
  bool leased = false;
  Guid device{};                           ///< writer that holds the lease
  ForceLimits limits{0.0, 0.0, 0.0, 0.0};  ///< zero: it tells none
  double stale_after_ms = 0.0;
};

/// What a server says about itself in its status.
struct ServerInfo {
  Guid server{};
  std::uint64_t epoch = 0;
  std::uint32_t protocol_version = 0;
  std::string version;
  std::string session;
  std::string host;
  int pid = 0;
  std::string scene;
  std::vector<ServerTool> tools;

  /// Returns the tool of that name, or null.
  [[nodiscard]] const ServerTool* tool(std::string_view name) const noexcept;
};

/// Copies what identifies a server out of its status.
[[nodiscard]] ServerInfo server_info(const v1::ServerStatus& status);

/// Waits for the server of the participant's session and returns what it says; where
/// `enough` is given, waits on until that likes it, and returns the last word at the end
/// of `timeout`.
///
/// Throws Error kNoServer after `timeout`, naming the other sessions in which servers do
/// answer, and kVersionMismatch where one speaks another protocol version.
/// `participant` is one of the control channel.
[[nodiscard]] ServerInfo await_server(const Participant& participant,
                                      std::chrono::nanoseconds timeout,
                                      const std::function<bool(const ServerInfo&)>& enough = {});

/// Calls `use` with what each server says that `participants` hear, until every one that is known
/// has spoken and none became known for 600 ms, or `timeout` is over. Of a server that says more
/// meanwhile it is called again; of one that is leaving, not.
/// `participants` are of the control channel and of every session, each of another domain.
void listen_to_servers(
    std::span<const Participant> participants, std::chrono::nanoseconds timeout,
    const std::function<void(std::uint32_t domain, const v1::ServerStatus&)>& use);

/// Looks for another server in the participant's session, before one starts there.
/// Returns it, or nothing after `timeout`. A server that is leaving does not count.
[[nodiscard]] std::optional<ServerInfo> find_other_server(const Participant& participant,
                                                          std::chrono::nanoseconds timeout);

}  // namespace suture
