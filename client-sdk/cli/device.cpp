// SPDX-License-Identifier: Apache-2.0
// `suture device`: plays a surgeon file at the rate of a haptic device, over the SDK that
// any device uses.
#include "suture/device.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "commands.hpp"
#include "force_log.hpp"
#include "force_plot.hpp"
#include "protocol/surgeon.hpp"
#include "protocol/types.hpp"
#include "suture/viewer.hpp"

namespace suture::cli {
namespace {

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

  /// Sets the zero of the surgeon's clock: now.
  void begin_play() { start_ns_ = wall_clock_ns(); }

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
    if (!begun_) overruns_before_ = status.overruns;
    begun_ = true;
    // Percentiles of periods do not add up to percentiles of the whole; the median period
    // and the worst one bound what a hand has met.
    if (status.step.count > 0) {
      step_p50_us_.push_back(status.step.p50_us);
      step_p99_us_ = std::max(step_p99_us_, status.step.p99_us);
      step_max_us_ = std::max(step_max_us_, status.step.max_us);
    }
    overruns_ = status.overruns - overruns_before_;
    last_stamp_ns_ = status.stamp_ns;
    changed_.notify_all();
  }
  /// Waits for a status that was written after `stamp_ns`, which tells of all before it.
  void await_status_after(std::int64_t stamp_ns, std::chrono::milliseconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [&] { return last_stamp_ns_ > stamp_ns; });
  }
  [[nodiscard]] std::vector<Entry> entries() {
    const std::lock_guard lock(mutex_);
    return entries_;
  }
  struct Steps {
    double p50_ms = 0.0, worst_p99_ms = 0.0, max_ms = 0.0;
    std::uint64_t overruns = 0;
  };
  [[nodiscard]] Steps steps() {
    const std::lock_guard lock(mutex_);
    Steps steps{0.0, 1e-3 * step_p99_us_, 1e-3 * step_max_us_, overruns_};
    if (!step_p50_us_.empty()) {
      const auto middle =
          step_p50_us_.begin() + static_cast<std::ptrdiff_t>(step_p50_us_.size() / 2);
      std::nth_element(step_p50_us_.begin(), middle, step_p50_us_.end());
      steps.p50_ms = 1e-3 * *middle;
    }
    return steps;
  }

 private:
  static constexpr std::size_t kMost = 10'000;
  bool print_;
  std::atomic<std::int64_t> start_ns_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<Entry> entries_;
  std::vector<double> step_p50_us_;
  double step_p99_us_ = 0.0, step_max_us_ = 0.0;
  std::uint64_t overruns_before_ = 0, overruns_ = 0;
  std::int64_t last_stamp_ns_ = 0;
  bool begun_ = false;
};

