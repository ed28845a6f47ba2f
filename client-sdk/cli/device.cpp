// SPDX-License-Identifier: Apache-2.0
// `suture device`: plays a surgeon file at the rate of a haptic device, over the SDK that
// any device uses.
#include "suture/device.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "force_log.hpp"
#include "force_plot.hpp"
#include "protocol/surgeon.hpp"
#include "protocol/types.hpp"
#include "suture/viewer.hpp"

namespace suture::cli {
namespace {

constexpr std::size_t kSentSize = 65536;  // hands whose answer may still come: a minute
constexpr double kPrintPeriodS = 0.2;

Hand hand_at(const SurgeonTrack& track, double time_s) {
  const SurgeonPose pose = track.at(time_s);
  Hand hand;
  hand.position_m = pose.position_m;
  hand.orientation_xyzw = pose.orientation_xyzw;
  hand.jaw = pose.jaw;
  hand.in_world = true;  // a surgeon file holds the tool's poses, not a device's
  return hand;
}

/// Where in the file a looping play is: to the end and back, so that the hand never jumps.
double loop_time(const SurgeonTrack& track, double time_s) {
  const double length = track.end_s() - track.begin_s();
  if (length <= 0.0) return track.begin_s();
  const double phase = std::fmod(time_s, 2.0 * length);
  return track.begin_s() + (phase <= length ? phase : 2.0 * length - phase);
}

/// What happened to this tool, its needle and its tissue, as the server told it.
class EventBook {
 public:
  struct Entry {
    double time_s;  // on the surgeon's clock
    Event event;
  };
  explicit EventBook(bool print) : print_(print), start_ns_(wall_clock_ns()) {}

  void add(const Event& event) {
    if (event.stamp_ns < start_ns_) return;  // kept from before this device
    const double time_s = 1e-9 * static_cast<double>(event.stamp_ns - start_ns_);
    const std::lock_guard lock(mutex_);
    if (print_) {
      std::printf("%s%8.3f s  %s  %s%s%s", on_terminal() ? "\r\x1b[K" : "", time_s,
                  event.kind.c_str(), event.subject.c_str(), event.object.empty() ? "" : " · ",
                  event.object.c_str());
      if (!event.unit.empty()) std::printf("  %.4g %s", event.value, event.unit.c_str());
      if (event.faults != 0) std::printf("  %s", fault_names(event.faults).c_str());
      if (!event.text.empty()) std::printf("  %s", event.text.c_str());
      std::printf("\n");
      std::fflush(stdout);
    }
    if (entries_.size() < kMost) entries_.push_back({time_s, event});
  }
  void add(const Status& status) {
    const std::lock_guard lock(mutex_);
    status_ = status;
  }
  [[nodiscard]] std::vector<Entry> entries() {
    const std::lock_guard lock(mutex_);
    return entries_;
  }
  [[nodiscard]] Status status() {
    const std::lock_guard lock(mutex_);
    return status_;
  }

