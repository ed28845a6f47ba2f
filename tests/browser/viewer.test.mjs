// SPDX-License-Identifier: GPL-3.0-or-later
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { once } from "node:events";
import { mkdtempSync, readdirSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, beforeEach, describe, it as register } from "node:test";
import { event, figure, launch, lease, missing, nextFrame, open, pixels, root, Server, shown, vessels } from "./support.mjs";

const why = missing();
if (why) {
  console.log(`skipped: ${why}`);
  process.exit(77); // as CTest is told
}

/** Warm and lit: tissue at rest or stressed, and nothing else of the picture. */
const tissue = (r, g, b) => r > 90 && r > g + 18 && g >= b - 30 && r > b + 24;
/** Brighter than the ground and without a colour: steel. */
const steel = (r, g, b) => Math.min(r, g, b) > 120 && Math.max(r, g, b) - Math.min(r, g, b) < 26;

/** Runs in the page: a gamepad as a browser shows it, pushed by `window.pushed`; what it was told to feel is `window.felt`. */
function standInPad() {
  window.pushed = { connected: true, axes: [0, 0, 0, 0], down: [] };
  window.felt = [];
  const vibrationActuator = { playEffect: (_, effect) => (window.felt.push(effect), Promise.resolve("complete")) };
  navigator.getGamepads = () => [window.pushed.connected ? {
    id: "stand-in", index: 0, mapping: "standard", connected: true, axes: window.pushed.axes, vibrationActuator,
    buttons: Array.from({ length: 17 }, (_, i) => ({ pressed: window.pushed.down.includes(i), value: Number(window.pushed.down.includes(i)) })),
  } : null, null, null, null];
}

/** Runs in the page: notes of each frame of one body that arrives its number, when it came and the server's stamp, in milliseconds. */
function noteFrames() {
  window.arrived = [];
  window.Worker = class extends Worker {
    constructor(...words) {
      super(...words);
      this.addEventListener("message", ({ data: { topic, message } }) => {
        if (topic === "suture/mesh/frame" && message.body === "proximal")
          window.arrived.push({ number: message.sequence_number, at: performance.now(), made: Number(message.stamp_ns) / 1e6 });
      });
    }
  };
}

/** Writes the vessels with a thread in three bites of each, knotted at its tail, its head free; returns the scene's file. */
function sewnScene(folder) {
  const bites = [[0, -1], [0, 1], [15, -1], [15, 1], [30, -1], [30, 1]].map(([degrees, side]) => {
    const outer = side < 0 ? 0.006 : 0.005, inner = outer - 0.0015;
    const at = (radius) => [radius * Math.cos(degrees * Math.PI / 180), radius * Math.sin(degrees * Math.PI / 180), side * 0.00275];
    const walls = side < 0 ? [outer, inner] : [inner, outer];
    return walls.map((radius) => `  { tissue = "${side < 0 ? "proximal" : "distal"}", point_m = [${at(radius).map((x) => x.toFixed(6)).join(", ")}] },`).join("\n");
  });
  const thread = `[[thread]]\nname = "thread"\nlength_m = 0.1\nhead = "free"\ntail = "anchored"\npunctures = [\n${bites.join("\n")}\n]\n\n`;
  const scene = readFileSync(vessels, "utf8").replace(/\[\[thread\]\][^[]*/, thread).replaceAll('"vessels.msh"', JSON.stringify(join(dirname(vessels), "vessels.msh")));
  assert.ok(scene.includes(thread), "the scene of the vessels has no thread to replace");
  const file = join(folder, "sewn.toml");
  writeFileSync(file, scene);
  return file;
}

/** Gives the page, and does with who asks for its WebSocket what `answer` says: (request, socket) → nothing. */
class StandIn {
  answer = () => {};
  #server = createServer((request, response) => {
    const path = new URL(request.url, "http://any").pathname;
    const type = { js: "text/javascript", css: "text/css", html: "text/html" }[path.split(".").pop()] ?? "text/html";
    try {
      const body = readFileSync(join(root, "build/viewer", path === "/" ? "index.html" : path));
      response.writeHead(200, { "content-type": type }).end(body);
    } catch {
      response.writeHead(404).end();
    }
  });
  async start() {
    this.#server.on("upgrade", (request, socket) => this.answer(request, socket));
    await once(this.#server.listen(0, "127.0.0.1"), "listening");
    return `http://127.0.0.1:${this.#server.address().port}/`;
  }
  end() {
    this.#server.close();
  }
}

