// SPDX-License-Identifier: Apache-2.0
import { BufferAttribute, BufferGeometry, DynamicDrawUsage, Mesh, type Material } from "three";

const kSides = 10;

export interface TubeShape {
  radius_m: number;
  /** The first so much of the course grows from a point: a needle's tip. */
  taper_m?: number;
}

/** A round tube along points that change each frame, with a `value` per point for its colour. */
export class Tube {
  readonly mesh: Mesh<BufferGeometry, Material>;
  #points = 0;

  constructor(material: Material) {
    this.mesh = new Mesh(new BufferGeometry(), material);
    this.mesh.castShadow = true;
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
  }

  /** Draws along `course`, three numbers a point. Fewer than two points: nothing. */
  set(course: ArrayLike<number>, shape: TubeShape, value?: ArrayLike<number>): void {
    const points = course.length / 3;
    this.mesh.visible = points >= 2;
    if (points < 2) return;
    // A ring of no size at either end closes the tube.
    if (points !== this.#points) this.#allocate(points);
    const ring = (i: number) => Math.min(points - 1, Math.max(0, i - 1));
    const geometry = this.mesh.geometry;
    const position = geometry.getAttribute("position").array;
    const normal = geometry.getAttribute("normal").array;
    const values = geometry.getAttribute("value").array;

    let [nx, ny, nz] = [0, 0, 0];
    let arc = 0;
    for (let i = 0; i < points + 2; ++i) {
      const at = ring(i);
      const [b, a] = [3 * Math.max(0, at - 1), 3 * Math.min(points - 1, at + 1)];
      let [tx, ty, tz] = [course[a]! - course[b]!, course[a + 1]! - course[b + 1]!, course[a + 2]! - course[b + 2]!];
      const tangent = Math.hypot(tx, ty, tz) || 1;
      [tx, ty, tz] = [tx / tangent, ty / tangent, tz / tangent];
      // Carry the normal along: what is left of it at right angles to the tangent.
      let along = nx * tx + ny * ty + nz * tz;
      [nx, ny, nz] = [nx - along * tx, ny - along * ty, nz - along * tz];
      let n = Math.hypot(nx, ny, nz);
      if (n < 1e-3) {
        const axis = Math.abs(tx) < 0.6 ? [1, 0, 0] : [0, 1, 0];
        along = axis[0]! * tx + axis[1]! * ty;
        [nx, ny, nz] = [axis[0]! - along * tx, axis[1]! - along * ty, -along * tz];
        n = Math.hypot(nx, ny, nz);
      }
      [nx, ny, nz] = [nx / n, ny / n, nz / n];
      const [bx, by, bz] = [ty * nz - tz * ny, tz * nx - tx * nz, tx * ny - ty * nx];
      if (i > 1 && at > 0)
        arc += Math.hypot(course[3 * at]! - course[3 * at - 3]!, course[3 * at + 1]! - course[3 * at - 2]!, course[3 * at + 2]! - course[3 * at - 1]!);
      const cap = i === 0 || i === points + 1;
      const grown = shape.taper_m ? Math.min(1, 0.06 + Math.sqrt(arc / shape.taper_m)) : 1;
      const radius = cap ? 0 : shape.radius_m * grown;
      for (let s = 0; s < kSides; ++s) {
        const angle = (2 * Math.PI * s) / kSides;
        const [c, d] = [Math.cos(angle), Math.sin(angle)];
        const [x, y, z] = [c * nx + d * bx, c * ny + d * by, c * nz + d * bz];
        const k = 3 * (i * kSides + s);
        position[k] = course[3 * at]! + radius * x;
        position[k + 1] = course[3 * at + 1]! + radius * y;
        position[k + 2] = course[3 * at + 2]! + radius * z;
        const outward = i === 0 ? -1 : 1;
        normal[k] = cap ? outward * tx : x;
        normal[k + 1] = cap ? outward * ty : y;
        normal[k + 2] = cap ? outward * tz : z;
        values[i * kSides + s] = value?.[at] ?? 0;
      }
    }
    for (const name of ["position", "normal", "value"]) geometry.getAttribute(name).needsUpdate = true;
  }

  #allocate(points: number): void {
    this.#points = points;
    const rings = points + 2;
    const geometry = new BufferGeometry();
    for (const [name, size] of [["position", 3], ["normal", 3], ["value", 1]] as const) {
      const attribute = new BufferAttribute(new Float32Array(size * rings * kSides), size);
      attribute.setUsage(DynamicDrawUsage);
      geometry.setAttribute(name, attribute);
    }
    const index: number[] = [];
    for (let i = 0; i + 1 < rings; ++i)
      for (let s = 0; s < kSides; ++s) {
        const [a, b] = [i * kSides + s, i * kSides + ((s + 1) % kSides)];
        index.push(a, b, a + kSides, b, b + kSides, a + kSides);
      }
    geometry.setIndex(index);
    this.mesh.geometry.dispose();
    this.mesh.geometry = geometry;
  }
}
