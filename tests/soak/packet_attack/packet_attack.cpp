// SPDX-License-Identifier: GPL-3.0-or-later
// Bad packets at the DDS ports of a server that a device drives: README.md.
#include <arpa/inet.h>
#include <linux/if_ether.h>
#include <linux/if_packet.h>
#include <net/if.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <random>
#include <thread>
#include <vector>

#include "soak/force_watcher.hpp"
#include "soak/long_session.hpp"
#include "support/client_options.hpp"
#include "support/process.hpp"
#include "support/process_facts.hpp"
#include "support/test_session.hpp"
#include "suture/device.hpp"
#include "suture/error.hpp"
#include "suture/session.hpp"

namespace sutured::soak {
namespace {

using Bytes = std::vector<std::uint8_t>;
using Random = std::mt19937_64;

// Within 50 ms of the last force, and a tick or two to see it.
constexpr std::chrono::milliseconds kFaded{60};
// Of the fade that a silent server's force is taken to zero by: a smoothstep within 30 ms.
constexpr double kFadeSlope_per_s = 1.5 / 0.030;
const std::string kTool = "probe";
constexpr std::size_t kPool = 512;          // of live packets
constexpr std::uint64_t kBurst = 64;        // packets between two looks at what they do
constexpr std::uint64_t kFeltMax = 20'000;  // packets at a hand that feels, at most
constexpr std::size_t kHeader = 20;         // "RTPS", version, vendor, GUID prefix

std::size_t below(Random& random, std::size_t n) { return static_cast<std::size_t>(random() % n); }

/// Says whether a packet may reach the code for discovery data: some four bytes in it are the id of
/// a built-in endpoint. Also true of some that do not.
bool may_be_discovery(const Bytes& packet) {
  for (std::size_t i = kHeader; i + 4 <= packet.size(); ++i)
    if (packet[i] == 0 && packet[i + 1] <= 3 && (packet[i + 3] & 0xC0U) == 0xC0U) return true;
  return false;
}

/// Reads what travels to `ports` of this machine, as root may.
class Tap {
 public:
  Tap() : fd_(socket(AF_PACKET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, htons(ETH_P_IP))) {
    if (fd_ < 0) return;
    sockaddr_ll loopback{};
    loopback.sll_family = AF_PACKET;
    loopback.sll_protocol = htons(ETH_P_IP);
    loopback.sll_ifindex = static_cast<int>(if_nametoindex("lo"));
    if (bind(fd_, reinterpret_cast<sockaddr*>(&loopback), sizeof loopback) != 0) {
      close(fd_);
      fd_ = -1;
    }
  }
  ~Tap() {
    if (fd_ >= 0) close(fd_);
  }
  Tap(const Tap&) = delete;
  Tap& operator=(const Tap&) = delete;
  [[nodiscard]] bool open() const { return fd_ >= 0; }

  /// Moves what has come into `pool`, which stays below `most` packets.
  void take(const std::set<std::uint16_t>& ports, std::vector<Bytes>& pool, std::size_t most,
            Random& random) {
    Bytes frame(65536);
    for (int i = 0; i < 512; ++i) {
      const ssize_t size = recv(fd_, frame.data(), frame.size(), 0);
      if (size <= 0) return;
      const std::size_t ip = 4U * (frame[0] & 0xFU), rtps = ip + 8;
      if (static_cast<std::size_t>(size) < rtps + kHeader || frame[9] != IPPROTO_UDP) continue;
      const auto port = static_cast<std::uint16_t>(frame[ip + 2] << 8U | frame[ip + 3]);
      if (!ports.contains(port) || std::memcmp(&frame[rtps], "RTPS", 4) != 0) continue;
      Bytes packet(frame.begin() + static_cast<std::ptrdiff_t>(rtps), frame.begin() + size);
      if (pool.size() < most)
        pool.push_back(std::move(packet));
      else
        pool[below(random, most)] = std::move(packet);
    }
  }

