// SPDX-License-Identifier: Apache-2.0
// Everything that is drawn, fed by the session's messages.
import { Box3, Mesh, MeshBasicMaterial, SphereGeometry } from "three";
import type { Link } from "../connection/link";
import { add, normalized, scale, shaftAlong, type Pose, type Vec3 } from "../maths/vector";
import { kPresets, presetPlace, sceneAxes, type Preset, type SceneAxes } from "./cameras";
import { Contacts } from "./contacts";
import { Epochs, Lead } from "./epochs";
import { Labels, type Label } from "./labels";
import { Sutures } from "./sutures";
import { PlayClock, stampMs } from "./timeline";
import { Tissue, type TissueProbe } from "./tissue";
import { Tools, wasLed } from "./tools";
import type { View } from "./view";

/** Lengths as shares of the scene's radius: the longest force, a newton of contact, a line's radius. */
const kLongestForce = 0.75;
const kContactNewton = 0.9;
const kThin = 0.011;
const kQuiet_n = 0.02;

export class Stage {
  readonly tissue = new Tissue();
  readonly sutures = new Sutures();
  readonly tools = new Tools();
  readonly #contacts = new Contacts();
  readonly #clock = new PlayClock();
  readonly #view: View;
  readonly #labels: Labels;
  readonly #marker: Mesh;
  readonly #epochs = new Epochs();
  readonly #lead = new Lead();
  #axes: SceneAxes | undefined;
  /** Of the bodies for which the camera was placed, and whether the needle was known then. */
  #box = new Box3();
  #placed = false;
  #picked: { body: string; vertex: number } | undefined;
  readonly #firstPicture: (ms: number) => void;
  /** Called when bodies came or went: the scene is another one than before. */
  onOther: () => void = () => {};

