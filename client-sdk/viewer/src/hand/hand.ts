// SPDX-License-Identifier: Apache-2.0
// What the person does with the tool that the page holds: pointer, wheel, keys and gamepad become a
// target, which the worker's pacer turns into poses. One tool at a time.
import type { HandReport } from "../connection/worker_messages";
import type { Link } from "../connection/link";
import { about, add, length, multiply, normalized, rotate, scale, subtract, turnBetween, unit, type Pose, type Vec3 } from "../maths/vector";
import type { NeedleState, ThreadState, ToolView } from "../protocol/messages";
import { carried, driven, needleMotion, reachNeedle, type NeedleMotion } from "./needle_course";
import { reachThread, threadPlace } from "./thread_course";

export type DragMode = "move" | "turn" | "drive";

/** What the hand has to know of the rest of the page. */
export interface HandWorld {
  /** The camera's axes in the world. */
  cameraAxes(): { right: Vec3; up: Vec3; back: Vec3 };
  metresPerPixel(at: Vec3): number;
  toolView(tool: string): ToolView | undefined;
  needles(): NeedleState[];
  threads(): ThreadState[];
  /** Where a tool that was never led begins. */
  startPose(): Pose;
  /** No target lies farther than that from the scene's centre. */
  limits(): { centre: Vec3; radius: number };
  wasLed(view: ToolView): boolean;
}

/** Rates of what is held down: in camera axes m/s and rad/s, along the needle m/s. */
export interface HandRates {
  move: Vec3;
  turn: Vec3;
  drive: number;
}

const kTurn_rad_per_px = 0.006;
const kDrive_m_per_px = 0.00004;
const kDepth_px_per_wheel = 0.25;
/** A target that runs far ahead of a hand is a hand that does not stop when it should. */
const kAhead_m = 0.04;
const kArrived_m = 0.0006;
const kArrived_rad = 0.03;

export class Hand {
  mode: DragMode = "move";
  /** Called when the hand took or let go of a tool, or its report came. */
  onChange: () => void = () => {};
  /** Called when a hold ended; `why` for people, empty where they ended it themselves. */
  onEnd: (tool: string, why: string) => void = () => {};
  readonly #link: Link;
  readonly #world: HandWorld;
  #tool: string | undefined;
  #target: Pose = { position: [0, 0, 0], orientation: [0, 0, 0, 1] };
  #jaw = 0;
  #way: Pose[] = [];
  #report: HandReport | undefined;

  constructor(link: Link, world: HandWorld) {
    this.#link = link;
    this.#world = world;
  }

  get tool(): string | undefined {
    return this.#tool;
  }
  get report(): HandReport | undefined {
    return this.#report;
  }
  get jaw(): number {
    return this.#jaw;
  }
  get target(): Pose {
    return this.#target;
  }

