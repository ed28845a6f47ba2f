// SPDX-License-Identifier: Apache-2.0
// As much of a page as the panels need.

class Element {
  readonly attributes = new Map<string, string>();
  readonly dataset: Record<string, string> = {};
  readonly style: Record<string, string> = {};
  readonly listeners = new Map<string, (event: object) => void>();
  children: Element[] = [];
  parent: Element | undefined;
  hidden = false;
  disabled = false;
  #text = "";

  get textContent(): string {
    return this.#text + this.children.map((child) => child.textContent).join(" ");
  }
  set textContent(text: string) {
    this.children = [];
    this.#text = text;
  }
  readonly classList = { toggle() {}, add() {}, remove() {} };
  get firstElementChild() {
    return this.children[0];
  }
  get lastElementChild() {
    return this.children.at(-1);
  }
  setAttribute(name: string, value: string): void {
    this.attributes.set(name, value);
  }
  toggleAttribute(name: string, on: boolean): void {
    if (name === "hidden") this.hidden = on;
    else if (on) this.attributes.set(name, "");
    else this.attributes.delete(name);
  }
  addEventListener(name: string, listener: (event: object) => void): void {
    this.listeners.set(name, listener);
  }
  append(...children: (Element | string)[]): void {
    for (const child of children) {
      if (typeof child === "string") this.#text += child;
      else this.children.push(child);
      if (typeof child !== "string") child.parent = this;
    }
  }
  prepend(child: Element): void {
    child.parent = this;
    this.children.unshift(child);
  }
  remove(): void {
    if (this.parent) this.parent.children = this.parent.children.filter((child) => child !== this);
  }
}

/** Makes `document` for what a test builds. */
export function standInPage(): void {
  const documentElement = new Element();
  const byId = new Map<string, Element>();
  const getElementById = (id: string) => byId.get(id) ?? byId.set(id, new Element()).get(id);
  Object.assign(globalThis, { document: { createElement: () => new Element(), documentElement, getElementById } });
}
