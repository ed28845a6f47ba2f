// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>

#include "endpoints/server.hpp"

namespace sutured::commands {

/// Tells the service manager that started this process how it does, by sd_notify(3); does nothing
/// where none did.
///
/// Threads: one.
class ServiceManager {
 public:
  ServiceManager();

  /// Says that the server serves; `status` is for people.
  void ready(const std::string& status) const;
  /// Says that the server is alive, if both of its loops went on since that was last said: a
  /// simulation that hangs is not covered by a supervisor that ticks.
  void watch(const endpoints::Server::Pulse& pulse);
  /// Says that the server ends, and why.
  void stopping(const std::string& reason) const;

  /// How often `watch` wants to be called at least, ns.
  [[nodiscard]] std::int64_t look_ns() const noexcept { return look_ns_; }

 private:
  bool watched_ = false;
  std::int64_t look_ns_;
  endpoints::Server::Pulse told_;
};

}  // namespace sutured::commands
