// SPDX-License-Identifier: Apache-2.0
// A session's status, and commands to its server.
#pragma once

#include <memory>
#include <optional>

#include "suture/viewer.hpp"

namespace suture {

/// Something a server can be told to do.
enum class CommandKind {
  kPause,
  kResume,
  kReset,
  kStop,         ///< zero force for all tools until kResume
  kReleaseTool,  ///< end the lease of one tool
  kCheckpoint,   ///< keep the present state under a name
  kRewind,       ///< go back by some simulated seconds
  kRestore,      ///< go back to the state kept under a name
};

/// What some commands need to be told beside their kind.
struct CommandDetails {
  std::string tool{};        ///< kReleaseTool
  std::string checkpoint{};  ///< kCheckpoint, kRestore: letters, digits, '-' and '_', 32 at most
  double seconds = 0.0;      ///< kRewind
};

/// Talks to the server of a session. Threads: one at a time.
class __attribute__((visibility("default"))) Session {
 public:
  /// Connects. Throws Error kNoServer, kVersionMismatch, kPermissionDenied, kNetwork or
  /// kBadInput.
  explicit Session(const SessionOptions& options);
  ~Session();
  Session(Session&&) noexcept;
  Session& operator=(Session&&) noexcept;

  /// Returns the server's last status; waits for the first one.
  [[nodiscard]] Status status();

  /// Waits for the next status; nothing after `timeout`.
  [[nodiscard]] std::optional<Status> next_status(std::chrono::nanoseconds timeout);

  /// Sends a command and waits for the reply; returns the server's word on it. Throws
  /// Error kPermissionDenied where it refuses, and kNoServer where none replies in time.
  std::string command(CommandKind kind, const CommandDetails& details = {});

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace suture
