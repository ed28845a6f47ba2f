// SPDX-License-Identifier: Apache-2.0
// Points and unit quaternions (x, y, z, w) as plain arrays: the pure parts of the page need no three.js.

export type Vec3 = [number, number, number];
export type Quat = [number, number, number, number];

export interface Pose {
  position: Vec3;
  orientation: Quat;
}

export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a: Vec3, s: number): Vec3 => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a: Vec3): number => Math.hypot(a[0], a[1], a[2]);
export const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];

/** Returns `a` at unit length, or `otherwise` where it has none. */
export function normalized(a: Vec3, otherwise: Vec3 = [0, 0, 1]): Vec3 {
  const n = length(a);
  return n > 1e-12 ? scale(a, 1 / n) : otherwise;
}

/** Returns a unit vector at right angles to `a`. */
export function perpendicular(a: Vec3): Vec3 {
  const [x, y, z] = a.map(Math.abs) as Vec3;
  const axis: Vec3 = x <= y && x <= z ? [1, 0, 0] : y <= z ? [0, 1, 0] : [0, 0, 1];
  return normalized(cross(a, axis));
}

export function multiply(a: Quat, b: Quat): Quat {
  return [
    a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
    a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
    a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
    a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
  ];
}

export const conjugate = (q: Quat): Quat => [-q[0], -q[1], -q[2], q[3]];

export function unit(q: Quat): Quat {
  const n = Math.hypot(...q);
  return n > 1e-12 ? [q[0] / n, q[1] / n, q[2] / n, q[3] / n] : [0, 0, 0, 1];
}

export function rotate(q: Quat, v: Vec3): Vec3 {
  const u: Vec3 = [q[0], q[1], q[2]];
  const t = scale(cross(u, v), 2);
  return add(add(v, scale(t, q[3])), cross(u, t));
}

/** Returns the turn by `angle` radians about the unit `axis`. */
export function about(axis: Vec3, angle: number): Quat {
  const s = Math.sin(angle / 2);
  return [axis[0] * s, axis[1] * s, axis[2] * s, Math.cos(angle / 2)];
}

/** Returns the rotation vector (axis times angle, radians) of `q`, the short way. */
export function rotationVector(q: Quat): Vec3 {
  const sign = q[3] < 0 ? -1 : 1;
  const v: Vec3 = [sign * q[0], sign * q[1], sign * q[2]];
  const s = length(v);
  return s < 1e-12 ? scale(v, 2) : scale(v, (2 * Math.atan2(s, sign * q[3])) / s);
}

/** Returns the turn from `a` to `b`, in world axes, as a rotation vector. */
export const turnBetween = (a: Quat, b: Quat): Vec3 => rotationVector(multiply(b, conjugate(a)));

/** Returns `pose` turned by the rotation vector `turn` about `centre`. */
export function turnedAbout(pose: Pose, centre: Vec3, turn: Vec3): Pose {
  const angle = length(turn);
  const q = about(normalized(turn), angle);
  return {
    position: add(centre, rotate(q, subtract(pose.position, centre))),
    orientation: unit(multiply(q, pose.orientation)),
  };
}

/** Returns the rotation whose columns are the orthonormal right-handed axes x, y, z. */
export function fromAxes(x: Vec3, y: Vec3, z: Vec3): Quat {
  const trace = x[0] + y[1] + z[2];
  if (trace > 0) {
    const s = 2 * Math.sqrt(trace + 1);
    return unit([(y[2] - z[1]) / s, (z[0] - x[2]) / s, (x[1] - y[0]) / s, s / 4]);
  }
  if (x[0] > y[1] && x[0] > z[2]) {
    const s = 2 * Math.sqrt(1 + x[0] - y[1] - z[2]);
    return unit([s / 4, (y[0] + x[1]) / s, (z[0] + x[2]) / s, (y[2] - z[1]) / s]);
  }
  if (y[1] > z[2]) {
    const s = 2 * Math.sqrt(1 + y[1] - x[0] - z[2]);
    return unit([(y[0] + x[1]) / s, s / 4, (z[1] + y[2]) / s, (z[0] - x[2]) / s]);
  }
  const s = 2 * Math.sqrt(1 + z[2] - x[0] - y[1]);
  return unit([(z[0] + x[2]) / s, (z[1] + y[2]) / s, s / 4, (x[1] - y[0]) / s]);
}

/** Returns the rotation that takes the tool's z axis, its shaft, to the unit `shaft`. */
export function shaftAlong(shaft: Vec3, up: Vec3 = [0, 1, 0]): Quat {
  let x = cross(up, shaft);
  x = length(x) < 1e-6 ? perpendicular(shaft) : normalized(x);
  return fromAxes(x, cross(shaft, x), shaft);
}
