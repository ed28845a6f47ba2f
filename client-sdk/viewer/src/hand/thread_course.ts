// SPDX-License-Identifier: Apache-2.0
// Where a hand takes a thread.
import { add, dot, length, normalized, perpendicular, scale, subtract, type Pose, type Vec3 } from "../maths/vector";
import type { ThreadState } from "../protocol/messages";
import { alignShaft, point } from "./needle_course";

/** So far from the tissue, where there is as much of it. */
const kFromTissue_m = 0.012;
/** Less than that of a free end is nothing to take. */
const kEndMin_m = 0.002;
/** How far before the thread a hand stops first, so that it comes along its own shaft. */
const kStandOff_m = 0.012;

interface Place {
  at: Vec3;
  along: Vec3;
}

/** Returns the place `way_m` along `points`, or half-way where they are shorter than twice that. */
function placeAlong(points: readonly Vec3[], way_m: number): Place | undefined {
  let total = 0;
  for (let i = 1; i < points.length; ++i) total += length(subtract(points[i]!, points[i - 1]!));
  if (total < kEndMin_m) return undefined;
  let left = Math.min(way_m, total / 2);
  for (let i = 1; i < points.length; ++i) {
    const way = subtract(points[i]!, points[i - 1]!);
    const step = length(way);
    if (left <= step && step > 0) return { at: add(points[i - 1]!, scale(way, left / step)), along: normalized(way) };
    left -= step;
  }
  return undefined;
}

/**
 * Returns where a jaw takes `thread`: outside the tissue beyond its last puncture towards the head, or
 * where no end is left there, towards the tail; of a thread that is in no tissue, its middle.
 */
export function threadPlace(thread: ThreadState): Place | undefined {
  const course = Array.from({ length: thread.course_m.length / 3 }, (_, i) => point(thread.course_m, i));
  if (thread.punctures.length === 0) return placeAlong(course, Infinity);
  const nearest = (puncture: Vec3) => {
    let best = 0;
    for (let i = 1; i < course.length; ++i)
      if (length(subtract(course[i]!, puncture)) < length(subtract(course[best]!, puncture))) best = i;
    return best;
  };
  const at = (i: number) => [...thread.punctures[i]!.position_m] as Vec3;
  const head = course.slice(0, nearest(at(0)) + 1).reverse();
  const tail = course.slice(nearest(at(thread.punctures.length - 1)));
  return placeAlong(head, kFromTissue_m) ?? placeAlong(tail, kFromTissue_m);
}

/** Returns the poses on the way of an open jaw to that place: across the thread, from the side of `towards` (the eye). */
export function reachThread(from: Pose, place: Place, towards: Vec3): Pose[] {
  const across = subtract(towards, scale(place.along, dot(towards, place.along)));
  const shaft = normalized(across, perpendicular(place.along));
  const orientation = alignShaft(from.orientation, shaft);
  return [
    { position: add(place.at, scale(shaft, kStandOff_m)), orientation },
    { position: place.at, orientation },
  ];
}
