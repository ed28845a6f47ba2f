// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "protocol/participant.hpp"
#include "suture/session.hpp"

namespace sutured::testing {

/// Returns the options of an SDK client in a test's session.
inline suture::SessionOptions client_options(
    const suture::ParticipantOptions& session,
    std::chrono::milliseconds timeout = std::chrono::seconds(20)) {
  suture::SessionOptions options;
  options.domain = session.domain;
  options.session = session.session;
  options.timeout = timeout;
  return options;
}

}  // namespace sutured::testing
