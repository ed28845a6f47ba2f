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

#include "protocol/surgeon.hpp"
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
constexpr std::size_t kHeader = 20;  // "RTPS", version, vendor, GUID prefix

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

/// A hand that sews to and fro, and comes again whenever the server has lost it.
class Hand {
 public:
  Hand(const suture::ParticipantOptions& session, suture::SurgeonTrack track)
      : track_(std::move(track)) {
    options_.domain = session.domain;
    options_.session = session.session;
    options_.tool = track_.tool;
    options_.timeout = std::chrono::seconds(20);
    thread_ = std::thread([this] { live(); });
  }
  ~Hand() {
    over_ = true;
    thread_.join();
  }
  Hand(const Hand&) = delete;
  Hand& operator=(const Hand&) = delete;
  [[nodiscard]] int comings() const { return comings_; }
  [[nodiscard]] double force_n() const { return force_n_; }
  /// The largest force while none of the server's had come for `kFaded`.
  [[nodiscard]] double starved_force_n() const { return starved_force_n_; }
  [[nodiscard]] double longest_silence_ms() const {
    return 1e-6 * static_cast<double>(longest_ns_);
  }

 private:
  void live() {
    while (!over_) {
      try {
        suture::Device device(options_);
        ++comings_;
        std::uint64_t sequence = 0;
        std::chrono::nanoseconds silence{0};
        device.run([&](const suture::Force& force,
                       std::chrono::nanoseconds elapsed) -> std::optional<suture::Hand> {
          if (over_) return std::nullopt;
          const double n = std::hypot(force.force_n[0], force.force_n[1], force.force_n[2]);
          force_n_ = std::max(force_n_.load(), std::isfinite(n) ? n : HUGE_VAL);
          silence = force.sequence == sequence ? silence + elapsed : std::chrono::nanoseconds{0};
          sequence = force.sequence;
          if (silence > kFaded) starved_force_n_ = std::max(starved_force_n_.load(), n);
          longest_ns_ = std::max<std::int64_t>(longest_ns_, silence.count());
          const double now_s =
              std::chrono::duration<double>(std::chrono::steady_clock::now() - begun_).count();
          return to_and_fro(track_, now_s);
        });
      } catch (const suture::Error& error) {
        std::printf("  the device: %s\n", error.what());
      }
    }
  }

  suture::DeviceOptions options_;
  suture::SurgeonTrack track_;
  const std::chrono::steady_clock::time_point begun_ = std::chrono::steady_clock::now();
  std::atomic<bool> over_{false};
  std::atomic<int> comings_{0};
  std::atomic<double> force_n_{0.0}, starved_force_n_{0.0};
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

  const suture::SurgeonTrack track = suture::read_surgeon(kFolder + "one_bite.csv").tracks.at(0);
  const suture::Participant participant(session, suture::Channel::kControl);
  ForceWatcher watcher(participant, track.tool, kMaxSlew_n_per_s);
  Hand hand(session, track);
  const auto is_felt = [&](ForceWatcher& by) {
    const std::uint64_t answers = by.worst().answers;
    return testing::eventually(
        [&] {
          server.drain();
          const ForceWatcher::Worst now = by.worst();
          return now.rendering && now.answers >= answers + 500;
        },
        std::chrono::seconds(120));
  };
  if (!is_felt(watcher)) throw std::runtime_error("the device feels nothing before the attack");
  // Ports that are ours too (multicast) would have us attacked.
  std::vector<std::uint16_t> ports;
  const std::set<std::uint16_t> ours = testing::udp_ports(getpid());
  std::set_difference(theirs.begin(), theirs.end(), ours.begin(), ours.end(),
                      std::back_inserter(ports));

