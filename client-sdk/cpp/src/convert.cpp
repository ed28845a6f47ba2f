// SPDX-License-Identifier: Apache-2.0
#include "convert.hpp"

#include "protocol/rendezvous.hpp"

namespace suture {
namespace {

const char* name_of(v1::EventKind kind) noexcept {
  switch (kind) {
    case suture_v1_EVENT_GRASP:
      return "grasp";
    case suture_v1_EVENT_RELEASE:
      return "release";
    case suture_v1_EVENT_GRIP_SLIP:
      return "grip_slip";
    case suture_v1_EVENT_CONTACT:
      return "contact";
    case suture_v1_EVENT_CONTACT_LOST:
      return "contact_lost";
    case suture_v1_EVENT_PUNCTURE:
      return "puncture";
    case suture_v1_EVENT_EXIT:
      return "exit";
    case suture_v1_EVENT_RETRACT:
      return "retract";
    case suture_v1_EVENT_TAUT:
      return "taut";
    case suture_v1_EVENT_SLACK:
      return "slack";
    case suture_v1_EVENT_UNTHREAD:
      return "unthread";
    case suture_v1_EVENT_KNOT:
      return "knot";
    case suture_v1_EVENT_TEAR:
      return "tear";
    case suture_v1_EVENT_CUT:
      return "cut";
    case suture_v1_EVENT_LIMIT:
      return "limit";
    case suture_v1_EVENT_SOLVER:
      return "solver";
    case suture_v1_EVENT_TOOL_LEASED:
      return "tool_leased";
    case suture_v1_EVENT_TOOL_RETURNED:
      return "tool_returned";
    case suture_v1_EVENT_TOOL_IN_USE:
      return "tool_in_use";
    case suture_v1_EVENT_FAULT:
      return "fault";
    case suture_v1_EVENT_RECOVERED:
      return "recovered";
    case suture_v1_EVENT_PAUSED:
      return "paused";
    case suture_v1_EVENT_RESUMED:
      return "resumed";
    case suture_v1_EVENT_RESET:
      return "reset";
    case suture_v1_EVENT_STOPPED:
      return "stopped";
    case suture_v1_EVENT_STARTED:
      return "started";
    case suture_v1_EVENT_OVERRUN:
      return "overrun";
    case suture_v1_EVENT_NOTICE:
      return "notice";
    case suture_v1_EVENT_CHECKPOINT:
      return "checkpoint";
    case suture_v1_EVENT_REWOUND:
      return "rewound";
  }
  return "unknown";
}

Percentiles to_percentiles(const v1::Percentiles& wire) noexcept {
  return {wire.count, wire.p50_us, wire.p99_us, wire.max_us};
}

ThreadEnd to_end(v1::ThreadEnd end) noexcept {
  switch (end) {
    case suture_v1_END_FREE:
      return ThreadEnd::kFree;
    case suture_v1_END_SWAGED:
      return ThreadEnd::kSwaged;
    case suture_v1_END_HELD:
      return ThreadEnd::kHeld;
    case suture_v1_END_ANCHORED:
      return ThreadEnd::kAnchored;
  }
  return ThreadEnd::kFree;
}

template <class Sequence>
std::vector<Puncture> to_punctures(const Sequence& wire) {
  std::vector<Puncture> punctures;
  punctures.reserve(wire._length);
  for (const v1::Puncture& puncture : span_of(wire)) {
    punctures.push_back({std::string(text_of(puncture.body)), array_of(puncture.position_m),
                         puncture.arc_length_m, puncture.inward});
  }
  return punctures;
}

ToolStatus to_tool_status(const v1::ToolStatus& wire) {
  ToolStatus tool;
  tool.tool = text_of(wire.tool);
  tool.kind = text_of(wire.kind);
  tool.leased = wire.leased;
  tool.renders_itself = wire.renders_itself;
  tool.state = force_state(wire.state);
  tool.faults = wire.faults;
  tool.fault_count = wire.fault_count;
  tool.pose_rate_hz = wire.pose_rate_hz;
  tool.force_rate_hz = wire.force_rate_hz;
  tool.poses = wire.poses;
  tool.poses_lost = wire.poses_lost;
  tool.poses_dropped = wire.poses_dropped;
  tool.takeovers = wire.takeovers;
  tool.force_n = wire.force_n;
  tool.peak_force_n = wire.peak_force_n;
  tool.model_age_ms = wire.model_age_ms;
  tool.tick = to_percentiles(wire.tick);
  tool.energy_to_hand_j = wire.energy_to_hand_j;
  tool.max_force_n = wire.max_force_n;
  tool.stale_after_ms = wire.stale_after_ms;
  return tool;
}

}  // namespace

const char* name_of(ForceState state) noexcept {
  switch (state) {
    case ForceState::kIdle:
      return "idle";
    case ForceState::kRendering:
      return "rendering";
    case ForceState::kRamping:
      return "ramping";
    case ForceState::kClutched:
      return "clutched";
    case ForceState::kFault:
      return "fault";
    case ForceState::kStopped:
      return "stopped";
    case ForceState::kPaused:
      return "paused";
    case ForceState::kServerSilent:
      return "server_silent";
  }
  return "unknown";
}

const char* name_of(ThreadEnd end) noexcept {
  switch (end) {
    case ThreadEnd::kFree:
      return "free";
    case ThreadEnd::kSwaged:
      return "swaged";
    case ThreadEnd::kHeld:
      return "held";
    case ThreadEnd::kAnchored:
      return "anchored";
  }
  return "unknown";
}

std::string fault_names(std::uint32_t faults) {
  static constexpr const char* kNames[] = {
      "pose_stale",  "pose_not_finite", "pose_quaternion", "pose_jump",        "pose_rate",
      "pose_order",  "pose_jaw",        "model_stale",     "model_not_finite", "model_pivots",
      "force_limit", "slew_limit",      "energy",          "stopped",          "tool_in_use"};
  std::string text;
  for (std::size_t i = 0; i < std::size(kNames); ++i) {
    if ((faults >> i & 1U) == 0) continue;
    if (!text.empty()) text += ',';
    text += kNames[i];
  }
  return text;
}

ForceState force_state(v1::ToolState state) noexcept {
  switch (state) {
    case suture_v1_TOOL_IDLE:
      return ForceState::kIdle;
    case suture_v1_TOOL_RENDERING:
      return ForceState::kRendering;
    case suture_v1_TOOL_RAMPING:
      return ForceState::kRamping;
    case suture_v1_TOOL_CLUTCHED:
      return ForceState::kClutched;
    case suture_v1_TOOL_FAULT:
      return ForceState::kFault;
    case suture_v1_TOOL_STOPPED:
      return ForceState::kStopped;
    case suture_v1_TOOL_PAUSED:
      return ForceState::kPaused;
  }
  return ForceState::kFault;
}

Status to_status(const v1::ServerStatus& wire) {
  Status status;
  status.epoch = wire.epoch;
  status.sequence = wire.sequence_number;
  status.stamp_ns = wire.stamp_ns;
  status.version = text_of(wire.server_version);
  status.protocol_version = wire.protocol_version;
  status.session = text_of(wire.session);
  status.host = text_of(wire.host);
  status.pid = wire.pid;
  status.started_ns = wire.started_ns;
  status.state = name_of(wire.state);
  status.state_reason = text_of(wire.state_reason);
  status.scene = text_of(wire.scene);
  status.simulation_time_s = wire.simulation_time_s;
  status.steps = wire.steps;
  status.rate_hz = wire.rate_hz;
  status.achieved_rate_hz = wire.achieved_rate_hz;
  status.overruns = wire.overruns;
  status.step = to_percentiles(wire.step);
  status.wakeup = to_percentiles(wire.wakeup);
  status.write = to_percentiles(wire.write);
  status.missed_ticks = wire.missed_ticks;
  status.bodies = wire.bodies;
  status.vertices = wire.vertices;
  status.tets = wire.tets;
  status.rows = wire.rows;
  status.active_rows = wire.active_rows;
  status.contacts = wire.contacts;
  status.complementarity_residual = wire.complementarity_residual;
  status.frame_rate_hz = wire.frame_rate_hz;
  status.devices = wire.devices;
  status.viewers = wire.viewers;
  status.sched_fifo = wire.sched_fifo;
  status.memory_locked = wire.memory_locked;
  status.realtime_note = text_of(wire.realtime_note);
  for (const v1::ToolStatus& tool : span_of(wire.tools)) {
    status.tools.push_back(to_tool_status(tool));
  }
  return status;
}

Event to_event(const v1::Event& wire) {
  Event event;
  event.epoch = wire.epoch;
  event.sequence = wire.sequence_number;
  event.stamp_ns = wire.stamp_ns;
  event.kind = name_of(wire.kind);
  event.simulation_time_s = wire.simulation_time_s;
  event.subject = text_of(wire.subject);
  event.object = text_of(wire.object);
  event.position_m = array_of(wire.position_m);
  event.value = wire.value;
  event.unit = text_of(wire.unit);
  event.faults = wire.faults;
  event.text = text_of(wire.text);
  return event;
}

MeshTopology to_topology(const v1::MeshTopology& wire) {
  MeshTopology topology;
  topology.body = text_of(wire.body);
  topology.epoch = wire.epoch;
  topology.revision = wire.revision;
  topology.vertex = span_of(wire.vertex);
  topology.rest_position_m = span_of(wire.rest_position_m);
  topology.triangle = span_of(wire.triangle);
  for (const v1::TriangleGroup& group : span_of(wire.groups)) {
    topology.groups.push_back(
        {std::string(text_of(group.name)), group.first_triangle, group.triangle_count});
  }
  return topology;
}

MeshFrame to_frame(const v1::MeshFrame& wire) {
  MeshFrame frame;
  frame.body = text_of(wire.body);
  frame.epoch = wire.epoch;
  frame.sequence = wire.sequence_number;
  frame.stamp_ns = wire.stamp_ns;
  frame.revision = wire.revision;
  frame.step = wire.step;
  frame.simulation_time_s = wire.simulation_time_s;
  frame.position_m = span_of(wire.position_m);
  frame.von_mises_pa = span_of(wire.von_mises_pa);
  frame.principal_pa = span_of(wire.principal_pa);
  return frame;
}

ToolView to_tool(const v1::ToolView& wire) {
  ToolView tool;
  tool.tool = text_of(wire.tool);
  tool.kind = text_of(wire.kind);
  tool.state = force_state(wire.state);
  tool.faults = wire.faults;
  tool.position_m = array_of(wire.position_m);
  tool.orientation_xyzw = array_of(wire.orientation_xyzw);
  tool.jaw = wire.jaw;
  tool.force_n = array_of(wire.force_n);
  tool.torque_nm = array_of(wire.torque_nm);
  tool.holding = text_of(wire.holding);
  return tool;
}

NeedleView to_needle(const v1::NeedleState& wire) {
  NeedleView needle;
  needle.needle = text_of(wire.needle);
  needle.epoch = wire.epoch;
  needle.stamp_ns = wire.stamp_ns;
  needle.arc = wire.shape == suture_v1_NEEDLE_ARC;
  needle.radius_m = wire.radius_m;
  needle.length_m = wire.length_m;
  needle.diameter_m = wire.diameter_m;
  needle.position_m = array_of(wire.position_m);
  needle.orientation_xyzw = array_of(wire.orientation_xyzw);
  needle.holder = text_of(wire.holder);
  needle.tip_inside = wire.tip_inside;
  needle.tip_force_n = wire.tip_force_n;
  needle.embedded_length_m = wire.embedded_length_m;
  needle.course_m = span_of(wire.course_m);
  needle.punctures = to_punctures(wire.punctures);
  return needle;
}

ThreadView to_thread(const v1::ThreadState& wire) {
  ThreadView thread;
  thread.thread = text_of(wire.thread);
  thread.epoch = wire.epoch;
  thread.stamp_ns = wire.stamp_ns;
  thread.length_m = wire.length_m;
  thread.diameter_m = wire.diameter_m;
  thread.tension_n = wire.tension_n;
  thread.slack_m = wire.slack_m;
  thread.taut = wire.taut;
  thread.head = to_end(wire.head);
  thread.tail = to_end(wire.tail);
  thread.head_holder = text_of(wire.head_holder);
  thread.tail_holder = text_of(wire.tail_holder);
  thread.course_m = span_of(wire.course_m);
  thread.arc_length_m = span_of(wire.arc_length_m);
  thread.segment_tension_n = span_of(wire.segment_tension_n);
  thread.punctures = to_punctures(wire.punctures);
  return thread;
}

ContactsView to_contacts(const v1::ContactState& wire) {
  ContactsView contacts;
  contacts.epoch = wire.epoch;
  contacts.stamp_ns = wire.stamp_ns;
  contacts.step = wire.step;
  contacts.points.reserve(wire.points._length);
  for (const v1::ContactPoint& point : span_of(wire.points)) {
    contacts.points.push_back({array_of(point.position_m), array_of(point.normal), point.force_n,
                               point.gap_m, text_of(point.body), text_of(point.other)});
  }
  return contacts;
}

QualityView to_quality(const v1::Quality& wire) {
  QualityView quality;
  quality.thread = text_of(wire.thread);
  quality.epoch = wire.epoch;
  quality.stamp_ns = wire.stamp_ns;
  quality.elapsed_s = wire.elapsed_s;
  quality.needle_path_m = wire.needle_path_m;
  quality.peak_force_n = wire.peak_force_n;
  quality.peak_principal_stress_pa = wire.peak_principal_stress_pa;
  quality.gap_start_m = wire.gap_start_m;
  quality.gap_m = wire.gap_m;
  quality.tension_n = wire.tension_n;
  quality.bite_depth_mean_m = wire.bite_depth_mean_m;
  quality.bite_depth_spread_m = wire.bite_depth_spread_m;
  quality.bite_spacing_mean_m = wire.bite_spacing_mean_m;
  quality.bite_spacing_spread_m = wire.bite_spacing_spread_m;
  quality.handovers = wire.handovers;
  quality.needle_drops = wire.needle_drops;
  quality.bites.reserve(wire.bites._length);
  for (const v1::Bite& bite : span_of(wire.bites)) {
    quality.bites.push_back({text_of(bite.body), array_of(bite.entry_m), array_of(bite.exit_m),
                             bite.depth_m, bite.edge_distance_m, bite.spacing_m,
                             bite.peak_force_n});
  }
  return quality;
}

v1::CommandKind to_wire(CommandKind kind) noexcept {
  switch (kind) {
    case CommandKind::kPause:
      return suture_v1_COMMAND_PAUSE;
    case CommandKind::kResume:
      return suture_v1_COMMAND_RESUME;
    case CommandKind::kReset:
      return suture_v1_COMMAND_RESET;
    case CommandKind::kStop:
      return suture_v1_COMMAND_STOP;
    case CommandKind::kReleaseTool:
      return suture_v1_COMMAND_RELEASE_TOOL;
    case CommandKind::kCheckpoint:
      return suture_v1_COMMAND_CHECKPOINT;
    case CommandKind::kRewind:
      return suture_v1_COMMAND_REWIND;
    case CommandKind::kRestore:
      return suture_v1_COMMAND_RESTORE;
  }
  return suture_v1_COMMAND_STOP;
}

}  // namespace suture