  take(tool: string): void {
    if (this.#tool) this.release();
    const view = this.#world.toolView(tool);
    const led = view !== undefined && this.#world.wasLed(view);
    this.#target = led
      ? { position: [...view.position_m] as Vec3, orientation: unit([...view.orientation_xyzw] as Pose["orientation"]) }
      : this.#world.startPose();
    this.#jaw = led && view.holding !== "" ? view.jaw : 0;
    this.#tool = tool;
    this.#report = undefined;
    this.#way = [];
    this.#link.takeHand(tool, this.#target, this.#jaw);
    this.onChange();
  }

  /** Gives the lease back; `why` for people, where it was not their wish. */
  release(why = ""): void {
    const tool = this.#tool;
    if (!tool) return;
    this.#tool = undefined;
    this.#report = undefined;
    this.#link.releaseHand();
    this.onChange();
    this.onEnd(tool, why);
  }

  /** The connection ended: the lease with it. */
  lost(): void {
    if (this.#tool) this.release("the connection was lost");
  }

  onReport(report: HandReport): void {
    if (report.tool !== this.#tool) return;
    if (report.lease === "none") return this.release(report.why ?? "the page was busy for too long");
    this.#report = report;
    this.onChange();
  }

  drag(dx: number, dy: number, mode: DragMode): void {
    if (!this.#tool) return;
    const { right, up } = this.#world.cameraAxes();
    if (mode === "move") {
      const m = this.#world.metresPerPixel(this.#target.position);
      this.#move(add(scale(right, dx * m), scale(up, -dy * m)));
    } else if (mode === "turn") {
      this.#turn(add(scale(up, dx * kTurn_rad_per_px), scale(right, dy * kTurn_rad_per_px)));
    } else {
      this.drive((Math.abs(dx) > Math.abs(dy) ? dx : -dy) * kDrive_m_per_px);
    }
  }

  /** Away from the eye for a positive `wheel`. */
  depth(wheel: number): void {
    if (!this.#tool) return;
    const m = this.#world.metresPerPixel(this.#target.position);
    this.#move(scale(this.#world.cameraAxes().back, wheel * kDepth_px_per_wheel * m));
  }

  /** Drives the needle held along its own axis; without one, rolls the tool about its shaft. */
  drive(way_m: number): void {
    if (!this.#tool) return;
    this.#way = [];
    const motion = this.#heldNeedle();
    if (motion) this.#target = driven(this.#target, motion, way_m);
    else this.#turn(scale(rotate(this.#target.orientation, [0, 0, 1]), way_m / 0.008));
  }

  set closed(closed: boolean) {
    this.#jaw = closed ? 1 : 0;
  }
  get closed(): boolean {
    return this.#jaw > 0.5;
  }
  setJaw(jaw: number): void {
    this.#jaw = Math.min(1, Math.max(0, jaw));
  }

  /** Leads the open jaw to the nearest needle, at a hand's pace. Returns whether there is one, and the jaw is free. */
  reach(): boolean {
    if (!this.#tool || this.#holding() !== "") return false;
    const at = this.#target.position;
    const far = (needle: NeedleState) => length(subtract([...needle.position_m] as Vec3, at));
    const needle = this.#world.needles().filter((n) => n.course_m.length >= 6).sort((a, b) => far(a) - far(b))[0];
    if (!needle) return false;
    const holder = needle.holder === "" ? undefined : this.#world.toolView(needle.holder);
    const holderPose = holder && {
      position: [...holder.position_m] as Vec3, orientation: [...holder.orientation_xyzw] as Pose["orientation"],
    };
    this.#jaw = 0;
    this.#way = reachNeedle(this.#target, needle, this.#world.cameraAxes().back, holderPose);
    return true;
  }

  /** Leads the open jaw to the nearest thread, where one takes it to pull it. Returns whether there is one, and the jaw is free. */
  reachForThread(): boolean {
    if (!this.#tool || this.#holding() !== "") return false;
    const far = (at: Vec3) => length(subtract(at, this.#target.position));
    const places = this.#world.threads().map(threadPlace).filter((place) => place !== undefined);
    const place = places.sort((a, b) => far(a.at) - far(b.at))[0];
    if (!place) return false;
    this.#jaw = 0;
    this.#way = reachThread(this.#target, place, this.#world.cameraAxes().back);
    return true;
  }

  get reaching(): boolean {
    return this.#way.length > 0;
  }

  /** Once a display frame: what is held down, the way to a needle or thread, and the word that the page lives. */
  update(rates: HandRates, elapsed_s: number): void {
    if (!this.#tool) return;
    const { right, up, back } = this.#world.cameraAxes();
    const inWorld = (v: Vec3): Vec3 => add(add(scale(right, v[0]), scale(up, v[1])), scale(back, v[2]));
    if (length(rates.move) > 0) this.#move(inWorld(scale(rates.move, elapsed_s)));
    if (length(rates.turn) > 0) this.#turn(inWorld(scale(rates.turn, elapsed_s)));
    if (rates.drive !== 0) this.drive(rates.drive * elapsed_s);
    this.#followWay();
    this.alive();
  }

  /** Tells the worker where the hand wants to be. */
  alive(): void {
    if (this.#tool) this.#link.aimHand(this.#target, this.#jaw);
  }

  #followWay(): void {
    const next = this.#way[0];
    if (!next) return;
    this.#target = next;
    const pose = this.#report?.pose;
    if (!pose || length(subtract(pose.position, next.position)) > kArrived_m ||
      length(turnBetween(pose.orientation, next.orientation)) > kArrived_rad) return;
    this.#way.shift();
  }

  #move(way: Vec3): void {
    this.#way = [];
    let position = add(this.#target.position, way);
    const { centre, radius } = this.#world.limits();
    const out = subtract(position, centre);
    if (length(out) > radius) position = add(centre, scale(normalized(out), radius));
    const pose = this.#report?.pose;
    if (pose) {
      const ahead = subtract(position, pose.position);
      if (length(ahead) > kAhead_m) position = add(pose.position, scale(normalized(ahead), kAhead_m));
    }
    this.#target = { ...this.#target, position };
  }

  #turn(turn: Vec3): void {
    this.#way = [];
    const q = about(normalized(turn), length(turn));
    this.#target = { ...this.#target, orientation: unit(multiply(q, this.#target.orientation)) };
  }

  #holding(): string {
    return (this.#tool && this.#world.toolView(this.#tool)?.holding) || "";
  }

  #heldNeedle(): NeedleMotion | undefined {
    const view = this.#tool ? this.#world.toolView(this.#tool) : undefined;
    const needle = view && this.#world.needles().find((n) => n.needle === view.holding && n.course_m.length >= 6);
    if (!view || !needle) return undefined;
    const now: Pose = { position: [...view.position_m] as Vec3, orientation: [...view.orientation_xyzw] as Pose["orientation"] };
    return carried(needleMotion(needle), now, this.#target);
  }
}
