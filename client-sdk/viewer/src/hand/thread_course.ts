// SPDX-License-Identifier: Apache-2.0
// Where a hand takes a thread.
import { dot, length, normalized, perpendicular, scale, subtract, type Pose, type Vec3 } from "../maths/vector";
import type { ThreadState } from "../protocol/messages";
import { comeAlong, lengthOf, placeAlong, pointsOf, type Place } from "./course";

/** So far from the tissue, where there is as much of it. */
const kFromTissue_m = 0.012;
/** Less than that of a free end is nothing to take. */
const kEndMin_m = 0.002;

/** Returns the place so far from the tissue, or half-way where the end is shorter than twice that; none on a stump. */
function placeOnEnd(points: readonly Vec3[], way_m: number): Place | undefined {
  const whole_m = lengthOf(points);
  return whole_m < kEndMin_m ? undefined : placeAlong(points, Math.min(way_m, whole_m / 2));
}

/**
 * Returns where a jaw takes `thread`: outside the tissue beyond its last puncture towards the head, or
 * where no end is left there, towards the tail; of a thread that is in no tissue, its middle.
 */
export function threadPlace(thread: ThreadState): Place | undefined {
  const course = pointsOf(thread.course_m);
  if (thread.punctures.length === 0) return placeOnEnd(course, Infinity);
  const nearest = (puncture: Vec3) => {
    let best = 0;
    for (let i = 1; i < course.length; ++i)
      if (length(subtract(course[i]!, puncture)) < length(subtract(course[best]!, puncture))) best = i;
    return best;
  };
  const at = (i: number) => [...thread.punctures[i]!.position_m] as Vec3;
  const head = course.slice(0, nearest(at(0)) + 1).reverse();
  const tail = course.slice(nearest(at(thread.punctures.length - 1)));
  return placeOnEnd(head, kFromTissue_m) ?? placeOnEnd(tail, kFromTissue_m);
}

/** Returns the poses on the way of an open jaw to that place: across the thread, from the side of `towards` (the eye). */
export function reachThread(from: Pose, place: Place, towards: Vec3): Pose[] {
  const across = subtract(towards, scale(place.along, dot(towards, place.along)));
  return comeAlong(from, place.at, normalized(across, perpendicular(place.along)));
}
