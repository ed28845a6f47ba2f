// SPDX-License-Identifier: Apache-2.0
// Courses of needles and threads, and how a hand comes to a place on one.
import {
  about, add, cross, dot, length, multiply, normalized, perpendicular, rotate, scale, subtract, unit, type Pose, type Quat, type Vec3,
} from "../maths/vector";

/** Returns the i-th point of a course. */
export const point = (course: ArrayLike<number>, i: number): Vec3 => [course[3 * i]!, course[3 * i + 1]!, course[3 * i + 2]!];

/** Returns the points of a course as it travels, three numbers each. */
export const pointsOf = (course: ArrayLike<number>): Vec3[] => Array.from({ length: Math.floor(course.length / 3) }, (_, i) => point(course, i));

export function lengthOf(points: readonly Vec3[]): number {
  let total = 0;
  for (let i = 1; i < points.length; ++i) total += length(subtract(points[i]!, points[i - 1]!));
  return total;
}

export interface Place {
  at: Vec3;
  along: Vec3;
}

/** Returns the place `way_m` along `points`; beyond them undefined. */
export function placeAlong(points: readonly Vec3[], way_m: number): Place | undefined {
  let left = way_m;
  for (let i = 1; i < points.length; ++i) {
    const way = subtract(points[i]!, points[i - 1]!);
    const step = length(way);
    if (left <= step && step > 0) return { at: add(points[i - 1]!, scale(way, left / step)), along: normalized(way) };
    left -= step;
  }
  return undefined;
}

/** Returns the point of a course at `share` of its length. */
export function pointAt(course: ArrayLike<number>, share: number): Vec3 {
  const points = pointsOf(course);
  return placeAlong(points, share * lengthOf(points))?.at ?? points[points.length - 1]!;
}

/** Returns how far `at` is from a course, in metres; infinity for an empty one. */
export function distanceToCourse(course: ArrayLike<number>, at: Vec3): number {
  let best = Infinity;
  for (let i = 0; 3 * i + 2 < course.length; ++i) {
    const a = point(course, i);
    const way = 3 * i + 5 < course.length ? subtract(point(course, i + 1), a) : ([0, 0, 0] as Vec3);
    const n2 = dot(way, way);
    const share = n2 > 0 ? Math.min(1, Math.max(0, dot(subtract(at, a), way) / n2)) : 0;
    best = Math.min(best, length(subtract(at, add(a, scale(way, share)))));
  }
  return best;
}

/** Returns `orientation` turned the short way so that its z axis, the shaft, is along `shaft`. */
export function alignShaft(orientation: Quat, shaft: Vec3): Quat {
  const now = rotate(orientation, [0, 0, 1]);
  const axis = cross(now, shaft);
  const angle = Math.atan2(length(axis), dot(now, shaft));
  return unit(multiply(about(normalized(axis, perpendicular(now)), angle), orientation));
}

/** How far before a place a hand stops first, so that it comes along its own shaft. */
const kStandOff_m = 0.012;

/** Returns the poses on the way of an open jaw from `from` to `at`, its shaft along `shaft`. */
export function comeAlong(from: Pose, at: Vec3, shaft: Vec3): Pose[] {
  const orientation = alignShaft(from.orientation, shaft);
  return [
    { position: add(at, scale(shaft, kStandOff_m)), orientation },
    { position: at, orientation },
  ];
}
