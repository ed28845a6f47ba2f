// SPDX-License-Identifier: Apache-2.0
// One server: connects, comes back after a loss, subscribes to what the page shows, decodes it, and
// carries the hand's poses and the page's commands. Runs in the worker.
import { firstReport, HandDevice, kPosePeriod_ms, type Clock, type HandOutput } from "../hand/hand_device";
import { Codec } from "../protocol/codec";
import {
  clientMessageData, kSubprotocols, parseMessageData, parseServerText, type Channel,
} from "../protocol/framing";
import type { CommandKind, ServerStatus, ToolForce, ToolPose, Topic } from "../protocol/messages";
import { metricsAddress } from "./address";
import { backoffMs } from "./backoff";
import type { DataMessage, FromWorker, ToWorker } from "./worker_messages";

const kWatched: readonly Topic[] = [
  "suture/status", "suture/event", "suture/command/reply", "suture/mesh/topology", "suture/mesh/frame",
  "suture/tool/state", "suture/needle", "suture/thread", "suture/contact", "suture/quality",
];
const kForce = "suture/tool/force";
/** Answers come at the rate of poses: a stream for one who holds a tool only. */
const kForceSubscription = 1000;

const kPublished = [
  { id: 1, topic: "suture/tool/pose", schemaName: "suture::v1::ToolPose" },
  { id: 2, topic: "suture/tool/device", schemaName: "suture::v1::DeviceProfile" },
  { id: 3, topic: "suture/command", schemaName: "suture::v1::Command" },
] as const;

const kNobody = new Uint8Array(16);
const kReportPeriod_ms = 24;
/** The id of a server's word (server/gateway/hands.hpp) on a profile or pose that the page's token does not allow. */
const kMayNotDrive = "may-not-drive";
const kNotAllowed = "your token does not allow to drive it";
/** A tool that was refused is not asked for again so soon: each pose until the answer is a fault, of which a server takes 100. */
const kRefused_ms = 10_000;

type Post = (message: FromWorker, transfer?: ArrayBuffer[]) => void;

export class Session implements HandOutput {
  readonly #post: Post;
  readonly #clock: Clock;
  #url = "";
  #socket: WebSocket | undefined;
  #attempt = 0;
  #everOpen = false;
  #retry: ReturnType<typeof setTimeout> | undefined;
  #channels = new Map<string, Channel>();
  #subscribed = new Map<number, Channel>();
  #schema = "";
  #codec: Codec | undefined;
  #complained = new Set<string>();
  #hand: HandDevice | undefined;
  #handTimer: ReturnType<typeof setInterval> | undefined;
  #reportedMs = 0;
  /** When the server refused which tool. */
  #refusedMs = new Map<string, number>();
  #poseSequence = 0n;
  #epoch = 0n;
  #request = 0n;

  constructor(post: Post, clock: Clock) {
    this.#post = post;
    this.#clock = clock;
  }

  handle(message: ToWorker): void {
    switch (message.type) {
      case "connect":
        this.#url = message.url;
        return this.#connect();
      case "retry":
        if (!this.#socket) this.#connect();
        return;
      case "command":
        return this.#command(message.kind, message.tool);
      case "hand_take":
        return this.#takeHand(message.tool, message);
      case "hand_target":
        return this.#hand?.aim(message.pose, message.jaw);
      case "hand_release":
        return this.#releaseHand();
    }
  }

  // ---------------------------------------------------------------- the socket

  #connect(): void {
    clearTimeout(this.#retry);
    this.#post({ type: "connection", state: { phase: "connecting", attempt: this.#attempt } });
    const socket = new WebSocket(this.#url, kSubprotocols);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    let opened = false;
    socket.onopen = () => {
      opened = true;
      this.#attempt = 0;
      this.#everOpen = true;
      this.#post({ type: "connection", state: { phase: "open" } });
      const channels = kPublished.map((each) => ({ ...each, encoding: "cdr" }));
      socket.send(JSON.stringify({ op: "advertise", channels }));
    };
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.#onText(data);
      else if (data instanceof ArrayBuffer) this.#onFrame(data);
    };
    socket.onclose = () => this.#onClose(opened);
  }

  #onClose(opened: boolean): void {
    this.#socket = undefined;
    this.#channels.clear();
    this.#subscribed.clear();
    this.#refusedMs.clear();
    this.#dropHand();
    const delayMs = backoffMs(this.#attempt++, Math.random());
    const attempt = this.#attempt;
    const retryAtMs = Date.now() + delayMs;
    const tell = (refused: boolean) => this.#post({
      type: "connection", state: { phase: "lost", attempt, retryAtMs, everOpen: this.#everOpen, refused },
    });
    tell(false);
    this.#retry = setTimeout(() => this.#connect(), delayMs);
    if (!opened) void this.#isRefused().then((refused) => {
      if (!refused || this.#socket || attempt !== this.#attempt) return;
      clearTimeout(this.#retry); // a person has to do something first
      tell(true);
    });
  }

