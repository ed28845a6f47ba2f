// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Link } from "../src/connection/link";
import { Session } from "../src/connection/session";
import type { FromWorker, HandReport } from "../src/connection/worker_messages";
import { Hand, type HandWorld } from "../src/hand/hand";
import type { Pose } from "../src/maths/vector";

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
