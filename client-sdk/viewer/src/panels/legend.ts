// SPDX-License-Identifier: Apache-2.0
import { cssGradient, kStressMaps, kTensionMap, niceTicks, type AutoRange, type ColourMap } from "../scene/colour_map";
import { h, setText } from "./dom";
import { tick } from "./format";

class Scale {
  readonly bar = h("div", { class: "scale-bar" });
  readonly ticks = h("div", { class: "scale-ticks" });
  #top = NaN;

  update(top: number, steps: number): void {
    if (top === this.#top) return;
    this.#top = top;
    this.ticks.replaceChildren(
      ...niceTicks(top, steps).map((value) => h("span", { style: `bottom:${((100 * value) / top).toFixed(2)}%` }, tick(value))),
    );
  }
}

/** What the colours mean: stress in kPa, tension in N. */
export class Legend {
  readonly element: HTMLElement;
  readonly #stress = new Scale();
  readonly #tension = new Scale();
  readonly #tensionPart: HTMLElement;
  readonly #hold: HTMLButtonElement;
  readonly #range: AutoRange;
  #map = 0;

  constructor(range: AutoRange, setMap: (map: ColourMap) => void) {
    this.#range = range;
    this.#tension.bar.style.background = cssGradient(kTensionMap, "to top");
    this.#stress.bar.style.background = cssGradient(kStressMaps[0]!, "to top");
    this.#hold = h("button", { class: "small", type: "button", "aria-pressed": "false", title: "Keep the scale as it is", onclick: () => this.holdScale() }, "Hold");
    const map = h("button", { class: "small", type: "button", title: "Other colours (C)", onclick: () => this.nextMap() }, kStressMaps[0]!.name);
    this.nextMap = () => {
      this.#map = (this.#map + 1) % kStressMaps.length;
      const chosen = kStressMaps[this.#map]!;
      this.#stress.bar.style.background = cssGradient(chosen, "to top");
      setText(map, chosen.name);
      setMap(chosen);
    };
    this.#tensionPart = h("div", { class: "scale", role: "img", "aria-label": "Colours of the thread's tension, newtons", hidden: true },
      h("div", { class: "scale-title" }, "tension ", h("b", {}, "N")), h("div", { class: "scale-body" }, this.#tension.bar, this.#tension.ticks));
    this.element = h("div", { class: "legend" },
      h("div", { class: "scale" },
        h("div", { class: "scale-title" }, "von Mises ", h("b", {}, "kPa")),
        h("div", { class: "scale-body", role: "img", "aria-label": "Colours of the stress, kilopascals" }, this.#stress.bar, this.#stress.ticks),
        h("div", { class: "scale-buttons" }, map, this.#hold)),
      this.#tensionPart);
  }

  nextMap: () => void;

  holdScale(): void {
    this.#range.fixed = this.#range.fixed === undefined ? this.#range.top : undefined;
    this.#hold.setAttribute("aria-pressed", String(this.#range.fixed !== undefined));
  }

  update(stress_pa: number, tension_n: number, hasThread: boolean): void {
    this.#stress.update(stress_pa / 1000, 5);
    this.#tensionPart.hidden = !hasThread;
    if (hasThread) this.#tension.update(tension_n, 3);
  }
}
