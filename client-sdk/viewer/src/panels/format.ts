// SPDX-License-Identifier: Apache-2.0
// Numbers for people: SI inside, millimetres, kilopascals and milliseconds on show.

const fixed = (value: number, digits: number): string => (Number.isFinite(value) ? value.toFixed(digits) : "–");

export const mm = (m: number, digits = 1): string => `${fixed(m * 1e3, digits)} mm`;
export const kPa = (pa: number): string => `${fixed(pa / 1e3, Math.abs(pa) < 1e4 ? 2 : 1)} kPa`;
export const newton = (n: number): string => `${fixed(n, 2)} N`;
export const hz = (value: number): string => `${fixed(value, 0)} Hz`;
export const ms = (us: number): string => `${fixed(us / 1e3, us < 1e4 ? 2 : 1)} ms`;
export const seconds = (s: number): string => `${fixed(s, 1)} s`;
export const count = (value: number | bigint): string => value.toLocaleString("en").replaceAll(",", " ");

export const position = (p: ArrayLike<number>): string =>
  `${[0, 1, 2].map((i) => fixed(p[i]! * 1e3, 2)).join(", ")} mm`;

/** Ticks of a scale without needless zeros. */
export const tick = (value: number): string => String(Number(value.toPrecision(3)));
