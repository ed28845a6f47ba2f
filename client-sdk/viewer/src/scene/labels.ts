// SPDX-License-Identifier: Apache-2.0
import { Vector3, type Camera } from "three";
import type { Vec3 } from "../maths/vector";

export interface Label {
  key: string;
  text: string;
  at: Vec3;
  colour: string;
}

/** Short texts that follow points of the scene; they are for the eye only, panels say the same. */
export class Labels {
  readonly #layer: HTMLElement;
  readonly #elements = new Map<string, HTMLElement>();

  constructor(layer: HTMLElement) {
    this.#layer = layer;
  }

  set(labels: readonly Label[], camera: Camera, width: number, height: number): void {
    const left = new Set(this.#elements.keys());
    const place = new Vector3();
    for (const label of labels) {
      left.delete(label.key);
      let element = this.#elements.get(label.key);
      if (!element) {
        element = document.createElement("div");
        element.className = "label";
        this.#layer.append(element);
        this.#elements.set(label.key, element);
      }
      place.set(...label.at).project(camera);
      const seen = place.z < 1 && Math.abs(place.x) < 1.1 && Math.abs(place.y) < 1.1;
      element.hidden = !seen;
      if (!seen) continue;
      if (element.textContent !== label.text) element.textContent = label.text;
      element.style.setProperty("--colour", label.colour);
      element.style.transform = `translate(${(((place.x + 1) / 2) * width).toFixed(1)}px, ${(((1 - place.y) / 2) * height).toFixed(1)}px)`;
    }
    for (const key of left) {
      this.#elements.get(key)?.remove();
      this.#elements.delete(key);
    }
  }
}
