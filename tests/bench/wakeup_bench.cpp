// SPDX-License-Identifier: GPL-3.0-or-later
// How late the supervisor's thread wakes, beside `cyclictest` of rt-tests: the same clock, period,
// policy, priority and locked memory, both free to run on any processor.
//
// In turns of three seconds, the order alternating: at the same time each would hold up the other.
// Figures are medians of the turns, ratios medians of the pairs' ratios, so that what else happens
// on a shared machine in one turn does not count.
#include <chrono>
#include <cmath>
#include <cstdio>
#include <sstream>
#include <thread>

#include "bench/figures.hpp"
#include "haptics/realtime.hpp"
#include "haptics/supervisor.hpp"
#include "protocol/participant.hpp"
#include "support/program.hpp"

namespace sutured::bench {
namespace {

constexpr int kPairs = 20, kTurn_s = 3;

struct Lateness {
  double p50_us = 0.0, p999_us = 0.0;
};

Lateness of_supervisor() {
  haptics::Supervisor supervisor([](std::int64_t) {});
  std::this_thread::sleep_for(std::chrono::seconds(kTurn_s));
  const haptics::LatencySummary late = supervisor.take_wakeup();
  return {std::floor(late.p50_us), std::floor(late.p999_us)};  // as cyclictest does
}

/// Its histogram has a line for each microsecond: the lateness without its fraction, and how often.
Lateness of_cyclictest(bool realtime) {
  // With its own tuning of power management it would measure another machine than ours.
  std::vector<std::string> command{"cyclictest",
                                   "--quiet",
                                   "--threads=1",
                                   "--interval=1000",
                                   "--loops=" + std::to_string(1000 * kTurn_s),
                                   "--histogram=100000",
                                   "--mlockall",
                                   "--default-system"};
  if (realtime)
    command.push_back("--priority=" + std::to_string(haptics::kSupervisorPriority));
  else
    command.push_back("--policy=other");
  const testing::ProgramResult result = testing::run_program(command);
  if (result.exit_code != 0)
    throw std::runtime_error("cyclictest failed, see whether rt-tests is installed: " + result.err);
  std::vector<double> late_us;
  std::istringstream lines(result.out);
  std::string line;
  while (std::getline(lines, line)) {
    unsigned us = 0, count = 0;
    if (std::sscanf(line.c_str(), "%u %u", &us, &count) == 2)
      late_us.insert(late_us.end(), count, us);
  }
  if (late_us.size() < 900U * kTurn_s)
    throw std::runtime_error("cyclictest left no histogram: " + result.out);
  return {quantile(late_us, 0.5), quantile(late_us, 0.999)};
}

}  // namespace

void measure_wakeup(Figures& figures) {
  // As the server does before its threads start; what cannot be had is missing on both sides.
  static_cast<void>(haptics::prepare_realtime());
  const bool realtime = suture::may_run_realtime(haptics::kSupervisorPriority);
  std::vector<double> ours_p50, ours_p999, theirs_p50, theirs_p999, ratio_p50, ratio_p999;
  for (int pair = 0; pair < kPairs; ++pair) {
    Lateness ours, theirs;
    if (pair % 2 == 0) ours = of_supervisor();
    theirs = of_cyclictest(realtime);
    if (pair % 2 == 1) ours = of_supervisor();
    ours_p50.push_back(ours.p50_us);
    ours_p999.push_back(ours.p999_us);
    theirs_p50.push_back(theirs.p50_us);
    theirs_p999.push_back(theirs.p999_us);
    ratio_p50.push_back(ours.p50_us / std::max(theirs.p50_us, 1.0));
    ratio_p999.push_back(ours.p999_us / std::max(theirs.p999_us, 1.0));
  }
  figures.add("wakeup_us.p50", quantile(ours_p50, 0.5), "us");
  figures.add("wakeup_us.p999", quantile(ours_p999, 0.5), "us");
  figures.add("cyclictest_us.p50", quantile(theirs_p50, 0.5), "us");
  figures.add("cyclictest_us.p999", quantile(theirs_p999, 0.5), "us");
  figures.add("wakeup_over_cyclictest.p50", quantile(ratio_p50, 0.5), "x");
  figures.add("wakeup_over_cyclictest.p999", quantile(ratio_p999, 0.5), "x", 1.2);
}

}  // namespace sutured::bench
