// SPDX-License-Identifier: Apache-2.0
import type { CommandKind, Topic, Topics } from "../protocol/messages";
import type { Pose } from "../maths/vector";
import type { ConnectionState, FromWorker, HandReport, ToWorker } from "./worker_messages";

export interface LinkListeners {
  connection(state: ConnectionState): void;
  hand(report: HandReport): void;
  notice(text: string): void;
}

type DataListener = (message: never, bytes: number) => void;

/** The page's end of its worker. */
export class Link {
  readonly #worker = new Worker(new URL("./worker.ts", import.meta.url), { type: "module" });
  readonly #listeners = new Map<Topic, DataListener[]>();

  constructor(listeners: LinkListeners) {
    this.#worker.onmessage = ({ data }: MessageEvent<FromWorker>) => {
      switch (data.type) {
        case "connection":
          return listeners.connection(data.state);
        case "hand":
          return listeners.hand(data.report);
        case "notice":
          return listeners.notice(data.text);
        case "data":
          this.#listeners.get(data.topic)?.forEach((listener) => listener(data.message as never, data.bytes));
      }
    };
  }

  /** Calls `listener` with each message of `topic`. */
  on<T extends Topic>(topic: T, listener: (message: Topics[T], bytes: number) => void): void {
    this.#listeners.set(topic, [...(this.#listeners.get(topic) ?? []), listener as DataListener]);
  }

  connect(url: string): void {
    this.#send({ type: "connect", url });
  }
  retry(): void {
    this.#send({ type: "retry" });
  }
  command(kind: CommandKind, tool = ""): void {
    this.#send({ type: "command", kind, tool });
  }
  takeHand(tool: string, pose: Pose, jaw: number): void {
    this.#send({ type: "hand_take", tool, pose, jaw });
  }
  aimHand(pose: Pose, jaw: number): void {
    this.#send({ type: "hand_target", pose, jaw });
  }
  releaseHand(): void {
    this.#send({ type: "hand_release" });
  }

  #send(message: ToWorker): void {
    this.#worker.postMessage(message);
  }
}
