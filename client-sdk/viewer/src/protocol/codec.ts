// SPDX-License-Identifier: Apache-2.0
import { parseIDL, type IDLMessageDefinition } from "@foxglove/omgidl-parser";
import { MessageReader, MessageWriter } from "@foxglove/omgidl-serialization";

/**
 * Decodes and encodes CDR by the schema that the server advertises. A schema is parsed once; float
 * sequences come out as typed arrays over the frame, without a copy of each number.
 */
export class Codec {
  readonly #definitions: IDLMessageDefinition[];
  readonly #readers = new Map<string, MessageReader>();
  readonly #writers = new Map<string, MessageWriter>();

  /** Throws where `schema` is no OMG IDL. */
  constructor(schema: string) {
    this.#definitions = parseIDL(schema);
  }

  /** Returns the constants of enumeration `name`, or [] where the schema has none of that name. */
  enumerators(name: string): { name: string; value: number }[] {
    const found = this.#definitions.find((definition) => definition.name === name);
    if (found?.aggregatedKind !== "module") return [];
    return found.definitions.map((each) => ({ name: each.name, value: Number(each.value) }));
  }

  /** Returns the fields of `payload`; throws where it is too short or no such type is known. */
  read<T>(schemaName: string, payload: Uint8Array): T {
    let reader = this.#readers.get(schemaName);
    if (!reader) this.#readers.set(schemaName, (reader = new MessageReader(schemaName, this.#definitions)));
    return reader.readMessage<T>(payload);
  }

  /** Returns `message` as XCDR1, little-endian, with its header of four bytes. */
  write(schemaName: string, message: object): Uint8Array {
    let writer = this.#writers.get(schemaName);
    if (!writer) this.#writers.set(schemaName, (writer = new MessageWriter(schemaName, this.#definitions)));
    return writer.writeMessage(message);
  }
}
