// Calls a service by api/javascript/whittle.js: node javascript_client.mjs URL FOLDER.  FOLDER has ball.xyz, 300 points
// of a unit sphere; what is wrong is thrown.
//
// SPDX-License-Identifier: GPL-3.0-or-later
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { Client, Problem, readPly } from "../../api/javascript/whittle.js";

const [url, folder] = process.argv.slice(2);
const path = join(folder, "ball.xyz");
const bytes = await readFile(path);

const tests = {
  async "a cloud comes and its outputs go"() {
    const client = new Client(url, { pieceBytes: 5000 });
    const told = [], seen = [];
    const cloud = await client.upload(path, { onProgress: (...at) => told.push(at) });
    assert.match(cloud, /^[0-9a-f]{64}$/);
    assert.deepEqual(told[0], [0, bytes.length]);
    assert.deepEqual(told.at(-1), [bytes.length, bytes.length]);
    assert(told.length > 2 && told.every(([sent], i) => i === 0 || sent > told[i - 1][0]));
    const submitted = await client.simplify(cloud, { ratio: 0.5, outputs: ["cloud", "mesh"] }, { label: "ball" });
    const job = await client.wait(submitted, { onProgress: (document) => seen.push(document.status) });
    assert.equal(job.status, "successful");
    assert.equal(job.label, "ball");
    assert.equal(seen.at(-1), "successful");
    assert.equal((await client.clouds())[0].id, cloud);
    assert((await client.jobs({ label: "ball" })).some((each) => each.id === job.id));

    const points = await client.points(job);
    assert.equal(points.count, 150);
    assert.equal(points.positions.length, 450);
    for (let i = 0; i < 150; i++) assert(Math.abs(Math.hypot(...points.positions.subarray(3 * i, 3 * i + 3)) - 1) < 1e-4);
    assert.deepEqual((await client.points(job, { points: 7 })).positions, points.positions.slice(0, 21));
    const mesh = await client.mesh(job);
    assert.equal(mesh.triangles.length, 3 * (2 * mesh.count - 4)); // of a closed surface without handles
    assert(mesh.triangles.every((id) => id < mesh.count));
    assert.deepEqual(readPly(await client.output(job, "mesh.ply")), mesh);
    assert.equal((await fetch(client.outputUrl(job, "cloud.ply", { ratio: 0.1 }))).status, 200);
  },

  async "blobs and bytes are sources, and lists of clouds are one"() {
    const client = new Client(url);
    const half = bytes.indexOf("\n", bytes.length / 2) + 1;
    const whole = await client.upload(new Blob([bytes]));
    assert.equal(whole, await client.upload(new Uint8Array(bytes)));
    assert.equal(whole, await client.upload(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length)));
    const one = await client.wait(await client.simplify(whole, { ratio: 0.3 }));
    const two = await client.wait(await client.simplify([bytes.subarray(0, half), bytes.subarray(half)], { ratio: 0.3 }));
    assert.deepEqual(await client.output(two, "cloud.ply"), await client.output(one, "cloud.ply"));
    await assert.rejects(client.upload({ some: "thing" }), TypeError);
  },

  async "what a proxy says in between holds up neither upload nor reading"() {
    const count = { POST: 0, HEAD: 0, PATCH: 0, GET: 0 };
    const client = new Client(url, { pieceBytes: 5000, fetch: (at, options) => {
      const { method } = options, every_second = ++count[method] % 2 && method !== "POST";
      const status = method === "PATCH" ? [502, 409, 423][count[method] % 3] : 503;
      return every_second ? new Response(method === "HEAD" ? null : "Bad Gateway", { status }) : fetch(at, options);
    } });
    assert.match(await client.upload(bytes), /^[0-9a-f]{64}$/);
    assert((await client.clouds()).length > 0 && count.PATCH > bytes.length / 2500);
  },

  async "an upload of which nothing is kept ends"() {
    for (const [offset, tries] of [["0", 3], [null, 1], ["-1", 1], ["much", 1]]) {
      let pieces = 0;
      const client = new Client(url, { retries: 2, fetch: async (_, { method }) => {
        pieces += method === "PATCH";
        if (pieces > 50) throw new Problem(500, { title: "endless" });
        const state = method === "HEAD" ? "0" : offset;
        return new Response(null, { status: 204, headers: { Location: "/v1/uploads/1", ...(state && { "Upload-Offset": state }) } });
      } });
      await assert.rejects(client.upload(bytes), (error) => !(error instanceof Problem));
      assert.equal(pieces, tries, offset);
    }
  },

  async "a reply may take as long as something comes of it"() {
    const { setTimeout: realSet, clearTimeout: realClear } = globalThis, timers = new Map();
    let now = 0, last = 0;
    const advance = (ms) => {
      now += ms;
      for (const [id, [due, call]] of timers) if (due <= now && timers.delete(id)) call();
    };
    const slow = (pauses) => async (_, { signal }) => new Response(new ReadableStream({
      start: (to) => signal.addEventListener("abort", () => to.error(signal.reason)),
      pull(to) {
        if (!pauses.length) return to.close();
        advance(pauses.shift());
        if (!signal.aborted) to.enqueue(new Uint8Array(10));
      },
    }, { highWaterMark: 0 }));
    globalThis.setTimeout = (call, ms) => timers.set(++last, [now + ms, call]) && last;
    globalThis.clearTimeout = (id) => timers.delete(id);
    try {
      const client = (pauses) => new Client(url, { retries: 0, timeout: 60000, fetch: slow(pauses) });
      assert.equal((await client([40000, 40000, 40000]).output("a", "b")).byteLength, 30);
      await assert.rejects(client([40000, 70000, 1]).output("a", "b"), /no reply from .* for 60000 ms/);
    } finally {
      Object.assign(globalThis, { setTimeout: realSet, clearTimeout: realClear });
    }
    assert.equal(timers.size, 0);
  },

  async "a batch is a job for each cloud"() {
    const client = new Client(url), seen = [];
    const half = bytes.indexOf("\n", bytes.length / 2) + 1;
    const batch = await client.batch([bytes.subarray(0, half), bytes.subarray(half)], { ratio: 0.4 }, { label: "halves" });
    const ended = await client.waitBatch(batch, { onProgress: ({ progress }) => seen.push(progress) });
    assert.equal(ended.status, "successful");
    assert.deepEqual([ended.label, ended.counts.successful, seen.at(-1)], ["halves", 2, 100]);
    assert.equal((await client.points(ended.jobs[1])).count, (await client.job(ended.jobs[1])).report.points_out);
    assert.equal((await client.cancelBatch(batch)).id, batch.id);
    await assert.rejects(client.waitBatch(batch), (error) => error.document.type.endsWith("no-such-batch"));
  },

  async "an upload goes on where its connection broke, and in another run"() {
    let breaks = 0, location;
    const breaking = async (target, options) => { // the request arrives, and its reply doesn't
      const reply = await fetch(target, options);
      if (options.method !== "PATCH" || ++breaks % 2 === 0) return reply;
      await reply.arrayBuffer();
      throw new TypeError("fetch failed");
    };
    const client = new Client(url, { fetch: breaking, pieceBytes: 3000 });
    const cloud = await client.upload(bytes);
    assert(breaks > 2);
    const stop = new AbortController();
    const other = bytes.subarray(0, bytes.lastIndexOf("\n", bytes.length - 2) + 1);
    await assert.rejects(client.upload(other, {
      onStarted: (at) => { location = at; },
      onProgress: (sent) => { if (sent > 4000) stop.abort(new Error("enough")); },
      signal: stop.signal,
    }), /enough/);
    const told = [];
    const resumed = await client.upload(other, { resume: location, onProgress: (sent) => told.push(sent) });
    assert(told[0] > 4000);
    assert.notEqual(resumed, cloud);
  },

  async "what breaks for good is told"() {
    const dead = new Client(url, { retries: 1, fetch: async () => { throw new TypeError("fetch failed"); } });
    await assert.rejects(dead.job("01900000-0000-7000-8000-000000000000"), /fetch failed/);
    const silent = new Client(url, {
      retries: 0, timeout: 50,
      fetch: (target, { signal }) => new Promise((resolve, reject) => {
        signal.addEventListener("abort", () => reject(signal.reason));
      }),
    });
    await assert.rejects(silent.clouds(), /no reply from/);
  },

  async "problems carry their document"() {
    const client = new Client(url);
    for (const [call, status, slug] of [
      [() => client.simplify(bytes, { ratio: 7 }), 400, "invalid-parameter"],
      [() => client.simplify("0".repeat(64)), 404, "no-such-cloud"],
      [() => client.upload(new Uint8Array([0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10, 0, 0])), 415, "unsupported-format"],
      [() => client.output("01900000-0000-7000-8000-000000000000", "a"), 404, "no-such-job"],
    ]) await assert.rejects(call(), (error) => error instanceof Problem && error.status === status &&
      error.document.type.endsWith(slug) && error.message.includes(error.document.detail));
    const flat = await client.simplify(Buffer.from("0 0 0\n1 0 0\n0 1 0\n1 1 0\n"), { outputs: ["mesh"], surface: "closed" });
    await assert.rejects(client.wait(flat), (error) => error instanceof Problem && error.document.type.endsWith("degenerate-cloud"));
  },

  async "a job is cancelled, and one that has ended deleted"() {
    const client = new Client(url);
    const job = await client.wait(await client.simplify(bytes, { ratio: 0.2 }));
    assert.equal((await client.cancel(job)).id, job.id);
    await assert.rejects(client.job(job), (error) => error.status === 410);
    const aborted = AbortSignal.abort(new Error("not now"));
    await assert.rejects(client.clouds({ signal: aborted }), /not now/);
  },

  async "PLY of other types, with quads"() {
    const head = "ply\nformat binary_little_endian 1.0\ncomment x\nelement vertex 4\nproperty double x\nproperty float y\n" +
      "property double z\nproperty uchar red\nproperty list uchar short of\nelement face 1\n" +
      "property list uchar int vertex_indices\nend_header\n";
    const body = Buffer.alloc(4 * 24 + 17);
    for (let i = 0; i < 4; i++) {
      body.writeDoubleLE(i + 0.1, 24 * i);
      body.writeFloatLE(2 * i, 24 * i + 8);
      body.writeDoubleLE(-i, 24 * i + 12);
      body.writeUInt8(250 + i, 24 * i + 20);
      body.writeUInt8(1, 24 * i + 21);
    }
    body.writeUInt8(4, 96);
    for (let k = 0; k < 4; k++) body.writeInt32LE(k, 97 + 4 * k);
    const ply = readPly(Buffer.concat([Buffer.from(head), body]));
    assert.deepEqual([...ply.positions], [0.1, 0, -0, 1.1, 2, -1, 2.1, 4, -2, 3.1, 6, -3]);
    assert(ply.positions instanceof Float64Array);
    assert.deepEqual(ply.attributes, { red: Uint8Array.of(250, 251, 252, 253) });
    assert.deepEqual([...ply.triangles], [0, 1, 2, 0, 2, 3]);
    assert.throws(() => readPly(Buffer.from("ply\nformat ascii 1.0\nend_header\n")), /encoding=binary/);
    assert.throws(() => readPly(Buffer.from("solid")), /no PLY/);
  },
};

for (const [name, test] of Object.entries(tests)) {
  await test();
  console.log(name);
}
