// SPDX-License-Identifier: Apache-2.0
// Foxglove's WebSocket protocol, as far as the page speaks it: JSON texts, and two binary frames.
//
//     server: opcode 1 | u32 subscription | u64 receive time, ns | payload
//     client: opcode 1 | u32 channel | payload                              little-endian

/** Offered in this order; a server picks one. */
export const kSubprotocols = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

const kMessageData = 1;
const kServerHeader = 13;
const kClientHeader = 5;

export interface Channel {
  id: number;
  topic: string;
  encoding: string;
  schemaName: string;
  schemaEncoding?: string;
  schema: string;
}

export type ServerText =
  | { op: "serverInfo"; name: string; capabilities: string[]; sessionId?: string }
  | { op: "advertise"; channels: Channel[] }
  | { op: "unadvertise"; channelIds: number[] }
  | { op: "status"; level: number; message: string; id?: string };

export interface MessageData {
  subscriptionId: number;
  receiveTimeNs: bigint;
  /** A view of the frame, not a copy. */
  payload: Uint8Array;
}

/** Returns the message in a binary frame; undefined for frames of another kind and short ones. */
export function parseMessageData(frame: ArrayBuffer): MessageData | undefined {
  const view = new DataView(frame);
  if (frame.byteLength < kServerHeader || view.getUint8(0) !== kMessageData) return undefined;
  return {
    subscriptionId: view.getUint32(1, true),
    receiveTimeNs: view.getBigUint64(5, true),
    payload: new Uint8Array(frame, kServerHeader),
  };
}

/** Returns the text of a server as an object; undefined where it is none that the page knows. */
export function parseServerText(text: string): ServerText | undefined {
  try {
    const value: unknown = JSON.parse(text);
    const known = ["serverInfo", "advertise", "unadvertise", "status"];
    if (typeof value !== "object" || value === null || !("op" in value)) return undefined;
    return known.includes(String(value.op)) ? (value as ServerText) : undefined;
  } catch {
    return undefined;
  }
}

/** Returns `payload` as a frame for the client's own channel `channelId`. */
export function clientMessageData(channelId: number, payload: Uint8Array): Uint8Array {
  const frame = new Uint8Array(kClientHeader + payload.byteLength);
  const view = new DataView(frame.buffer);
  view.setUint8(0, kMessageData);
  view.setUint32(1, channelId, true);
  frame.set(payload, kClientHeader);
  return frame;
}
