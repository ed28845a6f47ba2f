// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cstdio>
#include <ctime>
#include <deque>
#include <mutex>

#include "commands.hpp"
#include "suture/session.hpp"
#include "suture/viewer.hpp"

namespace suture::cli {
namespace {

constexpr std::size_t kEventsShown = 8;

std::string clock_text(std::int64_t stamp_ns) {
  const auto seconds = static_cast<std::time_t>(stamp_ns / 1'000'000'000);
  std::tm local{};
  localtime_r(&seconds, &local);
  char text[16];
  std::strftime(text, sizeof text, "%H:%M:%S", &local);
  return text;
}

void print_table(const Status& status, const std::deque<Event>& events) {
  std::printf("sutured %s on %s, pid %d · scene %s · session %s · %s%s%s\n", status.version.c_str(),
              status.host.c_str(), status.pid, status.scene.c_str(),
              status.session.empty() ? "(default)" : status.session.c_str(), status.state.c_str(),
              status.state_reason.empty() ? "" : ": ", status.state_reason.c_str());
  std::printf(
      "simulation  %7.1f of %.0f Hz   step p50 %6.2f  p99 %6.2f  max %6.2f ms   %llu overruns"
      "   t = %.1f s\n",
      status.achieved_rate_hz, status.rate_hz, 1e-3 * status.step.p50_us, 1e-3 * status.step.p99_us,
      1e-3 * status.step.max_us, static_cast<unsigned long long>(status.overruns),
      status.simulation_time_s);
  std::printf(
      "scene       %u bodies, %u vertices, %u tets; %u rows (%u unilateral active), %u contacts, "
      "residual %.1e\n",
      status.bodies, status.vertices, status.tets, status.rows, status.active_rows, status.contacts,
      status.complementarity_residual);
  std::printf(
      "real time   wake-up p50 %5.0f  p99 %5.0f  max %5.0f µs   %llu missed   SCHED_FIFO %s, "
      "memory %s%s%s\n",
      status.wakeup.p50_us, status.wakeup.p99_us, status.wakeup.max_us,
      static_cast<unsigned long long>(status.missed_ticks), status.sched_fifo ? "yes" : "no",
      status.memory_locked ? "locked" : "not locked",
      status.realtime_note.empty() ? "" : "\n            ", status.realtime_note.c_str());
  std::printf("clients     %u devices, %u viewers, frames at %.0f Hz\n\n", status.devices,
              status.viewers, status.frame_rate_hz);
  std::printf("%-16s %-8s %-6s %-8s %-10s %8s %8s %8s %8s %8s %9s %9s %8s  %s\n", "tool", "kind",
              "leased", "renders", "state", "poses/s", "forces/s", "force N", "peak N", "given mJ",
              "tick p50", "tick p99", "lost", "faults");
  for (const ToolStatus& tool : status.tools) {
    std::printf(
        "%-16s %-8s %-6s %-8s %-10s %8.0f %8.0f %8.3f %8.3f %8.2f %6.0f µs %6.0f µs %8llu  %s\n",
        tool.tool.c_str(), tool.kind.c_str(), tool.leased ? "yes" : "no",
        tool.renders_itself ? "device" : "server", name_of(tool.state), tool.pose_rate_hz,
        tool.force_rate_hz, tool.force_n, tool.peak_force_n, 1e3 * tool.energy_to_hand_j,
        tool.tick.p50_us, tool.tick.p99_us, static_cast<unsigned long long>(tool.poses_lost),
        fault_names(tool.faults).c_str());
  }
  if (!events.empty()) std::printf("\n");
  for (const Event& event : events) {
    std::printf("%s  %-12s %s%s%s", clock_text(event.stamp_ns).c_str(), event.kind.c_str(),
                event.subject.c_str(), event.object.empty() ? "" : " · ", event.object.c_str());
    if (!event.unit.empty()) std::printf("  %.4g %s", event.value, event.unit.c_str());
    std::printf("%s%s\n", event.text.empty() ? "" : "  ", event.text.c_str());
  }
}

void print_line(const Status& status) {
  std::printf("%s %s %.1f Hz, step p50 %.2f p99 %.2f ms, %llu overruns",
              clock_text(status.stamp_ns).c_str(), status.state.c_str(), status.achieved_rate_hz,
              1e-3 * status.step.p50_us, 1e-3 * status.step.p99_us,
              static_cast<unsigned long long>(status.overruns));
  for (const ToolStatus& tool : status.tools) {
    std::printf(" | %s %s %.0f/s %.3f N", tool.tool.c_str(), name_of(tool.state),
                tool.force_rate_hz, tool.force_n);
  }
  std::printf("\n");
}

}  // namespace

int run_top(const TopArguments& arguments) {
  SessionOptions options;
  options.domain = arguments.session.domain;
  options.session = arguments.session.session;
  options.security = arguments.session.security;
  options.network = arguments.session.network;
  options.timeout =
      std::chrono::milliseconds(static_cast<std::int64_t>(arguments.session.timeout_s * 1000.0));
  Session session(options);
  if (arguments.once) {
    print_table(session.status(), {});
    return kDone;
  }
  std::mutex mutex;
  std::deque<Event> events;
  ViewerCallbacks callbacks;
  callbacks.on_event = [&](const Event& event) {
    const std::lock_guard lock(mutex);
    events.push_back(event);
    if (events.size() > kEventsShown) events.pop_front();
  };
  Viewer viewer(options, callbacks);
  std::optional<Status> status = session.status();
  int silent = 0;
  while (!interrupted) {
    if (status) {
      silent = 0;
      if (on_terminal()) {
        const std::lock_guard lock(mutex);
        std::printf("\x1b[H\x1b[2J");
        print_table(*status, events);
      } else {
        print_line(*status);
      }
      std::fflush(stdout);
      if (status->state == "leaving") {
        std::printf("the server has left\n");
        return kDone;
      }
    } else if (++silent >= 6) {
      throw Error(ErrorCode::kNoServer, "the server fell silent 3 s ago",
                  "see whether it still runs");
    }
    status = session.next_status(std::chrono::milliseconds(500));
  }
  return kInterrupted;
}

}  // namespace suture::cli
