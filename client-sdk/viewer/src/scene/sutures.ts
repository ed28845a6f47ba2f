// SPDX-License-Identifier: Apache-2.0
// Needles and threads: tubes along the courses that the server sends, with rings at their punctures.
import { Group, type Material } from "three";
import type { NeedleState, ThreadState } from "../protocol/messages";
import { AutoRange, kTensionMap } from "./colour_map";
import { steel } from "./matcaps";
import { Punctures } from "./punctures";
import { ScalarMaterial } from "./scalar_material";
import { mixInto, stampMs, Timeline } from "./timeline";
import { Tube, type TubeShape } from "./tube";

interface Course {
  stamp_ns: bigint;
  course_m: Float64Array;
}

/** One tube that follows its frames. */
class Strand<T extends Course> {
  readonly timeline = new Timeline<T>();
  readonly tube: Tube;
  #course = new Float64Array(0);
  #shown: { before?: T; after?: T; share?: number } = {};

  constructor(tube: Tube) {
    this.tube = tube;
  }

  /** Returns whether something moved. */
  update(moment_ms: number, shape: (frame: T) => TubeShape, value?: (frame: T) => ArrayLike<number>): boolean {
    const between = this.timeline.at(moment_ms);
    if (!between) return false;
    const { before, after, share } = between;
    if (before === this.#shown.before && after === this.#shown.after && share === this.#shown.share) return false;
    this.#shown = between;
    if (this.#course.length !== after.course_m.length) this.#course = new Float64Array(after.course_m.length);
    mixInto(this.#course, before.course_m, after.course_m, share);
    this.tube.set(this.#course, shape(after), value?.(after));
    return true;
  }

  get course(): Float64Array {
    return this.#course;
  }

  get frame(): T | undefined {
    return this.#shown.after;
  }
}

export class Sutures {
  readonly group = new Group();
  readonly tension = new AutoRange(0.02);
  readonly #punctures = new Punctures();
  readonly #needles = new Map<string, Strand<NeedleState>>();
  readonly #threads = new Map<string, Strand<ThreadState>>();
  readonly #steel = steel();
  readonly #silk = new ScalarMaterial(kTensionMap, { roughness: 0.55, metalness: 0, emissive: 0x1a1f3a });

  constructor() {
    this.group.add(this.#punctures.mesh);
  }

  pushNeedle(state: NeedleState): void {
    this.#strand(this.#needles, state.needle, this.#steel).timeline.push(stampMs(state.stamp_ns), state);
  }

  pushThread(state: ThreadState): void {
    this.#strand(this.#threads, state.thread, this.#silk).timeline.push(stampMs(state.stamp_ns), state);
  }

  clear(): void {
    for (const strand of [...this.#needles.values(), ...this.#threads.values()]) {
      this.group.remove(strand.tube.mesh);
      strand.tube.mesh.geometry.dispose();
    }
    this.#needles.clear();
    this.#threads.clear();
    this.#punctures.begin();
    this.#punctures.end();
  }

  update(moment_ms: number): void {
    let changed = false;
    for (const needle of this.#needles.values())
      changed = needle.update(moment_ms, (f) => ({ radius_m: f.diameter_m / 2, taper_m: 6 * f.diameter_m })) || changed;
    let tension_n = 0;
    for (const thread of this.#threads.values()) {
      changed = thread.update(moment_ms, (f) => ({ radius_m: f.diameter_m / 2 }), tensionAtPoints) || changed;
      tension_n = Math.max(tension_n, thread.timeline.latest?.tension_n ?? 0);
    }
    this.tension.observe(tension_n, 1 / 60);
    this.#silk.scalarTop = this.tension.top;
    if (!changed) return;
    this.#punctures.begin();
    for (const needle of this.#needles.values())
      if (needle.frame) this.#punctures.add(needle.frame.punctures, needle.course, 1.25 * needle.frame.diameter_m);
    for (const thread of this.#threads.values())
      if (thread.frame) this.#punctures.add(thread.frame.punctures, thread.course, 1.5 * thread.frame.diameter_m);
    this.#punctures.end();
  }

  /** The newest state of each needle. */
  needles(): NeedleState[] {
    return [...this.#needles.values()].flatMap((strand) => strand.timeline.latest ?? []);
  }

  threads(): ThreadState[] {
    return [...this.#threads.values()].flatMap((strand) => strand.timeline.latest ?? []);
  }

  #strand<T extends Course>(strands: Map<string, Strand<T>>, name: string, material: Material): Strand<T> {
    let strand = strands.get(name);
    if (!strand) {
      strands.set(name, (strand = new Strand<T>(new Tube(material))));
      this.group.add(strand.tube.mesh);
    }
    return strand;
  }
}

/** The tension at each point of the course: the mean of the segments beside it. */
export function tensionAtPoints(thread: Pick<ThreadState, "course_m" | "segment_tension_n">): Float64Array {
  const segments = thread.segment_tension_n;
  const points = thread.course_m.length / 3;
  const result = new Float64Array(points);
  for (let i = 0; i < points; ++i) {
    const before = segments[i - 1] ?? segments[i] ?? 0;
    const after = segments[i] ?? before;
    result[i] = (before + after) / 2;
  }
  return result;
}
