// SPDX-License-Identifier: GPL-3.0-or-later
// Two hosts on one machine, each a network namespace with one Ethernet interface, and between
// them a cable or a relay that delays, jitters, reorders and loses packets:
//
//     namespace a            relay's namespace            namespace b
//     eth0 10.0.0.1 ══veth══ to_a ──impaired── to_b ══veth══ eth0 10.0.0.2
//
// There is no other way from a to b, so that whatever the programs in them exchange (discovery by
// multicast too) went through it; they need no configuration for that. Frames are relayed as they
// are: a datagram of several fragments is lost with any of them, as on a real network.
//
// Namespaces need CAP_SYS_ADMIN; who has it not makes them within a user namespace of their own,
// where the kernel permits that. Where it permits neither the program says so and ends with 77.
#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/if_packet.h>
#include <net/ethernet.h>
#include <net/if.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <optional>
#include <queue>
#include <string>
#include <system_error>
#include <vector>

#include "protocol/latency_histogram.hpp"
#include "protocol/types.hpp"
#include "support/impaired_link.hpp"

namespace sutured::testing {
namespace {

constexpr int kSkip = 77;
constexpr std::int64_t kSecond_ns = 1'000'000'000;

volatile std::sig_atomic_t ended = 0;

[[noreturn]] void give_up(const std::string& what) {
  std::fprintf(stderr, "two_hosts: %s: %s\n", what.c_str(), std::strerror(errno));
  std::exit(errno == EPERM || errno == ENOSPC || errno == EOPNOTSUPP ? kSkip : 1);
}

void write_file(const char* path, const std::string& text) {
  const int fd = open(path, O_WRONLY | O_CLOEXEC);
  if (fd < 0 || write(fd, text.data(), text.size()) != static_cast<ssize_t>(text.size()))
    give_up(path);
  close(fd);
}

/// Enters a network namespace of its own; says whether that took a user namespace as well.
bool leave_network() {
  if (unshare(CLONE_NEWNET) == 0) return false;
  const std::string user = std::to_string(getuid()), group = std::to_string(getgid());
  if (unshare(CLONE_NEWUSER | CLONE_NEWNET) != 0) give_up("no network namespace for this user");
  write_file("/proc/self/setgroups", "deny");
  write_file("/proc/self/uid_map", "0 " + user + " 1");
  write_file("/proc/self/gid_map", "0 " + group + " 1");
  return true;
}

/// A process that does nothing but keep a network namespace; it goes with its parent.
pid_t start_host() {
  int made[2];
  if (pipe2(made, O_CLOEXEC) != 0) give_up("pipe");
  const pid_t pid = fork();
  if (pid < 0) give_up("fork");
  if (pid == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    const char done = unshare(CLONE_NEWNET) == 0 ? 'y' : 'n';
    if (write(made[1], &done, 1) != 1) _exit(1);
    close(made[1]);
    for (;;) pause();
  }
  close(made[1]);
  char done = 'n';
  if (read(made[0], &done, 1) != 1 || done != 'y') {
    errno = EPERM;
    give_up("no network namespace for a host");
  }
  close(made[0]);
  return pid;
}

/// Runs `ip` with these words in the network namespace of `host` (0: in ours).
void ip(pid_t host, std::vector<std::string> words) {
  const pid_t pid = fork();
  if (pid < 0) give_up("fork");
  if (pid == 0) {
    if (host != 0) {
      const int ns = open(("/proc/" + std::to_string(host) + "/ns/net").c_str(), O_RDONLY);
      if (ns < 0 || setns(ns, CLONE_NEWNET) != 0) _exit(126);
    }
    words.insert(words.begin(), "ip");
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    // Administrators' programs are not in everybody's PATH.
    for (const char* program : {"/usr/sbin/ip", "/sbin/ip", "/bin/ip"})
      execv(program, arguments.data());
    _exit(127);
  }
  int status = 0;
  waitpid(pid, &status, 0);
  if (status == 0) return;
  const int code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  std::string line;
  for (const std::string& word : words) line += " " + word;
  std::fprintf(stderr, "two_hosts: ip%s failed%s\n", line.c_str(),
               code == 127 ? ": install iproute2" : "");
  std::exit(kSkip);
}

void bring_up(pid_t host, const std::string& device, const std::string& address) {
  // No addresses but ours: IPv6 would send packets of its own.
  ip(host, {"link", "set", "dev", device, "addrgenmode", "none"});
  if (!address.empty()) ip(host, {"address", "add", address, "dev", device});
  ip(host, {"link", "set", "dev", device, "up"});
  if (host != 0) ip(host, {"link", "set", "dev", "lo", "up"});
}

/// An end of the relay: all frames that come in at one of its interfaces.
int open_packets(const char* device) {
  const int fd = socket(AF_PACKET, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (fd < 0) give_up("packet socket");
  // Checksums that the sender left to the device travel as the header in front of a frame says.
  const int on = 1, buffer = 8 << 20;
  if (setsockopt(fd, SOL_PACKET, PACKET_VNET_HDR, &on, sizeof on) != 0) give_up("PACKET_VNET_HDR");
  if (setsockopt(fd, SOL_PACKET, PACKET_IGNORE_OUTGOING, &on, sizeof on) != 0)
    give_up("PACKET_IGNORE_OUTGOING");
  if (setsockopt(fd, SOL_SOCKET, SO_RCVBUFFORCE, &buffer, sizeof buffer) != 0)
    setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer);
  sockaddr_ll address{};
  address.sll_family = AF_PACKET;
  address.sll_protocol = htons(ETH_P_ALL);
  address.sll_ifindex = static_cast<int>(if_nametoindex(device));
  if (bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) give_up("bind");
  return fd;
}

/// Forwards frames between two packet sockets.
class Relay {
 public:
  Relay(int a, int b, Impairment impairment)
      : ways_{{a, b, ImpairedLink(impairment)}, {b, a, ImpairedLink(other_way(impairment))}} {}

