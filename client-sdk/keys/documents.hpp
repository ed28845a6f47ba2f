// SPDX-License-Identifier: Apache-2.0
// Governance and permissions of DDS Security, as text.
#pragma once

#include <cstdint>
#include <string>

#include "keys/site.hpp"

namespace suture::keys {

/// Returns what is protected on the site's network, and how.
[[nodiscard]] std::string governance_xml(Protection protection);

/// Returns what the holder of the certificate with `subject` (RFC 2253) may do, from an hour
/// before `now_s` until `expires_s`, Unix time.
[[nodiscard]] std::string permissions_xml(const std::string& subject, const Rights& rights,
                                          std::int64_t now_s, std::int64_t expires_s);

}  // namespace suture::keys
