// SPDX-License-Identifier: Apache-2.0
import type { ConnectionState } from "../connection/worker_messages";
import { byId, h } from "./dom";

/** What covers the picture while there is none: connecting, lost, no scene. */
export class Overlay {
  readonly #element = byId("overlay");
  readonly #retry: () => void;
  #key = "";
  #timer: ReturnType<typeof setInterval> | undefined;

  constructor(retry: () => void) {
    this.#retry = retry;
  }

  show(state: ConnectionState, hasScene: boolean): void {
    const key = `${state.phase}/${hasScene}/${state.phase === "lost" ? `${state.attempt}${state.refused}` : ""}`;
    if (key === this.#key) return;
    this.#key = key;
    clearInterval(this.#timer);
    this.#element.classList.toggle("slim", hasScene);
    this.#element.hidden = state.phase === "open" && hasScene;
    document.documentElement.dataset["connection"] = state.phase;
    if (state.phase === "open") this.#say("No scene yet", ["The server is connected and has sent no tissue. A scene appears here as soon as there is one."], true);
    else if (state.phase === "connecting") this.#say("Connecting", [hasScene ? "The picture is the last one." : ""], true);
    else this.#lost(state, hasScene);
  }

  #lost(state: Extract<ConnectionState, { phase: "lost" }>, hasScene: boolean): void {
    const wait = h("p", {});
    const tell = () => {
      const left = Math.max(0, Math.ceil((state.retryAtMs - Date.now()) / 1000));
      wait.textContent = left > 0 ? `Trying again in ${left} s.` : "Trying again.";
    };
    tell();
    this.#timer = setInterval(tell, 250);
    const lastPicture = hasScene ? "The picture is the last one." : "";
    const retry = h("button", { type: "button", class: "primary", onclick: () => this.#retry() }, "Try now");
    if (state.refused)
      this.#say("Access refused", ["This server asks for a token, and has been given none that holds.", lastPicture], false,
        tokenForm(), h("button", { type: "button", onclick: () => this.#retry() }, "Try again"));
    else if (state.everOpen) this.#say("Connection lost", [lastPicture], false, wait, retry);
    else this.#say("No answer", ["Is the server running?"], false, wait, retry);
  }

  #say(title: string, texts: string[], busy: boolean, ...more: Node[]): void {
    this.#element.replaceChildren(h("div", { class: "overlay-box", role: "status" },
      busy ? h("div", { class: "spinner", "aria-hidden": "true" }) : undefined,
      h("h2", {}, title), ...texts.filter((text) => text !== "").map((text) => h("p", {}, text)), ...more));
  }
}

/** A token goes behind the `#`, where it stays in the browser; the page then begins anew with it. */
function tokenForm(): HTMLElement {
  const token = h("input", { type: "password", "aria-label": "Token", autocomplete: "off", required: true });
  return h("form", {
    class: "token",
    onsubmit: (event) => {
      event.preventDefault();
      location.hash = new URLSearchParams({ token: token.value.trim() }).toString();
    },
  }, token, h("button", { type: "submit", class: "primary" }, "Open"));
}
