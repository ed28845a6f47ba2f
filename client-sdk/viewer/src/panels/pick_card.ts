// SPDX-License-Identifier: Apache-2.0
import type { TissueProbe } from "../scene/tissue";
import { Figures, h, setText } from "./dom";
import { kPa, mm, position } from "./format";

/** Numbers of the place that was picked. */
export class PickCard {
  readonly element: HTMLElement;
  readonly #figures = new Figures();
  readonly #title = h("h2", {});

  constructor(close: () => void) {
    this.element = h("div", { class: "pick", hidden: true, role: "region", "aria-label": "Picked place" },
      h("div", { class: "pick-head" }, this.#title, h("button", { type: "button", class: "small", "aria-label": "Close", onclick: close }, "✕")),
      this.#figures.element);
  }

  show(probe: TissueProbe | undefined): void {
    this.element.hidden = probe === undefined;
    if (!probe) return;
    setText(this.#title, probe.body);
    this.#figures.set("Vertex", String(probe.vertex));
    this.#figures.set("Position", position(probe.position_m));
    this.#figures.set("Moved by", mm(probe.displacement_m, 2));
    this.#figures.set("Von Mises", kPa(probe.von_mises_pa));
    if (probe.principal_pa) this.#figures.set("Principal", probe.principal_pa.map((p) => (p / 1000).toFixed(2)).join(", ") + " kPa");
  }
}
