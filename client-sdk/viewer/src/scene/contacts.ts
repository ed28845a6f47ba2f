// SPDX-License-Identifier: Apache-2.0
import { Color, Group, InstancedMesh, Matrix4, MeshBasicMaterial, SphereGeometry } from "three";
import { add, normalized, scale, type Vec3 } from "../maths/vector";
import type { ContactState } from "../protocol/messages";
import { Arrows, type Arrow } from "./arrows";

const kMost = 512;
const kPressed = new Color("#ff5d73");
const kNear = new Color("#9fb3c8");
const kSilent_n = 1e-4;

/** Pairs in contact: a dot each, and its normal force as an arrow. */
export class Contacts {
  readonly group = new Group();
  readonly #dots = new InstancedMesh(new SphereGeometry(1, 10, 8), new MeshBasicMaterial(), kMost);
  readonly #arrows = new Arrows(kMost);
  #shown: ContactState | undefined;
  #latest: ContactState | undefined;

  constructor() {
    this.#dots.frustumCulled = false;
    this.#dots.count = 0;
    this.#dots.visible = false;
    this.group.add(this.#dots, this.#arrows.group);
  }

  push(state: ContactState): void {
    this.#latest = state;
  }

  clear(): void {
    this.#latest = undefined;
  }

  /** `length_m_per_n` scales the arrows. */
  update(dot_m: number, length_m_per_n: number): void {
    if (this.#shown === this.#latest) return;
    this.#shown = this.#latest;
    const points = (this.#latest?.points ?? []).filter((p) => p.force_n > kSilent_n || p.gap_m < dot_m).slice(0, kMost);
    const arrows: Arrow[] = [];
    points.forEach((point, i) => {
      const at = [...point.position_m] as Vec3;
      const pressed = point.force_n > kSilent_n;
      const size = pressed ? dot_m : 0.6 * dot_m;
      this.#dots.setMatrixAt(i, new Matrix4().makeScale(size, size, size).setPosition(...at));
      this.#dots.setColorAt(i, pressed ? kPressed : kNear);
      if (!pressed) return;
      const normal = normalized([...point.normal] as Vec3);
      const length = Math.min(12 * dot_m, Math.max(4 * dot_m, point.force_n * length_m_per_n));
      arrows.push({ from: add(at, scale(normal, dot_m)), vector: scale(normal, length), radius_m: 0.28 * dot_m, colour: kPressed });
    });
    this.#dots.count = points.length;
    this.#dots.visible = points.length > 0;
    this.#dots.instanceMatrix.needsUpdate = true;
    if (this.#dots.instanceColor) this.#dots.instanceColor.needsUpdate = true;
    this.#arrows.set(arrows);
  }
}
