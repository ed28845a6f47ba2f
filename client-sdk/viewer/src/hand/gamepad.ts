// SPDX-License-Identifier: Apache-2.0
// A gamepad of the standard layout. Nothing moves unless the left shoulder is held: a pad that lies on the table, or
// falls from it, leads no needle.
import { length, type Vec3 } from "../maths/vector";
import type { HandRates } from "./hand";

const kDeadZone = 0.12;
const kSpeed_m_per_s = 0.04;
const kTurn_rad_per_s = 1.5;
const kDrive_m_per_s = 0.008;
/** By how much less everything moves while the left trigger is pressed through. */
const kSlow = 0.75;
const kRumble_ms = 120;
const kRumblePeriod_ms = 90;
const kQuiet = 0.004; // a needle pierces a wall at a fiftieth of what its driver can give

const [kA, kB, kLeftShoulder, kRightShoulder, kLeftTrigger, kRightTrigger, kStart] = [0, 1, 4, 5, 6, 7, 9];

export interface PadInput {
  /** Zero unless the left shoulder is held. */
  rates: HandRates;
  /** Something is pushed that the left shoulder does not let through. */
  heldBack: boolean;
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

const kStill: HandRates = { move: [0, 0, 0], turn: [0, 0, 0], drive: 0 };

/** The first gamepad that `pads` lists, as `navigator.getGamepads` does. */
export class Pad {
  readonly #pads: () => readonly (Gamepad | null)[];
  #before: boolean[] = [];
  #rumbled_ms = 0;

  constructor(pads: () => readonly (Gamepad | null)[]) {
    this.#pads = pads;
  }

  /** Returns what is pushed now, once a display frame; nothing where there is no pad. */
  read(): PadInput | undefined {
    const pad = this.#pad();
    if (!pad) return undefined;
    const down = pad.buttons.map((button) => button.pressed);
    const pressed = (i: number) => down[i] === true && this.#before[i] !== true;
    const value = (i: number) => pad.buttons[i]?.value ?? 0;
    const pace = 1 - kSlow * value(kLeftTrigger);
    const pushed: HandRates = {
      move: [axis(pad.axes[0]), -axis(pad.axes[1]), axis(pad.axes[3])].map((v) => v * kSpeed_m_per_s * pace) as Vec3,
      turn: [0, axis(pad.axes[2]) * kTurn_rad_per_s * pace, 0],
      drive: (value(kRightTrigger) - value(kRightShoulder)) * kDrive_m_per_s * pace,
    };
    const still = length(pushed.move) === 0 && length(pushed.turn) === 0 && pushed.drive === 0;
    const letThrough = down[kLeftShoulder] === true;
    const input: PadInput = {
      rates: letThrough ? pushed : kStill,
      heldBack: !letThrough && !still,
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
    return this.#pads().find((pad) => pad?.connected && pad.mapping === "standard") ?? undefined;
  }
}
