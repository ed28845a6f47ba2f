// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "haptics/bounded_queue.hpp"
#include "haptics/period_latency.hpp"
#include "haptics/tool_channel.hpp"
#include "protocol/snapshot.hpp"
#include "simulation/quality.hpp"
#include "simulation/simulation.hpp"

namespace sutured::haptics {

/// What viewers see of one step.
struct DisplayFrame {
  std::uint64_t epoch = 0;
  std::uint64_t step = 0;
  std::int64_t stamp_ns = 0;  ///< Unix epoch
  double time_s = 0.0;
  simulation::StepReport report;
  std::vector<std::vector<float>> position_m;    ///< per body, 3 per surface vertex, world
  std::vector<std::vector<float>> von_mises_pa;  ///< per body, 1 per surface vertex
  std::vector<std::vector<float>> principal_pa;  ///< per body, 3 per surface vertex, largest first
  std::vector<simulation::NeedleState> needles;  ///< as far as `display_copies.hpp` lets them
  std::vector<simulation::ThreadState> threads;  ///< likewise
  std::vector<simulation::ContactPoint> contacts;  ///< likewise
  std::vector<simulation::HeldThing> held;         ///< per tool
  std::vector<simulation::ThreadQuality> quality;  ///< per thread; empty without a meter
};

/// One tool's model, and what a device needs beside it to render it itself.
struct PublishedModel {
  suture::HapticModel model;
  double time_s = 0.0;
  std::uint64_t pose_sequence = 0;  ///< of the pose that the step took
  std::uint64_t writer = 0;         ///< who sent it
  bool engaged = false;
  Workspace mapping;
};

/// Something that happened, and in which world.
struct LoopEvent {
  std::uint64_t epoch = 0;
  std::uint64_t step = 0;
  simulation::Event event;
};

/// What becomes of a tool that has a place in a world which was put in: see
/// SimulationLoop::replace_state.
enum class Waiting : std::uint8_t {
  kAtPlace,      ///< it stays there
  kAway,         ///< it is out of the scene: its hand is still where it was in the world before
  kJoins,        ///< its hand has come, and leads it
  kJoinsAnew,    ///< its hand has come, from so far off that it lets go first
  kNobodyComes,  ///< it is out of the scene, and waits no longer
};
/// `waited_ns`: since the world was put in, pauses not counted.
[[nodiscard]] Waiting wait_for_hand(const ToolPlace& place, const ToolTarget& target,
                                    std::uint64_t epoch, std::int64_t waited_ns) noexcept;

/// Steps a simulation by the clock, on a thread of its own.
///
/// Each period it takes the tools' latest targets, steps, publishes every tool's model,
/// then, at the display rate, brings the displacements up to date and publishes a frame.
/// Forces never wait for what is shown. A step that takes longer than its period delays
/// the next one to the next beat of the clock; the missed beats are counted as overruns
/// and their time is simulated with the next step.
///
/// Threads: construction and `stop` the owner; `frame` and `events` one reader; the
/// others any.
class SimulationLoop {
 public:
  struct Options {
    double rate_hz = 250.0;
    double display_rate_hz = 60.0;
    /// Of the same simulation; none: nobody is judged. Gaps and bites are measured twice a second.
    std::optional<simulation::QualityMeter> quality;
    /// Called on the simulation's thread after each step's models are published: short.
    std::function<void()> models_published;
    /// Called on the simulation's thread after each step, and once more, with `last`, when the
    /// loop ends: for records. It may take the time between two steps.
    std::function<void(simulation::Simulation&, bool last)> watch;
    /// Called on the simulation's thread after each step, and at each beat while it stands still:
    /// for copies of the state. Must not wait.
    std::function<void(simulation::Simulation&, simulation::QualityMeter*, std::uint64_t epoch,
                       std::int64_t now_ns)>
        keep;
    /// The simulation comes with a past: its tools stay where they are until their hands come.
    bool resumed = false;
  };
  /// Puts another state into the simulation and its meter. Where it throws, the simulation must be
  /// as after a reset.
  using Replace = std::function<void(simulation::Simulation&, simulation::QualityMeter*)>;

  /// Starts stepping. `channels`: one per tool of the scene, in order; they outlive it.
  SimulationLoop(simulation::Simulation simulation, std::span<ToolChannel* const> channels,
                 Options options);
  ~SimulationLoop();
  SimulationLoop(const SimulationLoop&) = delete;
  SimulationLoop& operator=(const SimulationLoop&) = delete;

  /// Ends after the present step. Channels then find their models stale.
  void stop() noexcept;

