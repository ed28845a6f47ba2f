// SPDX-License-Identifier: Apache-2.0
const kFirst_ms = 250;
const kLongest_ms = 8000;

/**
 * Returns how long to wait before attempt `attempt` (0 is the first after a loss): doubled each time
 * up to 8 s, and up to a quarter less by `random` in [0, 1) so that many pages do not come at once.
 */
export function backoffMs(attempt: number, random: number): number {
  return Math.min(kFirst_ms * 2 ** Math.min(attempt, 16), kLongest_ms) * (1 - 0.25 * random);
}
