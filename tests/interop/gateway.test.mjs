// SPDX-License-Identifier: GPL-3.0-or-later
// A real server and a hand that sews, seen by packages that are not ours.
import assert from "node:assert/strict";
import { after, before, describe, it } from "node:test";
import { Server, sewing } from "../support/server.mjs";
import { Connection, subprotocols } from "./clients.mjs";
import { enumerator, writerOf } from "./schemas.mjs";

/** What `sutured check` says of the scene. */
const surfaces = { proximal: { vertices: 660, triangles: 1320 }, distal: { vertices: 528, triangles: 1056 } };

const finite = (values, what) => {
  for (const value of values) assert.ok(Number.isFinite(value), `${what}: ${value}`);
};
const norm = (vector) => Math.hypot(...vector);
const unit = (quaternion, what) => assert.ok(Math.abs(norm(quaternion) - 1) < 1e-9, `${what}: ${quaternion}`);
const xyz = ({ x, y, z }) => [x, y, z];

describe("Foxglove's packages", { timeout: 240_000 }, () => {
  let server, hand;
  before(async () => {
    server = await Server.start();
    hand = sewing(server);
  });
  after(async () => {
    await hand?.end();
    await server?.end();
  });

  for (const subprotocol of subprotocols)
    describe(subprotocol, () => {
      let connection;
      before(async () => (connection = await Connection.open(server.socket, subprotocol)));
      after(() => connection?.close());

      it("learn what there is", () => {
        assert.equal(connection.subprotocol, subprotocol);
        assert.equal(connection.info.name, "sutured");
        assert.deepEqual(connection.info.supportedEncodings, ["cdr"]);
        const names = [...connection.channels.keys()];
        for (const topic of ["suture/tool/force", "suture/mesh/frame", "suture/event", "suture/scene"])
          assert.ok(names.includes(topic), `${topic} is none of ${names}`);
        for (const channel of connection.channels.values())
          assert.deepEqual([channel.encoding, channel.schemaEncoding], ["cdr", "omgidl"], channel.topic);
      });

      it("decode a mesh and its frame", async () => {
        for (const [body, { vertices, triangles }] of Object.entries(surfaces)) {
          const topology = await connection.first("suture/mesh/topology", (message) => message.body === body);
          assert.equal(topology.vertex.length, vertices);
          assert.equal(topology.triangle.length, 3 * triangles);
          for (const index of topology.triangle) assert.ok(index < vertices, `triangle of vertex ${index}`);
          const frame = await connection.first("suture/mesh/frame", (message) => message.body === body);
          assert.equal(frame.revision, topology.revision);
          assert.equal(frame.position_m.length, 3 * vertices);
          assert.equal(frame.von_mises_pa.length, vertices);
          finite(frame.position_m, "position");
          finite(frame.von_mises_pa, "stress");
          // The vessel is 24 mm wide and 20 mm long, and no hand takes it further than that.
          for (const metres of frame.position_m) assert.ok(Math.abs(metres) < 0.1, `position ${metres}`);
        }
      });

      it("decode a force that is felt, within the tool's limit", async () => {
        const status = await connection.first("suture/status");
        const driver = status.tools.find((tool) => tool.tool === "driver");
        assert.equal(driver.max_force_n, 3.3);
        const force = await connection.first("suture/tool/force", (message) => norm(message.force_n) > 0.005);
        finite(force.force_n, "force");
        finite(force.torque_nm, "torque");
        assert.ok(norm(force.force_n) <= driver.max_force_n, `force: ${force.force_n}`);
        assert.equal(typeof force.pose_sequence, "bigint");
        assert.ok(force.pose_sequence > 0n);
      });

      it("decode where tool and needle are", async () => {
        const tool = await connection.first("suture/tool/state", (message) => message.tool === "driver");
        finite(tool.position_m, "tool");
        unit(tool.orientation_xyzw, "tool");
        const needle = await connection.first("suture/needle");
        unit(needle.orientation_xyzw, "needle");
        assert.equal(needle.radius_m, 0.008);
        assert.ok(Math.abs(needle.length_m - Math.PI * 0.008) < 1e-9);
      });

      it("decode a puncture", async () => {
        const { schema } = connection.channels.get("suture/event");
        const puncture = enumerator(schema, "suture::v1::EventKind", "EVENT_PUNCTURE");
        const event = await connection.first("suture/event", (message) => message.kind === puncture);
        assert.equal(event.subject, "needle");
        assert.ok(Object.keys(surfaces).includes(event.object), event.object);
        assert.equal(event.unit, "N");
        // The scene's puncture force, and what a step of the hand adds to it.
        assert.ok(event.value >= 0.05 && event.value < 0.2, `${event.value} N`);
        finite(event.position_m, "place");
      });

      it("decode the scene that they draw", async () => {
        // An update draws what has come so far: to whoever has just joined, of some bodies first.
        const drawn = [...Object.keys(surfaces).map((body) => `tissue/${body}`), "needle/needle"];
        const update = await connection.first("suture/scene", ({ entities }) => drawn.every((id) => entities.some((each) => each.id === id)));
        const entity = (id) => update.entities.find((each) => each.id === id);
        for (const [body, { vertices, triangles }] of Object.entries(surfaces)) {
          const { frame_id, triangles: lists } = entity(`tissue/${body}`);
          assert.equal(frame_id, "world");
          assert.equal(lists.length, 1);
          const [list] = lists;
          assert.equal(list.points.length, vertices);
          assert.equal(list.colors.length, vertices);
          assert.equal(list.indices.length, 3 * triangles);
          for (const index of list.indices) assert.ok(index < vertices, `index ${index}`);
          finite(list.points.flatMap(xyz), "point");
          for (const { r, g, b, a } of list.colors)
            for (const channel of [r, g, b, a]) assert.ok(channel >= 0 && channel <= 1, `colour ${channel}`);
        }
        assert.ok(entity("needle/needle").lines[0].points.length > 2);
      });

      it("pause and resume the server by a command of their own", async () => {
        const { schema, schemaName } = connection.channels.get("suture/command");
        const encode = writerOf(schemaName, schema);
        let request = 0n;
        const command = (kind) => {
          connection.publish("suture/command", schemaName, encode({
            epoch: 0n, request: ++request, stamp_ns: BigInt(Date.now()) * 1_000_000n, requester: new Uint8Array(16),
            kind: enumerator(schema, "suture::v1::CommandKind", kind), tool: "", requester_name: "interop", checkpoint: "", seconds: 0,
          }));
        };
        for (const [kind, state] of [["COMMAND_PAUSE", "SERVER_PAUSED"], ["COMMAND_RESUME", "SERVER_RUNNING"]]) {
          command(kind);
          const value = enumerator(schema, "suture::v1::ServerState", state);
          await connection.first("suture/status", (message) => message.state === value);
        }
      });
    });
});

describe("a page of another origin", { timeout: 120_000 }, () => {
  // As Lichtblick on the desktop, Foxglove on the web, and one that begins like it.
  const [desktop, web, other] = ["file://", "https://app.foxglove.dev", "https://app.foxglove.dev.example"];
  const come = async (server, origin) => {
    const connection = await Connection.open(server.socket, "foxglove.sdk.v1", { origin });
    await connection.first("suture/status");
    connection.close();
  };
  const refused = (server, origin) => assert.rejects(Connection.open(server.socket, "foxglove.sdk.v1", { origin }), /403/, origin);

  it("is refused", async () => {
    const server = await Server.start();
    try {
      for (const origin of [desktop, web, other, "null"]) await refused(server, origin);
      await come(server, new URL(server.url).origin);
      await come(server, undefined);
    } finally {
      await server.end();
    }
  });

  it("is let in where --http-origin names it", async () => {
    const server = await Server.start({ options: ["--http-origin", desktop, "--http-origin", web] });
    try {
      for (const origin of [desktop, web]) await come(server, origin);
      for (const origin of [other, "null"]) await refused(server, origin);
    } finally {
      await server.end();
    }
  });
});
