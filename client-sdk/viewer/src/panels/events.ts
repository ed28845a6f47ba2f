// SPDX-License-Identifier: Apache-2.0
import { EventKind, faultNames, type ServerEvent } from "../protocol/messages";
import { card, h } from "./dom";

const kMost = 200;
/** Events that are known again; a server repeats fewer. */
const kRemembered = 2000;

const kTexts: Record<EventKind, string> = {
  [EventKind.Grasp]: "grasps", [EventKind.Release]: "lets go of", [EventKind.GripSlip]: "slips on",
  [EventKind.Contact]: "touches", [EventKind.ContactLost]: "leaves",
  [EventKind.Puncture]: "punctures", [EventKind.Exit]: "comes out of", [EventKind.Retract]: "is drawn back out of",
  [EventKind.Taut]: "is taut", [EventKind.Slack]: "is slack", [EventKind.Unthread]: "loses a bite in",
  [EventKind.Knot]: "is knotted", [EventKind.Tear]: "tears", [EventKind.Cut]: "is cut",
  [EventKind.Limit]: "at its limit", [EventKind.Solver]: "solver",
  [EventKind.ToolLeased]: "is held by a device", [EventKind.ToolReturned]: "is free", [EventKind.ToolInUse]: "is in use: another device wants it",
  [EventKind.Fault]: "fault", [EventKind.Recovered]: "recovered",
  [EventKind.Paused]: "paused", [EventKind.Resumed]: "resumed", [EventKind.Reset]: "reset", [EventKind.Stopped]: "stopped", [EventKind.Started]: "started",
  [EventKind.Overrun]: "overrun", [EventKind.Notice]: "notice",
  [EventKind.Checkpoint]: "state kept as", [EventKind.Rewound]: "another state was put in place",
};

const kBad = new Set([EventKind.Fault, EventKind.Solver, EventKind.Tear, EventKind.Stopped, EventKind.ToolInUse]);
const kWarn = new Set([EventKind.Limit, EventKind.GripSlip, EventKind.Overrun, EventKind.Unthread]);
const kNeedle = new Set([EventKind.Puncture, EventKind.Exit, EventKind.Retract]);
/** Whose text is for people already and says more than ours. */
const kTextFirst = new Set([EventKind.Fault, EventKind.Limit, EventKind.Solver, EventKind.Overrun, EventKind.Notice, EventKind.Stopped, EventKind.Rewound]);

/** Returns one line on what happened. */
export function eventText(event: ServerEvent): string {
  const unit = event.unit === "" ? "" : ` (${Number(event.value.toPrecision(3))} ${event.unit})`;
  if (kTextFirst.has(event.kind) && event.text !== "")
    return `${event.subject === "" ? "" : `${event.subject}: `}${event.text}${event.kind === EventKind.Overrun ? ` (${event.value})` : unit}`;
  const faults = event.faults === 0 ? "" : ` (${faultNames(event.faults).join(", ")})`;
  const words = [event.subject, kTexts[event.kind] ?? `event ${event.kind}`, event.object].filter((word) => word !== "");
  return words.join(" ") + unit + faults;
}

/** Returns both as one event with their sum, where a machine that is too slow says the same once a second. */
export function joined(before: ServerEvent | undefined, event: ServerEvent): ServerEvent | undefined {
  if (event.kind !== EventKind.Overrun || before?.kind !== event.kind || before.text !== event.text || before.subject !== event.subject)
    return undefined;
  return { ...event, value: before.value + event.value };
}

const kind = (event: ServerEvent): string =>
  kBad.has(event.kind) ? "bad" : kWarn.has(event.kind) ? "warn" : kNeedle.has(event.kind) ? "needle" : "";

/** What happened, the newest first. */
export class Events {
  readonly element: HTMLElement;
  readonly #list = h("ol", { class: "events", tabindex: 0, "aria-label": "Events, the newest first" });
  readonly #seen = new Set<string>();
  /** Of the line on top. */
  #newest: ServerEvent | undefined;

  constructor() {
    this.element = card("Events", "events", this.#list);
  }

  /** Returns whether the event is a new one: late joiners and comers-back get the last ones again. */
  push(event: ServerEvent): boolean {
    const key = `${event.epoch}/${event.sequence_number}/${event.stamp_ns}`;
    if (this.#seen.has(key)) return false;
    this.#seen.add(key);
    if (this.#seen.size > kRemembered) this.#seen.delete(this.#seen.values().next().value!);
    const joint = joined(this.#newest, event);
    if (joint) this.#list.firstElementChild!.remove();
    this.#newest = event = joint ?? event;
    this.#add(`${event.simulation_time_s.toFixed(2)} s`, eventText(event), kind(event), EventKind[event.kind] ?? "");
    return true;
  }

  notice(text: string, state = ""): void {
    this.#newest = undefined;
    this.#add("", text, state, "Page");
  }

  #add(time: string, text: string, state: string, kindName: string): void {
    this.#list.prepend(h("li", { class: state, "data-kind": kindName }, h("time", {}, time), h("span", {}, text)));
    while (this.#list.children.length > kMost) this.#list.lastElementChild!.remove();
  }
}
