// SPDX-License-Identifier: Apache-2.0
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { card, h } from "./dom";
import { kWindow_s, Recent } from "./recent";
import { cssVariable } from "./theme";

const kDraw_ms = 66;

/** A live plot over simulation time. */
export class Plot {
  readonly element: HTMLElement;
  readonly recent = new Recent();
  readonly #place = h("div", { class: "plot" });
  readonly #colour: (name: string) => string;
  readonly #least: number;
  #plot: uPlot | undefined;
  #drawn_ms = 0;
  #series = "";

  /** `least` is the smallest end of the scale. */
  constructor(title: string, id: string, unit: string, least: number, colour: (name: string) => string) {
    this.#colour = colour;
    this.#least = least;
    this.element = card(`${title}, ${unit}`, id, this.#place);
    new ResizeObserver(() => this.#plot?.setSize(this.#size())).observe(this.#place);
  }

  /** Makes the plot anew in the colours of the page. */
  restyle(): void {
    this.#plot?.destroy();
    this.#plot = undefined;
  }

  update(now_ms: number): void {
    if (now_ms - this.#drawn_ms < kDraw_ms || this.#place.clientWidth === 0) return;
    this.#drawn_ms = now_ms;
    if (!this.#plot || this.#series !== this.recent.names.join()) this.#make();
    this.#plot!.setData([this.recent.times, ...this.recent.columns] as uPlot.AlignedData);
  }

  #size(): { width: number; height: number } {
    return { width: this.#place.clientWidth, height: 128 };
  }

  #make(): void {
    this.#plot?.destroy();
    this.#series = this.recent.names.join();
    const [grid, text] = [cssVariable("--line"), cssVariable("--dim")];
    const axis: uPlot.Axis = {
      stroke: text, grid: { stroke: grid, width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif", gap: 3,
    };
    this.#plot = new uPlot({
      ...this.#size(),
      legend: { show: this.recent.names.length > 1, live: false },
      cursor: { show: false },
      scales: {
        x: { time: false, range: (_, __, max) => [Math.max(0, (max ?? 0) - kWindow_s), Math.max(max ?? 0, kWindow_s)] },
        y: { range: (_, min, max) => [Math.min(0, min ?? 0), Math.max(this.#least, 1.1 * (max ?? 0))] },
      },
      axes: [
        { ...axis, size: 22, values: (_, splits) => splits.map((s) => `${s} s`) },
        { ...axis, size: 38 },
      ],
      series: [
        {},
        ...this.recent.names.map((name): uPlot.Series => ({
          label: name, stroke: this.#colour(name), width: 1.6, spanGaps: true, points: { show: false },
        })),
      ],
    }, [[], ...this.recent.names.map(() => [])] as uPlot.AlignedData, this.#place);
  }
}
