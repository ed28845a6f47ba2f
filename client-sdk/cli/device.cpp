// SPDX-License-Identifier: Apache-2.0
// `suture device`: plays a surgeon file at the rate of a haptic device, over the SDK that
// any device uses. Each tool of the file is a device of its own: thread, lease, forces.
#include "suture/device.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <exception>
#include <fstream>
#include <functional>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <thread>
#include <vector>

#include "commands.hpp"
#include "force_log.hpp"
#include "force_plot.hpp"
#include "protocol/surgeon.hpp"
#include "protocol/types.hpp"
#include "protocol/whole_file.hpp"
#include "suture/session.hpp"
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

/// From the first row to the last of all tools that are played.
struct Span {
  double begin_s = 0.0, end_s = 0.0;
};

/// Where in the file a looping play is: to the end and back, so that no hand ever jumps, and
/// the same for all tools, so that they stay in step.
double loop_time(const Span& span, double time_s) {
  const double length = span.end_s - span.begin_s;
  if (length <= 0.0) return span.begin_s;
  const double phase = std::fmod(time_s, 2.0 * length);
  return span.begin_s + (phase <= length ? phase : 2.0 * length - phase);
}

/// What happened to the tools, their needle and their tissue, as the server told it.
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

/// A tool's force at one time, for the eye.
struct ShownForce {
  double time_s = 0.0;
  Force force;
};

void print_one_force(const ShownForce& shown, double end_s, double limit_n) {
  const Force& force = shown.force;
  constexpr int kBar = 20;
  const double magnitude = length_of(force.force_n);
  const int filled =
      limit_n > 0.0 ? std::clamp(static_cast<int>(std::lround(magnitude / limit_n * kBar)), 0, kBar)
                    : 0;
  char bar[kBar + 1];
  for (int i = 0; i < kBar; ++i) bar[i] = i < filled ? '#' : '.';
  bar[kBar] = '\0';
  std::printf("%s%7.2f / %.2f s  %7.4f N  [%s]  (%+.4f %+.4f %+.4f) N  %s%s%s%s",
              on_terminal() ? "\r\x1b[K" : "", shown.time_s, end_s, magnitude, bar,
              force.force_n[0], force.force_n[1], force.force_n[2], name_of(force.state),
              force.holding ? ", holding" : "", force.faults != 0 ? "  " : "",
              fault_names(force.faults).c_str());
  if (!on_terminal()) std::printf("\n");
  std::fflush(stdout);
}

