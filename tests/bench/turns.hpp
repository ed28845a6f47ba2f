// SPDX-License-Identifier: GPL-3.0-or-later
// A hand's round trips while something else goes on beside, and while it does not.
#pragma once

#include <signal.h>

#include <initializer_list>
#include <string>
#include <vector>

#include "bench/figures.hpp"
#include "bench/pinger.hpp"
#include "protocol/surgeon.hpp"
#include "support/process.hpp"

namespace sutured::bench {

/// Round trips of both kinds of turns, which alternate, so that what else a machine does falls on
/// both alike.
struct Turns {
  static constexpr int kTurns = 48;  ///< of both kinds together
  static constexpr int kTurn_ms = 500, kSettling_ms = 100;
  static constexpr double kWith_s = 1e-3 * kTurn_ms * kTurns / 2;

  std::vector<double> with_us, without_us;  ///< of the poses that were answered

  /// Returns the share of one kind's poses that were answered.
  [[nodiscard]] static double answered_percent(const std::vector<double>& us) {
    return 100.0 * static_cast<double>(us.size()) / (kTurns / 2 * (kTurn_ms - kSettling_ms));
  }
};

/// Plays `track` to its end and back, a thousand poses a second, once the server answers.
/// SIGUSR1 tells `beside` when to begin, SIGUSR2 when to pause. Throws std::runtime_error where
/// nobody answers.
[[nodiscard]] Turns play_in_turns(const suture::SurgeonTrack& track, Pinger& hand,
                                  const testing::Process& beside);

/// Adds the figures of `turns`, `WHAT_with_BESIDE_us.p99` and so on; the budget is of the ratio of
/// the 99th percentiles.
void add(Figures& figures, Turns& turns, const std::string& what, const std::string& beside,
         double budget);

/// Returns a set of signals.
[[nodiscard]] inline sigset_t signals(std::initializer_list<int> numbers) {
  sigset_t set;
  sigemptyset(&set);
  for (const int number : numbers) sigaddset(&set, number);
  return set;
}

}  // namespace sutured::bench
