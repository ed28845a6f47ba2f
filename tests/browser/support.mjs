// SPDX-License-Identifier: GPL-3.0-or-later
// Debian's Chromium without a display or a GPU, and what it shows.
import { existsSync } from "node:fs";
import { join } from "node:path";
import { chromium } from "playwright-core";
import { program, root } from "../support/server.mjs";

export { root, Server, vessels } from "../support/server.mjs";

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

/** Opens the page, after `init` has run in it, and waits for its first picture; a fault of the page fails the test that asked. */
export async function open(browser, server, options = {}) {
  const { query = "", init = () => {}, ...context } = options;
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 }, colorScheme: "dark", ...context });
  page.setDefaultTimeout(90_000);  // only a failure reaches it: pictures without a GPU, beside other tests
  const faults = [];
  page.on("pageerror", (error) => faults.push(error.message));
  await page.addInitScript(init);
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

/** Returns what a page shows of its tools, its figures and its events. */
export const shown = (page) => page.evaluate(() => [`lease ${document.documentElement.dataset.lease}`,
  ...["tools", "status", "events"].map((id) => document.getElementById(id)?.innerText)].join("\n"));

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
