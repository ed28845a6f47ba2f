// SPDX-License-Identifier: Apache-2.0
// `suture doctor`: is this machine, as it is now, fit for 1 kHz haptics?
#include <ifaddrs.h>
#include <net/if.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>
#include <thread>

#include "commands.hpp"
#include "network_probe.hpp"
#include "protocol/participant.hpp"
#include "protocol/security.hpp"

namespace suture::cli {
namespace {

enum class Grade { kGood, kFair, kBad };

/// Collects findings and prints them as they come.
class Report {
 public:
  /// Prints one line: grade, what, and below it the mend where there is one to make.
  void add(Grade grade, const std::string& what, const std::string& mend = "") {
    static constexpr const char* kPlain[] = {"good", "fair", "BAD "};
    static constexpr const char* kColoured[] = {"\x1b[32mgood\x1b[0m", "\x1b[33mfair\x1b[0m",
                                                "\x1b[31mBAD \x1b[0m"};
    const auto index = static_cast<std::size_t>(grade);
    std::printf("  %s  %s\n", on_terminal() ? kColoured[index] : kPlain[index], what.c_str());
    if (grade != Grade::kGood && !mend.empty()) std::printf("        mend: %s\n", mend.c_str());
    std::fflush(stdout);
    worst_ = std::max(worst_, grade);
  }
  [[nodiscard]] Grade worst() const { return worst_; }

 private:
  Grade worst_ = Grade::kGood;
};

std::optional<std::string> first_line(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line)) return std::nullopt;
  return line;
}

template <class... Values>
std::string format(const char* pattern, Values... values) {
  char text[512];
  std::snprintf(text, sizeof text, pattern, values...);
  return text;
}

void check_kernel(Report& report) {
  utsname name{};
  uname(&name);
  const std::string version = name.version;
  const bool realtime = first_line("/sys/kernel/realtime").value_or("0") == "1" ||
                        version.find("PREEMPT_RT") != std::string::npos;
  const bool preempts = version.find("PREEMPT") != std::string::npos;
  report.add(realtime ? Grade::kGood : Grade::kFair,
             format("kernel %s, %s", name.release,
                    realtime   ? "PREEMPT_RT"
                    : preempts ? "preemptible, not PREEMPT_RT"
                               : "without preemption"),
             "sudo apt install linux-image-rt-amd64, and reboot into it");
}

void check_processors(Report& report) {
  cpu_set_t set;
  CPU_ZERO(&set);
  const int usable = sched_getaffinity(0, sizeof set, &set) == 0 ? CPU_COUNT(&set) : 1;
  report.add(usable >= 4   ? Grade::kGood
             : usable >= 2 ? Grade::kFair
                           : Grade::kBad,
             format("%d processors", usable),
             usable >= 2 ? "four leave room for the simulation, the forces, a viewer and the rest"
                         : "use a machine, or give this one, two processors at least");
}

void check_isolation(Report& report) {
  const std::string isolated = first_line("/sys/devices/system/cpu/isolated").value_or("");
  report.add(isolated.empty() ? Grade::kFair : Grade::kGood,
             isolated.empty() ? "no processor is kept free of other work"
                              : "kept free of other work: processor " + isolated,
             "of four processors or more: add isolcpus=3 nohz_full=3 to the kernel's command line "
             "(/etc/default/grub, sudo update-grub, reboot), and start the device there by "
             "taskset -c 3; not the server, whose threads would not spread from there");
}

void check_governor(Report& report) {
  const std::optional<std::string> governor =
      first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
  if (!governor) {
    report.add(Grade::kGood, "processor frequency is not scaled here (or a hypervisor does it)");
    return;
  }
  report.add(*governor == "performance" ? Grade::kGood : Grade::kFair,
             "processor frequency governor: " + *governor,
             "sudo cpupower frequency-set -g performance");
}

void check_scheduling(Report& report) {
  rlimit limit{};
  getrlimit(RLIMIT_RTPRIO, &limit);
  const bool permitted = may_run_realtime(kReceivePriority);
  report.add(permitted ? Grade::kGood : Grade::kFair,
             permitted ? format("SCHED_FIFO permitted at priority %d", kReceivePriority)
                       : format("SCHED_FIFO not permitted (RLIMIT_RTPRIO is %llu, %d is wanted)",
                                static_cast<unsigned long long>(limit.rlim_cur), kReceivePriority),
             "add to /etc/security/limits.conf: \"@realtime - rtprio 80\", join that group, "
             "log in again");
}

void check_nice(Report& report) {
  constexpr int kWanted = -10;  // what the simulation's thread asks for
  bool permitted = false;
  // On Linux a nice value is the thread's own and goes with it.
  std::thread([&] {
    permitted = setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), kWanted) == 0;
  }).join();
  report.add(permitted ? Grade::kGood : Grade::kFair,
             format("nice %d %spermitted to the simulation", kWanted, permitted ? "" : "not "),
             "add to /etc/security/limits.conf: \"@realtime - nice -10\", join that group, log in "
             "again");
}

