// SPDX-License-Identifier: GPL-3.0-or-later
// Clients of Foxglove's protocol: their own, and one by hand for the newer subprotocol, which theirs does not ask for.
import { EventEmitter } from "node:events";
import FoxgloveWebSocket from "@foxglove/ws-protocol";
import WebSocket from "ws";
import { readerOf } from "./schemas.mjs";

const { FoxgloveClient } = FoxgloveWebSocket;

/** `foxglove.sdk.v1` by its specification, with as much of FoxgloveClient's face as is used here. */
class SdkClient extends EventEmitter {
  #socket;
  #next = 0;

  constructor({ ws }) {
    super();
    this.#socket = ws;
    ws.binaryType = "arraybuffer";
    ws.onerror = (event) => this.emit("error", event.error);
    ws.onclose = (event) => this.emit("close", event);
    ws.onmessage = ({ data }) => (typeof data === "string" ? this.#text(JSON.parse(data)) : this.#binary(new DataView(data)));
  }

  #text(message) {
    this.emit(message.op, message.op === "advertise" ? message.channels : message);
  }
  #binary(view) {
    if (view.getUint8(0) !== 1) throw new Error(`opcode ${view.getUint8(0)}`);
    this.emit("message", {
      subscriptionId: view.getUint32(1, true),
      timestamp: view.getBigUint64(5, true),
      data: new DataView(view.buffer, view.byteOffset + 13),
    });
  }
  #send(message) {
    this.#socket.send(JSON.stringify(message));
  }

  subscribe(channelId) {
    const id = ++this.#next;
    this.#send({ op: "subscribe", subscriptions: [{ id, channelId }] });
    return id;
  }
  unsubscribe(id) {
    this.#send({ op: "unsubscribe", subscriptionIds: [id] });
  }
  advertise(channel) {
    const id = ++this.#next;
    this.#send({ op: "advertise", channels: [{ id, ...channel }] });
    return id;
  }
  sendMessage(channelId, bytes) {
    const message = new Uint8Array(5 + bytes.byteLength);
    message[0] = 1;
    new DataView(message.buffer).setUint32(1, channelId, true);
    message.set(bytes, 5);
    this.#socket.send(message);
  }
  close() {
    this.#socket.close();
  }
}

const makers = { "foxglove.websocket.v1": FoxgloveClient, "foxglove.sdk.v1": SdkClient };
export const subprotocols = Object.keys(makers);

/** One connection, whose messages are decoded by the schemas that the server advertised. */
export class Connection {
  #client;
  #takers = new Map();
  #complain;
  /** Rejects with the server's first complaint. */
  complaint = new Promise((_, reject) => (this.#complain = reject));
  info = undefined;
  channels = new Map(); // by topic

  /** Resolves once the server has advertised its channels; `options` are those of Node's TLS. */
  static async open(url, subprotocol, options = {}) {
    const connection = new Connection();
    const socket = new WebSocket(url, [subprotocol], options);
    const client = (connection.#client = new makers[subprotocol]({ ws: socket }));
    connection.complaint.catch(() => {});
    const opened = new Promise((resolve) =>
      client.on("advertise", (channels) => {
        for (const channel of channels) connection.channels.set(channel.topic, channel);
        resolve();
      }));
    client.on("serverInfo", (info) => (connection.info = info));
    client.on("status", (status) => connection.#complain(new Error(status.message)));
    client.on("error", (error) => connection.#complain(error));
    client.on("close", (event) => connection.#complain(new Error(`closed: ${event.code} ${event.reason}`)));
    client.on("message", ({ subscriptionId, data }) => connection.#takers.get(subscriptionId)?.(data));
    await Promise.race([opened, connection.complaint]);
    connection.subprotocol = socket.protocol;
    return connection;
  }

  /** Returns the first message of `topic` for which `wanted` holds. */
  async first(topic, wanted = () => true) {
    const { id, schema, schemaName } = this.channels.get(topic);
    const decode = readerOf(schemaName, schema);
    const subscription = this.#client.subscribe(id);
    const found = new Promise((resolve, reject) =>
      this.#takers.set(subscription, (data) => {
        try {
          const message = decode(data);
          if (wanted(message)) resolve(message);
        } catch (error) {
          reject(error);
        }
      }));
    const message = await Promise.race([found, this.complaint]);
    this.#takers.delete(subscription);
    this.#client.unsubscribe(subscription);
    return message;
  }

  /** Publishes one message of `topic`, which the server need not have offered. */
  publish(topic, schemaName, bytes) {
    this.#client.sendMessage(this.#client.advertise({ topic, encoding: "cdr", schemaName }), bytes);
  }

  close() {
    this.#client.close();
  }
}
