// SPDX-License-Identifier: Apache-2.0
// The page as a device: poses of one tool a hundred and more times a second, forces back, the lease.
// Runs in the worker, so that a slow picture never makes a pose late.
import type { HandReport, LeaseState } from "../connection/worker_messages";
import type { Pose, Vec3 } from "../maths/vector";
import {
  POSE_GOODBYE, POSE_IN_WORLD, ToolState, type ToolForce, type ToolPose, type ToolStatus,
} from "../protocol/messages";
import { toolId } from "../protocol/fnv";
import { PosePacer } from "./pacer";

/** 125 Hz; a server lets a pointer rest for 150 ms. */
export const kPosePeriod_ms = 8;
/** A page that says nothing for so long has lost its hand. */
export const kSilence_ms = 1500;
/** Without an answer for so long somebody else holds the tool. */
const kAnswer_ms = 700;
/** Poses whose answer may still come. */
const kSent = 256;

export interface Clock {
  /** Milliseconds since the Unix epoch with fractions, never backwards. */
  nowMs(): number;
}

/** Where poses go; the profile says that this hand is a pointer. */
export interface HandOutput {
  sendPose(pose: ToolPose): void;
  sendProfile(tool: string): void;
  report(report: HandReport): void;
}

/** Returns a report of a tool of which nothing was heard yet. */
export function firstReport(tool: string, lease: LeaseState, pose: Pose, jaw: number): HandReport {
  return {
    tool, lease, pose, jaw, force: [0, 0, 0], torque: [0, 0, 0], state: ToolState.Idle, faults: 0,
    roundTripMs: undefined, poseRateHz: 0,
  };
}

export class HandDevice {
  readonly #tool: string;
  readonly #id: bigint;
  readonly #clock: Clock;
  readonly #output: HandOutput;
  readonly #pacer: PosePacer;
  readonly #startedMs: number;
  readonly #sent = new Map<bigint, bigint>();
  #sequence: bigint;
  #epoch = 0n;
  #heardMs: number;
  #answeredMs: number | undefined;
  #heldByOther = false;
  #report: HandReport;
  #ticks: number[] = [];

  /** `sequence` is of the last pose that this connection sent for any tool. */
  constructor(tool: string, pose: Pose, jaw: number, sequence: bigint, clock: Clock, output: HandOutput) {
    this.#tool = tool;
    this.#id = toolId(tool);
    this.#clock = clock;
    this.#output = output;
    this.#sequence = sequence;
    this.#startedMs = this.#heardMs = clock.nowMs();
    this.#pacer = new PosePacer(pose, jaw, this.#startedMs / 1000);
    this.#report = firstReport(tool, "asking", pose, jaw);
    output.sendProfile(tool);
  }

  get tool(): string {
    return this.#tool;
  }

  get sequence(): bigint {
    return this.#sequence;
  }

  set epoch(epoch: bigint) {
    this.#epoch = epoch;
  }

  /** The hand's word: where it wants to be. Also says that the page lives. */
  aim(pose: Pose, jaw: number): void {
    this.#heardMs = this.#clock.nowMs();
    this.#pacer.aim(pose, jaw);
  }

  /** Sends the next pose. Returns false where the hand has fallen silent: say goodbye then. */
  tick(): boolean {
    const nowMs = this.#clock.nowMs();
    if (nowMs - this.#heardMs > kSilence_ms) return false;
    const paced = this.#pacer.step(nowMs / 1000);
    const stamp = this.#send(POSE_IN_WORLD, paced, paced.jaw, paced.linearVelocity_m_per_s,
      paced.angularVelocity_rad_per_s);
    this.#sent.set(this.#sequence, stamp);
    this.#sent.delete(this.#sequence - BigInt(kSent));

    this.#ticks.push(nowMs);
    while (this.#ticks.length > 1 && nowMs - this.#ticks[0]! > 1000) this.#ticks.shift();
    const span = nowMs - this.#ticks[0]!;
    this.#report = {
      ...this.#report,
      lease: this.#lease(nowMs),
      ...(this.#answered(nowMs) ? {} : { force: [0, 0, 0] as Vec3, torque: [0, 0, 0] as Vec3, roundTripMs: undefined }),
      pose: { position: paced.position, orientation: paced.orientation },
      jaw: paced.jaw,
      poseRateHz: span > 0 ? ((this.#ticks.length - 1) / span) * 1000 : 0,
    };
    return true;
  }

  /** Gives the lease back. */
  goodbye(): void {
    const { pose, jaw } = this.#report;
    this.#send(POSE_IN_WORLD | POSE_GOODBYE, pose, jaw, [0, 0, 0], [0, 0, 0]);
    this.end();
  }

  /** Tells that the hold ended, without a word to the server; `why` for people. */
  end(why?: string): void {
    this.#report = { ...this.#report, lease: "none", why, force: [0, 0, 0], torque: [0, 0, 0] };
    this.tell();
  }

  /** Takes a force. Whether it answers one of our poses, and not another's, its echo tells. */
  onForce(force: ToolForce): void {
    if (force.tool_id !== this.#id) return;
    const stamp = this.#sent.get(force.pose_sequence);
    if (stamp === undefined || stamp !== force.pose_stamp_ns) return;
    const nowMs = this.#clock.nowMs();
    this.#answeredMs = nowMs;
    this.#heldByOther = false;
    this.#report = {
      ...this.#report,
      force: [...force.force_n] as Vec3,
      torque: [...force.torque_nm] as Vec3,
      state: force.state,
      faults: force.faults,
      roundTripMs: nowMs - Number(force.pose_stamp_ns / 1000n) / 1000,
    };
  }

  /** Takes what the server says of this tool. */
  onStatus(status: ToolStatus | undefined): void {
    this.#heldByOther = !this.#answered(this.#clock.nowMs()) && status?.leased === true;
  }

  tell(): void {
    this.#output.report(this.#report);
  }

  #answered(nowMs: number): boolean {
    return this.#answeredMs !== undefined && nowMs - this.#answeredMs < kAnswer_ms;
  }

  #lease(nowMs: number): LeaseState {
    if (this.#answered(nowMs)) return "held";
    return this.#heldByOther && nowMs - this.#startedMs > kAnswer_ms ? "refused" : "asking";
  }

  #send(flags: number, pose: Pose, jaw: number, linear: Vec3, angular: Vec3): bigint {
    const stamp_ns = BigInt(Math.round(this.#clock.nowMs() * 1000)) * 1000n;
    this.#sequence += 1n;
    this.#output.sendPose({
      tool_id: this.#id,
      epoch: this.#epoch,
      sequence_number: this.#sequence,
      stamp_ns,
      position_m: pose.position,
      orientation_xyzw: pose.orientation,
      linear_velocity_m_per_s: linear,
      angular_velocity_rad_per_s: angular,
      jaw: Math.min(1, Math.max(0, jaw)),
      buttons: 0,
      flags,
    });
    return stamp_ns;
  }
}
