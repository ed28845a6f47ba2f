// SPDX-License-Identifier: Apache-2.0
import { Color, InstancedMesh, Matrix4, MeshStandardMaterial, Quaternion, TorusGeometry, Vector3 } from "three";
import type { Puncture } from "../protocol/messages";
import type { Vec3 } from "../maths/vector";

const kMost = 512;
const kAxis = new Vector3(0, 0, 1);
const kInward = new Color("#27c4f5");
const kOutward = new Color("#ffd166");

/** A ring around needle or thread wherever it passes a surface. */
export class Punctures {
  readonly mesh = new InstancedMesh(
    new TorusGeometry(1, 0.26, 10, 28),
    new MeshStandardMaterial({ roughness: 0.35, metalness: 0.1, emissive: 0xffffff, emissiveIntensity: 0.06 }),
    kMost,
  );
  #count = 0;

  constructor() {
    this.mesh.frustumCulled = false;
    this.mesh.count = 0;
    this.mesh.visible = false;
  }

  begin(): void {
    this.#count = 0;
  }

  /** Adds the punctures of one needle or thread with its course. */
  add(punctures: readonly Puncture[], course: ArrayLike<number>, radius_m: number): void {
    const turn = new Quaternion();
    for (const puncture of punctures) {
      if (this.#count === kMost) return;
      const at = [...puncture.position_m] as Vec3;
      turn.setFromUnitVectors(kAxis, new Vector3(...tangentAt(course, at)));
      const size = new Vector3(radius_m, radius_m, radius_m);
      this.mesh.setMatrixAt(this.#count, new Matrix4().compose(new Vector3(...at), turn, size));
      this.mesh.setColorAt(this.#count, puncture.inward ? kInward : kOutward);
      ++this.#count;
    }
  }

  end(): void {
    this.mesh.count = this.#count;
    this.mesh.visible = this.#count > 0;
    this.mesh.instanceMatrix.needsUpdate = true;
    if (this.mesh.instanceColor) this.mesh.instanceColor.needsUpdate = true;
  }
}

/** Returns the direction of `course` where it is nearest to `at`. */
function tangentAt(course: ArrayLike<number>, at: Vec3): Vec3 {
  let best = Infinity;
  let tangent: Vec3 = [0, 0, 1];
  for (let i = 0; i + 5 < course.length; i += 3) {
    const d: Vec3 = [course[i + 3]! - course[i]!, course[i + 4]! - course[i + 1]!, course[i + 5]! - course[i + 2]!];
    const n = Math.hypot(...d);
    if (n < 1e-9) continue;
    const middle = [0, 1, 2].map((k) => (course[i + k]! + course[i + 3 + k]!) / 2 - at[k]!);
    const distance = Math.hypot(...middle) - n / 2;
    if (distance < best) {
      best = distance;
      tangent = [d[0] / n, d[1] / n, d[2] / n];
    }
  }
  return tangent;
}