void print_force(double time_s, double end_s, const Force& force, double limit_n) {
  constexpr int kBar = 20;
  const double magnitude = length_of(force.force_n);
  const int filled =
      limit_n > 0.0 ? std::clamp(static_cast<int>(std::lround(magnitude / limit_n * kBar)), 0, kBar)
                    : 0;
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

/// The hands sent lately with their times: what the receive thread needs to say to which
/// pose a force belongs. One thread notes, another looks up; neither waits.
class SentHands {
 public:
  void note(std::uint64_t sequence, double time_s) noexcept {
    Entry& entry = entries_[sequence % kSize];
    entry.time_s.store(time_s, std::memory_order_relaxed);
    entry.sequence.store(sequence, std::memory_order_release);
  }
  [[nodiscard]] std::optional<double> time_of(std::uint64_t sequence) const noexcept {
    const Entry& entry = entries_[sequence % kSize];
    if (entry.sequence.load(std::memory_order_acquire) != sequence) return std::nullopt;
    return entry.time_s.load(std::memory_order_relaxed);
  }

 private:
  static constexpr std::size_t kSize = 65536;  // a minute at 1 kHz
  struct Entry {
    std::atomic<std::uint64_t> sequence{0};
    std::atomic<double> time_s{0.0};
  };
  std::array<Entry, kSize> entries_;
};

/// Prints the present force a few times a second, on a thread of its own: a terminal may
/// be slow, and the thread that keeps the beat must not wait for it.
class ForcePrinter {
 public:
  ForcePrinter(double end_s, double limit_n) : end_s_(end_s), limit_n_(limit_n) {
    worker_ = std::thread([this] {
      std::unique_lock lock(mutex_);
      while (!changed_.wait_for(lock, kPeriod, [this] { return done_; })) {
        print_force(time_s_, end_s_, force_, limit_n_);
      }
    });
  }
  ~ForcePrinter() {
    {
      const std::lock_guard lock(mutex_);
      done_ = true;
    }
    changed_.notify_all();
    worker_.join();
  }
  ForcePrinter(const ForcePrinter&) = delete;
  ForcePrinter& operator=(const ForcePrinter&) = delete;

  /// Leaves what to print next, unless it is being printed just now.
  void show(double time_s, const Force& force) noexcept {
    const std::unique_lock lock(mutex_, std::try_to_lock);
    if (!lock) return;
    time_s_ = time_s;
    force_ = force;
  }

 private:
  static constexpr std::chrono::milliseconds kPeriod{200};
  const double end_s_, limit_n_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool done_ = false;
  double time_s_ = 0.0;
  Force force_;
  std::thread worker_;
};

/// What a play came to.
struct Outcome {
  double duration_s = 0.0;
  DeviceStatistics counts;
  EventBook::Steps steps;
  std::vector<EventBook::Entry> events;
  std::uint64_t log_dropped = 0;
  double max_force_n = 0.0;
  double rendered_peak_n = 0.0;  ///< of what the device rendered itself
  std::string scene;

  [[nodiscard]] double answered_pct() const {
    return counts.hands_written == 0 ? 0.0
                                     : 100.0 * static_cast<double>(counts.forces_received) /
                                           static_cast<double>(counts.hands_written);
  }
};

bool passes_a_surface(const EventBook::Entry& entry) {
  return entry.event.kind == "puncture" || entry.event.kind == "exit";
}

double us(std::int64_t ns) { return 1e-3 * static_cast<double>(ns); }

Outcome play(const DeviceArguments& arguments, const SurgeonTrack& track, ForceLog& log) {
  SessionOptions session;
  session.domain = arguments.session.domain;
  session.session = arguments.session.session;
  session.timeout =
      std::chrono::milliseconds(static_cast<std::int64_t>(arguments.session.timeout_s * 1000.0));
  const auto hand_then = [&](double time_s) {
    return hand_at(track, arguments.loop ? loop_time(track, time_s) : time_s);
  };

  const auto sent = std::make_unique<SentHands>();
  DeviceOptions options;
  options.domain = session.domain;
  options.session = session.session;
  options.timeout = session.timeout;
  options.tool = arguments.tool;
  const bool renders_itself = arguments.render == "device";
  options.render = renders_itself ? Render::kDevice : Render::kServer;
  options.on_force = [&](const Force& force) {
    if (renders_itself) return;  // logged where it is rendered
    if (const std::optional<double> time_s = sent->time_of(force.hand_sequence)) {
      log.push({*time_s, hand_then(*time_s), force});
    }
  };
  std::optional<Device> held(std::in_place, options);
  Device& device = *held;
  if (!arguments.quiet) {
    std::printf("scene %s, tool %s: playing %s, %.2f s at %g Hz\n", device.scene().c_str(),
                arguments.tool.c_str(), arguments.surgeon.c_str(), track.end_s(),
                arguments.rate_hz);
  }
  EventBook book(!arguments.quiet);
  ViewerCallbacks callbacks;
  callbacks.on_event = [&](const Event& event) { book.add(event); };
  callbacks.on_status = [&](const Status& status) { book.add(status); };
  Viewer viewer(session, callbacks);

  Outcome outcome;
  outcome.max_force_n = device.max_force_n();
  outcome.scene = device.scene();
  std::uint64_t sequence = 0;
  {
    std::optional<ForcePrinter> printer;
    if (!arguments.quiet) printer.emplace(track.end_s(), device.max_force_n());
    double time_s = 0.0;
    double rendered_peak_n = 0.0;
    const Device::Tick tick = [&](const Force& force,
                                  std::chrono::nanoseconds elapsed) -> std::optional<Hand> {
      time_s += std::chrono::duration<double>(elapsed).count();
      if (interrupted || (!arguments.loop && time_s > track.end_s())) return std::nullopt;
      if (printer) printer->show(time_s, force);
      if (renders_itself && sequence > 0) {
        const double felt_s = sent->time_of(sequence).value_or(time_s);
        log.push({felt_s, hand_then(felt_s), force});
        rendered_peak_n = std::max(rendered_peak_n, length_of(force.force_n));
      }
      if (sequence == 0) book.begin_play();  // events count from the first hand
      sent->note(++sequence, time_s);
      return hand_then(time_s);
    };
    device.run(tick, arguments.rate_hz);
    outcome.duration_s = time_s;
    outcome.rendered_peak_n = rendered_peak_n;
  }
  // The answer to the last hand is on its way; then the tool goes back, and the next status
  // tells of the end.
  static_cast<void>(device.read_after(sequence, std::chrono::milliseconds(100)));
  outcome.counts = device.statistics();
  if (renders_itself) outcome.counts.peak_force_n = outcome.rendered_peak_n;
  held.reset();
  book.await_status_after(wall_clock_ns(), std::chrono::milliseconds(1200));
  viewer.close();
  log.finish();
  outcome.steps = book.steps();
  outcome.events = book.entries();
  outcome.log_dropped = log.dropped();
  return outcome;
}

void print_summary(const Outcome& outcome) {
  const DeviceStatistics& counts = outcome.counts;
  const auto number = [](std::uint64_t value) { return static_cast<unsigned long long>(value); };
  std::printf("%ssummary\n", on_terminal() ? "\r\x1b[K" : "");
  std::printf("  poses sent            %llu in %.2f s\n", number(counts.hands_written),
              outcome.duration_s);
  std::printf("  forces received       %llu (%.2f %%), %llu unanswered, %llu out of order\n",
              number(counts.forces_received), outcome.answered_pct(),
              number(counts.hands_unanswered), number(counts.out_of_order));
  std::printf("  peak force            %.4f N (limit %.2f N)\n", counts.peak_force_n,
              outcome.max_force_n);
  std::printf("  round trip            p50 %.0f µs, p99 %.0f µs, max %.0f µs\n",
              us(counts.round_trip_p50_ns), us(counts.round_trip_p99_ns),
              us(counts.round_trip_max_ns));
  std::printf(
      "  simulation step       p50 %.2f ms, p99 of the worst half second %.2f ms, max %.2f ms; "
      "%llu overruns\n",
      outcome.steps.p50_ms, outcome.steps.worst_p99_ms, outcome.steps.max_ms,
      number(outcome.steps.overruns));
  for (const EventBook::Entry& entry : outcome.events) {
    if (!passes_a_surface(entry)) continue;
    std::printf("  %-21s %.3f s, %.4f N, %s · %s\n", entry.event.kind.c_str(), entry.time_s,
                entry.event.value, entry.event.subject.c_str(), entry.event.object.c_str());
  }
  if (outcome.log_dropped > 0) {
    std::printf("  log                   %llu forces did not fit and are missing\n",
                number(outcome.log_dropped));
  }
}

std::string summary_json(const DeviceArguments& arguments, const Outcome& outcome) {
  const DeviceStatistics& counts = outcome.counts;
  nlohmann::json punctures = nlohmann::json::array();
  for (const EventBook::Entry& entry : outcome.events) {
    if (!passes_a_surface(entry)) continue;
    punctures.push_back({{"time_s", entry.time_s},
                         {"kind", entry.event.kind},
                         {"subject", entry.event.subject},
                         {"object", entry.event.object},
                         {"force_n", entry.event.value}});
  }
  const nlohmann::json summary = {{"tool", arguments.tool},
                                  {"scene", outcome.scene},
                                  {"duration_s", outcome.duration_s},
                                  {"poses_sent", counts.hands_written},
                                  {"forces_received", counts.forces_received},
                                  {"answered_pct", outcome.answered_pct()},
                                  {"unanswered", counts.hands_unanswered},
                                  {"repeated", counts.repeated},
                                  {"out_of_order", counts.out_of_order},
                                  {"peak_force_n", counts.peak_force_n},
                                  {"max_force_n", outcome.max_force_n},
                                  {"round_trip_us",
                                   {{"p50", us(counts.round_trip_p50_ns)},
                                    {"p99", us(counts.round_trip_p99_ns)},
                                    {"max", us(counts.round_trip_max_ns)}}},
                                  {"step_ms",
                                   {{"p50", outcome.steps.p50_ms},
                                    {"p99_worst_period", outcome.steps.worst_p99_ms},
                                    {"max", outcome.steps.max_ms}}},
                                  {"overruns", outcome.steps.overruns},
                                  {"punctures", punctures},
                                  {"events", outcome.events.size()},
                                  {"interrupted", interrupted.load()}};
  return summary.dump(2) + "\n";
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
  ForceLog log(arguments.log);
  const Outcome outcome = play(arguments, *track, log);
  print_summary(outcome);
  if (!arguments.plot.empty()) {
    std::vector<PlotMark> marks;
    for (const EventBook::Entry& entry : outcome.events) {
      if (passes_a_surface(entry)) {
        marks.push_back({entry.time_s, entry.event.kind + " " + entry.event.object});
      }
    }
    const std::string title =
        "Force on the tool \"" + arguments.tool + "\" (" + outcome.scene + ")";
    write_text(arguments.plot, force_plot_svg(log.trace(), marks, title));
    std::printf("  plot                  %s\n", arguments.plot.c_str());
  }
  if (!arguments.summary.empty()) {
    write_text(arguments.summary, summary_json(arguments, outcome));
    std::printf("  summary               %s\n", arguments.summary.c_str());
  }
  return interrupted ? kInterrupted : kDone;
}

}  // namespace suture::cli
