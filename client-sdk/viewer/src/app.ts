// SPDX-License-Identifier: Apache-2.0
// Puts connection, scene, panels and hand together.
import { serverAddress } from "./connection/address";
import { Link } from "./connection/link";
import type { ConnectionState } from "./connection/worker_messages";
import { Pad } from "./hand/gamepad";
import { Hand } from "./hand/hand";
import { addRates, HeldKeys } from "./hand/held_keys";
import { distanceToCourse } from "./hand/course";
import { listenToPointer } from "./hand/pointer";
import { CommandKind, CommandResult, EventKind, ServerState, type ServerStatus } from "./protocol/messages";
import { announce, byId, h } from "./panels/dom";
import { Events, eventText } from "./panels/events";
import { HandPanel } from "./panels/hand_panel";
import { actsUnderList, Help, type Shortcut } from "./panels/keys";
import { Legend } from "./panels/legend";
import { Overlay } from "./panels/overlay";
import { PickCard } from "./panels/pick_card";
import { Plot } from "./panels/plots";
import { QualityPanel, Rate, StatusPanel } from "./panels/status";
import { cssVariable, ThemeSwitch } from "./panels/theme";
import { TopBar } from "./panels/top_bar";
import { pageOptions } from "./page_options";
import { kPresets } from "./scene/cameras";
import { colourAt, cssColour, kTensionMap } from "./scene/colour_map";
import { Lead } from "./scene/epochs";
import { Stage } from "./scene/stage";
import { wasLed } from "./scene/tools";
import { View } from "./scene/view";
import { Snapshot, tellError } from "./snapshot";

const kPanelPeriod_ms = 100;
const kNear_m = 0.03;
const kAlive_ms = 200;
/** Said aloud to a screen reader. */
const kSpoken = new Set([EventKind.Grasp, EventKind.Release, EventKind.Puncture, EventKind.Exit, EventKind.Fault, EventKind.Stopped]);

export class App {
  readonly #options = pageOptions(location.search);
  readonly #snapshot = this.#options.snapshot && new Snapshot(this.#options.snapshot.view);
  readonly #view: View;
  readonly #link: Link;
  readonly #stage: Stage;
  readonly #hand: Hand;
  readonly #keys = new HeldKeys();
  readonly #pad = new Pad(() => navigator.getGamepads?.() ?? []);
  readonly #bar: TopBar;
  readonly #overlay: Overlay;
  readonly #legend: Legend;
  readonly #status = new StatusPanel();
  readonly #quality = new QualityPanel();
  readonly #events = new Events();
  readonly #handPanel: HandPanel;
  readonly #pick: PickCard;
  readonly #force: Plot;
  readonly #tension: Plot;
  readonly #help: Help;
  readonly #theme: ThemeSwitch;
  readonly #shortcuts: Shortcut[];
  readonly #xray: HTMLButtonElement;
  readonly #frames = new Rate();
  readonly #bytes = new Rate();
  #connection: ConnectionState = { phase: "connecting", attempt: 0 };
  #lastStatus: ServerStatus | undefined;
  #slow = false;
  #held = false;
  #updated_ms = 0;
  #drawn = { frames: 0, at_ms: 0, rate: 0 };

