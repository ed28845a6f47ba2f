// SPDX-License-Identifier: Apache-2.0
// Where to look from. A scene has no front: it is found from its shape and from the needle.
import { add, cross, dot, length, normalized, scale, subtract, type Vec3 } from "../maths/vector";

export interface Box {
  min: Vec3;
  max: Vec3;
}

export interface SceneAxes {
  centre: Vec3;
  radius: number;
  /** The long way of the scene: from left to right. */
  along: Vec3;
  up: Vec3;
  /** Towards whoever looks. */
  front: Vec3;
}

export const kPresets = ["Overview", "Front", "Side", "Top", "Needle"] as const;
export type Preset = (typeof kPresets)[number];

/** Returns the preset of that name, however it is capitalised. */
export const presetNamed = (name: string): Preset | undefined =>
  kPresets.find((preset) => preset.toLowerCase() === name.toLowerCase());

/** Returns the axes of a scene within `box` whose needle, if any, is at `needle`: it lies in front. */
export function sceneAxes(box: Box, needle?: Vec3): SceneAxes {
  const size = subtract(box.max, box.min);
  const centre = scale(add(box.min, box.max), 0.5);
  const axes: Vec3[] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const longest = [0, 1, 2].reduce((a, b) => (size[b]! > size[a]! * 1.02 ? b : a), 2);
  const along = axes[longest]!;
  let front = needle ? subtract(needle, centre) : ([0, 0, 0] as Vec3);
  front = subtract(front, scale(along, dot(front, along)));
  if (length(front) < 0.05 * length(size)) front = axes[longest === 1 ? 0 : longest === 2 ? 0 : 2]!;
  // To the nearest axis of the world: a view from straight ahead reads best.
  const nearest = [0, 1, 2].reduce((a, b) => (Math.abs(front[b]!) > Math.abs(front[a]!) ? b : a), 0);
  front = scale(axes[nearest]!, front[nearest]! < 0 ? -1 : 1);
  let up = cross(front, along);
  let across = along;
  // Keep the world's y or z pointing up where that can be chosen.
  if (up.reduce((sum, c) => sum + c, 0) < 0) {
    up = scale(up, -1);
    across = scale(along, -1);
  }
  return { centre, radius: 0.5 * length(size), along: across, up, front };
}

export interface CameraPlace {
  position: Vec3;
  target: Vec3;
}

/** Returns the place of `preset` for a camera of `fov_rad` (vertical) and `aspect`. */
export function presetPlace(preset: Preset, axes: SceneAxes, fov_rad: number, aspect: number, needle?: Vec3): CameraPlace {
  const narrow = Math.min(1, aspect);
  const away = (axes.radius * 0.92) / Math.sin(fov_rad / 2) / narrow;
  const { centre, along, up, front } = axes;
  const from = (direction: Vec3, target = centre, distance = away): CameraPlace => ({
    position: add(target, scale(normalized(direction), distance)),
    target,
  });
  switch (preset) {
    case "Overview":
      return from(add(add(front, scale(up, 0.42)), scale(along, 0.24)));
    case "Front":
      return from(front);
    case "Side":
      return from(add(along, scale(front, 1e-3)));
    case "Top":
      return from(add(up, scale(front, 1e-3)));
    case "Needle":
      return from(add(add(front, scale(up, 0.6)), scale(along, 0.25)), needle ?? centre, 0.6 * away);
  }
}
