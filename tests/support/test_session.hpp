// SPDX-License-Identifier: GPL-3.0-or-later
// Domains and sessions that do not meet those of tests running beside.
#pragma once

#include <unistd.h>

#include <chrono>
#include <string>
#include <thread>

#include "protocol/participant.hpp"

namespace sutured::testing {

/// Returns a session of this process's own: CTest runs each case in a process.
inline suture::ParticipantOptions own_session() {
  suture::ParticipantOptions options;
  options.domain = 2U * (static_cast<std::uint32_t>(getpid()) % 100U);
  options.session = "test-" + std::to_string(getpid());
  return options;
}

/// Waits until `condition()` holds; false after `limit`, which only a failure reaches.
template <class Condition>
bool eventually(Condition&& condition, std::chrono::seconds limit = std::chrono::seconds(20)) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace sutured::testing
