// SPDX-License-Identifier: Apache-2.0
import { ServerState, type Quality, type ServerStatus } from "../protocol/messages";
import { card, Figures } from "./dom";
import { count, hz, kPa, mm, ms, newton, seconds } from "./format";

/** Messages and bytes over the last second. */
export class Rate {
  #times: number[] = [];
  #bytes: number[] = [];

  add(now_ms: number, bytes: number): void {
    this.#times.push(now_ms);
    this.#bytes.push(bytes);
    this.#drop(now_ms); // a page that is hidden adds for days and never asks
  }
  get kept(): number {
    return this.#times.length;
  }
  /** Returns messages and bytes a second. */
  at(now_ms: number): { perSecond: number; bytesPerSecond: number } {
    this.#drop(now_ms);
    return { perSecond: this.#times.length, bytesPerSecond: this.#bytes.reduce((a, b) => a + b, 0) };
  }

  #drop(now_ms: number): void {
    let drop = 0;
    while (drop < this.#times.length && now_ms - this.#times[drop]! > 1000) ++drop;
    if (drop === 0) return;
    this.#times.splice(0, drop);
    this.#bytes.splice(0, drop);
  }
}

export class StatusPanel {
  readonly element: HTMLElement;
  readonly #figures = new Figures();
  #running = false;

  constructor() {
    this.element = card("Status", "status", this.#figures.element);
  }

  set(status: ServerStatus): void {
    const f = this.#figures;
    this.#running = status.state === ServerState.Running;
    const late = status.achieved_rate_hz < 0.9 * status.rate_hz && this.#running;
    f.set("Simulation", `${hz(status.achieved_rate_hz)} of ${hz(status.rate_hz)}`, late ? "bad" : "");
    f.set("Step p50 / p99", `${ms(status.step.p50_us)} / ${ms(status.step.p99_us)}`);
    f.set("Overruns", count(status.overruns), late ? "warn" : "");
    f.set("Missed ticks", count(status.missed_ticks));
    f.set("Rows", `${count(status.active_rows)} of ${count(status.rows)}`, "", "active unilateral rows, of all");
    f.set("Contacts", count(status.contacts));
    const faults = status.tools.reduce((sum, tool) => sum + tool.fault_count, 0);
    f.set("Faults", count(faults), status.tools.some((tool) => tool.faults !== 0) ? "bad" : "", "of all tools, since the start");
    f.set("Devices / viewers", `${status.devices} / ${status.viewers}`);
    f.set("Mesh", `${count(status.vertices)} vertices, ${count(status.tets)} tets`);
    f.set("Real time", status.realtime_note === "" ? "yes" : "partly", status.realtime_note === "" ? "" : "warn", status.realtime_note);
    f.set("Server", `${status.server_version} on ${status.host}`, "", `session "${status.session}"`);
  }

  setRates(frames: number, bytes: number, drawn: number, roundTrip_ms: number | undefined): void {
    this.#figures.set("Frames", `${frames.toFixed(0)} /s`, this.#running && frames < 25 ? "warn" : "", "mesh frames that came in, of one body");
    this.#figures.set("Drawn", `${drawn.toFixed(0)} /s`);
    this.#figures.set("Received", `${(bytes / 1e6).toFixed(2)} MB/s`);
    this.#figures.set("Round trip", roundTrip_ms === undefined ? "–" : `${roundTrip_ms.toFixed(1)} ms`, "", "pose to force, while this page holds a tool");
  }
}

/** How well somebody sews. */
export class QualityPanel {
  readonly element: HTMLElement;
  readonly #figures = new Figures();
  #epoch = 0n;

  constructor() {
    this.element = card("Suture", "quality", this.#figures.element);
    this.element.hidden = true;
  }

  /** Of what is on show. */
  get epoch(): bigint {
    return this.#epoch;
  }

  set(quality: Quality): void {
    this.element.hidden = false;
    this.#epoch = quality.epoch;
    const f = this.#figures;
    if (quality.gap_start_m > 0) f.set("Gap", `${mm(quality.gap_m, 2)} of ${mm(quality.gap_start_m, 2)}`);
    f.set("Bites", count(quality.bites.length));
    if (quality.bites.length > 0) f.set("Depth, mean", mm(quality.bite_depth_mean_m, 2));
    if (quality.bites.length > 1) f.set("Spacing, mean", mm(quality.bite_spacing_mean_m, 2));
    f.set("Peak force", newton(quality.peak_force_n));
    f.set("Peak stress", kPa(quality.peak_principal_stress_pa));
    f.set("Tip's way", mm(quality.needle_path_m, 0));
    f.set("Hand-overs / drops", `${quality.handovers} / ${quality.needle_drops}`);
    f.set("Time", seconds(quality.elapsed_s));
  }

  /** Takes a reset's epoch: what is on show may be newer, as for a late joiner, who gets old events again. */
  reset(epoch: bigint): void {
    if (epoch > this.#epoch) this.clear();
  }

  clear(): void {
    this.element.hidden = true;
  }
}
