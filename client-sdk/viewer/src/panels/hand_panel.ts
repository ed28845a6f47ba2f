// SPDX-License-Identifier: Apache-2.0
import type { DragMode, Hand } from "../hand/hand";
import type { HeldKeys } from "../hand/held_keys";
import { length } from "../maths/vector";
import { faultNames, ToolState, type ToolStatus, type ToolView } from "../protocol/messages";
import { announce, card, h, setText } from "./dom";
import { mm, newton } from "./format";

const kStates: Record<ToolState, string> = {
  [ToolState.Idle]: "free", [ToolState.Rendering]: "felt", [ToolState.Ramping]: "ramping", [ToolState.Clutched]: "clutched",
  [ToolState.Fault]: "fault", [ToolState.Stopped]: "stopped", [ToolState.Paused]: "paused",
};

const kModes: { mode: DragMode; label: string; hint: string }[] = [
  { mode: "move", label: "Move", hint: "Drag moves the tool across the view; the wheel moves it nearer or farther" },
  { mode: "turn", label: "Turn", hint: "Drag turns the tool (also Shift and drag)" },
  { mode: "drive", label: "Drive", hint: "Drag drives the needle along its own curve (also Ctrl and drag); without a needle it rolls the tool" },
];

interface Row {
  element: HTMLElement;
  state: HTMLElement;
  force: HTMLElement;
  button: HTMLButtonElement;
}

/** The tools of the scene, and the hand that this page is. */
export class HandPanel {
  readonly element: HTMLElement;
  readonly #hand: Hand;
  readonly #rows = new Map<string, Row>();
  readonly #list = h("ul", { class: "tools" });
  readonly #controls: HTMLElement;
  readonly #lease = h("p", { class: "lease", role: "status" });
  readonly #modes = new Map<DragMode, HTMLButtonElement>();
  readonly #jaw: HTMLButtonElement;
  readonly #bar = h("div", { class: "meter-fill" });
  readonly #force = h("output", {});
  readonly #hint = h("p", { class: "hint" });
  readonly #near = h("span", {});
  readonly #meter: HTMLElement;
  #leaseText = "";
  /** A gamepad is pushed, without the shoulder that lets it move the tool. */
  padHeldBack = false;