 private:
  int fd_;
};

void put_16(Bytes& to, std::uint32_t value) {
  to.push_back(static_cast<std::uint8_t>(value));
  to.push_back(static_cast<std::uint8_t>(value >> 8U));
}

Bytes noise(Random& random) {
  Bytes packet(below(random, 1500));
  for (auto& byte : packet) byte = static_cast<std::uint8_t>(random());
  return packet;
}

/// A message with a true head and submessages of any kind, whose lengths may lie.
Bytes rtps_shaped(Random& random, const std::vector<Bytes>& pool) {
  Bytes packet{'R', 'T', 'P', 'S', 2, 1, 1, 0x10};
  for (int i = 0; i < 12; ++i) packet.push_back(static_cast<std::uint8_t>(random()));
  // As often as not from somebody whom the server knows.
  if (!pool.empty() && random() % 2 == 0) {
    const Bytes& known = pool[below(random, pool.size())];
    std::copy_n(known.begin(), kHeader, packet.begin());
  }
  constexpr std::uint8_t kKinds[] = {0x01, 0x06, 0x07, 0x08, 0x09, 0x0c, 0x0d, 0x0e,
                                     0x0f, 0x12, 0x13, 0x15, 0x16, 0x30, 0x33, 0x80};
  for (std::size_t n = 1 + below(random, 5); n > 0; --n) {
    const std::size_t size = 4 * below(random, 40);
    packet.push_back(kKinds[below(random, sizeof kKinds)]);
    packet.push_back(static_cast<std::uint8_t>(random()));
    put_16(packet, static_cast<std::uint32_t>(random() % 4 == 0 ? random() : size));
    for (std::size_t i = 0; i < size; ++i)
      packet.push_back(static_cast<std::uint8_t>(random() % 3 == 0 ? 0 : random()));
  }
  return packet;
}

Bytes mutated(Random& random, const std::vector<Bytes>& pool) {
  Bytes packet = pool[below(random, pool.size())];
  for (std::size_t n = 1 + below(random, 6); n > 0 && !packet.empty(); --n) {
    const std::size_t at = below(random, packet.size());
    switch (random() % 8) {
      case 0:
        packet[at] ^= static_cast<std::uint8_t>(1U << random() % 8);
        break;
      case 1:
        packet[at] = static_cast<std::uint8_t>(random());
        break;
      case 2:
        packet.resize(at);
        break;
      case 3: {  // a number at its ends, or a NaN
        constexpr std::uint64_t kEnds[] = {0,
                                           1,
                                           0x7FFFFFFF,
                                           0x80000000,
                                           0xFFFFFFFF,
                                           0xFFFFFFFE,
                                           0x7FFFFFFFFFFFFFFF,
                                           ~0ULL,
                                           0x7FF8ULL << 48U,
                                           0x7FF0ULL << 48U};
        const std::uint64_t end = kEnds[below(random, std::size(kEnds))];
        const std::size_t size = std::min<std::size_t>(random() % 2 == 0 ? 4 : 8, packet.size());
        const std::size_t place = below(random, packet.size() - size + 1) / 4 * 4;
        std::memcpy(&packet[place], &end, std::min(size, packet.size() - place));
        break;
      }
      case 4:  // more than there was
        for (std::size_t i = 4 * below(random, 64); i > 0; --i)
          packet.push_back(static_cast<std::uint8_t>(random()));
        break;
      case 5:  // the length of the first submessage
        if (packet.size() >= kHeader + 4) {
          packet[kHeader + 2] = static_cast<std::uint8_t>(random());
          packet[kHeader + 3] = static_cast<std::uint8_t>(random() % 4 == 0 ? random() : 0);
        }
        break;
      case 6:  // its kind and flags
        if (packet.size() >= kHeader + 2)
          packet[kHeader + random() % 2] = static_cast<std::uint8_t>(random() % 0x40);
        break;
      default: {  // the end of another one
        const Bytes& other = pool[below(random, pool.size())];
        const std::size_t from = below(random, other.size());
        packet.resize(at);
        packet.insert(packet.end(), other.begin() + static_cast<std::ptrdiff_t>(from), other.end());
      }
    }
  }
  return packet;
}

/// Where a probe presses on the proximal vessel, 0.7 mm deep and to and fro, `time_s` after it
/// came: it is felt for as long as poses arrive, and needs nothing in its jaw to be felt again.
suture::Hand pressing(double time_s) {
  constexpr double kAway_m = 0.012, kDeep_m = 0.0073, kApproach_s = 0.6;
  suture::Hand hand;
  hand.in_world = true;
  const double near = std::min(time_s / kApproach_s, 1.0);
  hand.position_m = {kAway_m + near * (kDeep_m - kAway_m), 0.0, -0.008};
  if (near == 1.0) hand.position_m[0] += 2e-4 * std::sin(7.0 * (time_s - kApproach_s));
  return hand;
}

/// A hand that presses, and comes again whenever the server has lost it.
class Hand {
 public:
  explicit Hand(const suture::ParticipantOptions& session) {
    options_.domain = session.domain;
    options_.session = session.session;
    options_.tool = kTool;
    options_.timeout = std::chrono::seconds(20);
    // Then the server has lost us: nothing holds a force back for so long.
    options_.give_up_after = std::chrono::milliseconds(500);
    options_.on_force = [this](const suture::Force& force) {
      arrived_n_ = std::max(arrived_n_.load(), magnitude_n(force));
    };
    thread_ = std::thread([this] { live(); });
  }
  ~Hand() { leave(); }
  Hand(const Hand&) = delete;
  Hand& operator=(const Hand&) = delete;
  /// Lets go, for good.
  void leave() {
    over_ = true;
    if (thread_.joinable()) thread_.join();
  }
  [[nodiscard]] int comings() const { return comings_; }
  /// Whether there is a force at the hand now.
  [[nodiscard]] bool feels() const { return now_n_ > kFelt_n; }
  [[nodiscard]] bool stopped() const { return stopped_; }
  [[nodiscard]] double force_n() const { return force_n_; }
  /// The largest force while none of the server's had come for `kFaded`.
  [[nodiscard]] double starved_force_n() const { return starved_force_n_; }
  /// How often a silence took a force that was felt to zero, and the steepest such fall over what
  /// the fade allows.
  [[nodiscard]] int fades() const { return fades_; }
  [[nodiscard]] double over_fade() const { return over_fade_; }
  [[nodiscard]] double longest_silence_ms() const {
    return 1e-6 * static_cast<double>(longest_ns_);
  }

