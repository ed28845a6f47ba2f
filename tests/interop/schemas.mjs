// SPDX-License-Identifier: GPL-3.0-or-later
// Messages by the schemas that came with them, and by nothing of ours.
import { parseIDL } from "@foxglove/omgidl-parser";
import { MessageReader, MessageWriter } from "@foxglove/omgidl-serialization";

const parsed = new Map();

function definitionsOf(schema) {
  if (!parsed.has(schema)) parsed.set(schema, parseIDL(schema));
  return parsed.get(schema);
}

/** Returns a function from CDR bytes to the message of type `name`. */
export function readerOf(name, schema) {
  const reader = new MessageReader(name, definitionsOf(schema));
  return (bytes) => reader.readMessage(bytes);
}

/** Returns a function from a message of type `name` to CDR bytes. */
export function writerOf(name, schema) {
  const writer = new MessageWriter(name, definitionsOf(schema));
  return (message) => writer.writeMessage(message);
}

/** Returns the value of an enumerator: `enumerator(schema, "suture::v1::EventKind", "EVENT_PUNCTURE")`. */
export function enumerator(schema, type, name) {
  const values = definitionsOf(schema).find((definition) => definition.name === type).definitions;
  return values.find((each) => each.name === name).value;
}
