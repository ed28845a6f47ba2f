// SPDX-License-Identifier: GPL-3.0-or-later
// The door to other machines: TLS and tokens, and what is said where it cannot open. Node's own TLS is the client.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { once } from "node:events";
import { chmodSync, copyFileSync, mkdtempSync, readFileSync, renameSync, rmSync, writeFileSync } from "node:fs";
import http from "node:http";
import https from "node:https";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, describe, it } from "node:test";
import { setTimeout } from "node:timers/promises";
import { Program, program, Server } from "../support/server.mjs";
import { Connection } from "./clients.mjs";

const folder = mkdtempSync(join(tmpdir(), "suture-access-"));
const file = (name) => join(folder, name);

/** Makes NAME.crt and NAME.key: a P-256 key, and a certificate that it signs itself. */
function certificate(name) {
  execFileSync("openssl", ["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
    "-subj", `/CN=${name}`, "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", file(`${name}.key`), "-out", file(`${name}.crt`)],
  { stdio: "pipe" });
  return readFileSync(file(`${name}.crt`));
}

/** Replaces the file of tokens by one with these, NAME: SECRET, who may command. */
function writeTokens(tokens) {
  const entries = Object.entries(tokens).map(([name, secret]) =>
    `[[token]]\nname = "${name}"\nsha256 = "${createHash("sha256").update(secret).digest("hex")}"\nrights = ["command"]\n`);
  writeFileSync(file("tokens.new"), entries.join("\n"));
  renameSync(file("tokens.new"), file("tokens.toml"));
}

/** Returns { status, text } of a GET. */
async function get(url, options = {}) {
  const [reply] = await once((url.startsWith("https") ? https : http).get(url, options), "response");
  let text = "";
  for await (const bytes of reply.setEncoding("utf8")) text += bytes;
  return { status: reply.statusCode, text };
}

const ours = certificate("ours");
const foreign = certificate("foreign");
writeTokens({ ward: "s3cret", eyes: "look" });
const tls = ["--http-certificate", file("ours.crt"), "--http-key", file("ours.key")];
const tokens = ["--http-tokens", file("tokens.toml")];

after(() => rmSync(folder, { recursive: true }));

describe("the door to other machines", { timeout: 240_000 }, () => {
  let server;
  before(async () => (server = await Server.start({ options: [...tls, ...tokens] })));
  after(() => server?.end());

  it("shows the page by TLS", async () => {
    assert.match(server.url, /^https:/);
    while ((await get(server.url + "healthz", { ca: ours })).status !== 200); // until its first status has come
    const page = await get(server.url, { ca: ours });
    assert.ok(page.status === 200 || page.text.includes("was not built"), page.text);
  });

  it("is refused by a client that does not know its certificate", async () => {
    await assert.rejects(get(server.url), { code: "DEPTH_ZERO_SELF_SIGNED_CERT" });
    await assert.rejects(get(server.url, { ca: foreign }), { code: "DEPTH_ZERO_SELF_SIGNED_CERT" });
    await assert.rejects(Connection.open(server.socket + "?token=s3cret", "foxglove.sdk.v1", { ca: foreign }), /self-signed/);
  });

  it("speaks no TLS before 1.2", async () => {
    const old = { ca: ours, minVersion: "TLSv1", maxVersion: "TLSv1.1", ciphers: "DEFAULT@SECLEVEL=0" };
    await assert.rejects(get(server.url, old), /alert protocol version/);
  });

  it("tells who speaks plain HTTP what to speak", async () => {
    const { status, text } = await get(server.url.replace("https", "http"));
    assert.equal(status, 400);
    assert.match(text, /this port speaks https/);
  });

  it("streams by TLS to who brings a token", async () => {
    const connection = await Connection.open(server.socket + "?token=s3cret", "foxglove.websocket.v1", { ca: ours });
    const frame = await connection.first("suture/mesh/frame");
    assert.ok(frame.position_m.length > 0);
    connection.close();
  });

  it("lets in nobody without a token that holds", async () => {
    for (const query of ["", "?token=", "?token=s3cre", "?token=s3cret2", "?token=LOOK"])
      await assert.rejects(Connection.open(server.socket + query, "foxglove.sdk.v1", { ca: ours }), /401/, query);
    assert.equal((await get(server.url + "metrics", { ca: ours })).status, 401);
    assert.equal((await get(server.url + "metrics?token=look", { ca: ours })).status, 200);
    assert.equal((await get(server.url + "metrics", { ca: ours, headers: { authorization: "Bearer look" } })).status, 200);
  });

  it("shows out whose token is revoked, and nobody else", async () => {
    const ward = await Connection.open(server.socket + "?token=s3cret", "foxglove.sdk.v1", { ca: ours });
    const eyes = await Connection.open(server.socket + "?token=look", "foxglove.sdk.v1", { ca: ours });
    writeTokens({ eyes: "look" });
    await assert.rejects(ward.complaint, /closed: 1008 this token no longer holds/);
    await assert.rejects(Connection.open(server.socket + "?token=s3cret", "foxglove.sdk.v1", { ca: ours }), /401/);
    await eyes.first("suture/mesh/frame");
    eyes.close();
  });

  it("shows everybody out where the file of tokens is deleted, says so, and lets them in again", async () => {
    const eyes = await Connection.open(server.socket + "?token=look", "foxglove.sdk.v1", { ca: ours });
    rmSync(file("tokens.toml"));
    await assert.rejects(eyes.complaint, /closed: 1008 this token no longer holds/);
    await assert.rejects(Connection.open(server.socket + "?token=look", "foxglove.sdk.v1", { ca: ours }), /401/);
    await server.said("tokens.toml is gone: all tokens are revoked");
    writeTokens({ eyes: "look" });
    while ((await get(server.url + "metrics?token=look", { ca: ours })).status !== 200) await setTimeout(50);
  });

  it("ends as it should beside connections that stay open", async () => {
    const agent = new https.Agent({ keepAlive: true });
    await get(server.url + "healthz", { ca: ours, agent });
    const eyes = await Connection.open(server.socket + "?token=look", "foxglove.sdk.v1", { ca: ours });
    await eyes.first("suture/mesh/frame");
    assert.equal(await server.end(), 0);
    agent.destroy();
    server = undefined;
  });
});

