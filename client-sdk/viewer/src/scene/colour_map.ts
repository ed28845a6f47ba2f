// SPDX-License-Identifier: Apache-2.0
// Colours for numbers. Each map grows evenly darker or lighter, so that it can be read without colour.

export type Rgb = [number, number, number];

export interface ColourMap {
  name: string;
  /** Evenly spaced, sRGB in 0 … 1. */
  stops: Rgb[];
}

const hex = (text: string): Rgb[] =>
  text.split(" ").map((c) => [0, 2, 4].map((i) => parseInt(c.slice(i, i + 2), 16) / 255) as Rgb);

export const kStressMaps: readonly ColourMap[] = [
  // At rest the colour of tissue, then through orange and red into violet.
  { name: "Tissue", stops: hex("eab59c f0a77f f39263 ee7749 e25a3c cc3a40 ab204f 831659 581457 300f4a") },
  { name: "Viridis", stops: hex("440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725") },
  { name: "Magma", stops: hex("000004 1c1044 4f127b 812581 b5367a e55064 fb8761 fec287 fcfdbf") },
];

export const kTensionMap: ColourMap = { name: "Tension", stops: hex("3f6ff0 5a6cf2 8a63ee b957e0 e04cc0 fb4a93 ff5b6a") };

/** Returns the colour at `share` of the map, 0 … 1; beyond, its ends. */
export function colourAt(map: ColourMap, share: number): Rgb {
  const last = map.stops.length - 1;
  const at = Math.min(1, Math.max(0, Number.isFinite(share) ? share : 0)) * last;
  const i = Math.min(Math.floor(at), last - 1);
  const a = map.stops[i]!;
  const b = map.stops[i + 1]!;
  return [0, 1, 2].map((k) => a[k]! + (at - i) * (b[k]! - a[k]!)) as Rgb;
}

export const cssColour = (c: Rgb): string => `rgb(${c.map((v) => Math.round(v * 255)).join(" ")})`;

export function cssGradient(map: ColourMap, direction: string): string {
  return `linear-gradient(${direction}, ${map.stops.map(cssColour).join(", ")})`;
}

/** Returns the smallest of 1, 2, 5 times a power of ten that is at least `value`. */
export function niceCeil(value: number): number {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  const digit = [1, 2, 5, 10].find((d) => d * power >= value * (1 - 1e-9)) ?? 10;
  return digit * power;
}

/** Returns round values from 0 to `top`, at most `count` steps. */
export function niceTicks(top: number, count: number): number[] {
  const step = niceCeil(top / count);
  const ticks: number[] = [];
  for (let i = 0; i * step <= top * (1 + 1e-9); ++i) ticks.push(i * step);
  return ticks;
}

/**
 * The end of a colour scale that follows what is shown: up at once, down slowly, in round values so
 * that colours do not swim.
 */
export class AutoRange {
  #top: number;
  readonly #least: number;
  /** Set by a person: the scale stays. */
  fixed: number | undefined;

  constructor(least: number) {
    this.#top = this.#least = least;
  }

  get top(): number {
    return this.fixed ?? niceCeil(this.#top);
  }

  /** Takes the largest value on show; `elapsed_s` since the last call. */
  observe(value: number, elapsed_s: number): void {
    if (!Number.isFinite(value)) return;
    if (value > this.#top) this.#top = value;
    else this.#top = Math.max(this.#least, value, this.#top * Math.exp(-elapsed_s / 8));
  }
}

/** Returns the value that `share` of `values` do not pass: one vertex at a sharp corner sets no scale. */
export function percentile(values: ArrayLike<number>, share: number): number {
  if (values.length === 0) return 0;
  const sorted = Float64Array.from(values).sort();
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))]!;
}