  /// Runs until a signal ends it, then says what became of the packets.
  void run() {
    sigset_t none;
    sigemptyset(&none);
    pollfd ends[2] = {{ways_[0].from, POLLIN, 0}, {ways_[1].from, POLLIN, 0}};
    while (ended == 0) {
      timespec timeout{1, 0};
      if (!waiting_.empty()) {
        const std::int64_t left_ns =
            std::clamp<std::int64_t>(waiting_.top().due_ns - suture::monotonic_ns(), 0, kSecond_ns);
        timeout = {left_ns / kSecond_ns, left_ns % kSecond_ns};
      }
      // Signals come only here.
      ppoll(ends, 2, &timeout, &none);
      for (Way& way : ways_) receive(way);
      send_due();
    }
    for (int i = 0; i < 2; ++i) {
      const Way& way = ways_[i];
      std::printf("%s: %llu passed, %llu lost, %llu held back, %llu dropped\n",
                  i == 0 ? "a to b" : "b to a", number(way.link.passed()), number(way.link.lost()),
                  number(way.link.held_back()), number(way.dropped));
    }
    std::printf("late by p50 %.0f, p99 %.0f, max %.0f us\n", 1e-3 * lateness(0.5),
                1e-3 * lateness(0.99), 1e-3 * static_cast<double>(late_.max_ns()));
  }

 private:
  static constexpr std::size_t kWaitingMax = 16384, kFrameMax = 65536 + 64;
  struct Way {
    int from, to;
    ImpairedLink link;
    std::uint64_t dropped = 0;  // no room, here or in a host's queue
  };
  struct Frame {
    std::int64_t due_ns;
    std::uint64_t order;  // of arrival: frames that are due at once keep theirs
    Way* way;
    std::vector<char> bytes;
    bool operator<(const Frame& other) const {
      return due_ns != other.due_ns ? due_ns > other.due_ns : order > other.order;
    }
  };

  static Impairment other_way(Impairment impairment) {
    impairment.seed += 0x9e3779b97f4a7c15U;
    return impairment;
  }
  static unsigned long long number(std::uint64_t value) { return value; }
  [[nodiscard]] double lateness(double fraction) const {
    return static_cast<double>(late_.percentile_ns(fraction));
  }

  void receive(Way& way) {
    ssize_t got = 0;
    while ((got = recv(way.from, buffer_.data(), buffer_.size(), 0)) > 0) {
      const std::int64_t now_ns = suture::monotonic_ns();
      const std::optional<std::int64_t> due_ns = way.link.departure_ns(now_ns);
      if (!due_ns) continue;
      if (waiting_.size() >= kWaitingMax) {
        ++way.dropped;
        continue;
      }
      waiting_.push({*due_ns, ++order_, &way, {buffer_.begin(), buffer_.begin() + got}});
    }
  }

