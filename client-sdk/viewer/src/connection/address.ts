// SPDX-License-Identifier: Apache-2.0

/**
 * Returns the WebSocket of the server that gave the page at `page`, with the token of its fragment.
 *
 *     https://host:1/#token=abc  →  wss://host:1/?token=abc
 *
 * `devServer` (HOST:PORT) stands for the page's own host while the page is being developed.
 */
export function serverAddress(page: string, devServer = ""): string {
  const from = new URL(page);
  const to = new URL(devServer === "" ? from.origin : `http://${devServer}`);
  to.protocol = from.protocol === "https:" && devServer === "" ? "wss:" : "ws:";
  to.pathname = "/";
  const token = new URLSearchParams(from.hash.slice(1)).get("token");
  if (token) to.searchParams.set("token", token);
  return to.href;
}