  constructor(hand: Hand, keys: HeldKeys) {
    this.#hand = hand;
    const held = (code: string, label: string, hint: string) => h("button", {
      type: "button", title: hint,
      onpointerdown: (event) => {
        (event.currentTarget as Element).setPointerCapture((event as PointerEvent).pointerId);
        keys.press(code);
      },
      onpointerup: () => keys.release(code),
      onpointercancel: () => keys.release(code),
      onkeydown: (event) => {
        if (["Enter", "Space"].includes((event as KeyboardEvent).code)) keys.press(code);
      },
      onkeyup: () => keys.release(code),
      onblur: () => keys.release(code),
    }, label);
    this.#jaw = h("button", { type: "button", "aria-pressed": "false", title: "Closes or opens the jaw (space)", onclick: () => this.toggleJaw() }, "Close jaw");
    const modes = h("div", { class: "segments", role: "group", "aria-label": "What a drag does" });
    for (const { mode, label, hint } of kModes) {
      const button = h("button", { type: "button", title: hint, "aria-pressed": "false", onclick: () => this.setMode(mode) }, label);
      this.#modes.set(mode, button);
      modes.append(button);
    }
    this.#meter = h("div", { class: "meter", role: "meter", "aria-label": "Force on the hand, newtons", "aria-valuemin": 0 }, this.#bar);
    this.#controls = h("div", { class: "hand", hidden: true },
      this.#lease, modes, this.#hint,
      h("div", { class: "buttons" }, this.#jaw,
        h("button", { type: "button", title: "Leads the open jaw to the needle, at a hand's pace (N)", onclick: () => this.reach() }, "To the needle"),
        h("button", { type: "button", title: "Leads the open jaw to the thread, beside the tissue (F)", onclick: () => this.reachForThread() }, "To the thread")),
      h("div", { class: "buttons" },
        held("PageDown", "Nearer", "Towards you (Page Down, wheel)"), held("PageUp", "Farther", "Away from you (Page Up, wheel)"),
        held("KeyQ", "Back", "Needle back along its curve (Q)"), held("KeyE", "Forward", "Needle forward along its curve (E)")),
      h("div", { class: "force" }, h("span", {}, "Force"), this.#meter, this.#force),
      h("p", { class: "hint" }, this.#near));
    this.element = card("Tools", "tools", this.#list, this.#controls);
    this.setMode("move");
  }

  setMode(mode: DragMode): void {
    this.#hand.mode = mode;
    for (const [each, button] of this.#modes) button.setAttribute("aria-pressed", String(each === mode));
    setText(this.#hint, kModes.find((each) => each.mode === mode)!.hint);
  }

  toggleJaw(): void {
    this.#hand.closed = !this.#hand.closed;
  }

  reach(): void {
    if (!this.#hand.reach()) announce("There is no free needle to reach for, or the jaw holds something");
  }

  reachForThread(): void {
    if (!this.#hand.reachForThread()) announce("There is no thread to reach for, or the jaw holds something");
  }

  /** Holds that tool, or lets go of it. */
  toggle(tool: string): void {
    if (this.#hand.tool === tool) this.#hand.release();
    else this.#hand.take(tool);
  }

  get tools(): string[] {
    return [...this.#rows.keys()];
  }

  /** `served`: the names of all tools of the scene, where they are known; the row of any other goes. */
  setTools(tools: readonly { view: ToolView; status: ToolStatus | undefined; colour: string }[], served?: readonly string[]): void {
    for (const name of this.#rows.keys())
      if (served && !served.includes(name) && !tools.some(({ view }) => view.tool === name)) this.#drop(name);
    for (const { view, status, colour } of tools) {
      const row = this.#rows.get(view.tool) ?? this.#add(view.tool, colour);
      const mine = this.#hand.tool === view.tool;
      const leased = status?.leased === true;
      const faults = faultNames(view.faults);
      const holds = view.holding === "" ? "" : `, holds ${view.holding}`;
      const state = !leased && !mine ? "free" : `${kStates[view.state] ?? "?"}${holds}${faults.length > 0 ? ` – ${faults.join(", ")}` : ""}`;
      setText(row.state, state);
      row.element.classList.toggle("bad", view.state === ToolState.Fault || view.state === ToolState.Stopped);
      row.element.classList.toggle("mine", mine);
      setText(row.force, leased || mine ? newton(length([view.force_n[0]!, view.force_n[1]!, view.force_n[2]!])) : "");
      const others = leased && !mine;
      setText(row.button, mine ? "Let go" : others ? "In use" : "Hold");
      row.button.disabled = others;
      row.button.title = others ? "Another device holds this tool" : mine ? "Gives the tool back (Esc)" : `Holds the ${view.tool} with mouse, keys or gamepad (G)`;
    }
  }

  /** `near`: what is next to the jaw, for people. */
  update(maxForce_n: number, near: { name: string; distance_m: number } | undefined, holding: string): void {
    const { tool, report } = this.#hand;
    this.#controls.hidden = tool === undefined;
    const lease = report?.lease ?? (tool ? "asking" : "none");
    document.documentElement.dataset["lease"] = lease;
    if (!tool) {
      this.#say("");
      return;
    }
    this.#say(lease === "held" ? `You hold the ${tool}` : lease === "refused" ? `Another device holds the ${tool}` : `Asking for the ${tool} …`);
    const force_n = report ? length(report.force) : 0;
    const share = Math.min(1, force_n / (maxForce_n || 1));
    this.#bar.style.transform = `scaleX(${share.toFixed(3)})`;
    this.#meter.classList.toggle("high", share > 0.8);
    this.#meter.setAttribute("aria-valuemax", maxForce_n.toFixed(2));
    this.#meter.setAttribute("aria-valuenow", force_n.toFixed(2));
    setText(this.#force, newton(force_n));
    this.#jaw.setAttribute("aria-pressed", String(this.#hand.closed));
    setText(this.#jaw, this.#hand.closed ? "Open jaw" : "Close jaw");
    setText(this.#near, this.padHeldBack ? "Gamepad: hold the left shoulder to move." : holding !== "" ? `The jaw holds ${holding}.`
      : this.#hand.reaching ? "On the way …"
        : near ? `${near.name}: ${mm(near.distance_m)} from the jaw` : "");
  }

  #say(text: string): void {
    if (text === this.#leaseText) return;
    this.#leaseText = text;
    setText(this.#lease, text);
  }

  #drop(tool: string): void {
    this.#rows.get(tool)?.element.remove();
    this.#rows.delete(tool);
    if (this.#hand.tool === tool) this.#hand.release("the scene has no such tool");
  }

  #add(tool: string, colour: string): Row {
    const state = h("span", { class: "tool-state" });
    const force = h("span", { class: "tool-force" });
    const button = h("button", { type: "button", class: "small", onclick: () => this.toggle(tool), "aria-label": `${tool}: hold or let go` }, "Hold");
    const element = h("li", { "data-tool": tool }, h("span", { class: "dot", style: `--colour:${colour}` }),
      h("span", { class: "tool-name" }, tool), state, force, button);
    const row = { element, state, force, button };
    this.#rows.set(tool, row);
    this.#list.append(element);
    return row;
  }
}
