// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace sutured::commands {

/// Returns `json` as text, `indent` spaces deep, or in one line. Names of groups and files are what
/// strangers wrote: what is not UTF-8 is replaced, not thrown at.
[[nodiscard]] inline std::string as_text(const nlohmann::json& json, int indent = -1) {
  return json.dump(indent, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace sutured::commands