  /** A browser does not say why a WebSocket was closed to it; a page that asks for the same token tells. */
  async #isRefused(): Promise<boolean> {
    try {
      return (await fetch(metricsAddress(this.#url), { method: "HEAD", cache: "no-store" })).status === 401;
    } catch {
      return false;
    }
  }

  #onText(text: string): void {
    const message = parseServerText(text);
    if (message?.op === "advertise") this.#onChannels(message.channels);
    if (message?.op === "unadvertise")
      for (const [topic, channel] of this.#channels)
        if (message.channelIds.includes(channel.id)) this.#channels.delete(topic);
    if (message?.op !== "status" || message.level === 0) return;
    if (message.id === kMayNotDrive) this.#onMayNotDrive();
    else this.#post({ type: "notice", text: message.message });
  }

  #onChannels(channels: Channel[]): void {
    const wanted = channels.filter((channel) => channel.encoding === "cdr" && channel.schemaEncoding === "omgidl" &&
      (channel.topic === kForce || (kWatched as readonly string[]).includes(channel.topic)));
    for (const channel of wanted) {
      this.#channels.set(channel.topic, channel);
      if (channel.schema === this.#schema) continue;
      try {
        this.#codec = new Codec(channel.schema);
        this.#schema = channel.schema;
      } catch (error) {
        this.#complain(`the schema of ${channel.topic} cannot be read: ${String(error)}`);
      }
    }
    this.#subscribe(wanted.filter((channel) => channel.topic !== kForce));
    if (this.#hand) this.#watchForces(true);
  }

  #subscribe(channels: Channel[]): void {
    const subscriptions = channels.map((channel) => ({ id: channel.id, channelId: channel.id }));
    for (const channel of channels) this.#subscribed.set(channel.id, channel);
    if (subscriptions.length > 0) this.#socket?.send(JSON.stringify({ op: "subscribe", subscriptions }));
  }

  #watchForces(watch: boolean): void {
    const channel = this.#channels.get(kForce);
    if (!channel || this.#socket?.readyState !== WebSocket.OPEN) return;
    if (watch === this.#subscribed.has(kForceSubscription)) return;
    if (watch) {
      this.#subscribed.set(kForceSubscription, channel);
      this.#socket.send(JSON.stringify({
        op: "subscribe", subscriptions: [{ id: kForceSubscription, channelId: channel.id }],
      }));
    } else {
      this.#subscribed.delete(kForceSubscription);
      this.#socket.send(JSON.stringify({ op: "unsubscribe", subscriptionIds: [kForceSubscription] }));
    }
  }

  #onFrame(frame: ArrayBuffer): void {
    const data = parseMessageData(frame);
    const channel = data && this.#subscribed.get(data.subscriptionId);
    if (!data || !channel || !this.#codec) return;
    try {
      const message = this.#codec.read<unknown>(channel.schemaName, data.payload);
      if (channel.topic === kForce) return this.#hand?.onForce(message as ToolForce);
      if (channel.topic === "suture/status") this.#onStatus(message as ServerStatus);
      const typed = { type: "data", topic: channel.topic, message, bytes: frame.byteLength } as DataMessage;
      this.#post(typed, buffersOf(message));
    } catch (error) {
      this.#complain(`a message of ${channel.topic} cannot be read: ${String(error)}`);
    }
  }

  #complain(text: string): void {
    if (this.#complained.has(text) || this.#complained.size > 20) return;
    this.#complained.add(text);
    this.#post({ type: "notice", text });
  }

