// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/simulation_loop.hpp"

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <utility>

#include "fem/elements.hpp"
#include "haptics/display_copies.hpp"
#include "haptics/model_builder.hpp"
#include "haptics/realtime.hpp"
#include "haptics/supervisor.hpp"
#include "protocol/types.hpp"

namespace sutured::haptics {

namespace {

constexpr std::int64_t kMeasurePeriod_ns = 500'000'000;

}  // namespace

SimulationLoop::SimulationLoop(simulation::Simulation simulation,
                               std::span<ToolChannel* const> channels, Options options)
    : simulation_(std::move(simulation)),
      channels_(channels.begin(), channels.end()),
      options_(std::move(options)),
      period_ns_(std::llround(1e9 / options_.rate_hz)),
      display_period_ns_(std::llround(1e9 / options_.display_rate_hz)),
      inputs_(channels.size()),
      targets_(channels.size()),
      changed_(channels.size()),
      places_(channels.size()) {
  simulation_.compute_stress(stress_);  // so that no frame allocates
  for (std::size_t i = 0; i < channels_.size(); ++i)
    models_.push_back(std::make_unique<suture::Snapshot<PublishedModel>>());
  frames_.for_each_place([this](DisplayFrame& frame) {
    for (const simulation::Body& body : simulation_.bodies()) {
      frame.position_m.emplace_back(3 * body.surface_vertices.size());
      frame.von_mises_pa.emplace_back(body.surface_vertices.size());
      frame.principal_pa.emplace_back(3 * body.surface_vertices.size());
    }
    frame.needles.resize(simulation_.needles().size());
    for (simulation::NeedleState& needle : frame.needles) reserve_needle(needle);
    frame.threads.resize(simulation_.threads().size());
    for (simulation::ThreadState& thread : frame.threads) reserve_thread(thread);
    frame.contacts.reserve(kShownContactsMax);
    frame.held.resize(channels_.size());
    if (!options_.quality) return;
    frame.quality.resize(simulation_.threads().size());
    for (simulation::ThreadQuality& quality : frame.quality)
      quality.bites.reserve(simulation::QualityMeter::kBitesMax);
  });
  begin_epoch();
  if (options_.resumed) keep_tools();
  thread_ = std::thread([this] { run(); });
}

SimulationLoop::~SimulationLoop() { stop(); }

void SimulationLoop::stop() noexcept {
  stop_.store(true);
  if (thread_.joinable()) thread_.join();
}

void SimulationLoop::pause(bool paused) noexcept {
  paused_.store(paused, std::memory_order_relaxed);
  for (ToolChannel* channel : channels_) channel->set_paused(paused);
}

std::string SimulationLoop::failure() const {
  return failed_.load(std::memory_order_acquire) ? failure_ : std::string();
}

const PublishedModel* SimulationLoop::next_model(std::size_t tool) noexcept {
  return models_[tool]->update() ? &models_[tool]->front() : nullptr;
}

void SimulationLoop::begin_epoch() {
  // The time makes an epoch unique over restarts as well.
  const auto now = static_cast<std::uint64_t>(suture::wall_clock_ns());
  epoch_.store(std::max(now, epoch_.load() + 1), std::memory_order_release);
  std::fill(changed_.begin(), changed_.end(), 0);
}

bool SimulationLoop::reset() {
  const std::lock_guard lock(replace_mutex_);
  const bool overtakes = std::exchange(replace_, nullptr) != nullptr;
  replace_asked_.store(false, std::memory_order_relaxed);
  resets_asked_.fetch_add(1, std::memory_order_relaxed);
  return overtakes;
}

void SimulationLoop::replace_state(Replace replace) {
  const std::lock_guard lock(replace_mutex_);
  replace_ = std::move(replace);
  replace_asked_.store(true, std::memory_order_relaxed);
}

std::string SimulationLoop::replace_failure() const {
  const std::lock_guard lock(replace_mutex_);
  return replace_failure_;
}

/// Resets or replaces the state where somebody asked for it; says whether it did.
bool SimulationLoop::change_world() {
  bool changed = false;
  if (const auto asked = resets_asked_.load(std::memory_order_relaxed); asked != resets_done_) {
    resets_done_ = asked;
    simulation_.reset();
    if (options_.quality) options_.quality->reset();
    std::fill(places_.begin(), places_.end(), std::nullopt);
    changed = true;
  }
  if (replace_asked_.load(std::memory_order_relaxed)) {
    // Whoever asks holds the lock for a moment; the next beat will do.
    const std::unique_lock lock(replace_mutex_, std::try_to_lock);
    if (lock && replace_) {
      const Replace replace = std::exchange(replace_, nullptr);
      replace_asked_.store(false, std::memory_order_relaxed);
      replace_failure_.clear();
      try {
        replace(simulation_, quality());
      } catch (const std::exception& error) {
        replace_failure_ = error.what();
      }
      keep_tools();
      changed = true;
    }
  }
  if (!changed) return false;
  begin_epoch();
  shown_ns_ = measured_ns_ = 0;
  return true;
}

/// Lets the tools stay where the state has them.
void SimulationLoop::keep_tools() {
  placed_ns_ = suture::monotonic_ns();
  for (std::size_t i = 0; i < places_.size(); ++i) {
    const simulation::ToolInput& input = simulation_.responses()[i].reference;
    places_[i].reset();
    if (!input.present) continue;
    ToolPlace& place = places_[i].emplace();
    const Eigen::Vector4d& q = input.orientation.coeffs();
    std::copy_n(input.position_m.data(), 3, place.pose.position_m.begin());
    std::copy_n(q.data(), 4, place.pose.orientation_xyzw.begin());
    place.jaw = input.jaw;
  }
}

void SimulationLoop::run() noexcept {
  name_thread("simulation");
  go_before_ordinary_threads();
  std::int64_t due_ns = suture::monotonic_ns() + period_ns_;
  std::uint64_t beats = 1;  // of the clock, since the last step
  try {
    while (!stop_.load(std::memory_order_relaxed)) {
      sleep_until(due_ns);
      const bool changed = change_world();
      const std::int64_t now_ns = suture::monotonic_ns();
      if (paused()) {
        placed_ns_ = now_ns;
        if (changed) publish_frame(now_ns);
      } else {
        step(now_ns, static_cast<double>(beats) * static_cast<double>(period_ns_) * 1e-9);
      }
      if (options_.keep) options_.keep(simulation_, quality(), epoch(), suture::monotonic_ns());
      beats_.fetch_add(1, std::memory_order_relaxed);
      const NextTick next = next_tick(due_ns, suture::monotonic_ns(), period_ns_);
      overruns_.fetch_add(next.missed, std::memory_order_relaxed);
      due_ns = next.at_ns;
      beats = next.missed + 1;
    }
    if (options_.keep)
      options_.keep(simulation_, quality(), epoch(), std::numeric_limits<std::int64_t>::max());
    if (options_.watch) options_.watch(simulation_, true);
  } catch (const std::exception& error) {
    failure_ = error.what();
    failed_.store(true, std::memory_order_release);
  }
}

Waiting wait_for_hand(const ToolPlace& place, const ToolTarget& target, std::uint64_t epoch,
                      std::int64_t waited_ns) noexcept {
  if (target.present && target.epoch == epoch) {
    // A device's own frame was fitted to the place when its hand came.
    const auto &a = place.pose.position_m, &b = target.pose.position_m;
    const double off_m = std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    return target.frame == Frame::kWorld && off_m > SimulationLoop::kJoin_m ? Waiting::kJoinsAnew
                                                                            : Waiting::kJoins;
  }
  if (waited_ns < SimulationLoop::kStay_ns) return Waiting::kAtPlace;
  return target.present ? Waiting::kAway : Waiting::kNobodyComes;
}

void SimulationLoop::take_input(std::size_t tool, std::int64_t now_ns) {
  ToolTarget& target = targets_[tool] = channels_[tool]->target();
  std::optional<ToolPlace>& place = places_[tool];
  bool lets_go = false;
  if (place) {
    const Waiting waiting = wait_for_hand(*place, target, epoch(), now_ns - placed_ns_);
    lets_go = waiting == Waiting::kJoinsAnew;
    if (waiting == Waiting::kAtPlace) {
      target.present = true;
      target.pose = place->pose;
      target.jaw = place->jaw;
    } else if (waiting == Waiting::kAway) {
      target.present = false;
    } else {
      place.reset();
    }
  }
  simulation::ToolInput& input = inputs_[tool];
  input.present = target.present && !lets_go;
  const auto& p = target.pose.position_m;
  const auto& q = target.pose.orientation_xyzw;
  input.position_m = {p[0], p[1], p[2]};
  input.orientation = Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized();
  input.jaw = target.jaw;
  // A hand that its clutch has taken out of the world holds nothing there.
  input.present = input.present && simulation::may_follow(input);
}

void SimulationLoop::step(std::int64_t now_ns, double dt_s) {
  for (std::size_t i = 0; i < channels_.size(); ++i) take_input(i, now_ns);
  simulation_.step(inputs_, dt_s);
  steps_.fetch_add(1, std::memory_order_relaxed);
  publish_models(now_ns);
  step_times_.record(suture::monotonic_ns() - now_ns);
  const simulation::StepReport& report = simulation_.report();
  const std::array<std::int64_t, kStages> stages{report.track_ns,    report.contact_ns,
                                                 report.assemble_ns, report.solve_ns,
                                                 report.backward_ns, report.model_ns};
  for (std::size_t i = 0; i < kStages; ++i)
    stage_ns_[i].fetch_add(stages[i], std::memory_order_relaxed);
  if (options_.models_published) options_.models_published();
  publish_events();
  if (options_.quality) options_.quality->watch(simulation::quality_view(simulation_));
  if (options_.watch) options_.watch(simulation_, false);
  if (now_ns - shown_ns_ >= display_period_ns_) {
    shown_ns_ = now_ns;
    publish_frame(now_ns);
  }
}

void SimulationLoop::publish_models(std::int64_t taken_ns) {
  const std::int64_t stamp_ns = suture::wall_clock_ns() - (suture::monotonic_ns() - taken_ns);
  const auto responses = simulation_.responses();
  for (std::size_t i = 0; i < channels_.size(); ++i) {
    const ToolTarget& target = targets_[i];
    PublishedModel& published = models_[i]->back();
    suture::HapticModel& model = published.model;
    model.epoch = epoch();
    model.sequence = simulation_.report().step;
    model.stamp_ns = stamp_ns;
    model.period_ns = period_ns_;
    model.stale_after_ns = model_stale_after_ns(period_ns_);
    if (responses[i].world_changed) changed_[i] = model.sequence;
    model.changed_sequence = changed_[i];
    fill_model(responses[i], model);
    leave_out_placed(model);
    published.time_s = simulation_.time_s();
    published.pose_sequence = target.pose_sequence;
    published.writer = target.writer;
    published.engaged = target.present && !places_[i];
    published.mapping = target.mapping;
    // What is refused here is not for devices either: theirs age as ours does.
    if (channels_[i]->publish_model(model, taken_ns, suture::monotonic_ns(), places_[i]))
      models_[i]->publish();
  }
}

/// Takes the couplings to tools that wait for their hands out: such a tool does not move, and where
/// its hand was last has nothing to do with it.
void SimulationLoop::leave_out_placed(suture::HapticModel& model) const {
  int kept = 0;
  for (int k = 0; k < model.other_count; ++k) {
    if (places_[static_cast<std::size_t>(model.others[k].tool)]) continue;
    if (kept != k) model.others[kept] = model.others[k];
    ++kept;
  }
  model.other_count = kept;
}

void SimulationLoop::publish_events() {
  for (const simulation::Event& event : simulation_.events())
    events_.push({epoch(), simulation_.report().step, event});
}

void SimulationLoop::publish_frame(std::int64_t now_ns) {
  simulation_.update_displacements();
  simulation_.compute_stress(stress_);
  DisplayFrame& frame = frames_.back();
  frame.epoch = epoch();
  frame.step = simulation_.report().step;
  frame.stamp_ns = suture::wall_clock_ns();
  frame.time_s = simulation_.time_s();
  frame.report = simulation_.report();
  double peak_principal_pa = 0.0;
  const auto positions = simulation_.positions_m();
  const auto bodies = simulation_.bodies();
  for (std::size_t b = 0; b < bodies.size(); ++b) {
    const auto& vertices = bodies[b].surface_vertices;
    for (std::size_t v = 0; v < vertices.size(); ++v) {
      const std::size_t global = bodies[b].first_vertex + vertices[v];
      const auto& stress_pa = stress_.vertex_pa[global];
      const geometry::Vec3 principal_pa = fem::principal_stress_pa(stress_pa);
      peak_principal_pa = std::max(peak_principal_pa, principal_pa[0]);
      for (int k = 0; k < 3; ++k) {
        frame.position_m[b][3 * v + k] = static_cast<float>(positions[global][k]);
        frame.principal_pa[b][3 * v + k] = static_cast<float>(principal_pa[k]);
      }
      frame.von_mises_pa[b][v] = static_cast<float>(fem::von_mises_pa(stress_pa));
    }
  }
  for (std::size_t n = 0; n < frame.needles.size(); ++n)
    copy_needle(simulation_.needles()[n], frame.needles[n]);
  for (std::size_t t = 0; t < frame.threads.size(); ++t)
    copy_thread(simulation_.threads()[t], frame.threads[t]);
  copy_contacts(simulation_.contacts(), frame.contacts);
  for (std::size_t i = 0; i < frame.held.size(); ++i)
    frame.held[i] = simulation_.responses()[i].held;
  if (options_.quality) {
    options_.quality->note_principal_stress(peak_principal_pa);
    if (now_ns - measured_ns_ >= kMeasurePeriod_ns) {
      measured_ns_ = now_ns;
      options_.quality->measure(simulation::quality_view(simulation_));
    }
    std::copy(options_.quality->threads().begin(), options_.quality->threads().end(),
              frame.quality.begin());
  }
  frames_.publish();
}

}  // namespace sutured::haptics
