// SPDX-License-Identifier: Apache-2.0
// Where a session travels.
#pragma once

#include <string>
#include <vector>

namespace suture {

/// Says by which interface to take part, and with whom. What is left empty is taken from the
/// environment: `SUTURE_INTERFACE`, `SUTURE_PEERS` (with commas), `SUTURE_UNSECURED_NETWORK=1`.
struct NetworkOptions {
  std::string interface;           ///< name or IPv4 address; none: this machine alone (127.0.0.1)
  std::vector<std::string> peers;  ///< hosts to look for; and nobody else is heard
  bool unsecured = false;  ///< allows a network without keys: whoever is on it may take part
};

}  // namespace suture