  #publish(channelId: (typeof kPublished)[number]["id"], message: object): void {
    const published = kPublished.find((each) => each.id === channelId);
    if (!published || !this.#codec || this.#socket?.readyState !== WebSocket.OPEN) return;
    this.#socket.send(clientMessageData(channelId, this.#codec.write(published.schemaName, message)));
  }

  // ---------------------------------------------------------------- commands

  #command(kind: CommandKind, tool: string): void {
    this.#request += 1n;
    this.#publish(3, {
      requester: kNobody, epoch: this.#epoch, request: this.#request, stamp_ns: this.#stamp(), kind, tool,
      requester_name: "viewer", checkpoint: "", seconds: 0,
    });
  }

  #onStatus(status: ServerStatus): void {
    if (status.epoch === 0n) return; // another server that asks for the session
    this.#epoch = status.epoch;
    if (!this.#hand) return;
    this.#hand.epoch = status.epoch;
    const tool = this.#hand.tool;
    this.#hand.onStatus(status.tools.find((each) => each.tool === tool));
  }

  #stamp(): bigint {
    return BigInt(Math.round(this.#clock.nowMs() * 1000)) * 1000n;
  }

  // ---------------------------------------------------------------- the hand

  #takeHand(tool: string, start: Extract<ToWorker, { type: "hand_take" }>): void {
    if (this.#hand) this.#releaseHand();
    const end = (why: string) => this.report({ ...firstReport(tool, "none", start.pose, start.jaw), why });
    if (this.#socket?.readyState !== WebSocket.OPEN) return end("there is no connection");
    if (this.#clock.nowMs() - (this.#refusedMs.get(tool) ?? -Infinity) < kRefused_ms) return end(kNotAllowed);
    this.#hand = new HandDevice(tool, start.pose, start.jaw, this.#poseSequence, this.#clock, this);
    this.#hand.epoch = this.#epoch;
    this.#watchForces(true);
    this.#handTimer = setInterval(() => this.#handTick(), kPosePeriod_ms);
  }

  /** The profile and the first pose are refused with a word each, poses on the way with none: the first ends the hold. */
  #onMayNotDrive(): void {
    if (!this.#hand) return;
    this.#refusedMs.set(this.#hand.tool, this.#clock.nowMs());
    this.#hand.end(kNotAllowed); // a goodbye would be refused as well
    this.#watchForces(false);
    this.#dropHand();
  }

  #handTick(): void {
    if (!this.#hand) return;
    if (!this.#hand.tick()) return this.#releaseHand();
    const nowMs = this.#clock.nowMs();
    if (nowMs - this.#reportedMs < kReportPeriod_ms) return;
    this.#reportedMs = nowMs;
    this.#hand.tell();
  }

  #releaseHand(): void {
    this.#hand?.goodbye();
    this.#watchForces(false);
    this.#dropHand();
  }

  #dropHand(): void {
    clearInterval(this.#handTimer);
    if (!this.#hand) return;
    this.#poseSequence = this.#hand.sequence;
    this.#hand = undefined;
  }

  sendPose(pose: ToolPose): void {
    this.#publish(1, pose);
  }

  sendProfile(tool: string): void {
    this.#publish(2, {
      tool, epoch: this.#epoch, sequence_number: 1n, stamp_ns: this.#stamp(), device: kNobody, model: "viewer, pointer",
      rate_hz: 1000 / kPosePeriod_ms, max_force_n: 0, max_torque_nm: 0, max_stiffness_n_per_m: 0,
      max_damping_n_s_per_m: 0, max_force_slew_n_per_s: 0, pointer: true,
    });
  }

  report(report: Parameters<HandOutput["report"]>[0]): void {
    this.#post({ type: "hand", report });
  }
}

/** The buffers of the large sequences of a message, each once: moved to the page, not copied. */
function buffersOf(message: unknown): ArrayBuffer[] {
  const buffers = new Set<ArrayBuffer>();
  for (const value of Object.values(message as object))
    if (ArrayBuffer.isView(value) && value.buffer instanceof ArrayBuffer) buffers.add(value.buffer);
  return [...buffers];
}
