// SPDX-License-Identifier: Apache-2.0
// What a hand needs to know of a needle: which way it goes, and where to take it.
import {
  add, conjugate, cross, dot, length, normalized, perpendicular, rotate, scale, subtract, turnedAbout, type Pose, type Quat, type Vec3,
} from "../maths/vector";
import { NeedleShape, type NeedleState } from "../protocol/messages";
import { comeAlong, point, pointAt } from "./course";

export type NeedleMotion =
  /** Positive turns about `axis` take the tip forward. */
  | { kind: "arc"; centre: Vec3; axis: Vec3; radius_m: number }
  | { kind: "straight"; direction: Vec3 };

/** Returns the motion along the needle's own axis, tip first, in the world. */
export function needleMotion(needle: NeedleState): NeedleMotion {
  const orientation = [...needle.orientation_xyzw] as Quat;
  const tip = point(needle.course_m, 0);
  const behind = point(needle.course_m, 1);
  if (needle.shape !== NeedleShape.Arc) return { kind: "straight", direction: normalized(subtract(tip, behind)) };
  const centre = [...needle.position_m] as Vec3;
  const axis = rotate(orientation, [0, 0, 1]);
  const forward = dot(cross(subtract(behind, centre), subtract(tip, behind)), axis);
  return { kind: "arc", centre, axis: forward < 0 ? scale(axis, -1) : axis, radius_m: needle.radius_m };
}

/** The place and turn of `motion` as seen from a tool that holds the needle at `tool`, moved to `target`. */
export function carried(motion: NeedleMotion, tool: Pose, target: Pose): NeedleMotion {
  const turn = (v: Vec3): Vec3 => rotate(target.orientation, rotate(conjugate(tool.orientation), v));
  if (motion.kind === "straight") return { kind: "straight", direction: turn(motion.direction) };
  return { ...motion, axis: turn(motion.axis), centre: add(target.position, turn(subtract(motion.centre, tool.position))) };
}

/** Returns `pose` after its needle went `way_m` forward along its own axis. */
export function driven(pose: Pose, motion: NeedleMotion, way_m: number): Pose {
  if (motion.kind === "straight") return { ...pose, position: add(pose.position, scale(motion.direction, way_m)) };
  return turnedAbout(pose, motion.centre, scale(motion.axis, way_m / motion.radius_m));
}

/** From the tip: where a jaw that is near the tip, or near the tail, takes a needle. */
const kNearTip = 0.12;
const kNearTail = 0.88;

/**
 * Returns where on the needle a second or first jaw should close, as a share of its length from the
 * tip: at the end that has more of it free, and away from who holds it.
 */
export function graspShare(needle: NeedleState, holder: Vec3 | undefined): number {
  if (holder) {
    const away = (share: number) => length(subtract(pointAt(needle.course_m, share), holder));
    return away(kNearTip) > away(kNearTail) ? kNearTip : kNearTail;
  }
  const arcs = needle.punctures.map((puncture) => puncture.arc_length_m);
  if (arcs.length === 0) return needle.embedded_length_m > 0 && !needle.tip_inside ? kNearTip : kNearTail;
  return Math.min(...arcs) > needle.length_m - Math.max(...arcs) ? kNearTip : kNearTail;
}

/**
 * Returns the poses on the way of an open jaw to the needle. The shaft stands across the needle's plane,
 * on the side of `towards` (the eye), or opposite to the shaft of who holds the needle.
 */
export function reachNeedle(from: Pose, needle: NeedleState, towards: Vec3, holder: Pose | undefined): Pose[] {
  const motion = needleMotion(needle);
  let shaft = motion.kind === "arc" ? motion.axis : perpendicular(motion.direction);
  const side = holder ? scale(rotate(holder.orientation, [0, 0, 1]), -1) : towards;
  if (dot(shaft, side) < 0) shaft = scale(shaft, -1);
  return comeAlong(from, pointAt(needle.course_m, graspShare(needle, holder?.position)), shaft);
}
