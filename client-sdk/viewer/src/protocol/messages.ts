// SPDX-License-Identifier: Apache-2.0
// The wire types of idl/suture_v1.idl that the page reads or writes, as its decoder gives them:
// 64-bit integers are bigint, sequences and arrays of numbers are typed arrays. Meaning, units and
// frames of each field stand in the IDL; test/messages.test.ts holds the numbers here against it.

/** A sequence or array of numbers as decoded; what is written may be a plain array. */
export type Numbers = Float32Array | Float64Array | number[];

export const POSE_IN_WORLD = 1;
export const POSE_STOP = 4;
export const POSE_GOODBYE = 8;

export const FORCE_TOUCHING = 4;
export const FORCE_HOLDING = 8;
export const FORCE_ENGAGED = 16;

/** Names for people, by bit: FAULT_POSE_STALE = 1 is the first. */
export const kFaultNames = [
  "pose late", "pose not finite", "quaternion", "pose jump", "pose rate", "pose order", "jaw range",
  "model late", "model not finite", "out of pivots", "force limit", "slew limit", "energy", "stopped",
  "tool in use",
];

/** Returns the names of the faults whose bits are set. */
export function faultNames(faults: number): string[] {
  return kFaultNames.filter((_, bit) => (faults & (1 << bit)) !== 0);
}

export enum ToolState { Idle, Rendering, Ramping, Clutched, Fault, Stopped, Paused }

export enum EventKind {
  Grasp, Release, GripSlip,
  Contact, ContactLost,
  Puncture, Exit, Retract,
  Taut, Slack, Unthread, Knot, Tear, Cut,
  Limit,
  Solver,
  ToolLeased, ToolReturned, ToolInUse,
  Fault, Recovered,
  Paused, Resumed, Reset, Stopped, Started,
  Overrun,
  Notice,
  Checkpoint, Rewound,
}

export enum ServerState { Starting, Running, Paused, Stopped, Leaving }

export enum CommandKind { Pause, Resume, Reset, Stop, ReleaseTool, Checkpoint, Rewind, Restore }

export enum CommandResult { Done, Refused, NotSupported }

export enum NeedleShape { Straight, Arc }

interface Stamped {
  epoch: bigint;
  sequence_number: bigint;
  stamp_ns: bigint;
}

export interface ToolPose extends Stamped {
  tool_id: bigint;
  position_m: Numbers;
  orientation_xyzw: Numbers;
  linear_velocity_m_per_s: Numbers;
  angular_velocity_rad_per_s: Numbers;
  jaw: number;
  buttons: number;
  flags: number;
}

export interface ToolForce extends Stamped {
  tool_id: bigint;
  device: Uint8Array;
  pose_sequence: bigint;
  pose_stamp_ns: bigint;
  force_n: Numbers;
  torque_nm: Numbers;
  state: ToolState;
  faults: number;
  flags: number;
  model_age_us: number;
}

export interface TriangleGroup {
  name: string;
  first_triangle: number;
  triangle_count: number;
}

export interface MeshTopology extends Stamped {
  body: string;
  revision: number;
  vertex: Uint32Array;
  rest_position_m: Float32Array;
  triangle: Uint32Array;
  groups: TriangleGroup[];
}

export interface MeshFrame extends Stamped {
  body: string;
  revision: number;
  step: bigint;
  simulation_time_s: number;
  position_m: Float32Array;
  von_mises_pa: Float32Array;
  principal_pa: Float32Array;
}

export interface ToolView extends Stamped {
  tool: string;
  kind: string;
  state: ToolState;
  faults: number;
  flags: number;
  position_m: Float64Array;
  orientation_xyzw: Float64Array;
  jaw: number;
  force_n: Float64Array;
  torque_nm: Float64Array;
  holding: string;
}

export interface Puncture {
  body: string;
  position_m: Float64Array;
  arc_length_m: number;
  inward: boolean;
}

export interface NeedleState extends Stamped {
  needle: string;
  shape: NeedleShape;
  radius_m: number;
  length_m: number;
  diameter_m: number;
  position_m: Float64Array;
  orientation_xyzw: Float64Array;
  holder: string;
  tip_inside: boolean;
  tip_force_n: number;
  embedded_length_m: number;
  course_m: Float64Array;
  punctures: Puncture[];
}

export interface ThreadState extends Stamped {
  thread: string;
  length_m: number;
  diameter_m: number;
  tension_n: number;
  slack_m: number;
  taut: boolean;
  course_m: Float64Array;
  segment_tension_n: Float64Array;
  punctures: Puncture[];
}

export interface ContactPoint {
  position_m: Float64Array;
  normal: Float64Array;
  force_n: number;
  gap_m: number;
  body: string;
  other: string;
}

export interface ContactState extends Stamped {
  points: ContactPoint[];
}

export interface Quality extends Stamped {
  thread: string;
  elapsed_s: number;
  needle_path_m: number;
  peak_force_n: number;
  peak_principal_stress_pa: number;
  gap_start_m: number;
  gap_m: number;
  bite_depth_mean_m: number;
  bite_spacing_mean_m: number;
  handovers: number;
  needle_drops: number;
  bites: unknown[];
}

export interface ServerEvent extends Stamped {
  kind: EventKind;
  simulation_time_s: number;
  subject: string;
  object: string;
  position_m: Float64Array;
  value: number;
  unit: string;
  faults: number;
  text: string;
}

export interface Percentiles {
  count: bigint;
  p50_us: number;
  p99_us: number;
  max_us: number;
}

export interface ToolStatus {
  tool: string;
  kind: string;
  leased: boolean;
  device: Uint8Array;
  state: ToolState;
  faults: number;
  fault_count: number;
  pose_rate_hz: number;
  force_rate_hz: number;
  force_n: number;
  peak_force_n: number;
  model_age_ms: number;
  max_force_n: number;
}

export interface ServerStatus extends Stamped {
  protocol_version: number;
  server_version: string;
  session: string;
  host: string;
  state: ServerState;
  state_reason: string;
  scene: string;
  simulation_time_s: number;
  rate_hz: number;
  achieved_rate_hz: number;
  overruns: bigint;
  step: Percentiles;
  wakeup: Percentiles;
  missed_ticks: bigint;
  bodies: number;
  vertices: number;
  tets: number;
  rows: number;
  active_rows: number;
  contacts: number;
  frame_rate_hz: number;
  devices: number;
  viewers: number;
  realtime_note: string;
  tools: ToolStatus[];
}

export interface CommandReply {
  request: bigint;
  kind: CommandKind;
  result: CommandResult;
  text: string;
}

/** What the page listens to, by topic. */
export interface Topics {
  "suture/event": ServerEvent;
  "suture/status": ServerStatus;
  "suture/command/reply": CommandReply;
  "suture/mesh/topology": MeshTopology;
  "suture/mesh/frame": MeshFrame;
  "suture/tool/state": ToolView;
  "suture/tool/force": ToolForce;
  "suture/needle": NeedleState;
  "suture/thread": ThreadState;
  "suture/contact": ContactState;
  "suture/quality": Quality;
}

export type Topic = keyof Topics;
