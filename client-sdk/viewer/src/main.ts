// SPDX-License-Identifier: Apache-2.0
import "./style.css";
import { App } from "./app";
import { byId, h } from "./panels/dom";
import { tellError } from "./snapshot";

try {
  new App().start();
} catch (error) {
  const cause = error instanceof Error ? error.message : String(error);
  tellError("failed", cause, "");
  const overlay = byId("overlay");
  overlay.hidden = false;
  overlay.replaceChildren(h("div", { class: "overlay-box", role: "alert" }, h("h2", {}, "No picture"), h("p", {}, cause)));
}