void print_forces(std::span<const std::string> tools, std::span<const ShownForce> shown,
                  double end_s) {
  double time_s = 0.0;
  for (const ShownForce& one : shown) time_s = std::max(time_s, one.time_s);
  std::printf("%s%7.2f / %.2f s", on_terminal() ? "\r\x1b[K" : "", time_s, end_s);
  for (std::size_t i = 0; i < tools.size(); ++i) {
    const Force& force = shown[i].force;
    std::printf("%s%s %.4f N %s%s%s%s", i == 0 ? "  " : " · ", tools[i].c_str(),
                length_of(force.force_n), name_of(force.state), force.holding ? ", holding" : "",
                force.faults != 0 ? " " : "", fault_names(force.faults).c_str());
  }
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

/// Prints the present forces a few times a second, on a thread of its own: a terminal may
/// be slow, and the threads that keep the beat must not wait for it.
class ForcePrinter {
 public:
  ForcePrinter(std::span<const std::string> tools, double end_s, double limit_n)
      : tools_(tools), end_s_(end_s), limit_n_(limit_n), shown_(tools.size()) {
    worker_ = std::thread([this] {
      std::unique_lock lock(mutex_);
      while (!changed_.wait_for(lock, kPeriod, [this] { return done_; })) {
        if (tools_.size() == 1) {
          print_one_force(shown_[0], end_s_, limit_n_);
        } else {
          print_forces(tools_, shown_, end_s_);
        }
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

  /// Leaves what to print next of a tool, unless something is being printed just now.
  void show(std::size_t tool, double time_s, const Force& force) noexcept {
    const std::unique_lock lock(mutex_, std::try_to_lock);
    if (!lock) return;
    shown_[tool] = {time_s, force};
  }

 private:
  static constexpr std::chrono::milliseconds kPeriod{200};
  const std::span<const std::string> tools_;
  const double end_s_, limit_n_;  // the limit of the only tool
  std::mutex mutex_;
  std::condition_variable changed_;
  bool done_ = false;
  std::vector<ShownForce> shown_;
  std::thread worker_;
};

/// What one tool's play came to.
struct ToolOutcome {
  std::string tool;
  double duration_s = 0.0;
  DeviceStatistics counts;
  double max_force_n = 0.0;

  [[nodiscard]] double answered_pct() const {
    return counts.hands_written == 0 ? 0.0
                                     : 100.0 * static_cast<double>(counts.forces_received) /
                                           static_cast<double>(counts.hands_written);
  }
};

/// What a play came to.
struct Outcome {
  std::vector<ToolOutcome> tools;
  double duration_s = 0.0;  ///< of the longest
  EventBook::Steps steps;
  std::vector<EventBook::Entry> events;
  std::uint64_t log_dropped = 0;
  std::string scene;
};

bool passes_a_surface(const EventBook::Entry& entry) {
  return entry.event.kind == "puncture" || entry.event.kind == "exit";
}

double us(std::int64_t ns) { return 1e-3 * static_cast<double>(ns); }

/// What the tools of a play share: one clock, which starts when the server has answered each
/// of them, and one end, because a hand-over makes no sense with a hand missing. Nobody waits:
/// a tool that is ready early holds its first pose.
class Together {
 public:
  Together(std::size_t tools, EventBook& book) : book_(book), awaited_(tools) {}

  /// Says that one tool is ready; call once a tool. The last one starts the clock.
  void arrive() noexcept {
    if (awaited_.fetch_sub(1, std::memory_order_acq_rel) != 1) return;
    book_.begin_play();  // events count from the first hand that moves
    start_ns_.store(monotonic_ns(), std::memory_order_release);
  }
  /// The time on the surgeon's clock; nothing before the start.
  [[nodiscard]] std::optional<double> time_s() const noexcept {
    const std::int64_t start_ns = start_ns_.load(std::memory_order_acquire);
    if (start_ns == 0) return std::nullopt;
    return 1e-9 * static_cast<double>(monotonic_ns() - start_ns);
  }

  /// Ends the play of all tools because of one; the first cause is kept.
  void fail(const std::string& tool, std::exception_ptr cause) noexcept {
    const std::lock_guard lock(mutex_);
    if (!cause_) {
      cause_ = std::move(cause);
      culprit_ = tool;
    }
    over_ = true;
  }
  [[nodiscard]] bool over() const noexcept { return over_ || interrupted; }
  /// Throws what a tool ended by; `several`: with its name.
  void rethrow(bool several) {
    const std::lock_guard lock(mutex_);
    if (!cause_) return;
    try {
      std::rethrow_exception(cause_);
    } catch (const Error& error) {
      const bool named = error.cause().find('"' + culprit_ + '"') != std::string::npos;
      if (named || !several) throw;
      throw Error(error.code(), "tool \"" + culprit_ + "\": " + error.cause(), error.mend());
    }
  }

 private:
  EventBook& book_;
  std::atomic<std::size_t> awaited_;
  std::atomic<std::int64_t> start_ns_{0};  // monotonic
  std::atomic<bool> over_{false};
  std::mutex mutex_;
  std::exception_ptr cause_;
  std::string culprit_;
};

/// One tool of a play: a device on a thread of its own.
class Player {
 public:
  /// Connects. Throws what Device throws.
  Player(const DeviceArguments& arguments, const SessionOptions& session, const SurgeonTrack& track,
         Span span, std::size_t index, ForceLog& log)
      : track_(track),
        span_(span),
        index_(index),
        rate_hz_(arguments.rate_hz),
        loops_(arguments.loop),
        renders_itself_(arguments.render == "device"),
        log_(log) {
    DeviceOptions options;
    options.domain = session.domain;
    options.session = session.session;
    options.security = session.security;
    options.network = session.network;
    options.timeout = session.timeout;
    options.tool = track.tool;
    options.render = renders_itself_ ? Render::kDevice : Render::kServer;
    options.model = "suture device";
    options.limits = {.max_force_n = arguments.max_force_n,
                      .max_force_slew_n_per_s = arguments.max_slew_n_per_s,
                      .max_stiffness_n_per_m = arguments.max_stiffness_n_per_m,
                      .max_damping_n_s_per_m = arguments.max_damping_n_s_per_m};
    device_.emplace(std::move(options));
    outcome_.tool = track.tool;
    outcome_.max_force_n = device_->max_force_n();
  }
  ~Player() {
    if (thread_.joinable()) thread_.join();
  }
  Player(const Player&) = delete;
  Player& operator=(const Player&) = delete;

  [[nodiscard]] const std::string& scene() const { return device_->scene(); }
  [[nodiscard]] double max_force_n() const { return outcome_.max_force_n; }

  /// Plays on a thread of its own, with `tools` in all; both others outlive it.
  /// `at_end`: called when its own play is over, while it still has its tool; may be empty.
  void start(Together& together, ForcePrinter* printer, std::size_t tools,
             std::function<void()> at_end) {
    thread_ = std::thread([this, &together, printer, tools, at_end = std::move(at_end)] {
      try {
        play(together, printer, tools);
        if (!together.over()) expect_server();
        if (at_end) at_end();
      } catch (...) {
        together.fail(track_.tool, std::current_exception());
      }
      finish();
    });
  }
  const ToolOutcome& wait() {
    thread_.join();
    return outcome_;
  }

 private:
  [[nodiscard]] Hand hand_then(double time_s) const {
    return hand_at(track_, loops_ ? loop_time(span_, time_s) : time_s);
  }

  void play(Together& together, ForcePrinter* printer, std::size_t tools) {
    bool arrived = false;
    const Device::Tick tick = [&](const Force& force,
                                  std::chrono::nanoseconds) -> std::optional<Hand> {
      // Alone there is nobody to wait for.
      if (!arrived && (tools == 1 || force.hand_sequence > 0)) {
        arrived = true;
        together.arrive();
      }
      const double time_s = together.time_s().value_or(0.0);
      outcome_.duration_s = time_s;
      if (together.over() || (!loops_ && time_s > track_.end_s())) return std::nullopt;
      if (printer != nullptr) printer->show(index_, time_s, force);
      log(time_s, force);
      sent_.note(++sequence_, time_s);
      return hand_then(time_s);
    };
    device_->run(tick, rate_hz_);
  }

  /// What the hand is given at this tick, with the pose that it is given for.
  void log(double time_s, const Force& force) {
    if (force.hand_sequence == 0) return;  // nothing has been answered yet
    const std::uint64_t felt_for = renders_itself_ ? sequence_ : force.hand_sequence;
    log_.push(index_, {time_s, hand_then(sent_.time_of(felt_for).value_or(time_s)), force});
    felt_peak_n_ = std::max(felt_peak_n_, length_of(force.force_n));
  }

  /// Throws Error kNoServer where no force comes any more: the play has ended before the device
  /// would have given up.
  void expect_server() {
    constexpr std::chrono::milliseconds kPatience(1000);
    if (device_->read_after(sequence_, kPatience)) return;
    // The last answer may be lost, but the server sends for a device that is silent.
    if (device_->read().state != ForceState::kServerSilent) return;
    throw Error(ErrorCode::kNoServer, "the server fell silent before the play was over",
                "see whether it still runs (`suture top`)");
  }

  void finish() {
    outcome_.counts = device_->statistics();
    outcome_.counts.peak_force_n = felt_peak_n_;
    device_.reset();
  }

  const SurgeonTrack& track_;
  const Span span_;
  const std::size_t index_;
  const double rate_hz_;
  const bool loops_, renders_itself_;
  ForceLog& log_;
  SentHands sent_;
  std::uint64_t sequence_ = 0;
  double felt_peak_n_ = 0.0;
  ToolOutcome outcome_;
  std::optional<Device> device_;  // after what its callback uses
  std::thread thread_;
};

Outcome play(const DeviceArguments& arguments, std::span<const SurgeonTrack* const> tracks,
             std::span<const std::string> tools, ForceLog& log) {
  SessionOptions session;
  session.domain = arguments.session.domain;
  session.session = arguments.session.session;
  session.security = arguments.session.security;
  session.network = arguments.session.network;
  session.timeout =
      std::chrono::milliseconds(static_cast<std::int64_t>(arguments.session.timeout_s * 1000.0));
  Span span{tracks[0]->begin_s(), tracks[0]->end_s()};
  for (const SurgeonTrack* track : tracks) {
    span.begin_s = std::min(span.begin_s, track->begin_s());
    span.end_s = std::max(span.end_s, track->end_s());
  }
  std::vector<std::unique_ptr<Player>> players;
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    players.push_back(std::make_unique<Player>(arguments, session, *tracks[i], span, i, log));
  }

  Outcome outcome;
  outcome.scene = players[0]->scene();
  log.begin();
  if (!arguments.quiet) {
    std::string names;
    for (const std::string& tool : tools) names += (names.empty() ? "" : ", ") + tool;
    std::printf("scene %s, %s %s: playing %s, %.2f s at %g Hz\n", outcome.scene.c_str(),
                tools.size() == 1 ? "tool" : "tools", names.c_str(), arguments.surgeon.c_str(),
                span.end_s, arguments.rate_hz);
  }
  EventBook book(!arguments.quiet);
  ViewerCallbacks callbacks;
  callbacks.on_event = [&](const Event& event) { book.add(event); };
  callbacks.on_status = [&](const Status& status) { book.add(status); };
  Viewer viewer(session, callbacks);

  std::optional<Session> commands;
  if (arguments.pause_at_end) commands.emplace(session);
  Together together(players.size(), book);
  {
    std::optional<ForcePrinter> printer;
    if (!arguments.quiet) printer.emplace(tools, span.end_s, players[0]->max_force_n());
    std::size_t last = 0;
    for (std::size_t i = 0; i < tracks.size(); ++i)
      if (tracks[i]->end_s() > tracks[last]->end_s()) last = i;
    for (std::size_t i = 0; i < players.size(); ++i) {
      std::function<void()> at_end;
      if (commands && i == last) at_end = [&commands] { commands->command(CommandKind::kPause); };
      players[i]->start(together, printer ? &*printer : nullptr, players.size(), std::move(at_end));
    }
    for (const auto& player : players) {
      outcome.tools.push_back(player->wait());
      outcome.duration_s = std::max(outcome.duration_s, outcome.tools.back().duration_s);
    }
  }
  together.rethrow(players.size() > 1);
  // The next status tells of the end.
  book.await_status_after(wall_clock_ns(), std::chrono::milliseconds(1200));
  viewer.close();
  log.finish();
  outcome.steps = book.steps();
  outcome.events = book.entries();
  outcome.log_dropped = log.dropped();
  return outcome;
}

void print_tool(const ToolOutcome& outcome, bool named) {
  const DeviceStatistics& counts = outcome.counts;
  const auto number = [](std::uint64_t value) { return static_cast<unsigned long long>(value); };
  if (named) std::printf("  %s\n", outcome.tool.c_str());
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
}

void print_summary(const Outcome& outcome) {
  const auto number = [](std::uint64_t value) { return static_cast<unsigned long long>(value); };
  std::printf("%ssummary\n", on_terminal() ? "\r\x1b[K" : "");
  for (const ToolOutcome& tool : outcome.tools) print_tool(tool, outcome.tools.size() > 1);
  if (outcome.tools.size() > 1) std::printf("  all\n");
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

std::string summary_json(const Outcome& outcome) {
  nlohmann::json punctures = nlohmann::json::array();
  for (const EventBook::Entry& entry : outcome.events) {
    if (!passes_a_surface(entry)) continue;
    punctures.push_back({{"time_s", entry.time_s},
                         {"kind", entry.event.kind},
                         {"subject", entry.event.subject},
                         {"object", entry.event.object},
                         {"force_n", entry.event.value}});
  }
  nlohmann::json tools = nlohmann::json::object();
  for (const ToolOutcome& tool : outcome.tools) {
    const DeviceStatistics& counts = tool.counts;
    tools[tool.tool] = {{"duration_s", tool.duration_s},
                        {"poses_sent", counts.hands_written},
                        {"forces_received", counts.forces_received},
                        {"answered_pct", tool.answered_pct()},
                        {"unanswered", counts.hands_unanswered},
                        {"repeated", counts.repeated},
                        {"out_of_order", counts.out_of_order},
                        {"peak_force_n", counts.peak_force_n},
                        {"max_force_n", tool.max_force_n},
                        {"round_trip_us",
                         {{"p50", us(counts.round_trip_p50_ns)},
                          {"p99", us(counts.round_trip_p99_ns)},
                          {"max", us(counts.round_trip_max_ns)}}}};
  }
  const nlohmann::json summary = {{"scene", outcome.scene},
                                  {"duration_s", outcome.duration_s},
                                  {"tools", tools},
                                  {"step_ms",
                                   {{"p50", outcome.steps.p50_ms},
                                    {"p99_worst_period", outcome.steps.worst_p99_ms},
                                    {"max", outcome.steps.max_ms}}},
                                  {"overruns", outcome.steps.overruns},
                                  {"punctures", punctures},
                                  {"events", outcome.events.size()},
                                  {"interrupted", interrupted.load()}};
  // The scene's names are what a server sent: what is not UTF-8 is replaced, not thrown at.
  return summary.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

/// The tracks of the tools asked for, or of all tools of the file.
std::vector<const SurgeonTrack*> choose_tracks(const Surgeon& surgeon,
                                               const DeviceArguments& arguments) {
  std::vector<const SurgeonTrack*> tracks;
  for (const std::string& tool : arguments.tools) {
    const SurgeonTrack* track = surgeon.track(tool);
    if (track == nullptr) {
      std::string known;
      for (const SurgeonTrack& other : surgeon.tracks) {
        known += (known.empty() ? "" : ", ") + other.tool;
      }
      throw Error(ErrorCode::kBadInput,
                  arguments.surgeon + ": has no rows of the tool \"" + tool + "\"",
                  "it has rows of " + known);
    }
    if (std::find(tracks.begin(), tracks.end(), track) != tracks.end()) {
      throw Error(ErrorCode::kBadInput, "--tool " + tool + " stands there twice",
                  "one device holds a tool: name each once");
    }
    tracks.push_back(track);
  }
  if (tracks.empty()) {
    for (const SurgeonTrack& track : surgeon.tracks) tracks.push_back(&track);
  }
  return tracks;
}

/// Refuses outputs that would be written over the surgeon or over each other.
void expect_own_files(const DeviceArguments& arguments) {
  const std::array<std::pair<const char*, const std::string*>, 4> files{
      {{"the surgeon's", &arguments.surgeon},
       {"--log", &arguments.log},
       {"--plot", &arguments.plot},
       {"--summary", &arguments.summary}}};
  for (std::size_t i = 0; i < files.size(); ++i)
    for (std::size_t k = i + 1; k < files.size(); ++k)
      if (same_file(*files[i].second, *files[k].second))
        throw Error(
            ErrorCode::kBadInput,
            *files[k].second + ": " + files[k].first + " is " + files[i].first + " file too",
            std::string("give ") + files[k].first + " a file of its own");
}

}  // namespace

int run_device(const DeviceArguments& arguments) {
  const Surgeon surgeon = read_surgeon(arguments.surgeon);
  const std::vector<const SurgeonTrack*> tracks = choose_tracks(surgeon, arguments);
  std::vector<std::string> tools;
  tools.reserve(tracks.size());
  for (const SurgeonTrack* track : tracks) tools.push_back(track->tool);
  expect_own_files(arguments);
  ForceLog log(arguments.log, tools);
  const Outcome outcome = play(arguments, tracks, tools, log);
  print_summary(outcome);
  if (!arguments.plot.empty()) {
    std::vector<PlotMark> marks;
    for (const EventBook::Entry& entry : outcome.events) {
      if (passes_a_surface(entry)) {
        marks.push_back({entry.time_s, entry.event.kind + " " + entry.event.object});
      }
    }
    std::vector<PlotCurve> curves;
    for (std::size_t i = 0; i < tools.size(); ++i) curves.push_back({tools[i], &log.trace(i)});
    const std::string title =
        tools.size() == 1
            ? "Force on the tool \"" + tools[0] + "\" (" + outcome.scene + ")"
            : "Force on " + std::to_string(tools.size()) + " tools (" + outcome.scene + ")";
    write_text(arguments.plot, force_plot_svg(curves, marks, title));
    std::printf("  plot                  %s\n", arguments.plot.c_str());
  }
  if (!arguments.summary.empty()) {
    write_text(arguments.summary, summary_json(outcome));
    std::printf("  summary               %s\n", arguments.summary.c_str());
  }
  return interrupted ? kInterrupted : kDone;
}

}  // namespace suture::cli
