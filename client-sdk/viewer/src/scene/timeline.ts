// SPDX-License-Identifier: Apache-2.0
// Frames come at 60 Hz and unevenly; the display draws at its own rate. So the scene is shown a little
// in the past, where there is a frame on either side of the moment drawn.

const kForget = 0.002;
const kJump_ms = 1000;
const kShortestDelay_ms = 8;
const kLongestDelay_ms = 150;

/**
 * Maps this machine's clock to the moment of the server's that is on show:
 *
 *     moment = now − offset − delay
 *
 * offset  the smallest (received − stamp) seen, forgotten slowly: clocks drift
 * delay   one and a half frame periods, by the mean of what came
 */
export class PlayClock {
  #offset_ms: number | undefined;
  #last_ms = 0;
  #interval_ms = 1000 / 60;

  /** Takes the stamp of a frame and when it came, in milliseconds. */
  observe(stamp_ms: number, received_ms: number): void {
    const offset_ms = received_ms - stamp_ms;
    if (this.#offset_ms === undefined || Math.abs(offset_ms - this.#offset_ms) > kJump_ms || offset_ms < this.#offset_ms)
      this.#offset_ms = offset_ms;
    else this.#offset_ms += (offset_ms - this.#offset_ms) * kForget;
    const interval_ms = stamp_ms - this.#last_ms;
    if (interval_ms > 0 && interval_ms < kJump_ms) this.#interval_ms += 0.05 * (interval_ms - this.#interval_ms);
    if (interval_ms > 0 || interval_ms < -kJump_ms) this.#last_ms = stamp_ms;
  }

  get delay_ms(): number {
    return Math.min(kLongestDelay_ms, Math.max(kShortestDelay_ms, 1.5 * this.#interval_ms));
  }

  /** Returns the moment on show, in milliseconds of the server's stamps. */
  moment_ms(now_ms: number): number {
    return now_ms - (this.#offset_ms ?? 0) - this.delay_ms;
  }
}

export interface Between<T> {
  before: T;
  after: T;
  /** 0 at `before`, 1 at `after`. */
  share: number;
}

const kKept = 8;

/** The last frames of one thing, by stamp. */
export class Timeline<T> {
  #frames: { stamp_ms: number; value: T }[] = [];

  /** Takes a frame; one that is older than the last begins anew: the server was restarted. */
  push(stamp_ms: number, value: T): void {
    const last = this.#frames.at(-1);
    if (last && stamp_ms < last.stamp_ms) this.#frames = [];
    if (last && stamp_ms === last.stamp_ms) this.#frames.pop();
    this.#frames.push({ stamp_ms, value });
    if (this.#frames.length > kKept) this.#frames.shift();
  }

  clear(): void {
    this.#frames = [];
  }

  get latest(): T | undefined {
    return this.#frames.at(-1)?.value;
  }

  /** Returns the frames on either side of `moment_ms`; beyond the ends, the end twice. */
  at(moment_ms: number): Between<T> | undefined {
    const frames = this.#frames;
    if (frames.length === 0) return undefined;
    let i = frames.length - 1;
    while (i > 0 && frames[i]!.stamp_ms > moment_ms) --i;
    const before = frames[i]!;
    const after = frames[i + 1] ?? before;
    const span = after.stamp_ms - before.stamp_ms;
    const share = span > 0 ? Math.min(1, Math.max(0, (moment_ms - before.stamp_ms) / span)) : 0;
    return { before: before.value, after: after.value, share };
  }
}

/** Writes a + share (b − a) into `out`, or `b` where their lengths differ; returns how many numbers. */
export function mixInto(out: Float32Array | Float64Array, a: ArrayLike<number>, b: ArrayLike<number>, share: number): number {
  if (a.length !== b.length || a === b) {
    for (let i = 0; i < b.length; ++i) out[i] = b[i]!;
  } else {
    for (let i = 0; i < b.length; ++i) out[i] = a[i]! + share * (b[i]! - a[i]!);
  }
  return b.length;
}

export const stampMs = (stamp_ns: bigint): number => Number(stamp_ns / 1000n) / 1000;