  Random random(options.seed);
  std::vector<Bytes> pool;
  Tap tap;
  if (tap.open())
    testing::eventually([&] {
      tap.take(theirs, pool, 512, random);
      return pool.size() >= 256;
    });
  // A process that was killed and not yet waited for has no memory.
  const auto lives = [&] {
    const double now_kib = testing::resident_kib(server.pid());
    return now_kib > 0.0 && std::isfinite(now_kib);
  };
  const double before_kib = testing::resident_kib(server.pid());
  const std::uint64_t forces_before = watcher.worst().forces;
  std::printf("%zu ports, %zu live packets%s\n", ports.size(), pool.size(),
              tap.open() ? "" : " (none: to read them takes root)");

  const int udp = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  std::uint64_t sent = 0, left_out = 0, kinds[3] = {};
  const auto begun = std::chrono::steady_clock::now();
  while (sent < options.packets && !ports.empty()) {
    const std::uint64_t kind = pool.empty() ? random() % 2 : random() % 8 < 6 ? 2 : random() % 2;
    const Bytes packet = kind == 0   ? noise(random)
                         : kind == 1 ? rtps_shaped(random, pool)
                                     : mutated(random, pool);
    if (!options.discovery && may_be_discovery(packet)) {
      ++left_out;
      continue;
    }
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    to.sin_port = htons(ports[below(random, ports.size())]);
    (void)sendto(udp, packet.data(), packet.size(), 0, reinterpret_cast<sockaddr*>(&to), sizeof to);
    ++kinds[kind];
    if (++sent % 64 == 0) {
      if (!lives()) break;
      server.drain();  // Cyclone tells of each bad packet
      if (tap.open()) tap.take(theirs, pool, 512, random);
      std::this_thread::sleep_until(  // a pace, not a condition
          begun +
          std::chrono::duration_cast<std::chrono::nanoseconds>(
              std::chrono::duration<double>(static_cast<double>(sent) / options.per_second)));
    }
  }
  const double took_s =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
  close(udp);
  const ForceWatcher::Worst during = watcher.worst();
  const double after_kib = testing::resident_kib(server.pid());
  bool recovers = lives();
  if (recovers) {
    // A pose with one bit flipped may have stopped the tool, as a hand's own would: people resume.
    resume(session);
    // The server may have forgotten whoever listened: another looks.
    const suture::Participant another(session, suture::Channel::kControl);
    ForceWatcher fresh(another, track.tool, kMaxSlew_n_per_s);
    recovers = is_felt(fresh);
  }
  const ForceWatcher::Worst worst = watcher.worst();
  server.send(SIGTERM);
  const int code = server.wait();

  const auto number = [](std::uint64_t value) { return static_cast<unsigned long long>(value); };
  std::printf(
      "%llu packets in %.1f s (%llu noise, %llu shaped, %llu mutated; %llu of discovery left out)\n"
      "  forces during  %.0f a second, at most %.0f ms apart; the device came %d times\n"
      "  force          at most %.4f N, %.2f of what the slew allows; %.4f N at the hand\n"
      "  faults         %s\n"
      "  memory         %+.0f KiB\n",
      number(sent), took_s, number(kinds[0]), number(kinds[1]), number(kinds[2]), number(left_out),
      static_cast<double>(during.forces - forces_before) / took_s, hand.longest_silence_ms(),
      hand.comings(), worst.force_n, worst.over_slew, hand.force_n(),
      suture::fault_names(worst.faults).c_str(), after_kib - before_kib);
  int failed = 0;
  const auto expect = [&](bool holds, const char* what) {
    if (!holds) std::printf("FAILED: %s\n", what);
    failed += holds ? 0 : 1;
  };
  expect(!ports.empty(), "the server listens at ports of its own");
  expect(sent == options.packets && after_kib > 0.0 && std::isfinite(after_kib),
         "the server lives");
  expect(
      worst.force_n <= kMaxForce_n * (1.0 + 1e-9) && hand.force_n() <= kMaxForce_n * (1.0 + 1e-9),
      "forces are within the tool's limit");
  expect(worst.over_slew <= 1.0, "force steps are within the tool's slew limit");
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
