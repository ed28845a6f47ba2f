// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { metricsAddress, serverAddress } from "../src/connection/address";
import { backoffMs } from "../src/connection/backoff";
import { Codec } from "../src/protocol/codec";
import { toolId } from "../src/protocol/fnv";
import { clientMessageData, parseMessageData, parseServerText } from "../src/protocol/framing";
import {
  CommandKind, CommandResult, EventKind, faultNames, kFaultNames, NeedleShape, ServerState, ToolState,
  type MeshFrame, type ToolPose,
} from "../src/protocol/messages";
import { idl } from "./idl";

test("a tool's id is the FNV-1a hash of its name", () => {
  // The published vectors of FNV-1a, 64 bits.
  assert.equal(toolId(""), 0xcbf29ce484222325n);
  assert.equal(toolId("a"), 0xaf63dc4c8601ec8cn);
  assert.equal(toolId("foobar"), 0x85944171f73967e8n);
});

test("enumerations and masks are those of the contract", () => {
  const codec = new Codec(idl());
  const kebab = (name: string) => name.replaceAll("_", "").toLowerCase();
  const pairs = [
    ["ToolState", "TOOL_", ToolState], ["EventKind", "EVENT_", EventKind], ["ServerState", "SERVER_", ServerState],
    ["CommandKind", "COMMAND_", CommandKind], ["CommandResult", "COMMAND_", CommandResult], ["NeedleShape", "NEEDLE_", NeedleShape],
  ] as const;
  for (const [name, prefix, ours] of pairs) {
    const theirs = codec.enumerators(`suture::v1::${name}`);
    assert.ok(theirs.length > 0, name);
    assert.deepEqual(
      theirs.map((each) => [kebab(each.name.slice(prefix.length)), each.value]),
      Object.entries(ours).filter(([, value]) => typeof value === "number").map(([key, value]) => [kebab(key), value]),
    );
  }
  const faults = [...idl().matchAll(/const uint32 FAULT_\w+ = (\d+);/g)].map((found) => Number(found[1]));
  assert.equal(kFaultNames.length, faults.length);
  assert.deepEqual(faults, kFaultNames.map((_, bit) => 2 ** bit));
  assert.deepEqual(faultNames(1 + 8), ["pose late", "pose jump"]);
});

test("the contract parses, and a mesh frame survives the wire as typed arrays", () => {
  const codec = new Codec(idl());
  const sent = {
    body: "proximal", epoch: 7n, sequence_number: 8n, stamp_ns: 1_764_000_000_000_000_001n, revision: 2, step: 9n,
    simulation_time_s: 1.5, position_m: new Float32Array([0.5, -1.25, 2, 3, 4, 5]), von_mises_pa: new Float32Array([1, 2]), principal_pa: [],
  };
  const wire = codec.write("suture::v1::MeshFrame", sent);
  assert.deepEqual([...wire.subarray(0, 4)], [0, 1, 0, 0], "XCDR1, little-endian");
  const got = codec.read<MeshFrame>("suture::v1::MeshFrame", wire);
  assert.equal(got.body, "proximal");
  assert.equal(got.stamp_ns, sent.stamp_ns);
  assert.ok(got.position_m instanceof Float32Array);
  assert.deepEqual([...got.position_m], [...sent.position_m]);
  assert.equal(got.principal_pa.length, 0);
});

test("a pose is laid out as DDS lays it out", () => {
  const pose: ToolPose = {
    tool_id: toolId("driver"), epoch: 1n, sequence_number: 2n, stamp_ns: 3n, position_m: [0.25, 0.5, 0.75],
    orientation_xyzw: [0, 0, 0, 1], linear_velocity_m_per_s: [1, 2, 3], angular_velocity_rad_per_s: [4, 5, 6],
    jaw: 0.5, buttons: 0, flags: 1,
  };
  const wire = new Codec(idl()).write("suture::v1::ToolPose", pose);
  const view = new DataView(wire.buffer, wire.byteOffset + 4);
  assert.equal(wire.byteLength, 4 + 4 * 8 + 7 * 8 + 6 * 4 + 4 + 4 + 4);
  assert.equal(view.getBigUint64(0, true), pose.tool_id);
  assert.equal(view.getFloat64(32 + 8, true), 0.5);
  assert.equal(view.getFloat32(88, true), 1);
  assert.equal(view.getUint32(120, true), 1);
});

test("binary frames carry ids and payload", () => {
  const frame = new Uint8Array(15);
  new DataView(frame.buffer).setUint8(0, 1);
  new DataView(frame.buffer).setUint32(1, 77, true);
  new DataView(frame.buffer).setBigUint64(5, 123n, true);
  frame.set([5, 6], 13);
  const data = parseMessageData(frame.buffer);
  assert.equal(data?.subscriptionId, 77);
  assert.equal(data?.receiveTimeNs, 123n);
  assert.deepEqual([...(data?.payload ?? [])], [5, 6]);
  assert.equal(parseMessageData(new ArrayBuffer(4)), undefined);
  assert.equal(parseMessageData(new Uint8Array(15).fill(2).buffer), undefined);
  assert.deepEqual([...clientMessageData(258, new Uint8Array([9]))], [1, 2, 1, 0, 0, 9]);
});

test("texts that are none of the protocol's are left alone", () => {
  assert.equal(parseServerText("{"), undefined);
  assert.equal(parseServerText("null"), undefined);
  assert.equal(parseServerText('{"op":"parameterValues"}'), undefined);
  assert.equal(parseServerText('{"op":"unadvertise","channelIds":[1]}')?.op, "unadvertise");
});

test("the socket is the page's host, with the token of its fragment", () => {
  assert.equal(serverAddress("http://127.0.0.1:8080/"), "ws://127.0.0.1:8080/");
  assert.equal(serverAddress("https://host:1/index.html?quality=best#token=a%2Bb"), "wss://host:1/?token=a%2Bb");
  assert.equal(serverAddress("http://localhost:5173/", "/suture"), "ws://localhost:5173/suture");
  assert.equal(metricsAddress("wss://host:1/?token=a%2Bb"), "https://host:1/metrics?token=a%2Bb");
  assert.equal(metricsAddress("ws://localhost:5173/suture"), "http://localhost:5173/suture/metrics");
});

test("waiting doubles up to eight seconds, and never all pages at once", () => {
  assert.deepEqual([0, 1, 2, 5, 40].map((attempt) => backoffMs(attempt, 0)), [250, 500, 1000, 8000, 8000]);
  assert.equal(backoffMs(0, 1), 187.5);
});