void check_memory_lock(Report& report) {
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  // Locking what there is now says more than the limit: root needs none.
  const bool locked = mlockall(MCL_CURRENT) == 0;
  if (locked) munlockall();
  constexpr rlim_t kWanted = rlim_t{1} << 30;
  const bool enough = limit.rlim_cur == RLIM_INFINITY || limit.rlim_cur >= kWanted;
  report.add(
      locked ? Grade::kGood : Grade::kFair,
      std::string("memory can") + (locked ? "" : "not") + " be locked (RLIMIT_MEMLOCK " +
          (limit.rlim_cur == RLIM_INFINITY ? "unlimited"
                                           : std::to_string(limit.rlim_cur / 1024) + " KiB") +
          (enough || locked ? ")" : ", a server wants 1 GiB)"),
      "add to /etc/security/limits.conf: \"@realtime - memlock unlimited\", join that "
      "group, log in again");
}

void check_socket_buffers(Report& report) {
  constexpr long kWanted = 4L << 20;
  const std::string text = first_line("/proc/sys/net/core/rmem_max").value_or("0");
  const long bytes = std::strtol(text.c_str(), nullptr, 10);
  report.add(
      bytes >= kWanted ? Grade::kGood : Grade::kFair,
      format("receive buffers of up to %ld KiB (meshes want %ld)", bytes / 1024, kWanted / 1024),
      "sudo sysctl -w net.core.rmem_max=4194304");
}

/// Datagrams that the kernel dropped since the machine started, because nobody had taken those
/// before them; nothing where it does not tell.
std::optional<unsigned long long> dropped_datagrams() {
  std::ifstream file("/proc/net/snmp");
  std::string names, values;
  while (std::getline(file, names) && std::getline(file, values)) {
    if (!names.starts_with("Udp:")) continue;
    std::istringstream name_words(names), value_words(values);
    std::string name, value;
    while (name_words >> name && value_words >> value)
      if (name == "RcvbufErrors") return std::strtoull(value.c_str(), nullptr, 10);
  }
  return std::nullopt;
}

void check_dropped(Report& report) {
  const std::optional<unsigned long long> dropped = dropped_datagrams();
  if (!dropped) return;
  report.add(*dropped == 0 ? Grade::kGood : Grade::kFair,
             format("%llu datagrams dropped for want of room since the machine started", *dropped),
             "raise net.core.rmem_max as above where a viewer is among those that lost them; "
             "nstat -az UdpRcvbufErrors shows whether it goes on");
}

/// The interfaces by which devices on other machines may come.
void check_interfaces(Report& report) {
  ifaddrs* all = nullptr;
  if (getifaddrs(&all) != 0) return;
  bool found = false;
  for (const ifaddrs* each = all; each != nullptr; each = each->ifa_next) {
    if (each->ifa_addr == nullptr || each->ifa_addr->sa_family != AF_INET) continue;
    if ((each->ifa_flags & IFF_LOOPBACK) != 0 || (each->ifa_flags & IFF_RUNNING) == 0) continue;
    found = true;
    const std::string name = each->ifa_name;
    const bool radio = std::filesystem::exists("/sys/class/net/" + name + "/wireless");
    report.add(radio ? Grade::kFair : Grade::kGood,
               "interface " + name + (radio ? ", by radio" : ""),
               "connect devices by cable: radio loses packets and delays them by milliseconds");
  }
  freeifaddrs(all);
  if (!found) {
    report.add(Grade::kFair, "no interface but loopback: devices of this machine only",
               "bring one up for devices on other machines");
  }
}

/// Wakes every millisecond by the absolute clock; records how late.
void measure_wakeups(double seconds, LatencyHistogram& late) {
  std::thread loop([&] {
    sched_param parameters{};
    parameters.sched_priority = kReceivePriority;
    pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters);  // where permitted
    constexpr std::int64_t kSecondNs = 1'000'000'000;
    std::int64_t next_ns = monotonic_ns();
    const int ticks = static_cast<int>(seconds * 1000.0);
    for (int i = 0; i < ticks && !interrupted; ++i) {
      next_ns += 1'000'000;
      const timespec wake{static_cast<time_t>(next_ns / kSecondNs),
                          static_cast<long>(next_ns % kSecondNs)};
      while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &wake, nullptr) != 0) {
      }
      late.record(monotonic_ns() - next_ns);
    }
  });
  loop.join();
}

/// What helps threads that wake late: permission, where it is missing, before anything else.
const char* mend_of_late_threads(const char* not_permitted, const char* permitted) {
  return may_run_realtime(kReceivePriority) ? permitted : not_permitted;
}

