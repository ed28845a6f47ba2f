// SPDX-License-Identifier: GPL-3.0-or-later
// A real server in a process of its own, for the tests in JavaScript.
import { spawn } from "node:child_process";
import { once } from "node:events";
import { createServer } from "node:net";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

export const root = join(dirname(fileURLToPath(import.meta.url)), "../..");
export const program = process.env.SUTURED_PROGRAM ?? join(root, "build/release/server/sutured");
export const suture = process.env.SUTURE_CLI ?? join(root, "build/release/client-sdk/cli/suture");
export const vessels = join(root, "server/scenes/anastomosis/scene.toml");

/** An even domain that ordinary use leaves alone, and a session of this process in it. */
const domain = 100 + 2 * (process.pid % 60);
const session = `node-${process.pid}`;
let started = 0;

/** A port that nobody has just now: a server that comes back must come back on the same one. */
async function freePort() {
  const probe = createServer().listen(0, "127.0.0.1");
  await once(probe, "listening");
  const { port } = probe.address();
  probe.close();
  await once(probe, "close");
  return port;
}

/** A program that runs beside; `log` is what it has said. It goes with this process. */
export class Program {
  #process;
  #watch = () => {};
  log = "";

  constructor(command, words) {
    this.#process = spawn(command, words, { stdio: ["ignore", "pipe", "pipe"] });
    const child = this.#process;
    const kill = () => child.kill("SIGKILL");
    process.once("exit", kill);
    for (const pipe of [child.stdout, child.stderr])
      pipe.on("data", (bytes) => {
        this.log += bytes;
        this.#watch();
      });
    this.ended = once(child, "exit").then(([code, signal]) => {
      process.off("exit", kill);
      return code ?? signal;
    });
  }

  /** Waits until it has said `text`; fails where it ends before. */
  said(text) {
    const heard = new Promise((resolve) => {
      this.#watch = () => this.log.includes(text) && resolve();
      this.#watch();
    });
    const ended = this.ended.then((how) => {
      throw new Error(`it ended with ${how} before it said "${text}":\n${this.log}`);
    });
    return Promise.race([heard, ended]);
  }

  /** Ends it; returns its exit code, or the signal that ended it. */
  end(signal = "SIGINT") {
    this.#process.kill(signal);
    return this.ended;
  }
}

/** `sutured serve` with its gateway; `url` is where its page is. */
export class Server {
  #program;

  static async start({ scene = vessels, port = undefined, options = [] } = {}) {
    const server = new Server();
    server.session = `${session}-${++started}`;
    server.scene = scene;
    server.port = port ?? (await freePort());
    server.#program = new Program(program, ["serve", scene, ...server.place, "--http", `127.0.0.1:${server.port}`, ...options]);
    await server.#program.said("viewer at ");
    server.url = server.#program.log.match(/viewer at (\S+)/)[1];
    return server;
  }

  /** Waits until it has said `text`; fails where it ends before. */
  said(text) {
    return this.#program.said(text);
  }

  /** Where its WebSocket is. */
  get socket() {
    return this.url.replace("http", "ws");
  }
  /** Where it is found over DDS, as options of a command. */
  get place() {
    return ["--domain", String(domain), "--session", this.session];
  }

  end(signal = "SIGINT") {
    return this.#program.end(signal);
  }
}

/** A device that sews one bite of the vessels, to and fro. */
export const sewing = (server) =>
  new Program(suture, ["device", "--surgeon", join(root, "server/scenes/anastomosis/one_bite.csv"), "--loop", "--quiet", ...server.place]);
