// SPDX-License-Identifier: GPL-3.0-or-later
// What DDS Security costs a round trip: bare echoes in processes of their own, one for each way
// of protection and one without, all asked in every four milliseconds, the order turning.
#include <unistd.h>

#include <algorithm>
#include <deque>
#include <future>
#include <stdexcept>
#include <string>
#include <vector>

#include "bench/figures.hpp"
#include "bench/pinger.hpp"
#include "haptics/realtime.hpp"
#include "haptics/supervisor.hpp"
#include "keys/site.hpp"
#include "support/process.hpp"
#include "support/temporary_folder.hpp"

namespace sutured::bench {
namespace {

using suture::keys::Protection;
using suture::keys::Role;
using suture::keys::Site;

constexpr std::int64_t kMs = 1'000'000;
constexpr std::size_t kSettling = 2000, kRounds = 40'000;  // one pose each

/// One echo and what asks it.
struct Way {
  std::string name;
  suture::ParticipantOptions session;
  testing::Process echo;
  Pinger pinger;
  std::uint64_t first = 0;

  Way(std::string name_in, const suture::ParticipantOptions& asking, const std::string& keys)
      : name(std::move(name_in)),
        session(asking),
        echo({"/proc/self/exe", "--echo", std::to_string(asking.domain), "--session",
              asking.session, "--security", keys}),
        pinger(session, "driver") {}
};

/// Asks one echo a millisecond, in turn: each 250 times a second.
void ask(std::deque<Way>& ways, std::size_t rounds, std::int64_t& due_ns) {
  const suture::SurgeonPose pose;
  for (std::size_t i = 0; i < rounds; ++i) {
    // Each has each place in the order equally often.
    const std::size_t turn = i / ways.size();
    ways[(i + turn) % ways.size()].pinger.send(pose);
    due_ns = haptics::next_tick(due_ns, suture::monotonic_ns(), kMs).at_ns;
    haptics::sleep_until(due_ns);
  }
}

void play(std::deque<Way>& ways) {
  haptics::enter_realtime(60);
  std::int64_t due_ns = suture::monotonic_ns();
  const std::int64_t end_ns = due_ns + 30'000 * kMs;
  const auto all_answer = [&] {
    return std::all_of(ways.begin(), ways.end(),
                       [](const Way& way) { return way.pinger.answered() > 0; });
  };
  while (!all_answer()) {
    if (suture::monotonic_ns() > end_ns) throw std::runtime_error("an echo does not answer");
    ask(ways, ways.size(), due_ns);
  }
  ask(ways, kSettling, due_ns);
  for (Way& way : ways) way.first = way.pinger.sent() + 1;
  ask(ways, kRounds, due_ns);
}

}  // namespace

void measure_security(Figures& figures) {
  const testing::TemporaryFolder folder;
  std::deque<Way> ways;
  suture::ParticipantOptions session;
  session.domain = 8U * (static_cast<std::uint32_t>(getpid()) % 25U);
  session.session = "bench-" + std::to_string(getpid());
  session.security = "off";
  ways.emplace_back("plain", session, "off");
  const std::pair<const char*, Protection> protections[] = {
      {"signed", Protection::kSign},
      {"encrypted", Protection::kEncrypt},
      {"encrypted_with_origin", Protection::kEncryptWithOrigin}};
  for (const auto& [name, protection] : protections) {
    const std::string path = folder.path(name);
    Site::create(path, "bench", 2, protection);
    Site site(path);
    session.domain += 2;
    session.security = site.add("device", {{Role::kDevice}, {"driver"}, -1, ""}, 86400);
    ways.emplace_back(name, session, site.add("server", {{Role::kServer}, {}, -1, ""}, 86400));
  }
  // On a thread of its own, which takes its priority with it.
  std::async(std::launch::async, [&] { play(ways); }).get();

  double plain_p50 = 0.0, plain_p99 = 0.0;
  for (Way& way : ways) {
    std::vector<double> trips = way.pinger.round_trips_us(way.first, way.pinger.sent());
    if (trips.empty()) throw std::runtime_error("no pose was answered: " + way.name);
    const double p50 = quantile(trips, 0.5), p99 = quantile(trips, 0.99);
    figures.add("security_us." + way.name + ".p50", p50, "us");
    figures.add("security_us." + way.name + ".p99", p99, "us");
    if (way.name == "plain") {
      plain_p50 = p50;
      plain_p99 = p99;
      continue;
    }
    figures.add("security_over_plain." + way.name + ".p50", p50 / plain_p50, "x");
    figures.add("security_over_plain." + way.name + ".p99", p99 / plain_p99, "x");
  }
}

}  // namespace sutured::bench
