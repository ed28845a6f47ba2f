// SPDX-License-Identifier: Apache-2.0
import { Color, ConeGeometry, CylinderGeometry, Group, InstancedMesh, Matrix4, MeshStandardMaterial, Quaternion, Vector3 } from "three";
import type { Vec3 } from "../maths/vector";

export interface Arrow {
  from: Vec3;
  /** From there to the head's tip. */
  vector: Vec3;
  radius_m: number;
  colour: Color;
}

const kUp = new Vector3(0, 1, 0);

/** A bounded number of arrows, drawn at once. */
export class Arrows {
  readonly group = new Group();
  readonly #shafts: InstancedMesh;
  readonly #heads: InstancedMesh;
  readonly #most: number;

  constructor(most: number) {
    this.#most = most;
    const material = new MeshStandardMaterial({ roughness: 0.45, metalness: 0.1 });
    this.#shafts = new InstancedMesh(new CylinderGeometry(1, 1, 1, 12).translate(0, 0.5, 0), material, most);
    this.#heads = new InstancedMesh(new ConeGeometry(1, 1, 20).translate(0, 0.5, 0), material, most);
    for (const mesh of [this.#shafts, this.#heads]) {
      mesh.frustumCulled = false;
      mesh.setColorAt(0, new Color());  // its program differs from one of a mesh without colours
      mesh.count = 0;
      mesh.visible = false;
      this.group.add(mesh);
    }
  }

  set(arrows: readonly Arrow[]): void {
    const turn = new Quaternion();
    const direction = new Vector3();
    const from = new Vector3();
    const matrix = new Matrix4();
    const count = Math.min(arrows.length, this.#most);
    for (let i = 0; i < count; ++i) {
      const { vector, radius_m: r, colour, ...arrow } = arrows[i]!;
      from.set(...arrow.from);
      direction.set(...vector);
      const length = direction.length();
      turn.setFromUnitVectors(kUp, length > 0 ? direction.divideScalar(length) : kUp);
      const head = Math.min(5 * r, 0.6 * length);
      matrix.compose(from, turn, new Vector3(r, Math.max(length - head, 1e-9), r));
      this.#shafts.setMatrixAt(i, matrix);
      from.addScaledVector(direction, length - head);
      matrix.compose(from, turn, new Vector3(0.5 * head, Math.max(head, 1e-9), 0.5 * head));
      this.#heads.setMatrixAt(i, matrix);
      this.#shafts.setColorAt(i, colour);
      this.#heads.setColorAt(i, colour);
    }
    for (const mesh of [this.#shafts, this.#heads]) {
      mesh.count = count;
      mesh.visible = count > 0;
      mesh.instanceMatrix.needsUpdate = true;
      if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
    }
  }
}
