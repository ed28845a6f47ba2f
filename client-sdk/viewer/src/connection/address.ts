// SPDX-License-Identifier: Apache-2.0

/**
 * Returns the WebSocket of the server that gave the page at `page`, with the token of its fragment.
 *
 *     https://host:1/#token=abc  →  wss://host:1/?token=abc
 */
export function serverAddress(page: string, path = "/"): string {
  const from = new URL(page);
  const to = new URL(path, from.origin);
  to.protocol = from.protocol === "https:" ? "wss:" : "ws:";
  const token = new URLSearchParams(from.hash.slice(1)).get("token");
  if (token) to.searchParams.set("token", token);
  return to.href;
}

/** Returns where the server of that WebSocket has `/metrics`, which asks for the same token. */
export function metricsAddress(socket: string): string {
  const to = new URL(socket);
  to.protocol = to.protocol === "wss:" ? "https:" : "http:";
  to.pathname = `${to.pathname.replace(/\/$/, "")}/metrics`;
  return to.href;
}
