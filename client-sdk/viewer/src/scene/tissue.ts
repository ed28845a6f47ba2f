// SPDX-License-Identifier: Apache-2.0
import { Box3, BufferAttribute, BufferGeometry, DynamicDrawUsage, Group, Mesh, Sphere, Vector3, type Raycaster } from "three";
import type { MeshFrame, MeshTopology } from "../protocol/messages";
import { AutoRange, kStressMaps, percentile, type ColourMap } from "./colour_map";
import { splitCreases, type SplitMesh } from "./creases";
import { ScalarMaterial } from "./scalar_material";
import { mixInto, stampMs, Timeline } from "./timeline";

/** What stands at one vertex of a tissue's surface, now. */
export interface TissueProbe {
  body: string;
  /** Of the body's mesh. */
  vertex: number;
  position_m: [number, number, number];
  displacement_m: number;
  von_mises_pa: number;
  /** Largest first; absent where the server sends none. */
  principal_pa: [number, number, number] | undefined;
}

/** A tissue's surface: smooth light, creases kept, colours by stress. */
class Body {
  readonly mesh: Mesh<BufferGeometry, ScalarMaterial>;
  #topology: MeshTopology;
  readonly #timeline = new Timeline<MeshFrame>();
  readonly #split: SplitMesh;
  readonly #position: Float32Array;
  readonly #stress: Float32Array;
  #shown: Partial<{ before: MeshFrame; after: MeshFrame; share: number }> = {};

