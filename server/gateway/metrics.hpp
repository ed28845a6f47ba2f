// SPDX-License-Identifier: GPL-3.0-or-later
// The text that Prometheus scrapes.
#pragma once

#include <cstdint>
#include <string>

#include "gateway/web_server.hpp"
#include "protocol/types.hpp"

namespace sutured::gateway {

/// What the web's side counts besides `WebCounters`.
struct ClientCounters {
  std::uint64_t clients = 0;        ///< WebSockets open
  std::uint64_t dropped = 0;        ///< samples that clients were too slow for, since start
  std::uint64_t waiting_bytes = 0;  ///< in all outboxes
};

/// Returns /metrics: the server's last status (`null`: none has come yet, and only the
/// gateway's own counters are told) and the gateway's counters.
[[nodiscard]] std::string metrics_text(const suture::v1::ServerStatus* status,
                                       const WebCounters& web, const ClientCounters& clients);

}  // namespace sutured::gateway
