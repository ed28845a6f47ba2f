// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/scene_publisher.hpp"

#include <algorithm>
#include <cmath>
#include <span>
#include <string_view>
#include <utility>

#include "endpoints/wire.hpp"

namespace sutured::endpoints {
namespace {

constexpr std::int64_t kBeat_ns = 10'000'000;
// While the simulation is paused, whoever comes shall see what there is.
constexpr std::int64_t kRepeat_ns = 500'000'000;
constexpr std::int64_t kStatusPeriod_ns = 500'000'000;
constexpr std::int64_t kQualityPeriod_ns = 500'000'000;
// A fault that lasts, or comes a thousand times a second, is told once a second.
constexpr std::int64_t kFaultPeriod_ns = 1'000'000'000;
constexpr std::size_t kProfilesMax = 64;
// Devices that may tell of one tool between two beats.
constexpr int kProfilesAtOnce = 16;

constexpr const char* kNoCheckpoints =
    "this server keeps no checkpoints; start it with --checkpoints DIR";

constexpr std::array<std::string_view, haptics::kFaultCount> kFaultTexts{
    "no pose in time: the force fades",
    "a pose that is not finite, or beyond 1 km (poses are in metres): the force fades",
    "a quaternion that is not of unit length: the force fades",
    "a pose that jumps: the force fades",
    "more than 4000 poses a second: the rest is dropped",
    "a pose out of order: dropped",
    "a jaw outside 0 ... 1: the force fades",
    "the simulation is late: the force fades",
    "a model that is not finite: refused",
    "a tick ran out of pivots: multipliers clamped",
    "the force is at its limit",
    "the force changes as fast as it may",
    "more energy than hand and tissue put in: the force fades",
    "stopped: zero force until a resume",
    "another device wants this tool",
};

}  // namespace

ScenePublisher::ScenePublisher(const suture::Participant& control, const suture::Participant& mesh,
                               SessionClaim& claim, Served served)
    : served_(std::move(served)),
      claim_(claim),
      events_(control),
      profiles_(control, {}, kProfilesAtOnce),
      replies_(control),
      topologies_(mesh),
      frames_(mesh),
      tools_(mesh),
      needles_(mesh),
      threads_(mesh),
      contacts_(mesh),
      quality_(mesh),
      profiles_told_(served_.tools.size()),
      heeded_(served_.tools.size()),
      told_(served_.tools.size()),
      tool_status_(served_.tools.size()),
      told_quality_(served_.scene.threads.size()) {
  status_ns_ = suture::monotonic_ns();
  publish_topology();
  publish_status(state(), "");
  notice(suture_v1_EVENT_STARTED, "scene " + served_.scene.name);
  if (!served_.resumed.empty())
    notice(suture_v1_EVENT_REWOUND, "resumed " + served_.resumed + " of the simulation");
  thread_ = std::thread([this] { run(); });
}

ScenePublisher::~ScenePublisher() {
  stop_.store(true);
  if (thread_.joinable()) thread_.join();
}

void ScenePublisher::finish(const std::string& reason) noexcept {
  stop_.store(true);
  if (thread_.joinable()) thread_.join();
  try {
    publish_events(suture::monotonic_ns());
    publish_status(suture_v1_SERVER_LEAVING, reason);
  } catch (const std::bad_alloc&) {
    return;
  }
  constexpr std::chrono::milliseconds kPatience(200);
  claim_.status().wait_for_acknowledgements(kPatience);
  events_.wait_for_acknowledgements(kPatience);
}

void ScenePublisher::run() noexcept {
  haptics::name_thread("publisher");
  std::int64_t due_ns = suture::monotonic_ns() + kBeat_ns;
  while (!stop_.load(std::memory_order_relaxed)) {
    haptics::sleep_until(due_ns);
    const std::int64_t now_ns = suture::monotonic_ns();
    served_.forces.end_leases_of_the_departed();
    obey();
    heed_devices();
    look_for_a_rival();
    finish_changes();
    finish_checkpoints();
    publish_events(now_ns);
    if (served_.loop.epoch() != topology_epoch_) publish_topology();
    show(now_ns);
    if (now_ns - status_ns_ >= kStatusPeriod_ns) publish_status(state(), served_.loop.failure());
    due_ns = haptics::next_tick(due_ns, suture::monotonic_ns(), kBeat_ns).at_ns;
  }
}

// ------------------------------------------------------------------ the scene

void ScenePublisher::publish_topology() {
  topology_epoch_ = served_.loop.epoch();
  const auto rest = served_.loop.rest_positions_m();
  for (const simulation::Body& body : served_.loop.bodies()) {
    std::vector<std::uint32_t> vertex, triangle;
    std::vector<float> position;
    std::vector<std::uint32_t> place(static_cast<std::size_t>(body.vertex_count));
    for (const std::int32_t v : body.surface_vertices) {
      place[static_cast<std::size_t>(v)] = static_cast<std::uint32_t>(vertex.size());
      vertex.push_back(static_cast<std::uint32_t>(v));
      for (int k = 0; k < 3; ++k)
        position.push_back(
            static_cast<float>(rest[static_cast<std::size_t>(body.first_vertex + v)][k]));
    }
    for (const auto& corners : body.surface)
      for (const std::int32_t v : corners) triangle.push_back(place[static_cast<std::size_t>(v)]);
    suture::v1::MeshTopology wire{};
    suture::set_text(wire.body, body.name);
    wire.epoch = topology_epoch_;
    wire.sequence_number = 1;
    wire.stamp_ns = suture::wall_clock_ns();
    wire.revision = 1;
    suture::lend(wire.vertex, std::span<const std::uint32_t>(vertex));
    suture::lend(wire.rest_position_m, std::span<const float>(position));
    suture::lend(wire.triangle, std::span<const std::uint32_t>(triangle));
    topologies_.write(wire);
  }
}

void ScenePublisher::show(std::int64_t now_ns) {
  const haptics::DisplayFrame* fresh = served_.loop.next_frame();
  if (fresh != nullptr) shown_ = fresh;
  const bool due = fresh != nullptr || now_ns - shown_ns_ >= kRepeat_ns;
  if (!due || shown_ == nullptr || shown_->epoch != topology_epoch_) return;
  shown_ns_ = now_ns;
  publish_frame(*shown_);
}

void ScenePublisher::publish_frame(const haptics::DisplayFrame& frame) {
  ++frames_since_;
  ++frame_sequence_;
  report_ = frame.report;
  time_s_ = frame.time_s;
  const auto bodies = served_.loop.bodies();
  for (std::size_t b = 0; b < bodies.size(); ++b) {
    suture::v1::MeshFrame wire{};
    suture::set_text(wire.body, bodies[b].name);
    wire.epoch = frame.epoch;
    wire.sequence_number = frame_sequence_;
    wire.stamp_ns = frame.stamp_ns;
    wire.revision = 1;
    wire.step = frame.step;
    wire.simulation_time_s = frame.time_s;
    suture::lend(wire.position_m, std::span<const float>(frame.position_m[b]));
    suture::lend(wire.von_mises_pa, std::span<const float>(frame.von_mises_pa[b]));
    suture::lend(wire.principal_pa, std::span<const float>(frame.principal_pa[b]));
    frames_.write(wire);
  }
  publish_needles(frame);
  publish_threads(frame);
  publish_contacts(frame);
  publish_tools(frame);
  publish_quality(frame, suture::monotonic_ns());
}

void ScenePublisher::publish_needles(const haptics::DisplayFrame& frame) {
  for (std::size_t n = 0; n < frame.needles.size(); ++n) {
    suture::v1::NeedleState wire{};
    set_needle(wire, served_.scene, n, frame.needles[n], course_m_, punctures_);
    wire.epoch = frame.epoch;
    wire.sequence_number = frame_sequence_;
    wire.stamp_ns = frame.stamp_ns;
    needles_.write(wire);
  }
}

void ScenePublisher::publish_threads(const haptics::DisplayFrame& frame) {
  for (std::size_t t = 0; t < frame.threads.size(); ++t) {
    suture::v1::ThreadState wire{};
    set_thread(wire, served_.scene, t, frame.threads[t], punctures_);
    wire.epoch = frame.epoch;
    wire.sequence_number = frame_sequence_;
    wire.stamp_ns = frame.stamp_ns;
    threads_.write(wire);
  }
}

void ScenePublisher::publish_contacts(const haptics::DisplayFrame& frame) {
  suture::v1::ContactState wire{};
  set_contacts(wire, served_.scene, frame.contacts, contact_points_);
  wire.epoch = frame.epoch;
  wire.sequence_number = frame_sequence_;
  wire.stamp_ns = frame.stamp_ns;
  wire.step = frame.step;
  contacts_.write(wire);
}

void ScenePublisher::publish_quality(const haptics::DisplayFrame& frame, std::int64_t now_ns) {
  for (std::size_t t = 0; t < frame.quality.size(); ++t) {
    ToldQuality& told = told_quality_[t];
    const bool anew = told.epoch != frame.epoch;
    if (!anew && (now_ns - told.at_ns < kQualityPeriod_ns ||
                  !simulation::differs(told.figures, frame.quality[t])))
      continue;
    told = {frame.quality[t], frame.epoch, now_ns};
    suture::v1::Quality wire{};
    set_quality(wire, served_.scene, t, told.figures, bites_);
    wire.epoch = frame.epoch;
    wire.sequence_number = ++quality_sequence_;
    wire.stamp_ns = suture::wall_clock_ns();
    quality_.write(wire);
  }
}

void ScenePublisher::publish_tools(const haptics::DisplayFrame& frame) {
  for (std::size_t i = 0; i < served_.tools.size(); ++i) {
    const haptics::ToolReport& report = served_.tools[i].channel->report();
    suture::v1::ToolView wire{};
    suture::set_text(wire.tool, served_.tools[i].name);
    wire.epoch = frame.epoch;
    wire.sequence_number = frame_sequence_;
    wire.stamp_ns = frame.stamp_ns;
    suture::set_text(wire.kind, served_.tools[i].kind);
    wire.state = wire_state(report.state);
    wire.faults = report.faults;
    if (report.touching) wire.flags |= suture_v1_FORCE_TOUCHING;
    if (report.engaged) wire.flags |= suture_v1_FORCE_ENGAGED;
    std::copy(report.pose.position_m.begin(), report.pose.position_m.end(), wire.position_m);
    std::copy(report.pose.orientation_xyzw.begin(), report.pose.orientation_xyzw.end(),
              wire.orientation_xyzw);
    wire.jaw = report.jaw;
    std::copy(report.wrench.force_n.begin(), report.wrench.force_n.end(), wire.force_n);
    std::copy(report.wrench.torque_nm.begin(), report.wrench.torque_nm.end(), wire.torque_nm);
    if (frame.held[i].kind != simulation::HeldKind::kNothing) wire.flags |= suture_v1_FORCE_HOLDING;
    suture::set_text(wire.holding, held_name(served_.scene, frame.held[i]));
    tools_.write(wire);
  }
}

// ------------------------------------------------------------------ events

void ScenePublisher::publish_event(suture::v1::Event& event) {
  if (event.epoch == 0) event.epoch = served_.loop.epoch();
  event.sequence_number = ++event_sequence_;
  event.stamp_ns = suture::wall_clock_ns();
  events_.write(event);
}

void ScenePublisher::notice(suture_v1_EventKind kind, const std::string& text) {
  suture::v1::Event event{};
  event.kind = kind;
  event.simulation_time_s = time_s_;
  suture::set_text(event.text, text);
  publish_event(event);
}

void ScenePublisher::publish_events(std::int64_t now_ns) {
  haptics::LoopEvent happened;
  while (served_.loop.next_event(happened)) {
    suture::v1::Event event{};
    set_event(event, happened.event);
    event.epoch = happened.epoch;
    event.step = happened.step;
    publish_event(event);
  }
  if (const std::uint64_t dropped = served_.loop.events_dropped();
      dropped != events_dropped_told_) {
    notice(suture_v1_EVENT_NOTICE, std::to_string(dropped - events_dropped_told_) +
                                       " events were dropped: more than 1024 waited");
    events_dropped_told_ = dropped;
  }
  if (const std::uint64_t dropped = served_.forces.commands_dropped();
      dropped != commands_dropped_told_) {
    notice(suture_v1_EVENT_NOTICE, std::to_string(dropped - commands_dropped_told_) +
                                       " commands were dropped: more than 64 waited");
    commands_dropped_told_ = dropped;
  }
  if (const std::uint64_t overruns = served_.loop.overruns();
      overruns != overruns_told_ && now_ns - overruns_told_ns_ >= kFaultPeriod_ns) {
    suture::v1::Event event{};
    event.kind = suture_v1_EVENT_OVERRUN;
    event.simulation_time_s = time_s_;
    event.value = static_cast<double>(overruns - overruns_told_);
    suture::set_text(event.text, "periods of the simulation's clock were missed");
    publish_event(event);
    overruns_told_ = overruns;
    overruns_told_ns_ = now_ns;
  }
  for (std::size_t i = 0; i < served_.tools.size(); ++i) tell_channel(i, now_ns);
}

void ScenePublisher::tell_channel(std::size_t tool, std::int64_t now_ns) {
  Told& told = told_[tool];
  const haptics::ToolChannel& channel = *served_.tools[tool].channel;
  const haptics::ToolCounters& counters = channel.counters();
  const auto tell = [&](suture_v1_EventKind kind, std::uint64_t count, std::string_view text,
                        std::uint32_t faults, std::uint64_t device) {
    suture::v1::Event event{};
    event.kind = kind;
    event.simulation_time_s = time_s_;
    suture::set_text(event.subject, served_.tools[tool].name);
    event.value = static_cast<double>(count);
    event.faults = faults;
    suture::set_guid(event.device, served_.forces.guid_of_writer(device));
    suture::set_text(event.text, text);
    publish_event(event);
  };
  const auto tell_count = [&](const std::atomic<std::uint64_t>& counter, std::uint64_t& then,
                              suture_v1_EventKind kind, std::string_view text,
                              std::uint64_t device) {
    const std::uint64_t count = counter.load(std::memory_order_relaxed);
    if (count != then) tell(kind, count - then, text, 0, device);
    then = count;
  };
  const std::uint64_t holder = channel.lease();
  tell_count(counters.returns, told.returns, suture_v1_EVENT_TOOL_RETURNED, "the tool is free",
             told.lease_holder);
  tell_count(counters.leases, told.leases, suture_v1_EVENT_TOOL_LEASED, "a device holds the tool",
             holder);
  if (holder != 0) told.lease_holder = holder;
  for (int i = 0; i < haptics::kFaultCount; ++i) {
    const auto fault = static_cast<haptics::Fault>(i);
    const std::uint64_t count = counters.of(fault);
    if (count == told.faults[i] || (told.at_ns[i] != 0 && now_ns - told.at_ns[i] < kFaultPeriod_ns))
      continue;
    const auto kind = fault == haptics::Fault::kToolInUse ? suture_v1_EVENT_TOOL_IN_USE
                      : fault == haptics::Fault::kStopped ? suture_v1_EVENT_STOPPED
                      : fault == haptics::Fault::kForceLimit || fault == haptics::Fault::kSlewLimit
                          ? suture_v1_EVENT_LIMIT
                          : suture_v1_EVENT_FAULT;
    tell(kind, count - told.faults[i], kFaultTexts[i], haptics::fault_bit(fault), holder);
    told.faults[i] = count;
    told.at_ns[i] = now_ns;
  }
  tell_count(counters.recoveries, told.recoveries, suture_v1_EVENT_RECOVERED,
             "the force is whole again", holder);
}

// ------------------------------------------------------------------ commands

void ScenePublisher::answer(suture::v1::CommandReply& reply, suture_v1_CommandResult result,
                            const std::string& text) {
  reply.result = result;
  suture::set_text(reply.text, text);
  reply.epoch = served_.loop.epoch();
  reply.stamp_ns = suture::wall_clock_ns();
  replies_.write(reply);
}

void ScenePublisher::obey() {
  suture::v1::Command command;
  while (served_.forces.next_command(command)) {
    suture::v1::CommandReply reply{};
    std::copy(std::begin(command.requester), std::end(command.requester), reply.requester);
    reply.request = command.request;
    reply.kind = command.kind;
    switch (command.kind) {
      case suture_v1_COMMAND_RESET:
      case suture_v1_COMMAND_REWIND:
      case suture_v1_COMMAND_RESTORE:
        change_world(command, reply);
        break;
      case suture_v1_COMMAND_CHECKPOINT:
        keep_checkpoint(command, reply);
        break;
      default:
        execute(command, reply);
    }
  }
}

/// Asks the loop for another state; `finish_changes` answers when it has it.
void ScenePublisher::change_world(const suture::v1::Command& command,
                                  suture::v1::CommandReply& reply) {
  const auto refuse = [&](const std::string& text) {
    answer(reply, suture_v1_COMMAND_REFUSED, text);
  };
  if (const std::string failure = served_.loop.failure(); !failure.empty())
    return refuse("the simulation has ended: " + failure);
  const std::uint64_t epoch = served_.loop.epoch();
  if (command.kind == suture_v1_COMMAND_RESET) {
    if (served_.loop.reset()) {
      // The last word counts; what it overtook has not been done.
      std::erase_if(changes_, [this](PendingChange& pending) {
        if (pending.event != suture_v1_EVENT_REWOUND) return false;
        answer(pending.reply, suture_v1_COMMAND_REFUSED, "a reset came behind it; ask again");
        return true;
      });
    }
    changes_.push_back({reply, epoch, suture_v1_EVENT_RESET, ""});
    return;
  }
  if (served_.keeper == nullptr) return refuse(kNoCheckpoints);
  if (!changes_.empty()) return refuse("another change of the world is under way; ask again");
  try {
    const bool rewind = command.kind == suture_v1_COMMAND_REWIND;
    if (rewind && !(command.seconds > 0.0 && std::isfinite(command.seconds)))
      return refuse("a rewind goes back by more than 0 seconds");
    checkpoints::CheckpointKeeper::Change change =
        rewind ? served_.keeper->back_by(command.seconds)
               : served_.keeper->to(std::string(suture::text_of(command.checkpoint)));
    for (const std::string& line : change.refused) notice(suture_v1_EVENT_NOTICE, line);
    changes_.push_back({reply, epoch, suture_v1_EVENT_REWOUND, change.text});
    served_.loop.replace_state(std::move(change.apply));
  } catch (const std::exception& error) {
    refuse(error.what());
  }
}

void ScenePublisher::finish_changes() {
  std::erase_if(changes_, [this](PendingChange& pending) {
    if (served_.loop.epoch() == pending.epoch_before) return false;
    const bool replaced = pending.event == suture_v1_EVENT_REWOUND;
    const std::string failure = replaced ? served_.loop.replace_failure() : "";
    if (!failure.empty()) {
      notice(suture_v1_EVENT_RESET, "a checkpoint made no sense: " + failure);
      answer(pending.reply, suture_v1_COMMAND_REFUSED,
             "the checkpoint makes no sense (" + failure + "): the scene was reset");
      return true;
    }
    notice(pending.event, pending.text);
    answer(pending.reply, suture_v1_COMMAND_DONE, pending.text);
    return true;
  });
}

/// Asks for a checkpoint; `finish_checkpoints` answers when it is on disk.
void ScenePublisher::keep_checkpoint(const suture::v1::Command& command,
                                     suture::v1::CommandReply& reply) {
  if (served_.keeper == nullptr) return answer(reply, suture_v1_COMMAND_REFUSED, kNoCheckpoints);
  const std::string name(suture::text_of(command.checkpoint));
  try {
    served_.keeper->ask(name);
    checkpoints_asked_.emplace_back(name, reply);
  } catch (const std::exception& error) {
    answer(reply, suture_v1_COMMAND_REFUSED, error.what());
  }
}

void ScenePublisher::finish_checkpoints() {
  if (served_.keeper == nullptr) return;
  while (const auto word = served_.keeper->next_word()) {
    if (word->name.empty()) {
      notice(suture_v1_EVENT_NOTICE, word->text);
      continue;
    }
    if (word->good) {
      suture::v1::Event event{};
      event.kind = suture_v1_EVENT_CHECKPOINT;
      event.simulation_time_s = time_s_;
      suture::set_text(event.object, word->name);
      suture::set_text(event.text, word->text);
      publish_event(event);
    }
    const auto asked = std::find_if(checkpoints_asked_.begin(), checkpoints_asked_.end(),
                                    [&](const auto& a) { return a.first == word->name; });
    if (asked == checkpoints_asked_.end()) continue;
    answer(asked->second, word->good ? suture_v1_COMMAND_DONE : suture_v1_COMMAND_REFUSED,
           word->text);
    checkpoints_asked_.erase(asked);
  }
}

void ScenePublisher::execute(const suture::v1::Command& command, suture::v1::CommandReply& reply) {
  const std::string who(suture::text_of(command.requester_name));
  switch (command.kind) {
    case suture_v1_COMMAND_PAUSE:
      served_.loop.pause(true);
      notice(suture_v1_EVENT_PAUSED, who);
      return answer(reply, suture_v1_COMMAND_DONE, "");
    case suture_v1_COMMAND_RESUME:
      stopped_ = false;  // ForceService has let the forces go on
      served_.loop.pause(false);
      notice(suture_v1_EVENT_RESUMED, who);
      return answer(reply, suture_v1_COMMAND_DONE, "");
    case suture_v1_COMMAND_STOP:
      stopped_ = true;  // and it has stopped them, as the command came
      return answer(reply, suture_v1_COMMAND_DONE, "");
    case suture_v1_COMMAND_RELEASE_TOOL: {
      const std::string_view name = suture::text_of(command.tool);
      const auto found = std::find_if(served_.tools.begin(), served_.tools.end(),
                                      [&](const ServedTool& tool) { return tool.name == name; });
      if (found == served_.tools.end())
        return answer(reply, suture_v1_COMMAND_REFUSED,
                      "the scene has no tool \"" + std::string(name) + "\"");
      if (!found->channel->release())
        return answer(reply, suture_v1_COMMAND_REFUSED, "nobody holds that tool");
      return answer(reply, suture_v1_COMMAND_DONE, "");
    }
    default:
      answer(reply, suture_v1_COMMAND_NOT_SUPPORTED, "this server does not know that command");
  }
}

// ------------------------------------------------------------------ devices

// What a device tells of itself holds while its poses move the tool.
void ScenePublisher::heed_devices() {
  bool news = false;
  profiles_.take_each(
      [&](const suture::v1::DeviceProfile& profile, const suture::SampleInfo& info) {
        if (!info.valid) return;
        // Of itself, not of another: both writers of a device are of one participant.
        const auto writer = profiles_.writer_guid(info.writer);
        const suture::Guid device = suture::guid_of(profile.device);
        if (!writer || !std::equal(writer->begin(), writer->begin() + 12, device.begin())) return;
        const std::string_view name = suture::text_of(profile.tool);
        for (std::size_t i = 0; i < served_.tools.size(); ++i) {
          if (served_.tools[i].name != name) continue;
          remember_profile(i, device, device_limits(profile));
          news = true;
        }
      });
  for (std::size_t i = 0; i < served_.tools.size(); ++i) {
    const std::uint64_t holder = served_.tools[i].channel->lease();
    if (holder == heeded_[i] && !news) continue;
    const suture::Guid guid = served_.forces.guid_of_writer(holder);
    if (holder != 0 && guid == suture::kNobody) continue;  // its first pose is still being served
    heeded_[i] = holder;
    const auto& told = profiles_told_[i];
    const auto found = std::find_if(told.begin(), told.end(),
                                    [&](const auto& each) { return each.first == guid; });
    served_.tools[i].channel->set_device_limits(found == told.end() ? haptics::DeviceLimits{}
                                                                    : found->second);
  }
}

// Keeps what the newest devices told, and what the one told that holds the tool.
void ScenePublisher::remember_profile(std::size_t tool, const suture::Guid& device,
                                      const haptics::DeviceLimits& limits) {
  auto& told = profiles_told_[tool];
  std::erase_if(told, [&](const auto& each) { return each.first == device; });
  if (told.size() >= kProfilesMax) {
    const suture::Guid holder = served_.forces.guid_of_writer(served_.tools[tool].channel->lease());
    told.erase(std::find_if(told.begin(), told.end(),
                            [&](const auto& each) { return each.first != holder; }));
  }
  told.emplace_back(device, limits);
}

// ------------------------------------------------------------------ status

void ScenePublisher::look_for_a_rival() {
  std::string found = claim_.rival();
  if (found.empty()) return;
  const std::lock_guard lock(rival_mutex_);
  rival_ = std::move(found);
}

suture_v1_ServerState ScenePublisher::state() const {
  if (stopped_ || !served_.loop.failure().empty()) return suture_v1_SERVER_STOPPED;
  if (served_.loop.paused()) return suture_v1_SERVER_PAUSED;
  return served_.loop.steps() > 0 ? suture_v1_SERVER_RUNNING : suture_v1_SERVER_STARTING;
}

void ScenePublisher::publish_status(suture_v1_ServerState state, const std::string& reason) {
  const std::int64_t now_ns = suture::monotonic_ns();
  const double elapsed_s = std::max(static_cast<double>(now_ns - status_ns_) * 1e-9, 1e-3);
  status_ns_ = now_ns;

  suture::v1::ServerStatus status{};
  status.epoch = served_.loop.epoch();
  status.sequence_number = ++status_sequence_;
  identify(status, claim_.server(), served_.session, served_.scene.name);
  status.started_ns = claim_.started_ns();
  status.state = state;
  suture::set_text(status.state_reason, reason);
  status.simulation_time_s = time_s_;
  status.steps = served_.loop.steps();
  status.rate_hz = served_.rate_hz;
  status.achieved_rate_hz = static_cast<double>(status.steps - steps_then_) / elapsed_s;
  const double steps = std::max(static_cast<double>(status.steps - steps_then_), 1.0);
  steps_then_ = status.steps;
  const auto stage_ns = served_.loop.stage_ns();
  std::array<suture::v1::StageTime, haptics::SimulationLoop::kStages> stages{};
  for (std::size_t i = 0; i < stages.size(); ++i) {
    suture::set_text(stages[i].stage, haptics::SimulationLoop::kStageNames[i]);
    stages[i].mean_us = static_cast<double>(stage_ns[i] - stage_ns_then_[i]) * 1e-3 / steps;
  }
  stage_ns_then_ = stage_ns;
  suture::lend(status.stages, std::span<const suture::v1::StageTime>(stages));
  status.overruns = served_.loop.overruns();
  status.step = percentiles(served_.loop.take_step_times());
  status.wakeup = percentiles(served_.supervisor.take_wakeup());
  status.write = percentiles(served_.forces.take_write_times());
  status.missed_ticks = served_.supervisor.missed_ticks();
  status.bodies = static_cast<std::uint32_t>(served_.loop.bodies().size());
  status.vertices = static_cast<std::uint32_t>(served_.loop.rest_positions_m().size());
  status.tets = static_cast<std::uint32_t>(served_.loop.tet_count());
  status.rows = static_cast<std::uint32_t>(report_.rows);
  status.active_rows = static_cast<std::uint32_t>(report_.active_unilateral_rows);
  status.contacts = static_cast<std::uint32_t>(report_.contacts);
  status.complementarity_residual = report_.complementarity_residual;
  status.frame_rate_hz = static_cast<double>(frames_since_) / elapsed_s;
  frames_since_ = 0;
  status.viewers =
      static_cast<std::uint32_t>(std::max(frames_.matched() + served_.more_viewers(), 0));
  status.sched_fifo = served_.supervisor.realtime();
  status.memory_locked = served_.realtime.memory_locked;
  suture::set_text(status.realtime_note, served_.realtime.note);

  for (std::size_t i = 0; i < served_.tools.size(); ++i) {
    haptics::ToolChannel& channel = *served_.tools[i].channel;
    const haptics::ToolReport& report = channel.report();
    const haptics::ToolCounters& counters = channel.counters();
    Told& told = told_[i];
    suture::v1::ToolStatus& tool = tool_status_[i];
    tool = {};
    suture::set_text(tool.tool, served_.tools[i].name);
    suture::set_text(tool.kind, served_.tools[i].kind);
    const std::uint64_t holder = channel.lease();
    // Until `heed_devices` has seen it end, its device's limits stand: not free for the next one.
    tool.leased = holder != 0 || heeded_[i] != 0;
    status.devices += tool.leased ? 1 : 0;
    suture::set_guid(tool.device, served_.forces.guid_of_writer(holder));
    tool.renders_itself = report.renders_itself;
    tool.state = wire_state(report.state);
    tool.faults = report.faults;
    tool.energy_to_hand_j = report.energy_to_hand_j;
    for (int f = 0; f < haptics::kFaultCount; ++f)
      tool.fault_count += static_cast<std::uint32_t>(counters.of(static_cast<haptics::Fault>(f)));
    tool.poses = counters.poses.load(std::memory_order_relaxed);
    const std::uint64_t forces = counters.forces.load(std::memory_order_relaxed);
    tool.pose_rate_hz = static_cast<double>(tool.poses - told.poses) / elapsed_s;
    tool.force_rate_hz = static_cast<double>(forces - told.forces) / elapsed_s;
    told.poses = tool.poses;
    told.forces = forces;
    tool.poses_lost = counters.poses_lost.load(std::memory_order_relaxed);
    tool.poses_dropped = counters.poses_dropped.load(std::memory_order_relaxed);
    tool.takeovers = counters.takeovers.load(std::memory_order_relaxed);
    tool.force_n = report.shown_force_n;
    tool.peak_force_n = report.peak_force_n;
    tool.model_age_ms = static_cast<double>(channel.take_model_age_max_ns()) * 1e-6;
    tool.tick = percentiles(served_.forces.take_tick_times(i));
    tool.frozen_rows = served_.models.frozen_rows(i);
    const suture::ForceLimits limits = channel.limits();
    tool.max_force_n = limits.max_force_n;
    tool.max_torque_nm = limits.max_torque_nm;
    tool.max_force_slew_n_per_s = limits.max_force_slew_n_per_s;
    tool.max_torque_slew_nm_per_s = limits.max_torque_slew_nm_per_s;
    tool.stale_after_ms = static_cast<double>(channel.pose_stale_after_ns()) * 1e-6;
  }
  suture::lend(status.tools, std::span<const suture::v1::ToolStatus>(tool_status_));
  claim_.status().write(status);
}

}  // namespace sutured::endpoints
