// SPDX-License-Identifier: Apache-2.0
// Which epoch is on show. A server's only grow; another server's, on the same port, may begin anywhere.

export class Epochs {
  #now = -1n;
  #connected = false;

  get now(): bigint {
    return this.#now;
  }

  /** A connection was made, maybe to another server than before. */
  connected(): void {
    this.#connected = true;
  }

  /** Takes a message's epoch: "new" is the first of it, "old" one that was on the way while a newer began. */
  take(epoch: bigint): "now" | "new" | "old" {
    const connected = this.#connected;
    this.#connected = false;
    if (epoch === this.#now) return "now";
    if (epoch < this.#now && !connected) return "old";
    this.#now = epoch;
    return "new";
  }
}

/** The body that leads an epoch: time and rates are read from its frames, and once it comes again all others have come. */
export class Lead {
  #epoch = -1n;
  #body = "";
  #frames = 0;

  /** Takes a frame's body. Returns how many frames the lead has had, and 0 where this is one of another body. */
  take(epoch: bigint, body: string): number {
    if (epoch !== this.#epoch) {
      this.#epoch = epoch;
      this.#body = body;
      this.#frames = 0;
    }
    return body === this.#body ? ++this.#frames : 0;
  }
}