  constructor(topology: MeshTopology, material: ScalarMaterial) {
    this.#topology = topology;
    const rest = topology.rest_position_m;
    this.#split = splitCreases(rest, topology.triangle);
    this.#position = Float32Array.from(rest);
    this.#stress = new Float32Array(rest.length / 3);
    const count = this.#split.source.length;
    const geometry = new BufferGeometry();
    for (const [name, size] of [["position", 3], ["normal", 3], ["value", 1]] as const) {
      const attribute = new BufferAttribute(new Float32Array(size * count), size);
      attribute.setUsage(DynamicDrawUsage);
      geometry.setAttribute(name, attribute);
    }
    geometry.setIndex(new BufferAttribute(this.#split.index, 1));
    this.mesh = new Mesh(geometry, material);
    this.mesh.castShadow = this.mesh.receiveShadow = true;
    this.mesh.frustumCulled = false;
    this.mesh.userData["body"] = topology.body;
    this.#upload();
    // Wide enough for whatever a needle does to it: a pick looks at triangles within.
    geometry.boundingSphere = new Box3().setFromBufferAttribute(geometry.getAttribute("position") as BufferAttribute)
      .getBoundingSphere(new Sphere());
    geometry.boundingSphere.radius *= 2;
  }

  get topology(): MeshTopology {
    return this.#topology;
  }

  /** Takes the same shape of another epoch: it stays as it is drawn until a frame of that epoch comes. */
  renew(topology: MeshTopology): void {
    this.#topology = topology;
    this.#timeline.clear();
  }

  /** Takes a frame; one of another epoch or revision is none of this body's. */
  push(frame: MeshFrame): void {
    const { epoch, revision } = this.#topology;
    if (frame.epoch === epoch && frame.revision === revision && frame.position_m.length === this.#position.length)
      this.#timeline.push(stampMs(frame.stamp_ns), frame);
  }

  get latest(): MeshFrame | undefined {
    return this.#timeline.latest;
  }

  update(moment_ms: number): void {
    const between = this.#timeline.at(moment_ms);
    if (!between) return;
    const { before, after, share } = between;
    if (before === this.#shown.before && after === this.#shown.after && share === this.#shown.share) return;
    this.#shown = between;
    mixInto(this.#position, before.position_m, after.position_m, share);
    if (after.von_mises_pa.length === this.#stress.length)
      mixInto(this.#stress, before.von_mises_pa, after.von_mises_pa, share);
    this.#upload();
  }


  probeVertex(i: number): TissueProbe {
    const at = 3 * i;
    const rest = this.#topology.rest_position_m;
    const p = this.#position;
    const principal = this.latest?.principal_pa;
    return {
      body: this.#topology.body,
      vertex: this.#topology.vertex[i] ?? i,
      position_m: [p[at]!, p[at + 1]!, p[at + 2]!],
      displacement_m: Math.hypot(p[at]! - rest[at]!, p[at + 1]! - rest[at + 1]!, p[at + 2]! - rest[at + 2]!),
      von_mises_pa: this.#stress[i]!,
      principal_pa: principal && principal.length > at + 2 ? [principal[at]!, principal[at + 1]!, principal[at + 2]!] : undefined,
    };
  }

  surfaceVertexOf(drawn: number): number {
    return this.#split.source[drawn]!;
  }

  #upload(): void {
    const { source } = this.#split;
    const geometry = this.mesh.geometry;
    const position = geometry.getAttribute("position") as BufferAttribute;
    const value = geometry.getAttribute("value") as BufferAttribute;
    const [p, v] = [position.array, value.array];
    for (let i = 0; i < source.length; ++i) {
      const at = source[i]!;
      p[3 * i] = this.#position[3 * at]!;
      p[3 * i + 1] = this.#position[3 * at + 1]!;
      p[3 * i + 2] = this.#position[3 * at + 2]!;
      v[i] = this.#stress[at]!;
    }
    position.needsUpdate = value.needsUpdate = true;
    geometry.computeVertexNormals();
  }
}

/** Returns whether two bodies are the same at rest. */
export function sameShape(a: MeshTopology, b: MeshTopology): boolean {
  const same = (x: ArrayLike<number>, y: ArrayLike<number>): boolean => {
    if (x.length !== y.length) return false;
    for (let i = 0; i < x.length; ++i) if (x[i] !== y[i]) return false;
    return true;
  };
  return same(a.rest_position_m, b.rest_position_m) && same(a.triangle, b.triangle) && same(a.vertex, b.vertex);
}

export class Tissue {
  readonly group = new Group();
  readonly range = new AutoRange(2000);
  readonly #bodies = new Map<string, Body>();
  readonly #material = new ScalarMaterial(kStressMaps[0]!, { roughness: 0.48, metalness: 0 });
  #observed_ms = 0;

  /** Returns a triangle of the material, to make its program while the data are on the way. */
  standIn(): Mesh {
    const geometry = new BufferGeometry();
    for (const [name, size] of [["position", 3], ["normal", 3], ["value", 1]] as const)
      geometry.setAttribute(name, new BufferAttribute(new Float32Array(3 * size), size));
    const standIn = new Mesh(geometry, this.#material);
    standIn.receiveShadow = true;
    return standIn;
  }

  /** Takes a body at rest. Returns whether it is of another shape than before: after a reset it is not. */
  setTopology(topology: MeshTopology): boolean {
    const known = this.#bodies.get(topology.body);
    if (known && known.topology.revision === topology.revision && known.topology.epoch === topology.epoch) return false;
    if (known && sameShape(known.topology, topology)) {
      known.renew(topology);
      return false;
    }
    if (known) this.#remove(known);
    const body = new Body(topology, this.#material);
    body.mesh.castShadow = !this.translucent;
    this.#bodies.set(topology.body, body);
    this.group.add(body.mesh);
    return true;
  }

  /** Returns whether the frame's body is known in the frame's epoch. */
  push(frame: MeshFrame): boolean {
    const body = this.#bodies.get(frame.body);
    body?.push(frame);
    return body?.topology.epoch === frame.epoch;
  }

  /** Takes away the bodies of other epochs. Returns whether there were any. */
  keepOnly(epoch: bigint): boolean {
    const others = [...this.#bodies].filter(([, body]) => body.topology.epoch !== epoch);
    for (const [name, body] of others) {
      this.#remove(body);
      this.#bodies.delete(name);
    }
    return others.length > 0;
  }

  get empty(): boolean {
    return this.#bodies.size === 0;
  }

  update(moment_ms: number, now_ms: number): void {
    for (const body of this.#bodies.values()) body.update(moment_ms);
    if (now_ms - this.#observed_ms > 250) {
      let top = 0;
      for (const body of this.#bodies.values())
        if (body.latest) top = Math.max(top, percentile(body.latest.von_mises_pa, 0.995));
      this.range.observe(top, Math.min(1, (now_ms - this.#observed_ms) / 1000));
      this.#observed_ms = now_ms;
    }
    this.#material.scalarTop = this.range.top;
  }

  set map(map: ColourMap) {
    this.#material.scalarMap = map;
  }

  set translucent(on: boolean) {
    this.#material.transparent = on;
    this.#material.opacity = on ? 0.38 : 1;
    this.#material.depthWrite = !on;
    this.#material.needsUpdate = true;
    for (const body of this.#bodies.values()) body.mesh.castShadow = !on;
  }

  get translucent(): boolean {
    return this.#material.transparent;
  }

  /** Returns the box of all bodies of an epoch at rest. */
  bounds(epoch: bigint): Box3 {
    const box = new Box3();
    for (const body of this.#bodies.values()) {
      if (body.topology.epoch !== epoch) continue;
      const rest = body.topology.rest_position_m;
      for (let i = 0; i < rest.length; i += 3) box.expandByPoint(new Vector3(rest[i], rest[i + 1], rest[i + 2]));
    }
    return box;
  }

  /** Returns body and surface vertex nearest to where the ray meets a tissue first. */
  pick(ray: Raycaster): { body: string; vertex: number } | undefined {
    const hit = ray.intersectObjects(this.group.children, false)[0];
    const body = hit && this.#bodies.get(String(hit.object.userData["body"]));
    if (!hit?.face || !body) return undefined;
    const position = body.mesh.geometry.getAttribute("position");
    const corner = new Vector3();
    const distance = (i: number) => corner.fromBufferAttribute(position, i).distanceToSquared(hit.point);
    const nearest = [hit.face.a, hit.face.b, hit.face.c].reduce((a, b) => (distance(b) < distance(a) ? b : a));
    return { body: body.topology.body, vertex: body.surfaceVertexOf(nearest) };
  }

  probe(at: { body: string; vertex: number }): TissueProbe | undefined {
    return this.#bodies.get(at.body)?.probeVertex(at.vertex);
  }

  #remove(body: Body): void {
    this.group.remove(body.mesh);
    body.mesh.geometry.dispose();
  }
}
