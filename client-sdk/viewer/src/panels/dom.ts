// SPDX-License-Identifier: Apache-2.0

type Props = Record<string, string | number | boolean | ((event: Event) => void) | undefined>;
type Child = Node | string | undefined;

/** Makes an element: `on…` props listen, booleans are present or absent, the rest are attributes. */
export function h<K extends keyof HTMLElementTagNameMap>(tag: K, props: Props = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (typeof value === "function") element.addEventListener(name.slice(2).toLowerCase(), value);
    else if (typeof value === "boolean") element.toggleAttribute(name, value);
    else if (value !== undefined) element.setAttribute(name, String(value));
  }
  for (const child of children) if (child !== undefined) element.append(child);
  return element;
}

export function byId(id: string): HTMLElement {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found;
}

/** Sets a text only where it changes: the page rests where its figures do. */
export function setText(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export function card(title: string, id: string, ...children: Child[]): HTMLElement {
  return h("section", { class: "card", id, "aria-labelledby": `${id}-title` },
    h("h2", { id: `${id}-title` }, title), ...children);
}

/** Says something to a screen reader. */
export function announce(text: string): void {
  setText(byId("live"), text);
}

/** Figures with their names, in rows. */
export class Figures {
  readonly element = h("dl", { class: "figures" });
  readonly #values = new Map<string, HTMLElement>();

  set(name: string, value: string, state: "" | "warn" | "bad" = "", hint = ""): void {
    let element = this.#values.get(name);
    if (!element) {
      element = h("dd", { "data-figure": name });
      this.#values.set(name, element);
      this.element.append(h("div", {}, h("dt", {}, name), element));
    }
    setText(element, value);
    element.className = state;
    element.title = hint;
  }
}
