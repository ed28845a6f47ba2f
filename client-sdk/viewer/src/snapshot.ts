// SPDX-License-Identifier: Apache-2.0
// One fixed picture, for `suture snapshot`. The page tells whoever waits for it by attributes of its root:
//
//     data-ready                              the picture is drawn, and stays as it is
//     data-error, data-mend, data-error-kind  there will be none: why, what helps, and "input", "access" or "failed"
//     data-waits                              what is missing still
import { kPresets, presetNamed, type Preset } from "./scene/cameras";

export type SnapshotErrorKind = "input" | "access" | "failed";

/** A status comes twice a second: after two of them each topic has had its turn. */
const kStatuses = 2;

/** Knows when everything of a scene has come. Pure. */
export class SceneWatch {
  #epoch: bigint | undefined;
  readonly #shown = new Set<string>();
  #bodies: number | undefined;
  #statuses = 0;

  frame(epoch: bigint, body: string): void {
    this.#meet(epoch);
    this.#shown.add(body);
  }

  /** Takes a status of a scene that has `bodies` tissues. */
  status(epoch: bigint, bodies: number): void {
    this.#meet(epoch);
    this.#bodies = bodies;
    this.#statuses = this.#allShown ? this.#statuses + 1 : 0;
  }

  get complete(): boolean {
    return this.#allShown && this.#statuses >= kStatuses;
  }

  /** Returns what is missing, for people; empty where nothing is. */
  get waits(): string {
    if (this.#shown.size === 0) return "the server has sent no scene";
    if (this.#bodies === undefined) return "the server has sent no status";
    if (!this.#allShown) return `${this.#shown.size} of the scene's ${this.#bodies} tissues have come`;
    return this.complete ? "" : "the scene has only just come";
  }

  get #allShown(): boolean {
    return this.#bodies !== undefined && this.#bodies > 0 && this.#shown.size >= this.#bodies;
  }

  /** What came before a new epoch is of another scene. */
  #meet(epoch: bigint): void {
    if (epoch === this.#epoch) return;
    this.#epoch = epoch;
    this.#shown.clear();
    this.#bodies = undefined;
    this.#statuses = 0;
  }
}

/** The page as a picture: of which view, and how far it is. */
export class Snapshot {
  readonly scene = new SceneWatch();
  readonly view: Preset;
  /** The picture is as it shall be: nothing moves any more. */
  fixed = false;

  constructor(view: string) {
    document.documentElement.toggleAttribute("data-snapshot", true);
    this.view = presetNamed(view) ?? kPresets[0];
    if (!presetNamed(view))
      tellError("input", `there is no view "${view}"`, `take one of ${kPresets.map((name) => name.toLowerCase()).join(", ")}`);
  }

  /** `connected`: to the server's WebSocket. */
  tellWaiting(connected: boolean): void {
    document.documentElement.dataset["waits"] = connected ? this.scene.waits : "the server has not let the page in";
  }

  tellReady(): void {
    document.documentElement.dataset["ready"] = "";
  }
}

export function tellError(kind: SnapshotErrorKind, error: string, mend: string): void {
  Object.assign(document.documentElement.dataset, { error, mend, errorKind: kind });
}
