// SPDX-License-Identifier: GPL-3.0-or-later
// What `suture record` leaves, read by the MCAP project's own package.
import assert from "node:assert/strict";
import { mkdtempSync, rmSync, statSync } from "node:fs";
import { open, readFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, describe, it } from "node:test";
import zstd from "@foxglove/wasm-zstd";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { Program, Server, sewing, suture } from "../support/server.mjs";
import { readerOf } from "./schemas.mjs";

const decompressHandlers = { zstd: (bytes, size) => zstd.decompress(bytes, Number(size)) };

/** Each message of a file with its channel, decoded by the file's own schema. */
class Recording {
  #decoders = new Map();
  channels = new Map();
  schemas = new Map();
  messages = [];

  add({ channelId, sequence, logTime, data }) {
    const channel = this.channels.get(channelId);
    const schema = this.schemas.get(channel.schemaId);
    if (!this.#decoders.has(channelId))
      this.#decoders.set(channelId, readerOf(schema.name, new TextDecoder().decode(schema.data)));
    this.messages.push({ topic: channel.topic, sequence, logTime, value: this.#decoders.get(channelId)(data) });
  }
  of(topic) {
    return this.messages.filter((message) => message.topic === topic);
  }
}

/** Reads from the front to the back, as far as there are whole records. */
async function streamed(path) {
  const recording = new Recording();
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  reader.append(await readFile(path));
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Schema") recording.schemas.set(record.id, record);
    if (record.type === "Channel") recording.channels.set(record.id, record);
    if (record.type === "Message") recording.add(record);
  }
  recording.whole = reader.done();
  return recording;
}

/** Reads by the index at its end, as Foxglove does. */
async function indexed(path) {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, size) => {
      const bytes = new Uint8Array(Number(size));
      const { bytesRead } = await file.read(bytes, 0, bytes.length, Number(offset));
      return bytes.subarray(0, bytesRead);
    },
  };
  const recording = new Recording();
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  recording.channels = reader.channelsById;
  recording.schemas = reader.schemasById;
  recording.statistics = reader.statistics;
  for await (const message of reader.readMessages({ validateCrcs: true })) recording.add(message);
  await file.close();
  return recording;
}

/** What must hold of the messages, however the recorder ended. */
function judge(recording) {
  for (const channel of recording.channels.values()) assert.equal(channel.messageEncoding, "cdr", channel.topic);
  for (const schema of recording.schemas.values()) assert.equal(schema.encoding, "omgidl", schema.name);
  for (const topic of ["suture/tool/pose", "suture/tool/force", "suture/mesh/frame", "suture/tool/model"])
    assert.ok(recording.of(topic).length > 20, `${recording.of(topic).length} of ${topic}`);
  for (const topic of ["suture/mesh/topology", "suture/event", "suture/status"])
    assert.ok(recording.of(topic).length > 0, topic);

  const surface = new Map(recording.of("suture/mesh/topology").map(({ value }) => [value.body, value.vertex.length]));
  assert.deepEqual([...surface].sort(), [["distal", 528], ["proximal", 660]]);
  for (const { value } of recording.of("suture/mesh/frame")) {
    assert.equal(value.position_m.length, 3 * surface.get(value.body));
    assert.ok(value.position_m.every(Number.isFinite));
  }
  for (const { value } of recording.of("suture/tool/force")) assert.ok(Math.hypot(...value.force_n) <= 3.3);
  for (const { value } of recording.of("suture/tool/pose"))
    assert.ok(Math.abs(Math.hypot(...value.orientation_xyzw) - 1) < 1e-6);

  for (const { topic } of recording.channels.values()) {
    const times = recording.of(topic).map(({ logTime }) => logTime);
    for (let i = 1; i < times.length; ++i) assert.ok(times[i] >= times[i - 1], `${topic}: ${times[i]} after ${times[i - 1]}`);
  }
  const counts = (topic) => recording.of(topic).map(({ value }) => value.sequence_number);
  const behind = (of) => of.filter((count, i) => i > 0 && count <= of[i - 1]);
  assert.deepEqual(behind(counts("suture/tool/pose")), []);
  // Two threads of the server send forces: one may overtake the other's, which a device then drops.
  const forces = counts("suture/tool/force");
  assert.equal(new Set(forces).size, forces.length);
  assert.ok(behind(forces).length <= forces.length / 100, `${behind(forces).length} of ${forces.length} forces were overtaken`);
}

describe("@mcap/core", { timeout: 240_000 }, () => {
  const folder = mkdtempSync(join(tmpdir(), "suture-interop-"));
  let server, hand;
  before(async () => {
    await zstd.isLoaded;
    server = await Server.start();
    hand = sewing(server);
  });
  after(async () => {
    await hand?.end();
    await server?.end();
    rmSync(folder, { recursive: true });
  });

  /** Records until the file holds a mebibyte and ends the recorder by `signal`. */
  async function record(name, signal) {
    const path = join(folder, name);
    const recorder = new Program(suture, ["record", path, ...server.place]);
    await recorder.said("server: ");
    while (statSync(path).size < 1 << 20) await new Promise((next) => setTimeout(next, 20));
    const how = await recorder.end(signal);
    return { path, how, log: recorder.log };
  }

  it("reads a recording by its index and from front to back", async () => {
    const { path, how, log } = await record("whole.mcap", "SIGINT");
    assert.equal(how, 0, log);
    const byIndex = await indexed(path);
    judge(byIndex);
    const all = await streamed(path);
    assert.ok(all.whole);
    judge(all);
    assert.equal(byIndex.messages.length, all.messages.length);
    assert.equal(byIndex.statistics.messageCount, BigInt(all.messages.length));
  });

  it("reads what a recorder left that was killed", async () => {
    const { path, how } = await record("killed.mcap", "SIGKILL");
    assert.equal(how, "SIGKILL");
    const left = await streamed(path);
    assert.ok(!left.whole, "a file without an end is not taken for a whole one");
    judge(left);
  });
});
