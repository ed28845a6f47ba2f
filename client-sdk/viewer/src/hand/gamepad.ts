// SPDX-License-Identifier: Apache-2.0
// A gamepad of the standard layout: sticks move, triggers and shoulders work the jaw and the needle.
import { length, type Vec3 } from "../maths/vector";
import type { HandRates } from "./hand";

const kDeadZone = 0.12;
const kSpeed_m_per_s = 0.04;
const kDrive_m_per_s = 0.008;
const kRumble_ms = 120;
const kRumblePeriod_ms = 90;
const kQuiet = 0.02;

const [kA, kB, kLeftShoulder, kRightShoulder, kLeftTrigger, kRightTrigger, kStart] = [0, 1, 4, 5, 6, 7, 9];

export interface PadInput {
  rates: HandRates;
  /** Pressed since the last look. */
  jaw: boolean;
  reach: boolean;
  hold: boolean;
}

const axis = (value: number | undefined): number => {
  const v = value ?? 0;
  return Math.abs(v) < kDeadZone ? 0 : Math.sign(v) * ((Math.abs(v) - kDeadZone) / (1 - kDeadZone)) ** 2;
};

/** Returns how strongly a pad of two motors shakes at a force that is `share` of the tool's largest. */
export function rumble(share: number): { strong: number; weak: number } {
  const felt = Math.min(1, Math.max(0, share));
  return felt < kQuiet ? { strong: 0, weak: 0 } : { strong: felt ** 1.5, weak: Math.sqrt(felt) };
}

export class Pad {
  #before: boolean[] = [];
  #rumbled_ms = 0;

  get present(): boolean {
    return this.#pad() !== undefined;
  }

  read(): PadInput | undefined {
    const pad = this.#pad();
    if (!pad) return undefined;
    const down = pad.buttons.map((button) => button.pressed);
    const pressed = (i: number) => down[i] === true && this.#before[i] !== true;
    const value = (i: number) => pad.buttons[i]?.value ?? 0;
    const move: Vec3 = [axis(pad.axes[0]), -axis(pad.axes[1]), axis(pad.axes[3])].map((v) => v * kSpeed_m_per_s) as Vec3;
    const input: PadInput = {
      rates: {
        move,
        turn: [0, axis(pad.axes[2]) * 1.5, 0],
        drive: (value(kRightTrigger) - value(kLeftTrigger) + value(kRightShoulder) - value(kLeftShoulder)) * kDrive_m_per_s,
      },
      jaw: pressed(kA),
      reach: pressed(kB),
      hold: pressed(kStart),
    };
    this.#before = down;
    return input;
  }

  /** Lets the pad shake by a force, newtons, of a tool that can give `max_n`. */
  feel(force: Vec3, max_n: number, now_ms: number): void {
    const actuator = this.#pad()?.vibrationActuator;
    if (!actuator || now_ms - this.#rumbled_ms < kRumblePeriod_ms) return;
    const { strong, weak } = rumble(length(force) / (max_n || 1));
    if (weak === 0) return;
    this.#rumbled_ms = now_ms;
    void actuator
      .playEffect("dual-rumble", { duration: kRumble_ms, strongMagnitude: strong, weakMagnitude: weak })
      .catch(() => undefined);
  }

  #pad(): Gamepad | undefined {
    return navigator.getGamepads?.().find((pad) => pad?.connected && pad.mapping === "standard") ?? undefined;
  }
}
