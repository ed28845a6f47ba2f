// SPDX-License-Identifier: Apache-2.0

export type Theme = "auto" | "light" | "dark";

const kKey = "suture.theme";
const kThemes: readonly Theme[] = ["auto", "light", "dark"];

/** Light or dark: as the system says, or as the person chose. */
export class ThemeSwitch {
  #theme: Theme;
  readonly #changed: () => void;

  /** `asked`: instead of what the person chose before. */
  constructor(changed: () => void, asked?: Theme) {
    this.#changed = changed;
    this.#theme = asked ?? kThemes.find((theme) => theme === localStorage.getItem(kKey)) ?? "auto";
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => this.#apply());
    this.#apply();
  }

  get theme(): Theme {
    return this.#theme;
  }

  next(): void {
    this.#theme = kThemes[(kThemes.indexOf(this.#theme) + 1) % kThemes.length]!;
    localStorage.setItem(kKey, this.#theme);
    this.#apply();
  }

  #apply(): void {
    const light = this.#theme === "light" || (this.#theme === "auto" && matchMedia("(prefers-color-scheme: light)").matches);
    document.documentElement.dataset["theme"] = light ? "light" : "dark";
    this.#changed();
  }
}

export const cssVariable = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
