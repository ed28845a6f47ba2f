// SPDX-License-Identifier: Apache-2.0
import type { Theme } from "./panels/theme";

/** What the page's address asks for. */
export interface PageOptions {
  /** `?quality=best`: shadows and all pixels, however slow. For pictures. */
  best: boolean;
  /** `?theme=light`, `?theme=dark`: whatever the system and the person say. */
  theme: Theme | undefined;
  /** `?snapshot=1&view=needle`: one fixed picture of that view, without panels. The name is a stranger's word. */
  snapshot: { view: string } | undefined;
}

export function pageOptions(search: string): PageOptions {
  const asked = new URLSearchParams(search);
  const snapshot = asked.get("snapshot") === "1";
  const theme = asked.get("theme");
  return {
    best: snapshot || asked.get("quality") === "best",
    theme: theme === "light" || theme === "dark" ? theme : undefined,
    snapshot: snapshot ? { view: asked.get("view") ?? "overview" } : undefined,
  };
}
