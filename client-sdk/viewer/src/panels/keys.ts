// SPDX-License-Identifier: Apache-2.0
import { h } from "./dom";

export interface Shortcut {
  /** KeyboardEvent.code, and Shift where it is asked for. */
  code: string;
  shift?: boolean;
  keys: string;
  help: string;
  act: () => void;
}

/** Keys that are not a single act, for the help only. */
const kHand: [string, string][] = [
  ["drag", "moves the tool across the view, or what Move, Turn, Drive says"],
  ["Shift + drag", "turns the tool"],
  ["Ctrl + drag", "drives the needle along its curve"],
  ["wheel", "nearer or farther; with Ctrl along the needle's curve"],
  ["right drag", "turns the view"],
  ["arrows, Page Up / Down", "move the tool (Alt: slowly)"],
  ["I J K L", "turn the tool"],
  ["Q / E", "needle back / forward"],
];
const kView: [string, string][] = [
  ["drag, one finger", "turns the view"],
  ["wheel, two fingers", "zoom; two fingers or right drag also shift"],
  ["arrows, + / −", "turn the view, zoom"],
  ["click, tap", "picks a place of the tissue"],
];
const kPad: [string, string][] = [
  ["Start", "holds the first free tool, or lets go"],
  ["left shoulder", "hold it: nothing moves without"],
  ["sticks", "left: across the view; right: depth, turn"],
  ["right trigger, shoulder", "needle forward, back"],
  ["left trigger", "slowly"],
  ["A / B", "jaw / to the needle"],
];

/** Returns whether a key acts while the list is open: it closes the list, or it stops, which never waits. */
export const actsUnderList = (code: string): boolean => code === "KeyH" || code === "KeyS";

/** The overlay that lists every key. */
export class Help {
  readonly element: HTMLDialogElement;

  constructor(shortcuts: readonly Shortcut[]) {
    const table = (title: string, rows: readonly (readonly [string, string])[]) =>
      h("section", {}, h("h3", {}, title),
        h("dl", { class: "keys" }, ...rows.map(([keys, help]) => h("div", {}, h("dt", {}, h("kbd", {}, keys)), h("dd", {}, help)))));
    this.element = h("dialog", { class: "help", "aria-labelledby": "help-title" },
      h("div", { class: "help-head" }, h("h2", { id: "help-title" }, "Mouse, touch and keys"),
        h("button", { type: "button", class: "small", "aria-label": "Close", onclick: () => this.element.close() }, "✕")),
      h("div", { class: "help-body" },
        table("Keys", shortcuts.map((each) => [each.keys, each.help] as const)),
        table("Looking", kView), table("While a tool is held", kHand), table("Gamepad", kPad)));
    this.element.addEventListener("click", (event) => {
      if (event.target === this.element) this.element.close();
    });
  }

  toggle(): void {
    if (this.element.open) this.element.close();
    else this.element.showModal();
  }
}
