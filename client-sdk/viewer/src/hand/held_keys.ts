// SPDX-License-Identifier: Apache-2.0
import type { HandRates } from "./hand";
import { add, type Vec3 } from "../maths/vector";

const kSpeed_m_per_s = 0.03;
const kDrive_m_per_s = 0.008;
const kTurn_rad_per_s = 1.2;

/** Keys that act while they are down and a tool is held: [move, turn, drive]. Also with Shift. */
const kRates: Record<string, [Vec3, Vec3, number]> = {
  ArrowLeft: [[-1, 0, 0], [0, 0, 0], 0],
  ArrowRight: [[1, 0, 0], [0, 0, 0], 0],
  ArrowUp: [[0, 1, 0], [0, 0, 0], 0],
  ArrowDown: [[0, -1, 0], [0, 0, 0], 0],
  PageUp: [[0, 0, -1], [0, 0, 0], 0],
  PageDown: [[0, 0, 1], [0, 0, 0], 0],
  KeyJ: [[0, 0, 0], [0, -1, 0], 0],
  KeyL: [[0, 0, 0], [0, 1, 0], 0],
  KeyI: [[0, 0, 0], [-1, 0, 0], 0],
  KeyK: [[0, 0, 0], [1, 0, 0], 0],
  KeyQ: [[0, 0, 0], [0, 0, 0], -1],
  KeyE: [[0, 0, 0], [0, 0, 0], 1],
};

/** Which of those keys and buttons are down. */
export class HeldKeys {
  readonly #down = new Set<string>();

  /** Returns whether the key is one of the hand's. */
  press(code: string): boolean {
    if (!(code in kRates)) return false;
    this.#down.add(code);
    return true;
  }
  release(code: string): void {
    this.#down.delete(code);
  }
  clear(): void {
    this.#down.clear();
  }
  /** Takes any key's keydown or keyup: macOS tells no keyup of a key that is released while Meta (⌘) is down. */
  heed(event: { key: string; metaKey: boolean }): void {
    if (event.metaKey || event.key === "Meta") this.clear();
  }

  rates(slow: boolean): HandRates {
    const factor = slow ? 0.25 : 1;
    const sum: HandRates = { move: [0, 0, 0], turn: [0, 0, 0], drive: 0 };
    for (const code of this.#down) {
      const [move, turn, drive] = kRates[code]!;
      sum.move = add(sum.move, move.map((v) => v * kSpeed_m_per_s * factor) as Vec3);
      sum.turn = add(sum.turn, turn.map((v) => v * kTurn_rad_per_s * factor) as Vec3);
      sum.drive += drive * kDrive_m_per_s * factor;
    }
    return sum;
  }
}

export function addRates(a: HandRates, b: HandRates | undefined): HandRates {
  return b ? { move: add(a.move, b.move), turn: add(a.turn, b.turn), drive: a.drive + b.drive } : a;
}
