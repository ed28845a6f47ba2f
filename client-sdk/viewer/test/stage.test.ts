// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { Scene } from "three";
import type { Link } from "../src/connection/link";
import type { MeshFrame, MeshTopology, NeedleState, ToolView, Topic, Topics } from "../src/protocol/messages";
import { Epochs, Lead } from "../src/scene/epochs";
import { Stage } from "../src/scene/stage";
import type { View } from "../src/scene/view";

test("an epoch is met once, and what comes late of an old one is passed over", () => {
  const epochs = new Epochs();
  assert.deepEqual([7n, 7n, 9n, 7n, 9n].map((epoch) => epochs.take(epoch)), ["new", "now", "new", "old", "now"]);
  // The clock of another server may be behind.
  epochs.connected();
  assert.deepEqual([3n, 3n, 2n].map((epoch) => epochs.take(epoch)), ["new", "now", "old"]);
  epochs.connected();
  assert.equal(epochs.take(3n), "now", "the same server as before");
  assert.equal(epochs.now, 3n);
});

test("the first body of an epoch leads it", () => {
  const lead = new Lead();
  assert.deepEqual(["a", "b", "a", "b"].map((body) => lead.take(1n, body)), [1, 0, 2, 0]);
  assert.deepEqual(["c", "a", "c"].map((body) => lead.take(2n, body)), [1, 0, 2], "another scene has other names");
});

/** A stage with a view that only counts where the camera goes. */
function stage() {
  const listeners = new Map<Topic, (message: never) => void>();
  const link = { on: (topic: Topic, listener: (message: never) => void) => listeners.set(topic, listener) };
  const seen = { flights: 0, others: 0 };
  const view = { scene: new Scene(), fov_rad: 0.5, aspect: 1.6, prepare() {}, wake() {}, setAxes() {}, goTo: () => ++seen.flights };
  const made = new Stage(view as unknown as View, {} as HTMLElement, link as unknown as Link, () => {});
  made.onOther = () => ++seen.others;
  const say = <T extends Topic>(topic: T, message: Partial<Topics[T]>) => listeners.get(topic)!(message as never);
  const vertex = new Uint32Array([0, 1, 2]);
  const rest = (at: number) => new Float32Array([at, 0, 0, at + 1, 0, 0, at, 1, 0]);
  const topology = (epoch: bigint, body: string, at: number): Partial<MeshTopology> =>
    ({ epoch, body, revision: 1, vertex, triangle: vertex, rest_position_m: rest(at) });
  let stamp_ns = 0n;
  const frame = (epoch: bigint, body: string, at: number): Partial<MeshFrame> => ({
    epoch, body, revision: 1, stamp_ns: (stamp_ns += 16_000_000n), position_m: rest(at), von_mises_pa: new Float32Array(3), principal_pa: new Float32Array(0),
  });
  const needle = (epoch: bigint): Partial<NeedleState> =>
    ({ epoch, needle: "needle", stamp_ns, course_m: new Float64Array([3, 0, 0, 3, 1, 0]), punctures: [] });
  return {
    made, seen, say, topology, frame, needle,
    bodies: () => made.tissue.group.children.map((mesh) => mesh.userData["body"] as string).sort(),
    /** As a server begins an epoch: topologies, then frames with everything else. */
    begin(epoch: bigint, bodies: Record<string, number>, frames = 2) {
      for (const [body, at] of Object.entries(bodies)) say("suture/mesh/topology", topology(epoch, body, at));
      for (let i = 0; i < frames; ++i) {
        for (const [body, at] of Object.entries(bodies)) say("suture/mesh/frame", frame(epoch, body, at));
        say("suture/needle", needle(epoch));
      }
    },
  };
}

test("after a reset the same bodies stay drawn, and the camera where a person put it", () => {
  const { made, seen, begin, say, topology, frame, bodies } = stage();
  begin(1n, { a: 0, b: 5 });
  const [flights, meshes] = [seen.flights, [...made.tissue.group.children]];
  assert.ok(flights > 0);
  seen.others = 0;
  say("suture/mesh/topology", topology(2n, "a", 0));
  say("suture/mesh/frame", frame(2n, "a", 0));
  assert.deepEqual(bodies(), ["a", "b"], "the other's topology is on its way");
  begin(2n, { a: 0, b: 5 });
  begin(3n, { b: 5, a: 0 });
  assert.deepEqual(made.tissue.group.children, meshes, "no mesh was made anew");
  assert.deepEqual(seen, { flights, others: 0 });
});

test("another scene on the same port takes the place of the one before", () => {
  const { made, seen, begin, say, frame, bodies } = stage();
  const tool = (epoch: bigint, name: string): Partial<ToolView> => ({ epoch, tool: name, kind: "driver", stamp_ns: 1n, flags: 0 });
  begin(5n, { a: 0, b: 5 });
  say("suture/tool/state", tool(5n, "driver"));
  const flights = seen.flights;
  made.connected();
  begin(4n, { c: 20 });
  say("suture/tool/state", tool(4n, "probe"));
  assert.deepEqual(bodies(), ["c"]);
  assert.deepEqual(made.tools.views().map((view) => view.tool), ["probe"]);
  assert.ok(seen.flights > flights && seen.others > 0);
  assert.ok(made.axes.centre[0] > 19);

  // A tool of the same name and another kind is drawn as what it is.
  const drawn = made.tools.group.children.length;
  say("suture/tool/state", { ...tool(4n, "probe"), kind: "probe" });
  assert.equal(made.tools.group.children.length, drawn);
  assert.equal(made.tools.view("probe")?.kind, "probe");

  // What was still on the way of an older epoch changes nothing.
  say("suture/mesh/frame", frame(3n, "a", 0));
  say("suture/tool/state", tool(3n, "driver"));
  assert.equal(made.epoch, 4n);
  assert.deepEqual(made.tools.views().map((view) => view.tool), ["probe"]);

  // A scene that has one body more than the last, or one less.
  begin(6n, { d: 40, c: 20 });
  assert.deepEqual(bodies(), ["c", "d"]);
  assert.equal(made.axes.centre[0], 30.5);
  begin(7n, { d: 40 });
  assert.deepEqual(bodies(), ["d"]);
  assert.equal(made.axes.centre[0], 40.5);
});