  void send_due() {
    while (!waiting_.empty()) {
      const std::int64_t late_ns = suture::monotonic_ns() - waiting_.top().due_ns;
      if (late_ns < 0) return;
      const Frame& frame = waiting_.top();
      if (::send(frame.way->to, frame.bytes.data(), frame.bytes.size(), 0) < 0)
        ++frame.way->dropped;
      late_.record(late_ns);
      waiting_.pop();
    }
  }

  Way ways_[2];
  std::priority_queue<Frame> waiting_;
  std::uint64_t order_ = 0;
  suture::LatencyHistogram late_;
  std::vector<char> buffer_ = std::vector<char>(kFrameMax);
};

int run(int argc, char** argv) {
  CLI::App app("Two hosts in network namespaces, with a cable or a bad network between them");
  double delay_ms = 0.0, jitter_ms = 0.0, loss_percent = 0.0, reordering_percent = 0.0;
  Impairment impairment;
  bool cable = false;
  app.add_flag("--cable", cable, "a plain cable instead of the relay");
  app.add_option("--delay-ms", delay_ms, "one way")->check(CLI::Range(0.0, 10'000.0));
  app.add_option("--jitter-ms", jitter_ms, "delays are uniform in delay ± jitter")
      ->check(CLI::Range(0.0, 10'000.0));
  app.add_option("--loss-percent", loss_percent, "of packets, each way")
      ->check(CLI::Range(0.0, 100.0));
  app.add_option("--reordering-percent", reordering_percent,
                 "of packets are held 3 ms longer, so that later ones overtake them")
      ->check(CLI::Range(0.0, 100.0));
  app.add_option("--seed", impairment.seed, "of all that is at random")->capture_default_str();
  app.footer(
      "Prints how to start a program on host a (10.0.0.1) and on host b (10.0.0.2), then `ready`;\n"
      "runs until SIGINT or SIGTERM, and says what became of the packets.");
  CLI11_PARSE(app, argc, argv);
  if (jitter_ms > delay_ms) {
    std::fprintf(stderr, "two_hosts: a jitter beyond the delay would need packets from later\n");
    return 2;
  }
  impairment.delay_ns = static_cast<std::int64_t>(1e6 * delay_ms);
  impairment.jitter_ns = static_cast<std::int64_t>(1e6 * jitter_ms);
  impairment.loss = 1e-2 * loss_percent;
  impairment.reordering = 1e-2 * reordering_percent;

  struct sigaction action {};
  action.sa_handler = [](int) { ended = 1; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  sigset_t end_signals;
  sigemptyset(&end_signals);
  sigaddset(&end_signals, SIGINT);
  sigaddset(&end_signals, SIGTERM);

  const bool own_user = leave_network();
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // a change of user forgets it
  const pid_t a = start_host(), b = start_host();
  sigprocmask(SIG_BLOCK, &end_signals, nullptr);  // after the hosts, which inherit it
  std::optional<Relay> relay;
  if (cable) {
    ip(a, {"link", "add", "name", "eth0", "type", "veth", "peer", "name", "eth0", "netns",
           std::to_string(b)});
  } else {
    ip(0, {"link", "add", "name", "to_a", "type", "veth", "peer", "name", "eth0", "netns",
           std::to_string(a)});
    ip(0, {"link", "add", "name", "to_b", "type", "veth", "peer", "name", "eth0", "netns",
           std::to_string(b)});
    bring_up(0, "to_a", "");
    bring_up(0, "to_b", "");
    relay.emplace(open_packets("to_a"), open_packets("to_b"), impairment);
  }
  bring_up(a, "eth0", "10.0.0.1/24");
  bring_up(b, "eth0", "10.0.0.2/24");

  const std::string user = own_user ? " --user --preserve-credentials" : "";
  std::printf("a: nsenter --target %d%s --net\nb: nsenter --target %d%s --net\nready\n", a,
              user.c_str(), b, user.c_str());
  std::fflush(stdout);
  if (relay) {
    sched_param priority{};
    priority.sched_priority = 80;
    sched_setscheduler(0, SCHED_FIFO, &priority);  // where permitted
    prctl(PR_SET_TIMERSLACK, 1UL);
    relay->run();
  } else {
    int signal = 0;
    sigwait(&end_signals, &signal);
  }
  return 0;
}

}  // namespace
}  // namespace sutured::testing

int main(int argc, char** argv) { return sutured::testing::run(argc, argv); }
