// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { cross, dot, length, subtract, type Vec3 } from "../src/maths/vector";
import { eventText, joined } from "../src/panels/events";
import { actsUnderList } from "../src/panels/keys";
import { Recent } from "../src/panels/recent";
import { Rate } from "../src/panels/status";
import { pageOptions } from "../src/page_options";
import { EventKind, type ServerEvent } from "../src/protocol/messages";
import { kPresets, presetNamed, presetPlace, sceneAxes } from "../src/scene/cameras";
import { AutoRange, colourAt, kStressMaps, niceCeil, niceTicks, percentile } from "../src/scene/colour_map";
import { splitCreases } from "../src/scene/creases";
import { tensionAtPoints } from "../src/scene/sutures";
import { mixInto, PlayClock, Timeline } from "../src/scene/timeline";
import { SceneWatch } from "../src/snapshot";

test("a frame is shown between its neighbours", () => {
  const timeline = new Timeline<number>();
  assert.equal(timeline.at(0), undefined);
  for (const stamp of [100, 116, 132]) timeline.push(stamp, stamp);
  assert.deepEqual(timeline.at(120), { before: 116, after: 132, share: 0.25 });
  assert.deepEqual(timeline.at(50), { before: 100, after: 116, share: 0 });
  assert.deepEqual(timeline.at(500), { before: 132, after: 132, share: 0 });
  timeline.push(20, 20);
  assert.equal(timeline.at(500)?.before, 20, "a server that began anew");
  const out = new Float32Array(2);
  mixInto(out, [0, 2], [1, 4], 0.5);
  assert.deepEqual([...out], [0.5, 3]);
  mixInto(out, [0], [1, 4], 0.5);
  assert.deepEqual([...out], [1, 4], "another course: no mix");
});

test("the moment on show moves evenly though frames come unevenly", () => {
  const clock = new PlayClock();
  let seed = 7;
  const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
  for (let i = 0; i < 300; ++i) clock.observe(1000 + i * 20, 500_000 + i * 20 + 3 + 12 * random());
  const now = 500_000 + 300 * 20;
  // Behind the newest stamp by the least way and a frame and a half, never ahead of it.
  const behind = 1000 + 300 * 20 - clock.moment_ms(now);
  assert.ok(behind > 30 && behind < 40, String(behind));
  assert.ok(Math.abs(clock.moment_ms(now + 8) - clock.moment_ms(now) - 8) < 1e-6);
});

test("each colour map is one in lightness", () => {
  const luminance = (c: readonly number[]) => {
    const linear = c.map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * linear[0]! + 0.7152 * linear[1]! + 0.0722 * linear[2]!;
  };
  for (const map of kStressMaps) {
    const steps = Array.from({ length: 21 }, (_, i) => luminance(colourAt(map, i / 20)));
    const rising = steps.at(-1)! > steps[0]!;
    for (let i = 1; i < steps.length; ++i) assert.ok(rising ? steps[i]! > steps[i - 1]! : steps[i]! < steps[i - 1]!, `${map.name} at ${i}`);
  }
  assert.deepEqual(colourAt(kStressMaps[0]!, NaN), kStressMaps[0]!.stops[0]);
  assert.deepEqual(colourAt(kStressMaps[0]!, 9), kStressMaps[0]!.stops.at(-1));
});

test("scales end at round values and follow the picture", () => {
  assert.deepEqual([0.013, 1, 2.1, 7, 90].map(niceCeil), [0.02, 1, 5, 10, 100]);
  assert.deepEqual(niceTicks(10, 5), [0, 2, 4, 6, 8, 10]);
  const range = new AutoRange(100);
  range.observe(1200, 0.25);
  assert.equal(range.top, 2000);
  for (let i = 0; i < 400; ++i) range.observe(0, 0.25);
  assert.equal(range.top, 100);
  range.fixed = 500;
  range.observe(1e6, 1);
  assert.equal(range.top, 500);
  assert.equal(percentile(Array.from({ length: 1000 }, (_, i) => i), 0.5), 500);
});

test("a box gets its edges, a flat sheet stays whole", () => {
  const p = [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1];
  const box = [0, 2, 1, 0, 3, 2, 4, 5, 6, 4, 6, 7, 0, 1, 5, 0, 5, 4, 1, 2, 6, 1, 6, 5, 2, 3, 7, 2, 7, 6, 3, 0, 4, 3, 4, 7];
  const split = splitCreases(p, box);
  assert.equal(split.source.length, 24, "three normals at each of eight corners");
  assert.deepEqual([...split.index].map((i) => split.source[i]), box, "the same triangles");
  assert.equal(splitCreases(p, box.slice(0, 6)).source.length, 4);
});

