// SPDX-License-Identifier: GPL-3.0-or-later
#include "bench/turns.hpp"

#include <cmath>
#include <future>
#include <stdexcept>

#include "haptics/realtime.hpp"
#include "haptics/supervisor.hpp"

namespace sutured::bench {
namespace {

constexpr std::int64_t kMs = 1'000'000;

// Returns the first pose of each turn that counts.
std::vector<std::uint64_t> play(const suture::SurgeonTrack& track, Pinger& hand,
                                const testing::Process& beside) {
  haptics::enter_realtime(60);
  std::int64_t due_ns = suture::monotonic_ns();
  const auto ask = [&](double time_s) {
    hand.send(track.at(time_s));
    due_ns = haptics::next_tick(due_ns, suture::monotonic_ns(), kMs).at_ns;
    haptics::sleep_until(due_ns);
  };
  constexpr int kMeeting = 30'000, kRamp = 500;
  for (int i = 0; hand.answered() == 0; ++i) {
    ask(0.0);
    if (i > kMeeting) throw std::runtime_error("no answer in 30 s from the server");
  }
  for (int i = 0; i < kRamp; ++i) ask(0.0);
  const double length_s = track.end_s();
  double time_s = 0.0;
  std::vector<std::uint64_t> begins;
  for (int turn = 0; turn < Turns::kTurns; ++turn) {
    beside.send(turn % 2 == 0 ? SIGUSR1 : SIGUSR2);
    for (int i = 0; i < Turns::kTurn_ms; ++i, time_s += 1e-3) {
      if (i == Turns::kSettling_ms) begins.push_back(hand.sent() + 1);
      const double phase = std::fmod(time_s, 2.0 * length_s);
      ask(std::min(phase, 2.0 * length_s - phase));
    }
  }
  return begins;
}

}  // namespace

Turns play_in_turns(const suture::SurgeonTrack& track, Pinger& hand,
                    const testing::Process& beside) {
  // On a thread of its own, which takes its priority with it.
  const std::vector<std::uint64_t> begins =
      std::async(std::launch::async, [&] { return play(track, hand, beside); }).get();
  Turns turns;
  for (std::size_t turn = 0; turn < begins.size(); ++turn) {
    const std::vector<double> us =
        hand.round_trips_us(begins[turn], begins[turn] + Turns::kTurn_ms - Turns::kSettling_ms - 1);
    std::vector<double>& all = turn % 2 == 0 ? turns.with_us : turns.without_us;
    all.insert(all.end(), us.begin(), us.end());
  }
  if (turns.with_us.empty() || turns.without_us.empty())
    throw std::runtime_error("no pose was answered");
  return turns;
}

void add(Figures& figures, Turns& turns, const std::string& what, const std::string& beside,
         double budget) {
  const std::string with = what + "_with_" + beside, without = what + "_without_" + beside;
  figures.add(with + "_answered_percent", Turns::answered_percent(turns.with_us), "%");
  figures.add(without + "_answered_percent", Turns::answered_percent(turns.without_us), "%");
  const double with_p50 = quantile(turns.with_us, 0.5), with_p99 = quantile(turns.with_us, 0.99);
  const double without_p50 = quantile(turns.without_us, 0.5),
               without_p99 = quantile(turns.without_us, 0.99);
  figures.add(with + "_us.p50", with_p50, "us");
  figures.add(with + "_us.p99", with_p99, "us");
  figures.add(without + "_us.p50", without_p50, "us");
  figures.add(without + "_us.p99", without_p99, "us");
  figures.add(with + "_over_without.p50", with_p50 / without_p50, "x");
  figures.add(with + "_over_without.p99", with_p99 / without_p99, "x", budget);
}

}  // namespace sutured::bench