describe("a door that cannot open", { timeout: 120_000 }, () => {
  /** Starts a server of a scene that is not there; its one line, and how it ended. */
  async function refusal(...words) {
    const failed = new Program(program, ["serve", file("no_scene.toml"), ...words]);
    const code = await failed.ended;
    assert.equal(failed.log.trim().split("\n").length, 1, failed.log);
    return { code, text: failed.log };
  }
  const refused = async (code, text, ...words) => {
    const got = await refusal(...words);
    assert.match(got.text, text);
    assert.equal(got.code, code, got.text);
  };

  it("says so before the scene is read, which it tells of where nothing else is wrong", async () => {
    await refused(1, /no_scene\.toml/, "--http", "127.0.0.1:0");
  });

  it("is told: a port that is taken", async () => {
    const taken = createServer().listen(0, "127.0.0.1");
    await once(taken, "listening");
    await refused(4, /cannot listen on 127\.0\.0\.1 port \d+: Address already in use.*--http/, "--http", String(taken.address().port));
    taken.close();
  });

  it("is told: an address of another machine", async () => {
    await refused(4, /cannot listen on 192\.0\.2\.1 port 8443: Cannot assign requested address/, "--http", "192.0.2.1:8443", ...tls, ...tokens);
  });

  it("is told: no numeric address", () => refused(2, /"sutured\.example" is not a numeric address/, "--http", "sutured.example:80", ...tls, ...tokens));

  it("is told: no tokens, or none by TLS, for other machines", async () => {
    await refused(2, /--http 0\.0\.0\.0 would let everybody in.*--http-tokens/, "--http", "0.0.0.0:0", ...tls);
    await refused(2, /--http 0\.0\.0\.0 would send tokens in the clear.*--http-certificate/, "--http", "0.0.0.0:0", ...tokens);
  });

  it("is told: no file of tokens, and a faulty one", async () => {
    await refused(2, /none\.toml: cannot be opened: No such file/, "--http", "0", "--http-tokens", file("none.toml"));
    writeFileSync(file("faulty.toml"), '[[token]]\nname = "a"\nsha256 = "abc"\nrights = []\n');
    await refused(2, /faulty\.toml:1:\d+: "sha256" must be 64 hex digits/, "--http", "0", "--http-tokens", file("faulty.toml"));
  });

  it("is told: no certificate, no key, the key of another", async () => {
    await refused(2, /cannot read the certificate .*none\.crt/, "--http", "0", "--http-certificate", file("none.crt"), "--http-key", file("ours.key"));
    await refused(2, /cannot use the key .*none\.key/, "--http", "0", "--http-certificate", file("ours.crt"), "--http-key", file("none.key"));
    await refused(2, /cannot use the key .*foreign\.key.*mismatch/, "--http", "0", "--http-certificate", file("ours.crt"), "--http-key", file("foreign.key"));
  });

  it("is told: a key that others may read", async () => {
    copyFileSync(file("ours.key"), file("open.key"));
    chmodSync(file("open.key"), 0o644);
    await refused(2, /open\.key is open to every user.*chmod o= /, "--http", "0", "--http-certificate", file("ours.crt"), "--http-key", file("open.key"));
  });

  it("is told: options of a gateway that is off, and a folder that is not there", async () => {
    const off = new Program(program, ["serve", "scene.toml", ...tokens]);
    assert.equal(await off.ended, 2);
    assert.match(off.log, /--http-tokens requires --http/);
    const folderless = new Program(program, ["serve", "scene.toml", "--http", "0", "--http-page", file("no_folder")]);
    assert.equal(await folderless.ended, 2);
    assert.match(folderless.log, /no_folder/);
  });
});