describe("the viewer", { timeout: 240_000 }, () => {
  let server, browser;
  before(async () => {
    server = await Server.start();
    browser = await launch();
  });
  after(async () => {
    await browser?.close();
    await server?.end();
  });
  // Each test leaves the page and its scene as it wants: the next one begins anew.
  let context = [];
  const page = async (options, of = server) => {
    const opened = await open(browser, of, options);
    context.push(opened);
    return opened.page;
  };
  beforeEach(async () => {
    for (const { page: opened } of context) await opened.close();
    context = [];
  });
  // A failure tells what its pages showed.
  const it = (name, test) => register(name, async () => {
    try {
      await test();
    } catch (error) {
      for (const { page: opened } of context) if (!opened.isClosed()) console.log(await shown(opened));
      throw error;
    }
  });

  it("weighs less than a megabyte", () => {
    let bytes = 0;
    for (const folder of ["build/viewer", "build/viewer/assets"])
      for (const name of readdirSync(join(root, folder)))
        if (name.endsWith(".gz")) bytes += statSync(join(root, folder, name)).size;
    console.log(`page weight: ${(bytes / 1000).toFixed(0)} kB compressed`);
    assert.ok(bytes > 50_000 && bytes < 1_000_000, String(bytes));
  });

  it("draws both vessels and the needle", async () => {
    const took_ms = [];
    for (let i = 0; i < 4; ++i) {
      await context.at(-1)?.page.close();
      took_ms.push(Number(await (await page()).evaluate(() => document.documentElement.dataset.firstPictureMs)));
    }
    assert.ok(took_ms.every((ms) => ms > 0), String(took_ms));
    const [cold, ...rest] = took_ms;
    console.log(`first picture: ${rest.sort((a, b) => a - b)[1]} ms after the page was asked for (median of three, budget on loopback: 2000 ms), ` +
      `${cold} ms in a browser just started`);
    const opened = context.at(-1).page;
    await opened.waitForSelector('[data-figure="Mesh"]');
    await nextFrame(opened);
    const warm = await pixels(opened, tissue);
    assert.ok(warm.left > 0.04 && warm.left < 0.6, `tissue on the left: ${warm.left}`);
    assert.ok(warm.right > 0.04 && warm.right < 0.6, `tissue on the right: ${warm.right}`);
    const bright = await pixels(opened, steel);
    assert.ok(bright.left + bright.right > 0.002, `steel: ${bright.left + bright.right}`);
    for (const { faults } of context) assert.deepEqual(faults, []);
  });

  it("gets at least thirty frames a second", async () => {
    const opened = await page({ init: noteFrames });
    // Of some two seconds, by the page's clock and by the server's: frames that were kept up and come at once are not many a second.
    const span = await opened.waitForFunction(([length_ms, wanted]) => {
      const frames = window.arrived;
      for (let from = 0; from + wanted <= frames.length; ++from) {
        const within = frames.slice(from).filter(({ at, made }) => at - frames[from].at <= length_ms && made - frames[from].made <= length_ms);
        const numbers = new Set(within.map(({ number }) => number)).size;
        if (numbers >= wanted) {
          const last = within.at(-1);
          return { numbers, seconds: Math.max(last.at - frames[from].at, last.made - frames[from].made) / 1000 };
        }
      }
      return undefined;
    }, [2000, 60]);
    const { numbers, seconds } = await span.jsonValue();
    const rate = await figure(opened, "Frames", (value) => value >= 30);
    console.log(`frames: ${numbers} in ${seconds.toFixed(2)} s; the page tells of ${rate} a second`);
  });

  it("tells numbers of a place that is picked", async () => {
    const opened = await page();
    const box = await opened.locator("#canvas").boundingBox();
    // The vessels fill the middle of the overview, left and right of the gap.
    await opened.mouse.click(box.x + 0.36 * box.width, box.y + 0.5 * box.height);
    const card = opened.getByRole("region", { name: "Picked place" });
    await card.waitFor();
    assert.match(await card.innerText(), /(proximal|distal)[\s\S]*Position[\s\S]*mm[\s\S]*Von Mises[\s\S]*kPa/);
    await card.getByRole("button", { name: "Close" }).click();
    await card.waitFor({ state: "hidden" });
  });

  it("pauses, resumes, and resets when asked twice", async () => {
    const opened = await page();
    await opened.getByRole("button", { name: "Pause" }).click();
    await opened.locator("#connection", { hasText: "paused" }).waitFor();
    await opened.getByRole("button", { name: "Resume" }).click();
    await opened.locator("#connection", { hasText: "live" }).waitFor();
    await opened.getByRole("button", { name: "Reset" }).click();
    await opened.getByRole("button", { name: "Really reset?" }).click();
    await event(opened, "Reset");
  });

  it("leads the needle by the mouse to a puncture, and gives the tool back", async () => {
    const opened = await page();
    const driver = opened.locator('[data-tool="driver"]');
    await driver.getByRole("button").click();
    await lease(opened, "held");
    await opened.getByRole("button", { name: "To the needle" }).click();
    await opened.getByText(/needle: 0\.\d mm from the jaw/).waitFor();
    await opened.getByRole("button", { name: "Close jaw" }).click();
    await event(opened, "Grasp");
    await driver.getByText(/holds needle/).waitFor();

    await opened.getByRole("button", { name: "Drive", exact: true }).click();
    const box = await opened.locator("#canvas").boundingBox();
    let x = box.x + 0.3 * box.width;
    await opened.mouse.move(x, box.y + 0.3 * box.height);
    await opened.mouse.down();
    // 0.04 mm a pixel: the wall is 2 mm away, and gives way before it is pierced.
    const punctures = () => opened.locator('.events li[data-kind="Puncture"]').count();
    for (let i = 0; i < 100 && (await punctures()) === 0; ++i) {
      await opened.mouse.move((x += 4), box.y + 0.3 * box.height);
      await nextFrame(opened);
    }
    await opened.mouse.up();
    await event(opened, "Puncture");
    assert.match(await opened.locator('.events li[data-kind="Puncture"]').first().innerText(), /needle punctures proximal \(0\.\d+ N\)/);

    // Another page sees that the tool is taken, and cannot take it.
    const other = await page();
    await other.locator('[data-tool="driver"]').getByRole("button").and(other.locator(":disabled")).waitFor();

    await driver.getByRole("button", { name: "driver" }).click();
    await event(opened, "ToolReturned");
    await lease(opened, "none");
    await other.locator('[data-tool="driver"]').getByRole("button").and(other.locator(":enabled")).waitFor();
  });

  it("lets go of the needle, takes the thread, and pulls it taut", async () => {
    const folder = mkdtempSync(join(tmpdir(), "suture-browser-"));
    let sewn;
    try {
      sewn = await Server.start({ scene: sewnScene(folder) });
      // A small one: pictures without a GPU take the time of the hand.
      const opened = await page({ viewport: { width: 720, height: 480 } }, sewn);
      const driver = opened.locator('[data-tool="driver"]');
      await driver.getByRole("button").click();
      await lease(opened, "held");
      await opened.keyboard.press("n");
      await opened.getByText(/needle: 0\.\d mm from the jaw/).waitFor();
      await opened.keyboard.press("Space");
      await driver.getByText(/holds needle/).waitFor();
      await opened.keyboard.press("Space");
      await event(opened, "Release");
      await driver.getByText(/holds/).waitFor({ state: "hidden" });

      await opened.keyboard.press("f");
      await opened.getByText(/thread: 0\.\d mm from the jaw/).waitFor();
      await opened.getByRole("button", { name: "Close jaw" }).click();
      await driver.getByText(/holds thread/).waitFor();
      // To the left, away from the vessels' middle: slack first, and then it pulls.
      const box = await opened.locator("#canvas").boundingBox();
      const taut = () => opened.locator('.events li[data-kind="Taut"]').count();
      const force = async () => Number.parseFloat(await opened.getByRole("meter", { name: /^Force on the hand/ }).getAttribute("aria-valuenow"));
      for (let i = 0; i < 40 && !((await taut()) > 0 && (await force()) > 0.02); ++i) {
        await opened.mouse.move(box.x + 0.6 * box.width, box.y + 0.5 * box.height);
        await opened.mouse.down();
        await opened.mouse.move(box.x + 0.6 * box.width - 40, box.y + 0.5 * box.height, { steps: 4 });
        await opened.mouse.up();
        await nextFrame(opened);
      }
      await event(opened, "Taut");
      await opened.waitForFunction(() => Number.parseFloat(document.querySelector('[role="meter"]').getAttribute("aria-valuenow")) > 0.02);
      // Under load the jaw stays as it is: a slip of a finger drops nothing.
      await opened.getByRole("button", { name: "To the thread" }).click();
      await driver.getByText(/holds thread/).waitFor();
      await opened.getByRole("button", { name: "Open jaw" }).waitFor();
      assert.deepEqual(context[0].faults, []);
    } finally {
      await sewn?.end();
      rmSync(folder, { recursive: true });
    }
  });

  it("works the jaw by the space bar, whichever button was clicked before", async () => {
    const opened = await page();
    await opened.locator('[data-tool="driver"]').getByRole("button").click();
    await lease(opened, "held");
    for (const clicked of ["Turn", "To the needle"]) {
      await opened.getByRole("button", { name: clicked, exact: true }).click();
      await opened.keyboard.press("Space");
      await opened.getByRole("button", { name: "Open jaw" }).waitFor();
      await opened.keyboard.press("Space");
      await opened.getByRole("button", { name: "Close jaw" }).waitFor();
    }
    await lease(opened, "held");
  });

  it("is led by a gamepad, which shakes with the force, and gives the tool back when the pad is unplugged", async () => {
    // A small one: two whole pictures, drawn without a GPU, take the time of the hand.
    const watcher = await page({ viewport: { width: 480, height: 300 } });
    const opened = await page({ init: standInPad });
    const [kA, kB, kLeftShoulder, kRightTrigger, kStart] = [0, 1, 4, 7, 9];
    const set = (change) => opened.evaluate((c) => Object.assign(window.pushed, c), change);
    const press = async (...buttons) => {
      await set({ down: buttons });
      await nextFrame(opened);
      await nextFrame(opened);
    };
    await opened.locator('[data-tool="driver"]').getByRole("button").and(opened.locator(":enabled")).waitFor();
    // A page that is too busy to lead gives the tool back, and says so: a person takes it again.
    for (let told = 0; ; ++told) {
      await press(kStart);
      await press();
      const held = await opened.waitForFunction((before) => document.documentElement.dataset.lease === "held" ? "held"
        : document.querySelectorAll('.events li[data-kind="Page"]').length > before && "given back", told);
      if ((await held.jsonValue()) === "held") break;
    }

    // Its pose arrives: the page of somebody else sees the tool move to the right, and only with the shoulder.
    const label = watcher.locator(".label", { hasText: /^driver/ });
    await label.waitFor();
    const x = async () => (await label.boundingBox()).x;
    await set({ axes: [1, 0, 0, 0] });
    await opened.getByText("Gamepad: hold the left shoulder to move.").waitFor();
    const before = await x();
    await press(kLeftShoulder);
    while ((await x()) < before + 8) await nextFrame(watcher);
    await watcher.close();  // its pictures would take the time of the hand's
    await set({ axes: [0, 0, 0, 0] });

    await press(kB);
    await press();
    await opened.getByText(/needle: 0\.\d mm from the jaw/).waitFor();
    // The list begins with what others did before.
    const count = (kind) => opened.locator(`.events li[data-kind="${kind}"]`).count();
    const [grasps, punctures] = [await count("Grasp"), await count("Puncture")];
    await press(kA);
    await press();
    await event(opened, "Grasp", grasps + 1);
    await press(kLeftShoulder, kRightTrigger);
    await event(opened, "Puncture", punctures + 1);
    // The force is told of as often as the page draws; deeper in, there is more of it.
    await opened.waitForFunction(() => new Set(window.felt.map((each) => each.strongMagnitude)).size > 1);
    await press();
    const felt = await opened.evaluate(() => window.felt);
    assert.ok(felt.length > 0 && felt.every(({ weakMagnitude: m }) => m > 0 && m <= 1), JSON.stringify(felt.slice(0, 5)));
    assert.ok(Math.max(...felt.map((each) => each.strongMagnitude)) > Math.min(...felt.map((each) => each.strongMagnitude)));

    await set({ connected: false });
    await opened.evaluate(() => window.dispatchEvent(new Event("gamepaddisconnected")));
    await lease(opened, "none");
    await opened.locator('.events li[data-kind="Page"]', { hasText: "the gamepad was unplugged" }).waitFor();
    assert.deepEqual(context[1].faults, []);
  });

  it("gives the tool back when the page is hidden", async () => {
    const opened = await page();
    await opened.keyboard.press("g");
    await lease(opened, "held");
    await opened.evaluate(() => {
      Object.defineProperty(document, "hidden", { value: true, configurable: true });
      document.dispatchEvent(new Event("visibilitychange"));
      Object.defineProperty(document, "hidden", { value: false, configurable: true });
    });
    await lease(opened, "none");
    await opened.locator('.events li[data-kind="Page"]', { hasText: "the page was hidden" }).waitFor();
  });

  it("has names for its controls, a list of its keys, and two themes", async () => {
    const opened = await page();
    const nameless = await opened.evaluate(() => [...document.querySelectorAll("button")]
      .filter((button) => !button.textContent.trim() && !button.getAttribute("aria-label")).length);
    assert.equal(nameless, 0);
    await opened.keyboard.press("h");
    await opened.getByRole("dialog", { name: "Mouse, touch and keys" }).waitFor();
    await opened.keyboard.press("Escape");
    await opened.getByRole("dialog").waitFor({ state: "hidden" });
    for (const theme of ["light", "dark"]) {
      await opened.keyboard.press("d");
      await opened.waitForSelector(`html[data-theme="${theme}"]`, { state: "attached" });
    }
  });

  it("fits a tablet, where a tap picks", async () => {
    const opened = await page({ viewport: { width: 820, height: 1180 }, hasTouch: true });
    const wide = await opened.evaluate(() => document.documentElement.scrollWidth);
    assert.ok(wide <= 820, `${wide} pixels wide`);
    const box = await opened.locator("#canvas").boundingBox();
    assert.ok(box.height > 0.4 * 1180);
    const warm = await pixels(opened, tissue);
    assert.ok(warm.left > 0.03 && warm.right > 0.03, JSON.stringify(warm));
    await opened.touchscreen.tap(box.x + 0.36 * box.width, box.y + 0.5 * box.height);
    await opened.getByRole("region", { name: "Picked place" }).waitFor();
  });

  it("is refused without a token, says so, and is let in with one that is typed", async () => {
    const folder = mkdtempSync(join(tmpdir(), "suture-browser-"));
    const tokens = join(folder, "tokens.toml");
    const token = "open-sesame_7";
    writeFileSync(tokens, `[[token]]\nname = "test"\nsha256 = "${createHash("sha256").update(token).digest("hex")}"\nrights = []\n`);
    const guarded = await Server.start({ options: ["--http-tokens", tokens] });
    const opened = await browser.newPage();
    try {
      await opened.goto(guarded.url);
      await opened.getByRole("heading", { name: "Access refused" }).waitFor();
      const bring = async (tried) => {
        await opened.getByLabel("Token").fill(tried);
        await Promise.all([opened.waitForEvent("load"), opened.keyboard.press("Enter")]);
      };
      await bring("wrong");
      await opened.getByRole("heading", { name: "Access refused" }).waitFor();
      await bring(token);
      await opened.waitForSelector("html[data-first-picture-ms]", { state: "attached" });
    } finally {
      await opened.close();
      await guarded.end();
      rmSync(folder, { recursive: true });
    }
  });

  it("says that it connects, that nobody answers, and that there is no scene yet", async () => {
    const stand = new StandIn();
    const url = await stand.start();
    const opened = await browser.newPage();
    try {
      let asked;
      stand.answer = (_, socket) => (asked = socket);  // and says nothing
      await opened.goto(url);
      await opened.getByRole("heading", { name: "Connecting" }).waitFor();
      while (!asked) await nextFrame(opened);
      stand.answer = (_, socket) => socket.destroy();
      asked.destroy();
      await opened.getByRole("heading", { name: "No answer" }).waitFor();
      await opened.getByText("Is the server running?").waitFor();
      stand.answer = ({ headers }, socket) => {
        const accept = createHash("sha1").update(`${headers["sec-websocket-key"]}258EAFA5-E914-47DA-95CA-C5AB0DC85B11`).digest("base64");
        asked = socket.on("error", () => {});
        socket.write("HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n" +
          `Sec-WebSocket-Accept: ${accept}\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n`);
      };
      await opened.getByRole("heading", { name: "No scene yet" }).waitFor();
      assert.equal(await opened.evaluate(() => document.documentElement.dataset.connection), "open");
      asked.destroy();
    } finally {
      await opened.close();
      stand.end();
    }
  });

  it("says that the connection is lost, and comes back by itself", async () => {
    const opened = await page();
    await figure(opened, "Frames", (value) => value > 0);
    await server.end("SIGKILL");
    await opened.waitForSelector('html[data-connection="lost"]', { state: "attached" });
    await opened.getByRole("heading", { name: "Connection lost" }).waitFor();
    const warm = await pixels(opened, tissue);
    assert.ok(warm.left > 0.04, "the last picture stays");
    await figure(opened, "Frames", (value) => value === 0);  // so that those to come are the new server's

    server = await Server.start({ port: server.port });
    await opened.waitForSelector('html[data-connection="open"]', { state: "attached" });
    await opened.locator("#overlay").waitFor({ state: "hidden" });
    await figure(opened, "Frames", (value) => value > 0);
    assert.deepEqual(context[0].faults, []);
  });
});
