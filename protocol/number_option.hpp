// SPDX-License-Identifier: Apache-2.0
// What the command lines of both sides ask of a number.
#pragma once

#include <cmath>
#include <cstdlib>
#include <functional>
#include <string>

namespace suture {

/// Returns a check of an option's text: empty, or why it is refused. A NaN lies within no bounds.
/// `unit` is what the number counts.
[[nodiscard]] inline std::function<std::string(const std::string&)> within(
    double low, double high, const std::string& unit) {
  return [=](const std::string& text) -> std::string {
    char* end = nullptr;
    const double value = std::strtod(text.c_str(), &end);
    if (end != text.c_str() && *end == '\0' && value >= low && value <= high) return {};
    const auto plain = [](double bound) {
      std::string number = std::to_string(bound);
      number.erase(number.find_last_not_of('0') + 1);
      if (number.back() == '.') number.pop_back();
      return number;
    };
    return "\"" + text + "\" will not do: take a number from " + plain(low) + " to " + plain(high) +
           ' ' + unit;
  };
}

}  // namespace suture