  constructor() {
    this.#link = new Link({
      connection: (state) => this.#onConnection(state),
      hand: (report) => this.#hand.onReport(report),
      notice: (text) => this.#events.notice(text, "warn"),
    });
    // The worker connects while the picture is made ready: what it has to say waits in its channel.
    this.#link.connect(serverAddress(location.href, __SOCKET_PATH__));
    this.#view = new View(byId("canvas") as HTMLCanvasElement, this.#options.best);
    this.#stage = new Stage(this.#view, byId("labels"), this.#link, (ms) => {
      document.documentElement.dataset["firstPictureMs"] = ms.toFixed(0);
    });
    this.#stage.onOther = () => {
      if (this.#quality.epoch !== this.#stage.epoch) this.#quality.clear();
      this.#force.recent.forget();
      this.#tension.recent.forget();
    };
    this.#hand = new Hand(this.#link, {
      cameraAxes: () => this.#view.axes(),
      metresPerPixel: (at) => this.#view.metresPerPixel(at),
      toolView: (tool) => this.#stage.tools.view(tool),
      needles: () => this.#stage.sutures.needles(),
      threads: () => this.#stage.sutures.threads(),
      startPose: () => this.#stage.startPose(),
      limits: () => ({ centre: this.#stage.axes.centre, radius: 4 * this.#stage.axes.radius }),
      wasLed,
    });
    this.#hand.onEnd = (tool, why) => {
      if (why === "") return;
      this.#events.notice(`${tool} given back: ${why}`, "warn");
      announce(`${tool} given back: ${why}`);
    };
    this.#hand.onChange = () => {
      const holds = this.#hand.tool !== undefined;
      this.#view.handMode = holds;
      // The keys are the tool's now, not those of the button that took it.
      if (document.documentElement.toggleAttribute("data-hand", holds) && !this.#held) this.#focusPicture();
      // The next hold begins at rest, whatever is still down.
      if (!holds) this.#keys.clear();
      this.#held = holds;
      this.#view.wake();
    };
    this.#bar = new TopBar({
      pauseOrResume: () => this.#pauseOrResume(),
      reset: () => this.#command(CommandKind.Reset),
      stop: () => this.#command(CommandKind.Stop),
      theme: () => this.#theme.next(),
      help: () => this.#help.toggle(),
    });
    this.#overlay = new Overlay(() => this.#link.retry());
    this.#legend = new Legend(this.#stage.tissue.range, (map) => {
      this.#stage.tissue.map = map;
      this.#view.wake();
    });
    this.#force = new Plot("Force", "force-plot", "N", 0.2, (name) => this.#stage.tools.colour(name));
    this.#tension = new Plot("Tension", "tension-plot", "N", 0.05, () => cssColour(colourAt(kTensionMap, 0.3)));
    this.#handPanel = new HandPanel(this.#hand, this.#keys);
    this.#pick = new PickCard(() => this.#stage.unpick());
    this.#xray = h("button", { type: "button", "aria-pressed": "false", title: "See through the tissue (X)", onclick: () => this.#toggleXray() }, "X-ray");
    this.#shortcuts = this.#makeShortcuts();
    this.#help = new Help(this.#shortcuts);
    this.#theme = new ThemeSwitch(() => this.#restyle(), this.#options.theme);
    this.#lay();
    this.#listen();
    this.#restyle();
  }

  start(): void {
    this.#view.onFrame = (now_ms) => this.#onFrame(now_ms);
    // A picture may take long, or not be drawn at all: the hand's word does not depend on it.
    setInterval(() => this.#hand.alive(), kAlive_ms);
    setInterval(() => this.#updatePanels(performance.now()), kPanelPeriod_ms);
    window.addEventListener("hashchange", () => location.reload());
  }

  // ---------------------------------------------------------------- what comes in

  #onConnection(state: ConnectionState): void {
    this.#connection = state;
    this.#bar.setConnection(state);
    if (state.phase === "open") this.#stage.connected();
    if (state.phase === "lost") {
      this.#hand.lost();
      if (state.everOpen && state.attempt === 1) this.#events.notice("connection lost", "bad");
    }
    this.#overlay.show(state, this.#stage.hasScene);
    if (this.#snapshot && state.phase === "lost" && state.refused)
      tellError("access", "the server refuses access: the token is missing or wrong", "give one of its file of tokens");
  }

  #listen(): void {
    this.#link.on("suture/status", (status) => {
      this.#lastStatus = status;
      this.#bar.setStatus(status);
      this.#status.set(status);
      this.#snapshot?.scene.status(status.epoch, status.bodies);
    });
    this.#link.on("suture/event", (event) => {
      if (!this.#events.push(event)) return;
      if (kSpoken.has(event.kind) && Math.abs(Date.now() - Number(event.stamp_ns / 1_000_000n)) < 2000) announce(eventText(event));
      if (event.kind === EventKind.Reset) this.#quality.reset(event.epoch);
    });
    this.#link.on("suture/quality", (quality) => this.#quality.set(quality));
    this.#link.on("suture/command/reply", (reply) => {
      if (reply.result === CommandResult.Done) return;
      this.#events.notice(`${CommandKind[reply.kind]?.toLowerCase() ?? "command"} refused: ${reply.text}`, "bad");
      announce(reply.text);
    });
    let time_s = 0;
    const lead = new Lead();
    this.#link.on("suture/mesh/frame", (frame, bytes) => {
      this.#snapshot?.scene.frame(frame.epoch, frame.body);
      if (frame.epoch === this.#stage.epoch && lead.take(frame.epoch, frame.body) > 0) {
        this.#frames.add(performance.now(), 0);
        time_s = frame.simulation_time_s;
        this.#bar.setTime(time_s);
      }
      this.#bytes.add(performance.now(), bytes);
    });
    this.#link.on("suture/mesh/topology", () => this.#overlay.show(this.#connection, true));
    this.#link.on("suture/tool/state", (tool) => {
      if (tool.epoch === this.#stage.epoch && wasLed(tool)) this.#force.recent.push(tool.tool, time_s, Math.hypot(...tool.force_n));
    });
    this.#link.on("suture/thread", (thread) => {
      if (thread.epoch === this.#stage.epoch) this.#tension.recent.push(thread.thread, time_s, thread.tension_n);
    });

    listenToPointer(this.#view.canvas, this.#hand, {
      pick: (x, y) => this.#stage.pick(x, y),
      lost: () => this.#hand.release("the pointer was lost"),
    });
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.#hand.release("the page was hidden");
    });
    window.addEventListener("pagehide", () => this.#hand.release("the page was left"));
    window.addEventListener("gamepaddisconnected", () => this.#hand.release("the gamepad was unplugged"));
    window.addEventListener("blur", () => {
      this.#keys.clear();
      this.#hand.release("the window lost the focus");
    });
    // A button that was clicked would keep the space bar, which works the jaw. One that was reached by keys keeps it.
    window.addEventListener("click", (event) => {
      const byPointer = event.detail > 0 && (event.target as Element).closest("button") !== null;
      if (byPointer && this.#hand.tool) this.#focusPicture();
    });
    window.addEventListener("keydown", (event) => {
      this.#keys.heed(event);
      this.#onKey(event);
    });
    window.addEventListener("keyup", (event) => {
      this.#keys.heed(event);
      this.#keys.release(event.code);
    });
  }

  // ---------------------------------------------------------------- keys

  #makeShortcuts(): Shortcut[] {
    const looks = kPresets.map((preset, i): Shortcut => ({
      code: `Digit${i + 1}`, keys: String(i + 1), help: `view: ${preset.toLowerCase()}`, act: () => this.#stage.look(preset),
    }));
    return [
      { code: "KeyG", keys: "G", help: "hold the first free tool, or let go", act: () => this.#toggleHold() },
      { code: "Escape", keys: "Esc", help: "let go of the tool", act: () => this.#hand.release() },
      { code: "Space", keys: "Space", help: "close or open the jaw", act: () => this.#handPanel.toggleJaw() },
      { code: "KeyN", keys: "N", help: "lead the tool to the needle", act: () => this.#handPanel.reach() },
      { code: "KeyF", keys: "F", help: "lead the tool to the thread", act: () => this.#handPanel.reachForThread() },
      { code: "KeyM", keys: "M / T / V", help: "a drag moves, turns, drives", act: () => this.#handPanel.setMode("move") },
      { code: "KeyS", keys: "S", help: "stop: zero force for all tools until a resume", act: () => this.#command(CommandKind.Stop) },
      { code: "KeyP", keys: "P", help: "pause or resume", act: () => this.#pauseOrResume() },
      { code: "KeyR", shift: true, keys: "Shift + R", help: "reset (asked twice)", act: () => this.#bar.askReset() },
      ...looks,
      { code: "KeyX", keys: "X", help: "see through the tissue", act: () => this.#toggleXray() },
      { code: "KeyC", keys: "C", help: "other colours for stress", act: () => this.#legend.nextMap() },
      { code: "KeyD", keys: "D", help: "light, dark, or as the system", act: () => this.#theme.next() },
      { code: "KeyH", keys: "H or ?", help: "this list", act: () => this.#help.toggle() },
    ];
  }

  #onKey(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || /^(INPUT|SELECT|TEXTAREA)$/.test(target.tagName)) return;
    if (this.#help.element.open && !actsUnderList(event.code)) return;
    this.#slow = event.altKey;
    // A button that has the focus keeps its own keys.
    const onButton = target.tagName === "BUTTON";
    if (onButton && ["Space", "Enter"].includes(event.code)) return;
    if (this.#hand.tool && this.#keys.press(event.code)) return event.preventDefault();
    if (this.#moveView(event.code)) return event.preventDefault();
    if (event.repeat) return;
    if (event.key === "?") return this.#help.toggle();
    if (event.code === "KeyT") return this.#handPanel.setMode("turn");
    if (event.code === "KeyV") return this.#handPanel.setMode("drive");
    const found = this.#shortcuts.find((each) => each.code === event.code && (each.shift ?? false) === event.shiftKey);
    if (!found) return;
    event.preventDefault();
    found.act();
  }

  #focusPicture(): void {
    this.#view.canvas.focus({ preventScroll: true });
  }

  #moveView(code: string): boolean {
    const kStep = 0.06;
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [-kStep, 0], ArrowRight: [kStep, 0], ArrowUp: [0, kStep], ArrowDown: [0, -kStep],
    };
    const turn = turns[code];
    if (turn && document.activeElement === this.#view.canvas) this.#view.orbit(...turn);
    else if (code === "Equal" || code === "NumpadAdd") this.#view.zoom(0.9);
    else if (code === "Minus" || code === "NumpadSubtract") this.#view.zoom(1 / 0.9);
    else return false;
    return true;
  }

  // ---------------------------------------------------------------- what people ask for

  #command(kind: CommandKind): void {
    if (this.#connection.phase === "open") this.#link.command(kind);
  }

  #pauseOrResume(): void {
    const state = this.#lastStatus?.state;
    this.#command(state === ServerState.Paused || state === ServerState.Stopped ? CommandKind.Resume : CommandKind.Pause);
  }

  #toggleHold(): void {
    if (this.#hand.tool) return this.#hand.release();
    const free = this.#stage.tools.views().find((view) => this.#toolStatus(view.tool)?.leased !== true);
    if (free) this.#hand.take(free.tool);
    else announce("No tool is free");
  }

  #toggleXray(): void {
    const on = !this.#stage.tissue.translucent;
    this.#stage.tissue.translucent = on;
    this.#xray.setAttribute("aria-pressed", String(on));
    this.#view.wake();
  }

  // ---------------------------------------------------------------- each frame

  #onFrame(now_ms: number): void {
    if (this.#snapshot) return this.#takeSnapshot(this.#snapshot);
    const elapsed_s = Math.min(0.1, (now_ms - this.#updated_ms) / 1000);
    this.#updated_ms = now_ms;
    this.#stage.update(performance.now());
    this.#stage.label();
    this.#updateHand(now_ms, elapsed_s);
    this.#force.update(now_ms);
    this.#tension.update(now_ms);
  }

  /** Shows what has come so far; once that is all of it, for the last time. */
  #takeSnapshot(snapshot: Snapshot): void {
    if (snapshot.fixed) return;
    this.#stage.look(snapshot.view, false);
    this.#stage.update(performance.now());
    this.#stage.label();
    this.#updateLegend();
    snapshot.tellWaiting(this.#connection.phase === "open");
    if (!snapshot.scene.complete) return;
    snapshot.fixed = true;
    this.#view.onDrawn = () => {
      this.#view.onDrawn = undefined;
      snapshot.tellReady();
    };
  }

  #updateHand(now_ms: number, elapsed_s: number): void {
    const pad = this.#pad.read();
    if (pad?.hold) this.#toggleHold();
    this.#handPanel.padHeldBack = pad?.heldBack === true;
    if (!this.#hand.tool) return;
    if (pad?.jaw) this.#handPanel.toggleJaw();
    if (pad?.reach) this.#handPanel.reach();
    this.#hand.update(addRates(this.#keys.rates(this.#slow), pad?.rates), elapsed_s);
    this.#view.wake();
    const report = this.#hand.report;
    if (report) this.#pad.feel(report.force, this.#maxForce(), now_ms);
  }

  #updatePanels(now_ms: number): void {
    if (document.hidden || this.#snapshot) return;
    if (now_ms - this.#drawn.at_ms > 1000) {
      const frames = this.#view.framesDrawn;
      this.#drawn = { frames, at_ms: now_ms, rate: ((frames - this.#drawn.frames) * 1000) / (now_ms - this.#drawn.at_ms) };
      this.#status.setRates(this.#frames.at(now_ms).perSecond, this.#bytes.at(now_ms).bytesPerSecond, this.#drawn.rate,
        this.#hand.report?.lease === "held" ? this.#hand.report.roundTripMs : undefined);
    }
    this.#updateLegend();
    this.#handPanel.setTools(this.#stage.tools.views().map((view) => ({
      view, status: this.#toolStatus(view.tool), colour: this.#stage.tools.colour(view.tool),
    })), this.#servedTools());
    const held = this.#hand.tool ? this.#stage.tools.view(this.#hand.tool) : undefined;
    this.#handPanel.update(this.#maxForce(), this.#nearest(), held?.holding ?? "");
    this.#pick.show(this.#stage.probe());
    this.#overlay.show(this.#connection, this.#stage.hasScene);
  }

  #updateLegend(): void {
    this.#legend.update(this.#stage.tissue.range.top, this.#stage.sutures.tension.top, this.#stage.sutures.threads().length > 0);
  }

  #nearest(): { name: string; distance_m: number } | undefined {
    const at = this.#hand.report?.pose.position;
    if (!at) return undefined;
    const things = [
      ...this.#stage.sutures.needles().map((n) => ({ name: n.needle, distance_m: distanceToCourse(n.course_m, at) })),
      ...this.#stage.sutures.threads().map((t) => ({ name: t.thread, distance_m: distanceToCourse(t.course_m, at) })),
    ];
    return things.filter((thing) => thing.distance_m < kNear_m).sort((a, b) => a.distance_m - b.distance_m)[0];
  }

  /** Returns the names of the scene's tools, once its own status has come. */
  #servedTools(): string[] | undefined {
    const status = this.#lastStatus;
    return status?.epoch === this.#stage.epoch ? status.tools.map((each) => each.tool) : undefined;
  }

  #toolStatus(tool: string) {
    return this.#lastStatus?.tools.find((each) => each.tool === tool);
  }

  #maxForce(): number {
    return (this.#hand.tool && this.#toolStatus(this.#hand.tool)?.max_force_n) || 1;
  }

  // ---------------------------------------------------------------- the page

  #lay(): void {
    const presets = h("div", { class: "segments", role: "group", "aria-label": "Views" },
      ...kPresets.map((preset, i) => h("button", { type: "button", title: `View: ${preset} (${i + 1})`, onclick: () => this.#stage.look(preset) }, preset)));
    byId("stage-top").append(presets, this.#xray, this.#pick.element);
    byId("stage-bottom").append(this.#legend.element);
    byId("side").append(this.#handPanel.element, this.#force.element, this.#tension.element, this.#quality.element,
      this.#status.element, this.#events.element);
    document.body.append(this.#help.element);
  }

  #restyle(): void {
    this.#view.background = cssVariable("--stage");
    this.#force?.restyle();
    this.#tension?.restyle();
    if (this.#theme) this.#bar.setTheme(this.#theme.theme);
  }
}
