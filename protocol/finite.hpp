// SPDX-License-Identifier: Apache-2.0
// Whether all of several numbers are finite: NaN and infinity come from peers and solvers, and must
// not reach a hand.
#pragma once

#include <algorithm>
#include <cmath>
#include <iterator>

namespace suture {

template <class Range>
[[nodiscard]] bool all_finite(const Range& values) noexcept {
  return std::all_of(std::begin(values), std::end(values),
                     [](double value) { return std::isfinite(value); });
}

}  // namespace suture
