// SPDX-License-Identifier: Apache-2.0
import type { ConnectionState } from "../connection/worker_messages";
import { ServerState, type ServerStatus } from "../protocol/messages";
import { byId, h, setText } from "./dom";

export interface TopBarActions {
  pauseOrResume(): void;
  reset(): void;
  stop(): void;
  theme(): void;
  help(): void;
}

const kAsk_ms = 3000;

const kPhases: Record<ConnectionState["phase"], string> = { connecting: "connecting", open: "live", lost: "lost" };

/** Name, state, and what concerns everybody: pause, reset, stop. */
export class TopBar {
  readonly #scene = h("span", { class: "scene" });
  readonly #pill = h("span", { class: "pill", id: "connection", role: "status" }, "connecting");
  readonly #time = h("span", { class: "time", title: "Simulation time" });
  readonly #pause: HTMLButtonElement;
  readonly #reset: HTMLButtonElement;
  readonly #stop: HTMLButtonElement;
  readonly #theme: HTMLButtonElement;
  readonly #actions: TopBarActions;
  #asked: ReturnType<typeof setTimeout> | undefined;

  constructor(actions: TopBarActions) {
    this.#actions = actions;
    this.#pause = h("button", { type: "button", title: "Pauses or resumes the simulation (P)", onclick: () => actions.pauseOrResume() }, "Pause");
    this.#reset = h("button", { type: "button", title: "Begins the scene anew (Shift+R)", onclick: () => this.askReset() }, "Reset");
    this.#stop = h("button", { type: "button", class: "stop", title: "Zero force for all tools until a resume (S)", onclick: () => actions.stop() }, "Stop");
    this.#theme = h("button", { type: "button", class: "icon", title: "Light or dark (D)", onclick: () => actions.theme() }, "◐");
    byId("bar").append(
      h("h1", { class: "brand" }, "sutured"), this.#scene, this.#pill, this.#time, h("span", { class: "spacer" }),
      this.#pause, this.#reset, this.#stop, h("span", { class: "divider" }), this.#theme,
      h("button", { type: "button", class: "icon", title: "All keys (H)", "aria-label": "Help", onclick: () => actions.help() }, "?"));
    this.#enable(false);
  }

  /** A reset takes everybody's work away: it is asked twice. */
  askReset(): void {
    if (this.#asked !== undefined) {
      this.#endAsking();
      this.#actions.reset();
      return;
    }
    setText(this.#reset, "Really reset?");
    this.#reset.classList.add("asking");
    this.#asked = setTimeout(() => this.#endAsking(), kAsk_ms);
  }

  setConnection(state: ConnectionState): void {
    setText(this.#pill, kPhases[state.phase]);
    this.#pill.dataset["state"] = state.phase;
    this.#enable(state.phase === "open");
  }

  setStatus(status: ServerStatus): void {
    setText(this.#scene, status.scene);
    document.title = status.scene === "" ? "sutured" : `${status.scene} · sutured`;
    const standing = status.state === ServerState.Paused || status.state === ServerState.Stopped;
    setText(this.#pause, standing ? "Resume" : "Pause");
    this.#pause.classList.toggle("primary", standing);
    if (this.#pill.dataset["state"] === "open" || this.#pill.dataset["state"] === "standing") {
      setText(this.#pill, standing ? ServerState[status.state]!.toLowerCase() : kPhases.open);
      this.#pill.dataset["state"] = standing ? "standing" : "open";
      this.#pill.title = status.state_reason;
    }
  }

  setTime(time_s: number): void {
    setText(this.#time, `${time_s.toFixed(1)} s`);
  }

  setTheme(theme: string): void {
    this.#theme.setAttribute("aria-label", `Colours: ${theme}`);
    this.#theme.title = `Light or dark: ${theme} (D)`;
  }

  #endAsking(): void {
    clearTimeout(this.#asked);
    this.#asked = undefined;
    setText(this.#reset, "Reset");
    this.#reset.classList.remove("asking");
  }

  #enable(on: boolean): void {
    for (const button of [this.#pause, this.#reset, this.#stop]) button.disabled = !on;
  }
}