test("the camera sees the scene along its long side, the needle in front", () => {
  const axes = sceneAxes({ min: [-0.006, -0.006, -0.02], max: [0.006, 0.006, 0.02] }, [0.011, 0, 0]);
  assert.deepEqual(axes.front, [1, 0, 0]);
  assert.equal(Math.abs(axes.along[2]), 1);
  assert.ok(dot(cross(axes.along, axes.up), axes.front) > 0.999, "right-handed on the screen");
  for (const preset of kPresets) {
    const place = presetPlace(preset, axes, 0.5, 1.6, [0.011, 0, 0]);
    const way = subtract(place.position, place.target);
    assert.ok(length(way) > axes.radius && way.every(Number.isFinite), preset);
    assert.ok(length(cross(way, axes.up)) > 1e-9, `${preset} does not look along up`);
  }
  const flat = sceneAxes({ min: [0, 0, 0], max: [0.1, 0.1, 0.1] });
  assert.ok([flat.along, flat.up, flat.front].every((axis: Vec3) => Math.abs(length(axis) - 1) < 1e-12));
});

test("a thread's points have the mean tension of what meets there", () => {
  const thread = { course_m: new Float64Array(9), segment_tension_n: new Float64Array([0.2, 0.4]) };
  assert.deepEqual([...tensionAtPoints(thread)].map((t) => Number(t.toFixed(6))), [0.2, 0.3, 0.4]);
});

test("plots keep the last twenty seconds, figures of one moment in one row", () => {
  const recent = new Recent();
  for (let i = 0; i <= 3000; ++i) {
    recent.push("driver", i / 50, i);
    if (i > 10) recent.push("probe", i / 50, -i);
  }
  assert.deepEqual(recent.names, ["driver", "probe"]);
  assert.ok(recent.columns.every((column) => column.length === recent.times.length));
  assert.equal(recent.columns[1]!.at(-1), -3000);
  assert.ok(60 - recent.times[0]! < 21);
  recent.push("driver", 0, 1);
  assert.deepEqual(recent.times, [0], "time went back: a reset");
  recent.forget();
  recent.push("forceps", 1, 2);
  assert.deepEqual([recent.names, recent.times, recent.columns], [["forceps"], [1], [[2]]]);
});

test("a rate is of the last second", () => {
  const rate = new Rate();
  for (let i = 0; i < 200; ++i) rate.add(i * 20, 10);
  assert.equal(rate.kept, 51, "without having been asked");
  assert.deepEqual(rate.at(199 * 20), { perSecond: 51, bytesPerSecond: 510 });
  assert.equal(rate.at(1e9).perSecond, 0);
});

test("an event is a line for people", () => {
  const event: ServerEvent = {
    epoch: 1n, sequence_number: 1n, stamp_ns: 1n, kind: EventKind.Puncture, simulation_time_s: 1, subject: "needle", object: "proximal",
    position_m: new Float64Array(3), value: 0.0512, unit: "N", faults: 0, text: "",
  };
  assert.equal(eventText(event), "needle punctures proximal (0.0512 N)");
  assert.equal(eventText({ ...event, kind: EventKind.Fault, subject: "driver", object: "", unit: "", faults: 8, text: "a pose that jumps: the force fades" }),
    "driver: a pose that jumps: the force fades");

  const late = { ...event, kind: EventKind.Overrun, subject: "", object: "", unit: "", text: "periods were missed", value: 3 };
  assert.equal(eventText(joined(late, { ...late, value: 4 })!), "periods were missed (7)");
  for (const [before, after] of [[event, event], [late, event], [event, late], [undefined, late], [late, { ...late, text: "other" }]] as const)
    assert.equal(joined(before, after), undefined);
});

test("a stop may be given while the keys are listed, and little else", () => {
  assert.deepEqual(["KeyS", "KeyH", "KeyG", "KeyP", "KeyR", "Space", "ArrowUp"].filter(actsUnderList), ["KeyS", "KeyH"]);
});

test("an address asks for a picture, a theme and a view, and for nothing by mistake", () => {
  assert.deepEqual(pageOptions(""), { best: false, theme: undefined, snapshot: undefined });
  assert.deepEqual(pageOptions("?quality=best&theme=pink"), { best: true, theme: undefined, snapshot: undefined });
  assert.deepEqual(pageOptions("?snapshot=0&view=top"), { best: false, theme: undefined, snapshot: undefined });
  assert.deepEqual(pageOptions("?snapshot=1&view=a%26b&theme=light"), { best: true, theme: "light", snapshot: { view: "a&b" } });
  assert.equal(presetNamed("nEEDLE"), "Needle");
  assert.equal(presetNamed("toString"), undefined);
});

test("a picture waits for every tissue of one scene, and for two statuses after that", () => {
  const scene = new SceneWatch();
  assert.match(scene.waits, /no scene/);
  scene.status(1n, 2);
  scene.frame(1n, "proximal");
  assert.match(scene.waits, /1 of the scene's 2 tissues/);
  scene.status(1n, 2);
  scene.frame(1n, "distal");
  assert.equal(scene.complete, false);
  scene.status(1n, 2);
  assert.equal(scene.complete, false);
  scene.status(1n, 2);
  assert.equal(scene.complete, true);
  assert.equal(scene.waits, "");
  scene.frame(2n, "proximal");
  assert.equal(scene.complete, false, "what came before a reset is of another scene");
});
