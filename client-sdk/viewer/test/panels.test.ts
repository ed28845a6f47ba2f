// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { QualityPanel } from "../src/panels/status";
import type { Quality } from "../src/protocol/messages";
import { standInPage } from "./page";

standInPage();

test("a reset clears the figures of what was before it, and not those that came after", () => {
  const panel = new QualityPanel();
  assert.equal(panel.element.hidden, true);
  panel.set({
    epoch: 5n, bites: [] as unknown[], gap_start_m: 0, peak_force_n: 1, peak_principal_stress_pa: 1, needle_path_m: 1, elapsed_s: 1,
  } as Quality);
  panel.reset(4n);
  panel.reset(5n);
  assert.equal(panel.element.hidden, false, "a late joiner gets the old resets again");
  panel.reset(6n);
  assert.equal(panel.element.hidden, true);
});
