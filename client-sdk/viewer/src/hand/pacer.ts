// SPDX-License-Identifier: Apache-2.0
// Turns where the pointer is into poses that a hand could make: a server that sees a tool jump takes
// its force away. Pure: times are arguments.
import {
  about, add, length, multiply, normalized, scale, subtract, turnBetween, unit, type Pose, type Vec3,
} from "../maths/vector";

/** Far below what scenes allow (2 m/s by default, 60 rad/s). */
export const kMaxSpeed_m_per_s = 0.25;
export const kMaxSpin_rad_per_s = 4;
const kMaxJawRate_per_s = 5;
/** The pose follows its target like a first-order lag: a mouse moves in steps, a hand does not. */
const kLag_s = 0.03;
/** A late timer does not make up for what it missed. */
const kLongestStep_s = 0.012;

export interface PacedPose extends Pose {
  jaw: number;
  linearVelocity_m_per_s: Vec3;
  angularVelocity_rad_per_s: Vec3;
}

/** Moves a pose towards a target, smoothly and within the limits of speed above. */
export class PosePacer {
  #pose: PacedPose;
  #target: Pose & { jaw: number };
  #time_s: number;

  constructor(pose: Pose, jaw: number, time_s: number) {
    this.#pose = { ...pose, jaw, linearVelocity_m_per_s: [0, 0, 0], angularVelocity_rad_per_s: [0, 0, 0] };
    this.#target = { ...pose, jaw };
    this.#time_s = time_s;
  }

  /** Sets where the hand wants to be. A target that is not finite is ignored. */
  aim(pose: Pose, jaw: number): void {
    if (![...pose.position, ...pose.orientation, jaw].every(Number.isFinite)) return;
    this.#target = { position: pose.position, orientation: unit(pose.orientation), jaw: Math.min(1, Math.max(0, jaw)) };
  }

  /** Returns the pose at `time_s`, later than the one before. */
  step(time_s: number): PacedPose {
    const elapsed_s = Math.max(time_s - this.#time_s, 1e-6);
    const step_s = Math.min(elapsed_s, kLongestStep_s);
    this.#time_s = time_s;
    const share = 1 - Math.exp(-step_s / kLag_s);

    const way = limited(scale(subtract(this.#target.position, this.#pose.position), share), kMaxSpeed_m_per_s * step_s);
    const turn = limited(scale(turnBetween(this.#pose.orientation, this.#target.orientation), share),
      kMaxSpin_rad_per_s * step_s);
    const jawStep = kMaxJawRate_per_s * step_s;
    this.#pose = {
      position: add(this.#pose.position, way),
      orientation: unit(multiply(about(normalized(turn), length(turn)), this.#pose.orientation)),
      jaw: this.#pose.jaw + Math.min(jawStep, Math.max(-jawStep, this.#target.jaw - this.#pose.jaw)),
      linearVelocity_m_per_s: scale(way, 1 / elapsed_s),
      angularVelocity_rad_per_s: scale(turn, 1 / elapsed_s),
    };
    return this.#pose;
  }
}

function limited(v: Vec3, most: number): Vec3 {
  const n = length(v);
  return n > most ? scale(v, most / n) : v;
}