  void pause(bool paused) noexcept;
  [[nodiscard]] bool paused() const noexcept { return paused_.load(std::memory_order_relaxed); }
  /// Goes back to the start before the next step; `epoch` changes when that is done. Returns
  /// whether a `replace` still waited, which it overtakes: that is then never called.
  bool reset();
  /// Calls `replace` before the next step, and begins an epoch: what is felt goes to zero and comes
  /// back by a ramp. A tool that the new state has somewhere stays there, with what it holds, until
  /// its device has engaged from there, for kStay_ns at most; then it leaves the scene until that.
  /// One that a device moves in the world itself, and that is then farther off than kJoin_m, lets
  /// go. The last one that was given before a step counts; a reset behind it takes it back.
  void replace_state(Replace replace);
  /// Returns why the last `replace` failed; empty where it did not. Holds from the new epoch on.
  [[nodiscard]] std::string replace_failure() const;
  static constexpr std::int64_t kStay_ns = 10'000'000'000;
  static constexpr double kJoin_m = 5e-3;

  [[nodiscard]] std::uint64_t epoch() const noexcept {
    return epoch_.load(std::memory_order_acquire);
  }

  /// Moves to the newest frame; null if there is none newer.
  const DisplayFrame* next_frame() noexcept {
    return frames_.update() ? &frames_.front() : nullptr;
  }
  /// The last step's model of `tool`, for publishing; null if there is none newer.
  const PublishedModel* next_model(std::size_t tool) noexcept;
  bool next_event(LoopEvent& event) noexcept { return events_.pop(event); }
  [[nodiscard]] std::uint64_t events_dropped() const noexcept { return events_.dropped(); }

  /// Returns how long steps took (without display) since the last call. One caller.
  LatencySummary take_step_times() noexcept { return step_times_.take(); }
  /// Nanoseconds spent in a stage of the step since start.
  static constexpr std::size_t kStages = 6;
  static constexpr std::array<std::string_view, kStages> kStageNames{
      "track", "contact", "assemble", "solve", "backward", "model"};
  [[nodiscard]] std::array<std::int64_t, kStages> stage_ns() const noexcept {
    std::array<std::int64_t, kStages> all{};
    for (std::size_t i = 0; i < kStages; ++i) all[i] = stage_ns_[i].load(std::memory_order_relaxed);
    return all;
  }
  [[nodiscard]] std::uint64_t steps() const noexcept {
    return steps_.load(std::memory_order_relaxed);
  }
  /// Returns how many beats of the clock were served: with a step, or standing still in a pause.
  [[nodiscard]] std::uint64_t beats() const noexcept {
    return beats_.load(std::memory_order_relaxed);
  }
  [[nodiscard]] std::uint64_t overruns() const noexcept {
    return overruns_.load(std::memory_order_relaxed);
  }
  /// Returns why the simulation ended by itself; empty while it runs. The channels have
  /// faded by then; there is nothing to resume.
  [[nodiscard]] std::string failure() const;

  /// Bodies and rest positions never change: any thread, any time.
  [[nodiscard]] std::span<const simulation::Body> bodies() const { return simulation_.bodies(); }
  [[nodiscard]] std::span<const geometry::Vec3> rest_positions_m() const {
    return simulation_.rest_positions_m();
  }
  [[nodiscard]] std::size_t tet_count() const { return simulation_.tets().size(); }

 private:
  void run() noexcept;
  void begin_epoch();
  bool change_world();
  void keep_tools();
  /// What judges the surgeon; null: nobody does.
  simulation::QualityMeter* quality() noexcept {
    return options_.quality ? &*options_.quality : nullptr;
  }
  void take_input(std::size_t tool, std::int64_t now_ns);
  void leave_out_placed(suture::HapticModel& model) const;
  void step(std::int64_t now_ns, double dt_s);
  void publish_models(std::int64_t taken_ns);
  void publish_events();
  void publish_frame(std::int64_t now_ns);

  simulation::Simulation simulation_;
  std::vector<ToolChannel*> channels_;
  Options options_;
  std::int64_t period_ns_, display_period_ns_;

  std::vector<simulation::ToolInput> inputs_;
  std::vector<ToolTarget> targets_;     // of the present step
  std::vector<std::uint64_t> changed_;  // step in which the world of each tool changed last
  std::vector<std::optional<ToolPlace>> places_;  // of tools that wait for their hands
  std::int64_t placed_ns_ = 0;
  std::vector<std::unique_ptr<suture::Snapshot<PublishedModel>>> models_;
  suture::Snapshot<DisplayFrame> frames_;
  BoundedQueue<LoopEvent, 1024> events_;
  simulation::StressField stress_;
  std::uint64_t resets_done_ = 0;
  std::int64_t shown_ns_ = 0, measured_ns_ = 0;

  PeriodLatency step_times_;
  std::array<std::atomic<std::int64_t>, kStages> stage_ns_{};
  std::atomic<std::uint64_t> epoch_{0}, steps_{0}, beats_{0}, overruns_{0}, resets_asked_{0};
  std::atomic<bool> paused_{false}, stop_{false}, failed_{false}, replace_asked_{false};
  mutable std::mutex replace_mutex_;  // of the next two
  Replace replace_;
  std::string replace_failure_;
  std::string failure_;  // written before failed_ is set
  std::thread thread_;
};

}  // namespace sutured::haptics
