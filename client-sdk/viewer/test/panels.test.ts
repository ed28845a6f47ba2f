// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Hand } from "../src/hand/hand";
import { HeldKeys } from "../src/hand/held_keys";
import { Events } from "../src/panels/events";
import { HandPanel } from "../src/panels/hand_panel";
import { QualityPanel } from "../src/panels/status";
import { EventKind, type Quality, type ServerEvent, type ToolView } from "../src/protocol/messages";
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

test("the row of a tool goes with its scene, and with it a hold", () => {
  const ended: string[] = [];
  const hand = { tool: "driver", release: (why: string) => ended.push(why) };
  const panel = new HandPanel(hand as unknown as Hand, new HeldKeys());
  const row = (tool: string) => ({ view: { tool, holding: "", faults: 0, force_n: new Float64Array(3) } as ToolView, status: undefined, colour: "" });
  panel.setTools([row("driver"), row("forceps")]);
  panel.setTools([], undefined);
  panel.setTools([], ["driver", "forceps"]);
  panel.setTools([row("forceps")], ["driver", "forceps"]);
  assert.deepEqual(panel.tools, ["driver", "forceps"], "a reset: their states are on the way");
  panel.setTools([row("probe"), row("forceps")], ["probe"]);
  assert.deepEqual(panel.tools, ["forceps", "probe"]);
  assert.deepEqual(ended, ["the scene has no such tool"]);
  panel.setTools([row("probe")], ["probe"]);
  assert.deepEqual(panel.tools, ["probe"]);
});

test("the newest 2000 events are known again, and no more are kept", () => {
  const events = new Events();
  const push = (i: number) => events.push({
    epoch: 1n, sequence_number: BigInt(i), stamp_ns: 1n, kind: EventKind.Grasp, simulation_time_s: 0, subject: "driver", object: "needle",
    position_m: new Float64Array(3), value: 0, unit: "", faults: 0, text: "",
  } satisfies ServerEvent);
  for (let i = 0; i <= 2000; ++i) assert.equal(push(i), true);
  assert.deepEqual([1, 1000, 2000].map(push), [false, false, false]);
  assert.equal(push(0), true, "forgotten");
});
