// SPDX-License-Identifier: GPL-3.0-or-later
// Draws the page for docs/guide: a needle through both vessels, led by `suture device`.
//
//     node picture.mjs OUT.png [dark|light] [SECONDS of the recording]
import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { join } from "node:path";
import { event, launch, missing, open, root, Server } from "./support.mjs";

const [out, theme = "dark", until = "3.9"] = process.argv.slice(2);
const device = process.env.SUTURE_PROGRAM ?? join(root, "build/release/client-sdk/cli/suture");
const why = !out ? "say where to: node picture.mjs OUT.png" : existsSync(device) ? missing() : `${device} was not built`;
if (why) {
  console.error(why);
  process.exit(1);
}

const server = await Server.start();
const browser = await launch();
const surgeon = spawn(device, ["device", "--surgeon", join(root, "server/scenes/anastomosis/one_bite.csv"), ...server.place],
  { stdio: ["ignore", "ignore", "inherit"] });
try {
  const { page } = await open(browser, server, { query: "?quality=best", colorScheme: theme, viewport: { width: 1440, height: 900 } });
  await event(page, "Grasp");
  const grasped = await page.evaluate(() => Number.parseFloat(document.querySelector('.events li[data-kind="Grasp"] time').textContent));
  await page.keyboard.press("5");
  // The recording closes its jaw 1.2 s after its start.
  await page.waitForFunction((at) => Number.parseFloat(document.querySelector(".time").textContent) >= at, grasped - 1.2 + Number(until));
  await page.screenshot({ path: out });
  console.log(`drew ${out}`);
} finally {
  surgeon.kill();
  await browser.close();
  await server.end();
}
