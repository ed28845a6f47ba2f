// SPDX-License-Identifier: Apache-2.0
import { Session } from "./session";
import type { FromWorker, ToWorker } from "./worker_messages";

const session = new Session(
  (message: FromWorker, transfer: ArrayBuffer[] = []) => self.postMessage(message, { transfer }),
  { nowMs: () => performance.timeOrigin + performance.now() },
);

self.onmessage = ({ data }: MessageEvent<ToWorker>) => session.handle(data);
