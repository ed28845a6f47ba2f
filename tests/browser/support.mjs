// SPDX-License-Identifier: GPL-3.0-or-later
// A real server in a process of its own, and Debian's Chromium without a display or a GPU.
import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { once } from "node:events";
import { createServer } from "node:net";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

export const root = join(dirname(fileURLToPath(import.meta.url)), "../..");
export const program = process.env.SUTURED_PROGRAM ?? join(root, "build/release/server/sutured");
export const vessels = join(root, "server/scenes/anastomosis/scene.toml");

/** An even domain that ordinary use leaves alone, and a session of this process in it. */
const domain = 100 + 2 * (process.pid % 60);
const session = `browser-${process.pid}`;

/** A port that nobody has just now: a server that comes back must come back on the same one. */
async function freePort() {
  const probe = createServer().listen(0, "127.0.0.1");
  await once(probe, "listening");
  const { port } = probe.address();
  probe.close();
  await once(probe, "close");
  return port;
}

/** `sutured serve` with its gateway. */
export class Server {
  #process;
  log = "";

  static async start(scene = vessels, port = undefined) {
    const server = new Server();
    server.scene = scene;
    server.port = port ?? (await freePort());
    server.#process = spawn(program, ["serve", scene, ...server.place, "--http", `127.0.0.1:${server.port}`],
      { stdio: ["ignore", "ignore", "pipe"] });
    process.once("exit", () => server.#process.kill());
    await new Promise((resolve, reject) => {
      server.#process.on("error", reject);
      server.#process.on("exit", (code, signal) => reject(new Error(`sutured ended with ${code ?? signal}:\n${server.log}`)));
      server.#process.stderr.on("data", (bytes) => {
        server.log += bytes;
        if (server.log.includes("viewer at ")) resolve();
      });
    });
    server.#process.removeAllListeners("exit");
    return server;
  }

  get url() {
    return `http://127.0.0.1:${this.port}/`;
  }
  /** Where it is found over DDS, as options of a command. */
  get place() {
    return ["--domain", String(domain), "--session", session];
  }

  async end(signal = "SIGINT") {
    if (this.#process.exitCode !== null || this.#process.signalCode !== null) return;
    const exit = once(this.#process, "exit");
    this.#process.kill(signal);
    await exit;
  }
}

/** Says what is missing, in a word for people; undefined where nothing is. */
export function missing() {
  if (!existsSync(chromiumPath())) return "Debian's chromium is not installed";
  if (!existsSync(program)) return `${program} was not built`;
  if (!existsSync(join(root, "build/viewer/index.html"))) return "the page was not built: `make viewer`";
  return undefined;
}

function chromiumPath() {
  return process.env.CHROMIUM ?? "/usr/bin/chromium";
}

export function launch() {
  return chromium.launch({
    executablePath: chromiumPath(),
    args: ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", ...(process.getuid() === 0 ? ["--no-sandbox"] : [])],
  });
}

/** Opens the page and waits for its first picture; a fault of the page fails the test that asked. */
export async function open(browser, server, options = {}) {
  const { query = "", ...context } = options;
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 }, colorScheme: "dark", ...context });
  const faults = [];
  page.on("pageerror", (error) => faults.push(error.message));
  await page.goto(server.url + query);
  await page.waitForSelector("html[data-first-picture-ms]", { state: "attached" });
  return { page, faults };
}

/** Returns the figure of that name once `good` holds for its number. */
export async function figure(page, name, good = () => true) {
  const cell = page.locator(`[data-figure="${name}"]`);
  for (;;) {
    const value = Number.parseFloat(await cell.innerText());
    if (good(value)) return value;
    await nextFrame(page);
  }
}

export const nextFrame = (page) => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => done())));

/** Waits for an event of that kind in the page's list, `count` of them. */
export const event = (page, kind, count = 1) =>
  page.waitForFunction(([k, n]) => document.querySelectorAll(`.events li[data-kind="${k}"]`).length >= n, [kind, count]);

export const lease = (page, state) => page.waitForSelector(`html[data-lease="${state}"]`, { state: "attached" });

/**
 * Returns the share of the picture's pixels whose colour `is` accepts, left and right of the middle.
 * `is` runs in the page: (r, g, b) → boolean.
 */
export async function pixels(page, is) {
  const png = (await page.locator("#stage").screenshot()).toString("base64");
  // In a page of its own: ours may not fetch what its server did not give it.
  const reader = await page.context().browser().newPage();
  const share = await reader.evaluate(async ([data, source]) => {
    const accepts = new Function(`return ${source}`)();
    const image = await createImageBitmap(await (await fetch(`data:image/png;base64,${data}`)).blob());
    const paint = new OffscreenCanvas(image.width, image.height).getContext("2d");
    paint.drawImage(image, 0, 0);
    const { data: rgba } = paint.getImageData(0, 0, image.width, image.height);
    const found = { left: 0, right: 0 };
    for (let i = 0; i < rgba.length; i += 4)
      if (accepts(rgba[i], rgba[i + 1], rgba[i + 2])) ++found[(i / 4) % image.width < image.width / 2 ? "left" : "right"];
    const half = (image.width * image.height) / 2;
    return { left: found.left / half, right: found.right / half };
  }, [png, is.toString()]);
  await reader.close();
  return share;
}