void check_wakeups(Report& report, double seconds) {
  LatencyHistogram late;
  measure_wakeups(seconds, late);
  const auto us = [&](double fraction) {
    return 1e-3 * static_cast<double>(late.percentile_ns(fraction));
  };
  const double p99 = us(0.99);
  const double p999 = us(0.999);
  const Grade grade = p99 > 1000.0 ? Grade::kBad : p999 > 200.0 ? Grade::kFair : Grade::kGood;
  report.add(
      grade,
      format("1 kHz wake-up late by p50 %.0f, p99 %.0f, p99.9 %.0f, max %.0f µs (%llu ticks)",
             us(0.5), p99, p999, 1e-3 * static_cast<double>(late.max_ns()),
             static_cast<unsigned long long>(late.count())),
      grade == Grade::kBad
          ? mend_of_late_threads(
                "the machine is too busy for 1 kHz: end other work, permit SCHED_FIFO",
                "the machine is too busy for 1 kHz: end other work, isolate a processor "
                "(isolcpus=)")
          : mend_of_late_threads(
                "permit SCHED_FIFO, isolate a processor (isolcpus=), use PREEMPT_RT",
                "isolate a processor (isolcpus=), end other work, use PREEMPT_RT"));
}

void check_network(Report& report, EchoPeer& peer, double seconds) {
  EchoPeer::RoundTrips trips;
  peer.measure(seconds, trips);
  const auto us = [](const LatencyHistogram& histogram, double fraction) {
    return 1e-3 * static_cast<double>(histogram.percentile_ns(fraction));
  };
  if (!trips.met) {
    report.add(Grade::kBad, "two processes of this machine do not find each other over DDS",
               "bring up the loopback interface; check the firewall");
    return;
  }
  const double ratio = us(trips.dds, 0.5) / std::max(us(trips.udp, 0.5), 1e-3);
  const double p99 = us(trips.dds, 0.99);
  const std::uint64_t rounds = trips.dds.count() + trips.dds_lost;
  const Grade grade = p99 > 1000.0 || trips.dds_lost * 100 > rounds ? Grade::kBad
                      : p99 > 500.0                                 ? Grade::kFair
                                                                    : Grade::kGood;
  report.add(grade,
             format("round trip over DDS p50 %.0f, p99 %.0f, max %.0f µs; raw UDP %.0f, %.0f; "
                    "ratio %.2f; %llu of %llu lost",
                    us(trips.dds, 0.5), p99, 1e-3 * static_cast<double>(trips.dds.max_ns()),
                    us(trips.udp, 0.5), us(trips.udp, 0.99), ratio,
                    static_cast<unsigned long long>(trips.dds_lost),
                    static_cast<unsigned long long>(rounds)),
             grade == Grade::kBad
                 ? "forces would arrive later than the next pose: end other work on this machine"
                 : mend_of_late_threads("permit SCHED_FIFO, leave a processor free",
                                        "leave a processor free: end other work, or isolate one "
                                        "(isolcpus=)"));
}

/// Keys that end during a course are worse than none: said a month before.
void check_keys(Report& report, const std::string& folder) {
  constexpr std::int64_t kSoon_s = 30 * 86400;
  std::optional<Identity> identity;
  try {
    identity = read_identity(folder);
  } catch (const Error& error) {
    report.add(Grade::kBad, error.cause(), error.mend());
    return;
  }
  std::string tools;
  for (const std::string& tool : identity->tools) tools += " " + tool;
  const bool soon = identity->expires_s - std::time(nullptr) < kSoon_s;
  report.add(
      soon ? Grade::kFair : Grade::kGood,
      "keys of \"" + identity->name + "\" hold until " + date_text(identity->expires_s) +
          (tools.empty() ? "" : "; tools:" + tools),
      "`suture keys renew SITE " + identity->name + "` at the site, and copy the folder anew");
}

}  // namespace

int run_doctor(const DoctorArguments& arguments) {
  // The other process first: a fork takes no threads along.
  std::optional<EchoPeer> peer;
  if (arguments.network) peer.emplace(arguments.domain);

  Report report;
  std::printf("machine\n");
  check_kernel(report);
  check_processors(report);
  check_isolation(report);
  check_governor(report);
  check_scheduling(report);
  check_nice(report);
  check_memory_lock(report);
  check_wakeups(report, arguments.seconds);
  std::printf("network\n");
  check_interfaces(report);
  check_socket_buffers(report);
  check_dropped(report);
  if (peer) check_network(report, *peer, arguments.seconds);
  if (const std::string folder = security_folder(arguments.security); !folder.empty()) {
    std::printf("security\n");
    check_keys(report, folder);
  }
  if (interrupted) return kInterrupted;
  switch (report.worst()) {
    case Grade::kGood:
      std::printf("fit for 1 kHz\n");
      break;
    case Grade::kFair:
      std::printf("1 kHz is possible; the lines graded fair say what would make it steadier\n");
      break;
    case Grade::kBad:
      std::printf("not fit for 1 kHz: see the lines graded BAD\n");
      return kFailed;
  }
  return kDone;
}

}  // namespace suture::cli
