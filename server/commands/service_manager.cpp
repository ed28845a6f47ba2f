// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/service_manager.hpp"

#include <systemd/sd-daemon.h>

#include <algorithm>

namespace sutured::commands {
namespace {

constexpr std::int64_t kLook_ns = 200'000'000;

}  // namespace

ServiceManager::ServiceManager() : look_ns_(kLook_ns) {
  std::uint64_t timeout_us = 0;
  watched_ = sd_watchdog_enabled(0, &timeout_us) > 0;
  // Three looks a timeout, so that one late look is not the end.
  if (watched_)
    look_ns_ = std::clamp<std::int64_t>(static_cast<std::int64_t>(timeout_us) * 1000 / 3, 1'000'000,
                                        kLook_ns);
}

void ServiceManager::ready(const std::string& status) const {
  sd_notify(0, ("READY=1\nSTATUS=" + status).c_str());
}

void ServiceManager::watch(const endpoints::Server::Pulse& pulse) {
  if (!watched_ || pulse.beats == told_.beats || pulse.ticks == told_.ticks) return;
  told_ = pulse;
  sd_notify(0, "WATCHDOG=1");
}

void ServiceManager::stopping(const std::string& reason) const {
  sd_notify(0, ("STOPPING=1\nSTATUS=" + reason).c_str());
}

}  // namespace sutured::commands