  constructor(view: View, labels: HTMLElement, link: Link, firstPicture: (ms: number) => void) {
    this.#view = view;
    this.#labels = new Labels(labels);
    this.#firstPicture = firstPicture;
    this.#marker = new Mesh(new SphereGeometry(1, 20, 14), new MeshBasicMaterial({ color: 0x2563eb }));
    this.#marker.visible = false;
    view.scene.add(this.tissue.group, this.sutures.group, this.tools.group, this.#contacts.group, this.#marker);

    view.prepare(this.tissue.standIn());

    link.on("suture/mesh/topology", (topology) => {
      if (this.#meet(topology.epoch) && this.tissue.setTopology(topology)) this.#change();
    });
    link.on("suture/mesh/frame", (frame) => {
      if (!this.#meet(frame.epoch)) return;
      this.#clock.observe(stampMs(frame.stamp_ns), performance.now());
      if (this.tissue.push(frame) && this.#lead.take(frame.epoch, frame.body) === 2) this.#settle();
      view.wake();
    });
    link.on("suture/needle", (needle) => {
      if (!this.#meet(needle.epoch)) return;
      this.sutures.pushNeedle(needle);
      if (!this.#placed) this.#place();
    });
    link.on("suture/thread", (thread) => {
      if (this.#meet(thread.epoch)) this.sutures.pushThread(thread);
    });
    link.on("suture/contact", (contact) => {
      if (this.#meet(contact.epoch)) this.#contacts.push(contact);
    });
    link.on("suture/tool/state", (tool) => {
      if (this.#meet(tool.epoch)) this.tools.push(tool);
    });
  }

  /** A connection was made, maybe to another server than before. */
  connected(): void {
    this.#epochs.connected();
  }

  /** The epoch on show. */
  get epoch(): bigint {
    return this.#epochs.now;
  }

  get hasScene(): boolean {
    return !this.tissue.empty;
  }
  get axes(): SceneAxes {
    return this.#axes ?? { centre: [0, 0, 0], radius: 0.02, along: [0, 0, 1], up: [0, 1, 0], front: [1, 0, 0] };
  }

  look(preset: Preset, fly = true): void {
    this.#view.goTo(presetPlace(preset, this.axes, this.#view.fov_rad, this.#view.aspect, this.#needleAt()), fly);
  }

  /** Where a tool that was never led begins: before the scene, held from above and a little from the eye. */
  startPose(): Pose {
    const { centre, radius, up, front } = this.axes;
    const shaft = normalized(add(up, scale(this.#view.axes().back, 0.4)));
    return { position: add(centre, add(scale(front, 0.8 * radius), scale(up, 0.35 * radius))), orientation: shaftAlong(shaft, front) };
  }

  pick(clientX: number, clientY: number): void {
    this.#picked = this.tissue.pick(this.#view.ray(clientX, clientY));
    this.#view.wake();
  }
  unpick(): void {
    this.#picked = undefined;
    this.#view.wake();
  }
  probe(): TissueProbe | undefined {
    return this.#picked && this.tissue.probe(this.#picked);
  }

  /** Moves everything to the moment on show. */
  update(now_ms: number): void {
    const moment_ms = this.#clock.moment_ms(now_ms);
    const { radius } = this.axes;
    this.tissue.update(moment_ms, now_ms);
    this.sutures.update(moment_ms);
    this.#contacts.update(kThin * radius, kContactNewton * radius);
    this.tools.update(moment_ms, kLongestForce * radius, kThin * radius);
    const probe = this.probe();
    this.#marker.visible = probe !== undefined;
    if (probe) {
      this.#marker.position.set(...probe.position_m);
      this.#marker.scale.setScalar(1.3 * kThin * radius);
    }
  }

  /** Texts beside the tools. */
  label(): void {
    const labels: Label[] = this.tools.views().filter(wasLed).map((view) => {
      const force_n = Math.hypot(...view.force_n);
      const force = force_n > kQuiet_n ? `  ${force_n.toFixed(2)} N` : "";
      return { key: view.tool, text: `${view.tool}${force}`, at: [...view.position_m] as Vec3, colour: this.tools.colour(view.tool) };
    });
    const { width, height } = this.#view.size;
    this.#labels.set(labels, this.#view.camera, width, height);
  }

  #needleAt(): Vec3 | undefined {
    const needle = this.sutures.needles()[0];
    const course = needle?.course_m;
    if (!course || course.length < 3) return undefined;
    let at: Vec3 = [0, 0, 0];
    for (let i = 0; i < course.length; i += 3) at = add(at, [course[i]!, course[i + 1]!, course[i + 2]!]);
    return scale(at, 3 / course.length);
  }

  /** Takes a message's epoch; what came before a new one goes. Returns whether the message is one of it. */
  #meet(epoch: bigint): boolean {
    const word = this.#epochs.take(epoch);
    if (word !== "new") return word === "now";
    this.sutures.clear();
    this.tools.clear();
    this.#contacts.clear();
    return true;
  }

  /** Every body of the epoch has come: what is left is of another scene. After a reset nothing is. */
  #settle(): void {
    if (this.tissue.keepOnly(this.epoch)) this.#change();
    else this.#place();
  }

  #change(): void {
    this.#picked = undefined;
    this.#place();
    this.onOther();
  }

  /** Finds the scene's axes; the camera goes there once for each scene, and stays where a person put it. */
  #place(): void {
    const box = this.tissue.bounds(this.epoch);
    const needle = this.#needleAt();
    const known = this.#placed || needle === undefined;
    if (box.isEmpty() || (known && box.equals(this.#box))) return;
    const first = this.#axes === undefined;
    this.#box = box;
    this.#axes = sceneAxes({ min: box.min.toArray() as Vec3, max: box.max.toArray() as Vec3 }, needle);
    this.#view.setAxes(this.#axes);
    this.look(kPresets[0], false);
    this.#placed = needle !== undefined;
    if (first)
      this.#view.onDrawn = () => {
        this.#view.onDrawn = undefined;
        this.#firstPicture(performance.now());
        this.#view.adapt();
        // What shows later, so that a hand's first picture does not wait for its programs.
        for (const group of [this.tools.group, this.sutures.group, this.#contacts.group]) this.#view.prepare(group);
      };
  }
}
