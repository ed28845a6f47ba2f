// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test, type TestContext } from "node:test";
import type { Link } from "../src/connection/link";
import { Session } from "../src/connection/session";
import type { FromWorker, HandReport } from "../src/connection/worker_messages";
import { Hand, type HandWorld } from "../src/hand/hand";
import type { Pose } from "../src/maths/vector";
import { idl } from "./idl";

const kHome: Pose = { position: [0, 0, 0], orientation: [0, 0, 0, 1] };

/** A socket whose server is the test. */
class Socket {
  static readonly OPEN = 1;
  static last: Socket;
  readyState = 0;
  readonly sent: (string | Uint8Array)[] = [];
  onopen = () => {};
  onclose = () => {};
  onmessage: (event: { data: unknown }) => void = () => {};

  constructor() {
    Socket.last = this;
  }
  send(data: string | Uint8Array): void {
    this.sent.push(data);
  }
  open(): void {
    this.readyState = Socket.OPEN;
    this.onopen();
  }
}
Object.assign(globalThis, { WebSocket: Socket });

/** A session that has asked for a connection, and what it tells the page. */
function session() {
  const told: FromWorker[] = [];
  let now_ms = 1_764_000_000_000;
  const made = new Session((message) => told.push(message), { nowMs: () => now_ms });
  made.handle({ type: "connect", url: "ws://host/" });
  return {
    made, socket: Socket.last, pass: (ms: number) => (now_ms += ms),
    take: (tool: string) => made.handle({ type: "hand_take", tool, pose: kHome, jaw: 0 }),
    reports: () => told.flatMap((each) => (each.type === "hand" ? each.report : [])),
    notices: () => told.flatMap((each) => (each.type === "notice" ? each.text : [])),
  };
}

test("a hold that is asked for without a connection ends at once, and says why", () => {
  const { take, reports } = session();
  take("driver");
  assert.deepEqual(reports().map(({ tool, lease, why }) => [tool, lease, why]), [["driver", "none", "there is no connection"]]);
});

/** Returns what runs each `setInterval` so many times. */
function standInBeats(context: TestContext): (count: number) => void {
  const { setInterval, clearInterval } = globalThis;
  const running = new Map<number, () => void>();
  let last = 0;
  Object.assign(globalThis, {
    setInterval: (beat: () => void) => (running.set(++last, beat), last),
    clearInterval: (id: number) => running.delete(id),
  });
  context.after(() => void Object.assign(globalThis, { setInterval, clearInterval }));
  return (count) => {
    for (let i = 0; i < count; ++i) for (const beat of [...running.values()]) beat();
  };
}

/** Channel 1 takes poses, 2 profiles: how many went to each. */
const published = (socket: Socket) => [1, 2].map((channel) =>
  socket.sent.filter((each) => typeof each !== "string" && each[1] === channel).length);

test("a tool that the token does not allow is let go at the first word, which the page is told once", (context) => {
  const beats = standInBeats(context);
  const { take, made, socket, reports, notices, pass } = session();
  const say = (message: object) => socket.onmessage({ data: JSON.stringify(message) });
  const refuse = (topic: string) => say({ op: "status", level: 2, id: "may-not-drive", message: `${topic}: no` });
  socket.open();
  say({ op: "advertise", channels: [{ id: 1, topic: "suture/status", encoding: "cdr", schemaEncoding: "omgidl", schemaName: "suture::v1::Status", schema: idl() }] });
  take("driver");
  beats(2);
  assert.deepEqual(published(socket), [2, 1]);
  refuse("suture/tool/device");
  refuse("suture/tool/pose");
  made.handle({ type: "hand_release" }); // the page's answer to the report
  beats(100);
  assert.deepEqual(published(socket), [2, 1], "no pose more, and no goodbye");
  const why = "your token does not allow to drive it";
  assert.deepEqual(reports().filter((each) => each.lease === "none").map((each) => each.why), [why]);
  assert.deepEqual(notices(), []);

  // Asked again at once the server is spared; later its rights may be others.
  take("driver");
  beats(2);
  assert.deepEqual(published(socket), [2, 1]);
  assert.equal(reports().at(-1)?.why, why);
  pass(10_000);
  take("driver");
  assert.deepEqual(published(socket), [2, 2]);

  say({ op: "status", level: 2, message: "something else" });
  assert.deepEqual(notices(), ["something else"]);
  made.handle({ type: "hand_release" });
  assert.deepEqual(published(socket), [3, 2], "a hold that stood ends with a goodbye");
});

test("the page lets go for the reason that its worker gives", () => {
  const link = { takeHand() {}, releaseHand() {} } as unknown as Link;
  const hand = new Hand(link, { toolView: () => undefined, startPose: () => kHome } as unknown as HandWorld);
  const ended: string[] = [];
  hand.onEnd = (tool, why) => ended.push(`${tool}: ${why}`);
  const report = { tool: "driver", lease: "none" } as HandReport;
  for (const each of [{ ...report, why: "there is no connection" }, report]) {
    hand.take("driver");
    hand.onReport({ ...each, tool: "another" });
    assert.equal(hand.tool, "driver");
    hand.onReport(each);
    assert.equal(hand.tool, undefined);
  }
  assert.deepEqual(ended, ["driver: there is no connection", "driver: the page was busy for too long"]);
});
