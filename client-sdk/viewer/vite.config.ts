// SPDX-License-Identifier: Apache-2.0
import { readdir, readFile, writeFile } from "node:fs/promises";
import { join, resolve } from "node:path";
import { gzipSync } from "node:zlib";
import { defineConfig, type Plugin } from "vite";

const kTextFiles = /\.(html|js|css|svg|json|txt)$/;

/** Leaves FILE.gz beside each text file of the build, for a server that sends it as it is. */
function compress(): Plugin {
  let folder = "";
  return {
    name: "suture-compress",
    apply: "build",
    configResolved: (config) => void (folder = resolve(config.root, config.build.outDir)),
    async closeBundle() {
      for (const entry of await readdir(folder, { recursive: true })) {
        if (!kTextFiles.test(entry)) continue;
        const file = join(folder, entry);
        await writeFile(`${file}.gz`, gzipSync(await readFile(file), { level: 9 }));
      }
    },
  };
}

// `npm run dev` shows the page from here and takes the scene from a server at SUTURE_SERVER, through a
// proxy: the server lets in no page of another origin.
const server = process.env["SUTURE_SERVER"] ?? "127.0.0.1:8080";
const kProxied = "/suture";

export default defineConfig(({ command }) => ({
  base: "./",
  define: { __SOCKET_PATH__: JSON.stringify(command === "serve" ? kProxied : "/") },
  server: {
    proxy: {
      [kProxied]: {
        target: `ws://${server}`, ws: true, rewrite: (path) => path.slice(kProxied.length) || "/",
        changeOrigin: true, headers: { origin: `http://${server}` },
      },
    },
  },
  build: {
    outDir: "../../build/viewer",
    emptyOutDir: true,
    target: "es2022",
    chunkSizeWarningLimit: 1000,
  },
  worker: { format: "es" },
  plugins: [compress()],
}));