 private:
  using Clock = std::chrono::steady_clock;
  static double magnitude_n(const suture::Force& force) {
    const double n = std::hypot(force.force_n[0], force.force_n[1], force.force_n[2]);
    return std::isfinite(n) ? n : HUGE_VAL;
  }

  void live() {
    while (!over_) {
      try {
        suture::Device device(options_);
        ++comings_;
        std::uint64_t sequence = 0;
        std::chrono::nanoseconds silence{0};
        double last_n = 0.0, felt_n = 0.0;  // at the last tick; when the silence began
        const Clock::time_point begun = Clock::now();
        Clock::time_point woken = begun;  // before the last force was read, at the latest
        device.run([&](const suture::Force& force,
                       std::chrono::nanoseconds elapsed) -> std::optional<suture::Hand> {
          if (over_) return std::nullopt;
          const double n = magnitude_n(force);
          now_n_ = n;
          stopped_ = force.state == suture::ForceState::kStopped;
          force_n_ = std::max(force_n_.load(), n);
          if (force.sequence == sequence) {
            silence += elapsed;
            const double between_s = std::chrono::duration<double>(Clock::now() - woken).count();
            over_fade_ = std::max(
                over_fade_.load(),
                (last_n - n) / (kFadeSlope_per_s * std::max(arrived_n_.load(), 1e-9) * between_s));
            if (n == 0.0 && last_n > 0.0 && felt_n > kFelt_n) ++fades_;
          } else {
            silence = std::chrono::nanoseconds{0};
            felt_n = n;
          }
          sequence = force.sequence;
          last_n = n;
          woken += elapsed;
          if (silence > kFaded) starved_force_n_ = std::max(starved_force_n_.load(), n);
          longest_ns_ = std::max<std::int64_t>(longest_ns_, silence.count());
          return pressing(std::chrono::duration<double>(Clock::now() - begun).count());
        });
      } catch (const suture::Error& error) {
        if (error.code() != suture::ErrorCode::kNoServer)
          std::printf("  the device: %s\n", error.what());
      }
      now_n_ = 0.0;
      stopped_ = false;
    }
  }

