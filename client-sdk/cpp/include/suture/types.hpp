// SPDX-License-Identifier: Apache-2.0
// The values that a device or a viewer exchanges with a server.
//
// FRAMES. "Device" is the base frame of a haptic device, as its maker defines it; the
// server's scene says where it lies in the world and how motion and force are scaled.
// "World" is the frame of the scene: right-handed, metres. A hand's vectors are in the
// device frame unless `in_world` is set, and the forces that answer it come in the same
// frame. What viewers receive is in the world.
//
// UNITS. SI throughout; the unit ends each name. Rotations are unit quaternions
// (x, y, z, w) that take tool axes to the named frame.
//
// TIMES. Stamps are nanoseconds since the Unix epoch on the sender's clock; a round trip
// is measured on the device's clock alone, from the echo of its own stamp.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "suture/error.hpp"

namespace suture {

/// Three numbers along x, y, z.
using Vector3 = std::array<double, 3>;
/// A unit quaternion x, y, z, w.
using Quaternion = std::array<double, 4>;

/// Where the hand is: what a device sends.
struct Hand {
  Vector3 position_m{};  ///< of the tool's origin
  Quaternion orientation_xyzw{0.0, 0.0, 0.0, 1.0};
  double jaw = 0.0;           ///< 0 open … 1 closed
  std::uint32_t buttons = 0;  ///< bit i: button i is down
  bool in_world = false;      ///< world axes, neither mapped nor scaled nor clutched
  bool stop = false;          ///< the device's emergency stop: zero force now
  /// What the device measured of its velocity; NaN where it knows none.
  Vector3 linear_velocity_m_per_s{std::numeric_limits<double>::quiet_NaN(),
                                  std::numeric_limits<double>::quiet_NaN(),
                                  std::numeric_limits<double>::quiet_NaN()};
  Vector3 angular_velocity_rad_per_s{std::numeric_limits<double>::quiet_NaN(),
                                     std::numeric_limits<double>::quiet_NaN(),
                                     std::numeric_limits<double>::quiet_NaN()};
};

/// What a haptic device can do at its handle. Zero: not known, no limit beside the scene's.
struct DeviceLimits {
  double max_force_n = 0.0;
  double max_torque_nm = 0.0;
  double max_force_slew_n_per_s = 0.0;
  double max_stiffness_n_per_m = 0.0;  ///< the stiffest spring that it renders stably
  double max_damping_n_s_per_m = 0.0;  ///< the strongest damper that it renders stably
};

/// What stands behind a force.
enum class ForceState {
  kIdle,          ///< nothing has begun
  kRendering,     ///< the force is the tissue's
  kRamping,       ///< on its way from or to zero
  kClutched,      ///< uncoupled on purpose: zero
  kFault,         ///< a fault: zero, or on its way there; see `faults`
  kStopped,       ///< a stop command or button: zero until a resume
  kPaused,        ///< the simulation is paused
  kServerSilent,  ///< no force arrived in time: the SDK takes it to zero
};

/// Returns a word for `state`, such as "rendering".
__attribute__((visibility("default"))) const char* name_of(ForceState state) noexcept;

/// Returns the names of the FAULT bits set in `faults`, joined by commas; "" for none.
__attribute__((visibility("default"))) std::string fault_names(std::uint32_t faults);

/// What the hand shall feel: force and torque on the hand at the tool's origin, in the
/// frame of the hand that it answers. Within the limits of the scene's tool.
struct Force {
  Vector3 force_n{};
  Vector3 torque_nm{};
  ForceState state = ForceState::kIdle;
  std::uint32_t faults = 0;         ///< FAULT_* bits of idl/suture_v1.idl
  bool touching = false;            ///< the tool touches or holds something
  bool holding = false;             ///< the jaw holds something
  bool engaged = false;             ///< the hand moves the tool
  std::uint64_t sequence = 0;       ///< counts the server's forces; 0: none has come yet
  std::uint64_t hand_sequence = 0;  ///< the `write` that it answers
  std::int64_t hand_stamp_ns = 0;   ///< when that was measured
  std::int64_t round_trip_ns = 0;   ///< from that stamp to the arrival of this force
  std::uint32_t model_age_us = 0;   ///< age of the simulation step that it comes from
};

/// Counts what a device has exchanged since it connected.
struct DeviceStatistics {
  std::uint64_t hands_written = 0;
  std::uint64_t forces_received = 0;   ///< answers, each hand counted once
  std::uint64_t hands_unanswered = 0;  ///< of those written before the latest answer
  std::uint64_t repeated = 0;          ///< more than one force for the same hand
  std::uint64_t out_of_order = 0;      ///< overtaken by a newer one on the way, and dropped
  double peak_force_n = 0.0;
  std::int64_t round_trip_p50_ns = 0;
  std::int64_t round_trip_p99_ns = 0;
  std::int64_t round_trip_max_ns = 0;
};

/// A named run of triangles of a mesh.
struct MeshGroup {
  std::string name;
  std::uint32_t first_triangle = 0;
  std::uint32_t triangle_count = 0;
};

/// A body at rest. Views are valid until the callback returns.
struct MeshTopology {
  std::string_view body;
  std::uint64_t epoch = 0;
  std::uint32_t revision = 0;               ///< frames of this revision fit
  std::span<const std::uint32_t> vertex;    ///< per surface vertex: index in the body's mesh
  std::span<const float> rest_position_m;   ///< 3 per surface vertex, world
  std::span<const std::uint32_t> triangle;  ///< 3 surface vertices each, counter-clockwise outside
  std::vector<MeshGroup> groups;
};

/// A body now. Views are valid until the callback returns.
struct MeshFrame {
  std::string_view body;
  std::uint64_t epoch = 0;
  std::uint64_t sequence = 0;
  std::int64_t stamp_ns = 0;
  std::uint32_t revision = 0;
  std::uint64_t step = 0;
  double simulation_time_s = 0.0;
  std::span<const float> position_m;    ///< 3 per surface vertex, world
  std::span<const float> von_mises_pa;  ///< 1 per surface vertex
  std::span<const float> principal_pa;  ///< 3 per surface vertex, largest first; or empty
};

/// A tool as others see it, in the world.
struct ToolView {
  std::string_view tool;
  std::string_view kind;
  ForceState state = ForceState::kIdle;
  std::uint32_t faults = 0;
  Vector3 position_m{};
  Quaternion orientation_xyzw{0.0, 0.0, 0.0, 1.0};
  double jaw = 0.0;
  Vector3 force_n{};
  Vector3 torque_nm{};
  std::string_view holding;  ///< needle, thread or body in the jaw; empty for none
};

/// Where a needle or a thread passes a surface.
struct Puncture {
  std::string body;
  Vector3 position_m{};
  double arc_length_m = 0.0;
  bool inward = false;
};

/// A needle, in the world. `course_m` holds 3 numbers a point from tip to tail.
struct NeedleView {
  std::string_view needle;
  std::uint64_t epoch = 0;
  std::int64_t stamp_ns = 0;
  bool arc = false;
  double radius_m = 0.0;
  double length_m = 0.0;
  double diameter_m = 0.0;
  Vector3 position_m{};
  Quaternion orientation_xyzw{0.0, 0.0, 0.0, 1.0};
  std::string_view holder;  ///< a tool, or empty
  bool tip_inside = false;
  double tip_force_n = 0.0;
  double embedded_length_m = 0.0;
  std::span<const double> course_m;
  std::vector<Puncture> punctures;
};

/// What rules an end of a thread.
enum class ThreadEnd {
  kFree,
  kSwaged,    ///< crimped into a needle
  kHeld,      ///< in a tool's jaw
  kAnchored,  ///< knotted to a body
};

/// Returns a word for `end`, such as "swaged".
__attribute__((visibility("default"))) const char* name_of(ThreadEnd end) noexcept;

/// A thread, in the world. `course_m` holds 3 numbers a point from head to tail; the head is
/// where the needle is, or was.
struct ThreadView {
  std::string_view thread;
  std::uint64_t epoch = 0;
  std::int64_t stamp_ns = 0;
  double length_m = 0.0;
  double diameter_m = 0.0;
  double tension_n = 0.0;
  double slack_m = 0.0;
  bool taut = false;
  ThreadEnd head = ThreadEnd::kFree;
  ThreadEnd tail = ThreadEnd::kFree;
  std::string_view head_holder;  ///< tool, needle or body; empty for a free end
  std::string_view tail_holder;
  std::span<const double> course_m;
  std::span<const double> arc_length_m;       ///< per point of the course, from the head
  std::span<const double> segment_tension_n;  ///< per pair of neighbours
  std::vector<Puncture> punctures;
};

/// A pair in contact: of two bodies, or of a needle's shaft and a body.
struct ContactPoint {
  Vector3 position_m{};
  Vector3 normal{};  ///< unit, out of `body`
  double force_n = 0.0;
  double gap_m = 0.0;
  std::string_view body;
  std::string_view other;  ///< body, tool or needle
};

/// All pairs that carry force in one step, in the world; none is an empty list.
struct ContactsView {
  std::uint64_t epoch = 0;
  std::int64_t stamp_ns = 0;
  std::uint64_t step = 0;
  std::vector<ContactPoint> points;
};

/// One passage of a thread through a body, in the world at rest.
struct Bite {
  std::string_view body;
  Vector3 entry_m{};  ///< where the needle went in
  Vector3 exit_m{};
  double depth_m = 0.0;          ///< largest distance of its course from the surface
  double edge_distance_m = 0.0;  ///< from the wound's edge; NaN: the scene has no wound
  double spacing_m = 0.0;        ///< to the bite before in the same body; NaN: it is the first
  double peak_force_n = 0.0;     ///< NaN: the scene began with it
};

/// How well somebody sews with one thread. What is not known is NaN.
struct QualityView {
  std::string_view thread;
  std::uint64_t epoch = 0;
  std::int64_t stamp_ns = 0;
  double elapsed_s = 0.0;
  double needle_path_m = 0.0;  ///< length of the way of the needle's tip
  double peak_force_n = 0.0;   ///< on tissue
  double peak_principal_stress_pa = 0.0;
  double gap_start_m = 0.0;  ///< largest, between the wound's edges
  double gap_m = 0.0;
  double tension_n = 0.0;
  double bite_depth_mean_m = 0.0;
  double bite_depth_spread_m = 0.0;  ///< standard deviation
  double bite_spacing_mean_m = 0.0;
  double bite_spacing_spread_m = 0.0;
  std::uint32_t handovers = 0;
  std::uint32_t needle_drops = 0;
  std::vector<Bite> bites;
};

/// Something that happened. `kind` is a lower-case word such as "puncture".
struct Event {
  std::uint64_t epoch = 0;
  std::uint64_t sequence = 0;
  std::int64_t stamp_ns = 0;
  std::string kind;
  double simulation_time_s = 0.0;
  std::string subject;
  std::string object;
  Vector3 position_m{};
  double value = 0.0;
  std::string unit;
  std::uint32_t faults = 0;
  std::string text;
};

/// Percentiles over the last status period, microseconds.
struct Percentiles {
  std::uint64_t count = 0;
  double p50_us = 0.0;
  double p99_us = 0.0;
  double max_us = 0.0;
};

/// One tool of the scene, as the server counts it.
struct ToolStatus {
  std::string tool;
  std::string kind;
  bool leased = false;
  bool renders_itself = false;
  ForceState state = ForceState::kIdle;
  std::uint32_t faults = 0;
  std::uint32_t fault_count = 0;
  double pose_rate_hz = 0.0;
  double force_rate_hz = 0.0;
  std::uint64_t poses = 0;
  std::uint64_t poses_lost = 0;
  std::uint64_t poses_dropped = 0;
  std::uint64_t takeovers = 0;
  double force_n = 0.0;
  double peak_force_n = 0.0;
  double model_age_ms = 0.0;
  Percentiles tick;
  double energy_to_hand_j = 0.0;  ///< since the engagement began, less what the hand put in
  double max_force_n = 0.0;
  double stale_after_ms = 0.0;
};

/// What a server says about itself, twice a second.
struct Status {
  std::uint64_t epoch = 0;
  std::uint64_t sequence = 0;
  std::int64_t stamp_ns = 0;
  std::string version;
  std::uint32_t protocol_version = 0;
  std::string session;
  std::string host;
  int pid = 0;
  std::int64_t started_ns = 0;
  std::string state;  ///< starting, running, paused, stopped, leaving
  std::string state_reason;
  std::string scene;
  double simulation_time_s = 0.0;
  std::uint64_t steps = 0;
  double rate_hz = 0.0;
  double achieved_rate_hz = 0.0;
  std::uint64_t overruns = 0;
  Percentiles step;
  Percentiles wakeup;
  Percentiles write;
  std::uint64_t missed_ticks = 0;
  std::uint32_t bodies = 0, vertices = 0, tets = 0, rows = 0, active_rows = 0, contacts = 0;
  double complementarity_residual = 0.0;  ///< dimensionless
  double frame_rate_hz = 0.0;
  std::uint32_t devices = 0, viewers = 0;
  bool sched_fifo = false;
  bool memory_locked = false;
  std::string realtime_note;
  std::vector<ToolStatus> tools;
};

}  // namespace suture
