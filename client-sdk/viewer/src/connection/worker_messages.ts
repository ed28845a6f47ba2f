// SPDX-License-Identifier: Apache-2.0
// What the page and its worker tell each other.
import type { Pose, Vec3 } from "../maths/vector";
import type { CommandKind, Topic, Topics } from "../protocol/messages";

/** `refused`: the server answers, and the token is missing or wrong; nothing is tried again by itself. */
export type ConnectionState =
  | { phase: "connecting"; attempt: number }
  | { phase: "open" }
  | { phase: "lost"; attempt: number; retryAtMs: number; everOpen: boolean; refused: boolean };

/** How it stands with the lease of the tool that this page asks for. */
export type LeaseState = "none" | "asking" | "held" | "refused";

/** The hand as its worker sees it. Forces in newtons, world axes, on the hand. */
export interface HandReport {
  tool: string;
  lease: LeaseState;
  /** Where the worker ended the hold by itself: why, for people. */
  why?: string;
  pose: Pose;
  jaw: number;
  force: Vec3;
  torque: Vec3;
  state: number;
  faults: number;
  roundTripMs: number | undefined;
  poseRateHz: number;
}

export type ToWorker =
  | { type: "connect"; url: string }
  | { type: "retry" }
  | { type: "command"; kind: CommandKind; tool: string }
  | { type: "hand_take"; tool: string; pose: Pose; jaw: number }
  | { type: "hand_target"; pose: Pose; jaw: number }
  | { type: "hand_release" };

export type DataMessage = { [T in Topic]: { type: "data"; topic: T; message: Topics[T]; bytes: number } }[Topic];

export type FromWorker =
  | { type: "connection"; state: ConnectionState }
  | DataMessage
  | { type: "hand"; report: HandReport }
  | { type: "notice"; text: string };