  suture::DeviceOptions options_;
  std::atomic<bool> over_{false}, stopped_{false};
  std::atomic<int> comings_{0}, fades_{0};
  std::atomic<double> now_n_{0.0}, force_n_{0.0}, arrived_n_{0.0};
  std::atomic<double> starved_force_n_{0.0}, over_fade_{0.0};
  std::atomic<std::int64_t> longest_ns_{0};
  std::thread thread_;
};

struct Options {
  std::uint64_t packets = 20000, seed = 1;
  double per_second = 4000.0;
  bool discovery = false;
};

/// Commands the server to go on; three times where it does not answer, and says so.
void resume(const suture::ParticipantOptions& session) {
  for (int tries = 3; tries > 0; --tries) try {
      suture::Session(testing::client_options(session)).command(suture::CommandKind::kResume);
      return;
    } catch (const suture::Error& error) {
      std::printf("  resume: %s\n", error.what());
    }
}

int attack(const Options& options) {
  const suture::ParticipantOptions session = testing::own_session();
  testing::Process server({SUTURED_PROGRAM, "serve", kFolder + "scene.toml", "--domain",
                           std::to_string(session.domain), "--session", session.session});
  if (server.read_until("serving scene").find("serving scene") == std::string::npos)
    throw std::runtime_error("the server did not start: " + server.output());
  const std::set<std::uint16_t> theirs = testing::udp_ports(server.pid());

  const suture::Participant participant(session, suture::Channel::kControl);
  ForceWatcher watcher(participant, kTool, kMaxSlew_n_per_s);
  Hand hand(session);
  Random random(options.seed);
  std::vector<Bytes> pool;
  Tap tap;
  // Waits for a force at the hand, and goes on taking what must be taken meanwhile. A pose with one
  // bit flipped may have stopped the tool, as a hand's own would: people resume.
  const auto await_felt = [&] {
    return testing::eventually(
        [&] {
          server.drain();
          if (tap.open()) tap.take(theirs, pool, kPool, random);
          if (hand.stopped()) resume(session);
          return hand.feels();
        },
        std::chrono::seconds(60));
  };
  if (!await_felt()) throw std::runtime_error("the device feels nothing before the attack");
  // Ports that are ours too (multicast) would have us attacked.
  std::vector<std::uint16_t> ports;
  const std::set<std::uint16_t> ours = testing::udp_ports(getpid());
  std::set_difference(theirs.begin(), theirs.end(), ours.begin(), ours.end(),
                      std::back_inserter(ports));

  if (tap.open())
    testing::eventually([&] {
      tap.take(theirs, pool, kPool, random);
      return pool.size() >= kPool / 2;
    });
  // A process that was killed and not yet waited for has no memory.
  const auto lives = [&] {
    const double now_kib = testing::resident_kib(server.pid());
    return now_kib > 0.0 && std::isfinite(now_kib);
  };
  const double before_kib = testing::resident_kib(server.pid());
  std::printf("%zu ports, %zu live packets%s\n", ports.size(), pool.size(),
              tap.open() ? "" : " (none: to read them takes root)");

  const int udp = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  std::uint64_t sent = 0, left_out = 0, kinds[3] = {};
  const auto send_one = [&] {
    const std::uint64_t kind = pool.empty() ? random() % 2 : random() % 8 < 6 ? 2 : random() % 2;
    const Bytes packet = kind == 0   ? noise(random)
                         : kind == 1 ? rtps_shaped(random, pool)
                                     : mutated(random, pool);
    if (!options.discovery && may_be_discovery(packet)) {
      ++left_out;
      return;
    }
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    to.sin_port = htons(ports[below(random, ports.size())]);
    (void)sendto(udp, packet.data(), packet.size(), 0, reinterpret_cast<sockaddr*>(&to), sizeof to);
    ++kinds[kind];
    ++sent;
  };
  // Sends up to the packet `last`, `per_second`, while `goes_on(sent)` after each burst.
  const auto send_to = [&](std::uint64_t last, double per_second, const auto& goes_on) {
    const auto pause = std::chrono::duration_cast<std::chrono::nanoseconds>(
        std::chrono::duration<double>(static_cast<double>(kBurst) / per_second));
    auto due = std::chrono::steady_clock::now();
    while (sent < last && !ports.empty()) {
      for (const std::uint64_t end = std::min(last, sent + kBurst); sent < end;) send_one();
      server.drain();  // Cyclone tells of each bad packet
      if (tap.open()) tap.take(theirs, pool, kPool, random);
      if (!lives() || !goes_on()) return;
      due = std::max(due + pause, std::chrono::steady_clock::now() - pause);
      std::this_thread::sleep_until(due);  // a pace, not a condition
    }
  };
  const auto begun = std::chrono::steady_clock::now();
  const auto elapsed_s = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
  };

  // At a hand that feels: whenever that has ended (a forged sequence number makes the server deaf
  // to the true ones), the attack waits for it.
  const ForceWatcher::Worst before = watcher.worst();
  int waits = 0;
  send_to(std::min(options.packets / 8, kFeltMax), options.per_second / 4.0, [&] {
    if (hand.feels()) return true;
    ++waits;
    return await_felt();
  });
  const bool was_felt = await_felt();
  const ForceWatcher::Worst felt = watcher.worst();
  const double felt_s = elapsed_s();
  const std::uint64_t felt_sent = sent;

