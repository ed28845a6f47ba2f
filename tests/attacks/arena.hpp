// SPDX-License-Identifier: GPL-3.0-or-later
// A secured server, an honest device at 1 kHz, and attackers, each in a process of its own.
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "attacks/packets.hpp"
#include "bench/pinger.hpp"
#include "protocol/participant.hpp"
#include "support/process.hpp"
#include "support/temporary_folder.hpp"
#include "suture/session.hpp"

namespace sutured::attacks {

/// What the honest device went through.
struct Felt {
  std::uint64_t sent = 0, lost = 0;
  double p50_us = 0.0, p99_us = 0.0;
};

/// How far an attacker came.
struct Reached {
  std::string error;  ///< its own software's; empty: it went on
  std::uint64_t sent = 0;
  int matched = 0;   ///< readers of the server that its pose writer has, as itself sees it
  int answered = 0;  ///< forces for its poses
  int read = 0;      ///< samples of forces and models
};

/// One attack, as a value.
struct Attack {
  std::string name;  ///< for CTest
  std::string what;  ///< for people
  std::string by;    ///< who refuses it, and how
  /// May its pose writer see the server's reader: refused tool by tool, or with its own checks off?
  bool may_match = false;
  /// May its keys read forces and models?
  bool may_read = false;
};

/// All of them, in the table's order.
[[nodiscard]] const std::vector<Attack>& attacks();

class Arena {
 public:
  Arena();
  ~Arena();
  Arena(const Arena&) = delete;
  Arena& operator=(const Arena&) = delete;

  /// Plays the honest device for `seconds`, alone.
  Felt undisturbed(double seconds);
  /// Plays it until it is served again, at most `seconds_max`; returns how long that took.
  /// Nobody reads what the server says meanwhile: a full pipe must not hold it up.
  std::optional<double> seconds_until_served(double seconds_max);
  /// Lets an attack run beside it.
  struct Result {
    Felt felt;
    Reached reached;
    /// Of the tool that it wanted, as the server says: poses that moved it, and whether it is
    /// leased.
    std::uint64_t poses = 0;
    bool leased = false;
  };
  Result run(const Attack& attack, double seconds);

  /// A folder of the site's keys, by the identity's name.
  [[nodiscard]] std::string keys(const std::string& name) const;
  [[nodiscard]] const suture::ParticipantOptions& session() const { return session_; }
  [[nodiscard]] const std::string& site() const { return site_; }

 private:
  void make_keys();
  std::vector<std::string> command(const Attack& attack, double seconds);
  Felt measured(const std::atomic<bool>* until, double seconds);

  testing::TemporaryFolder folder_;
  std::string site_;
  suture::ParticipantOptions session_;
  std::optional<testing::Process> server_;
  std::optional<bench::Pinger> honest_;
  std::optional<suture::Session> watch_;
};

}  // namespace sutured::attacks