 private:
  static constexpr std::size_t kMost = 10'000;
  bool print_;
  std::int64_t start_ns_;
  std::mutex mutex_;
  std::vector<Entry> entries_;
  Status status_;
};

void print_force(double time_s, double end_s, const Force& force, double limit_n) {
  constexpr int kBar = 20;
  const double magnitude = length_of(force.force_n);
  const int filled =
      limit_n > 0.0 ? std::clamp(static_cast<int>(magnitude / limit_n * kBar + 0.5), 0, kBar) : 0;
  char bar[kBar + 1];
  for (int i = 0; i < kBar; ++i) bar[i] = i < filled ? '#' : '.';
  bar[kBar] = '\0';
  std::printf("%s%7.2f / %.2f s  %7.4f N  [%s]  (%+.4f %+.4f %+.4f) N  %s%s%s%s",
              on_terminal() ? "\r\x1b[K" : "", time_s, end_s, magnitude, bar, force.force_n[0],
              force.force_n[1], force.force_n[2], name_of(force.state),
              force.holding ? ", holding" : "", force.faults != 0 ? "  " : "",
              fault_names(force.faults).c_str());
  if (!on_terminal()) std::printf("\n");
  std::fflush(stdout);
}

void write_text(const std::string& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.flush();
  if (!file) {
    throw Error(ErrorCode::kBadInput, path + ": cannot be written",
                "check the path and its permissions, and the disk's space");
  }
}

}  // namespace

int run_device(const DeviceArguments& arguments) {
  const Surgeon surgeon = read_surgeon(arguments.surgeon);
  const SurgeonTrack* track = surgeon.track(arguments.tool);
  if (track == nullptr) {
    std::string known;
    for (const SurgeonTrack& other : surgeon.tracks) {
      known += (known.empty() ? "" : ", ") + other.tool;
    }
    throw Error(ErrorCode::kBadInput,
                arguments.surgeon + ": has no rows of the tool \"" + arguments.tool + "\"",
                "it has rows of " + known);
  }
  if (arguments.render == "device") {
    throw Error(ErrorCode::kBadInput, "this version renders on the server only",
                "leave --render out");
  }
  const auto timeout =
      std::chrono::milliseconds(static_cast<std::int64_t>(arguments.session.timeout_s * 1000.0));

  // What the receive thread needs to know of a hand whose answer arrives.
  struct Sent {
    std::atomic<std::uint64_t> sequence{0};
    std::atomic<double> time_s{0.0};
  };
  const auto sent = std::make_unique<std::array<Sent, kSentSize>>();
  ForceLog log(arguments.log);

  DeviceOptions options;
  options.domain = arguments.session.domain;
  options.session = arguments.session.session;
  options.tool = arguments.tool;
  options.timeout = timeout;
  options.on_force = [&](const Force& force) {
    const Sent& hand = (*sent)[force.hand_sequence % kSentSize];
    if (hand.sequence.load(std::memory_order_acquire) != force.hand_sequence) return;
    const double time_s = hand.time_s.load(std::memory_order_relaxed);
    log.push({time_s, hand_at(*track, arguments.loop ? loop_time(*track, time_s) : time_s), force});
  };
  Device device(options);

  if (!arguments.quiet) {
    std::printf("scene %s, tool %s: playing %s, %.2f s at %g Hz\n", device.scene().c_str(),
                arguments.tool.c_str(), arguments.surgeon.c_str(), track->end_s(),
                arguments.rate_hz);
  }
  EventBook book(!arguments.quiet);
  ViewerCallbacks callbacks;
  callbacks.on_event = [&](const Event& event) { book.add(event); };
  callbacks.on_status = [&](const Status& status) { book.add(status); };
  SessionOptions session;
  session.domain = arguments.session.domain;
  session.session = arguments.session.session;
  session.timeout = timeout;
  Viewer viewer(session, callbacks);

  const double end_s = track->end_s();
  std::uint64_t sequence = 0;
  double time_s = 0.0;
  // Printing is not for the thread that keeps the beat: a terminal may be slow.
  std::mutex shown_mutex;
  Force shown;
  double shown_time_s = 0.0;
  std::atomic<bool> playing{true};
  std::thread printer([&] {
    while (playing && !arguments.quiet) {
      {
        const std::lock_guard lock(shown_mutex);
        print_force(shown_time_s, end_s, shown, device.max_force_n());
      }
      std::this_thread::sleep_for(std::chrono::duration<double>(kPrintPeriodS));
    }
  });
  struct Join {
    std::atomic<bool>& playing;
    std::thread& printer;
    ~Join() {
      playing = false;
      if (printer.joinable()) printer.join();
    }
  };
  {
    const Join join{playing, printer};
    device.run(
        [&](const Force& force, std::chrono::nanoseconds elapsed) -> std::optional<Hand> {
          time_s += std::chrono::duration<double>(elapsed).count();
          if (interrupted || (!arguments.loop && time_s > end_s)) return std::nullopt;
          if (shown_mutex.try_lock()) {
            shown = force;
            shown_time_s = time_s;
            shown_mutex.unlock();
          }
          Sent& next = (*sent)[++sequence % kSentSize];
          next.time_s.store(time_s, std::memory_order_relaxed);
          next.sequence.store(sequence, std::memory_order_release);
          return hand_at(*track, arguments.loop ? loop_time(*track, time_s) : time_s);
        },
        arguments.rate_hz);
  }
  // The answer to the last hand is on its way, and the status that tells of it.
  static_cast<void>(device.read_after(sequence, std::chrono::milliseconds(100)));
  const DeviceStatistics counts = device.statistics();
  viewer.close();
  log.finish();

  const std::vector<EventBook::Entry> entries = book.entries();
  const Status status = book.status();
  std::vector<PlotMark> marks;
  nlohmann::json punctures = nlohmann::json::array();
  for (const EventBook::Entry& entry : entries) {
    const Event& event = entry.event;
    if (event.kind != "puncture" && event.kind != "exit") continue;
    marks.push_back({entry.time_s, event.kind + " " + event.object});
    punctures.push_back({{"time_s", entry.time_s},
                         {"kind", event.kind},
                         {"subject", event.subject},
                         {"object", event.object},
                         {"force_n", event.value}});
  }
  const auto us = [](std::int64_t ns) { return 1e-3 * static_cast<double>(ns); };
  const double answered_pct = counts.hands_written > 0
                                  ? 100.0 * static_cast<double>(counts.forces_received) /
                                        static_cast<double>(counts.hands_written)
                                  : 0.0;
  if (!arguments.quiet && on_terminal()) std::printf("\r\x1b[K");
  std::printf("summary\n");
  std::printf("  poses sent            %llu in %.2f s\n",
              static_cast<unsigned long long>(counts.hands_written), time_s);
  std::printf("  forces received       %llu (%.2f %%), %llu unanswered, %llu out of order\n",
              static_cast<unsigned long long>(counts.forces_received), answered_pct,
              static_cast<unsigned long long>(counts.hands_unanswered),
              static_cast<unsigned long long>(counts.out_of_order));
  std::printf("  peak force            %.4f N (limit %.2f N)\n", counts.peak_force_n,
              device.max_force_n());
  std::printf("  round trip            p50 %.0f µs, p99 %.0f µs, max %.0f µs\n",
              us(counts.round_trip_p50_ns), us(counts.round_trip_p99_ns),
              us(counts.round_trip_max_ns));
  std::printf("  simulation step       p50 %.2f ms, p99 %.2f ms, max %.2f ms; %llu overruns\n",
              1e-3 * status.step.p50_us, 1e-3 * status.step.p99_us, 1e-3 * status.step.max_us,
              static_cast<unsigned long long>(status.overruns));
  for (const auto& puncture : punctures) {
    std::printf("  %-21s %.3f s, %.4f N, %s · %s\n", puncture["kind"].get<std::string>().c_str(),
                puncture["time_s"].get<double>(), puncture["force_n"].get<double>(),
                puncture["subject"].get<std::string>().c_str(),
                puncture["object"].get<std::string>().c_str());
  }
  if (log.dropped() > 0) {
    std::printf("  log                   %llu forces did not fit and are missing\n",
                static_cast<unsigned long long>(log.dropped()));
  }
  if (!arguments.plot.empty()) {
    write_text(arguments.plot, force_plot_svg(log.trace(), marks,
                                              "Force on the tool \"" + arguments.tool + "\" (" +
                                                  device.scene() + ")"));
    std::printf("  plot                  %s\n", arguments.plot.c_str());
  }
  if (!arguments.summary.empty()) {
    const nlohmann::json summary = {{"tool", arguments.tool},
                                    {"scene", device.scene()},
                                    {"duration_s", time_s},
                                    {"poses_sent", counts.hands_written},
                                    {"forces_received", counts.forces_received},
                                    {"answered_pct", answered_pct},
                                    {"unanswered", counts.hands_unanswered},
                                    {"repeated", counts.repeated},
                                    {"out_of_order", counts.out_of_order},
                                    {"peak_force_n", counts.peak_force_n},
                                    {"max_force_n", device.max_force_n()},
                                    {"round_trip_us",
                                     {{"p50", us(counts.round_trip_p50_ns)},
                                      {"p99", us(counts.round_trip_p99_ns)},
                                      {"max", us(counts.round_trip_max_ns)}}},
                                    {"step_ms",
                                     {{"p50", 1e-3 * status.step.p50_us},
                                      {"p99", 1e-3 * status.step.p99_us},
                                      {"max", 1e-3 * status.step.max_us}}},
                                    {"overruns", status.overruns},
                                    {"punctures", punctures},
                                    {"events", entries.size()},
                                    {"interrupted", interrupted.load()}};
    write_text(arguments.summary, summary.dump(2) + "\n");
    std::printf("  summary               %s\n", arguments.summary.c_str());
  }
  return interrupted ? kInterrupted : kDone;
}

}  // namespace suture::cli