  // And at full rate, whether it feels or not.
  send_to(options.packets, options.per_second, [] { return true; });
  const double took_s = elapsed_s() - felt_s;
  close(udp);
  const ForceWatcher::Worst during = watcher.worst();
  const double after_kib = testing::resident_kib(server.pid());
  bool recovers = lives();
  ForceWatcher::Worst afterwards;
  if (recovers) {
    resume(session);
    // The server may have forgotten whoever listened: another looks, until the hand lets go.
    const suture::Participant another(session, suture::Channel::kControl);
    ForceWatcher fresh(another, kTool, kMaxSlew_n_per_s);
    const auto eventually = [&](const auto& holds) {
      return testing::eventually(
          [&] {
            server.drain();
            return holds(fresh.worst());
          },
          std::chrono::seconds(60));
    };
    recovers =
        await_felt() && eventually([](const ForceWatcher::Worst& now) { return now.felt >= 500; });
    hand.leave();
    eventually([](const ForceWatcher::Worst& now) { return now.fades > 0; });
    afterwards = fresh.worst();
  }
  const ForceWatcher::Worst worst = watcher.worst();
  server.send(SIGTERM);
  const int code = server.wait();

  const auto number = [](std::uint64_t value) { return static_cast<unsigned long long>(value); };
  const std::uint64_t felt_forces = felt.felt - before.felt;
  std::printf(
      "%llu packets (%llu noise, %llu shaped, %llu mutated; %llu of discovery left out)\n"
      "  at a hand that feels  %llu in %.1f s; %llu forces felt, %d times waited for\n"
      "  at full rate          %llu in %.1f s; %.0f forces a second\n"
      "  the device            came %d times, at most %.0f ms without a force\n"
      "  fades                 %d by the server, the steepest %.2f of what a fade may; at the "
      "hand, "
      "where the server was silent, %d, %.2f\n"
      "  force                 at most %.4f N, %.2f of what the slew allows; %.4f N at the hand\n"
      "  faults                %s\n"
      "  memory                %+.0f KiB\n",
      number(sent), number(kinds[0]), number(kinds[1]), number(kinds[2]), number(left_out),
      number(felt_sent), felt_s, number(felt_forces), waits, number(sent - felt_sent), took_s,
      static_cast<double>(during.forces - felt.forces) / took_s, hand.comings(),
      hand.longest_silence_ms(), worst.fades, worst.fall_per_s / kFadeSlope_per_s, hand.fades(),
      hand.over_fade(), worst.force_n, worst.over_slew, hand.force_n(),
      suture::fault_names(worst.faults).c_str(), after_kib - before_kib);
  int failed = 0;
  const auto expect = [&](bool holds, const char* what) {
    if (!holds) std::printf("FAILED: %s\n", what);
    failed += holds ? 0 : 1;
  };
  expect(!ports.empty(), "the server listens at ports of its own");
  expect(sent == options.packets && after_kib > 0.0 && std::isfinite(after_kib),
         "the server lives");
  // Each burst found a force at the hand: two forces for each, where it is sent in 64 ms.
  expect(was_felt && felt_forces >= felt_sent / kBurst * 2, "forces are felt while packets come");
  expect(
      worst.force_n <= kMaxForce_n * (1.0 + 1e-9) && hand.force_n() <= kMaxForce_n * (1.0 + 1e-9),
      "forces are within the tool's limit");
  expect(worst.over_slew <= 1.0, "force steps are within the tool's slew limit");
  expect(afterwards.fades > 0, "the force of a hand that lets go ends");
  expect(std::max(worst.fall_per_s, afterwards.fall_per_s) <= kFadeSlope_per_s &&
             hand.over_fade() <= 1.0,
         "a force that nothing follows fades, and does not fall");
  expect(hand.starved_force_n() == 0.0, "a hand that gets no forces feels none after 60 ms");
  expect(recovers, "a device is served again after it");
  expect(code == 0, "the server ends as it was asked to");
  if (code != 0) std::printf("%s\n", server.output().c_str());
  return failed == 0 ? 0 : 1;
}

}  // namespace
}  // namespace sutured::soak

int main(int argc, char** argv) {
  CLI::App app("Sends bad packets to the DDS ports of a server that a device drives");
  sutured::soak::Options options;
  app.add_option("--packets", options.packets, "how many")->capture_default_str();
  app.add_option("--seed", options.seed, "of their bytes")->capture_default_str();
  app.add_option("--per-second", options.per_second, "how many a second")->capture_default_str();
  app.add_flag("--discovery", options.discovery,
               "those of discovery too: Cyclone DDS 0.10.2 does not stand them (README.md)");
  CLI11_PARSE(app, argc, argv);
  try {
    return sutured::soak::attack(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sutured_packet_attack: %s\n", error.what());
    return 1;
  }
}
