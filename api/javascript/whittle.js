// A client of the service whittled, for browsers and Node from 18 on, of what both have alone.
//
//     import { Client } from "./whittle.js";
//     const client = new Client("http://127.0.0.1:8080", { token });
//     const cloud = await client.upload(file, { onProgress: (sent, total) => bar(sent / total) });
//     const job = await client.wait(await client.simplify(cloud, { ratio: 0.1, outputs: ["cloud", "mesh"] }));
//     const mesh = await client.mesh(job);                  // mesh.positions, mesh.triangles: typed arrays
//
// What the service refuses is thrown as Problem, whose document is the service's (RFC 9457).  Every call takes a signal
// (AbortSignal) that ends it.
//
// SPDX-License-Identifier: GPL-3.0-or-later

const PIECE_BYTES = 4 << 20;
const TUS = { "Tus-Resumable": "1.0.0" };
const ABSENT = [502, 503, 504]; // what a proxy says while the service behind it isn't there
const ENDED = ["successful", "failed", "dismissed"];

/** What the service refused, or why a job failed. */
export class Problem extends Error {
  constructor(status, document) {
    super(`${status} ${document.detail || document.title || ""}`.trim());
    this.name = "Problem";
    this.status = status;
    this.document = document;
  }
}

async function problemOf(response) {
  const text = await response.text().catch(() => "");
  try {
    const document = JSON.parse(text);
    if (document && typeof document === "object") return new Problem(response.status, document);
  } catch {
    // a proxy's page, for instance
  }
  return new Problem(response.status, { title: text.slice(0, 200) || response.statusText });
}

const sleep = (ms, signal) => new Promise((resolve, reject) => {
  const timer = setTimeout(done, ms);
  function done() {
    signal?.removeEventListener("abort", stop);
    resolve();
  }
  function stop() {
    clearTimeout(timer);
    reject(signal.reason);
  }
  if (signal?.aborted) stop();
  else signal?.addEventListener("abort", stop, { once: true });
});

const pause = (tried, signal) => sleep(100 * 2 ** tried, signal);

/* The same response; alive is called with each piece of its body. */
function watched(response, alive) {
  if (!response.body) return response;
  const watch = new TransformStream({
    transform(piece, to) {
      alive();
      to.enqueue(piece);
    },
  });
  const { status, statusText, headers } = response;
  return new Response(response.body.pipeThrough(watch), { status, statusText, headers });
}

const idOf = (job) => (typeof job === "string" ? job : job.id);

// ---------------------------------------------------------------------------------------------- sources

/* {size, slice(begin, end) -> what fetch takes, close()} of a Blob, of bytes, or in Node of a file's name. */
async function openSource(source) {
  if (typeof Blob !== "undefined" && source instanceof Blob)
    return { size: source.size, slice: (begin, end) => source.slice(begin, end), close() {} };
  if (source instanceof ArrayBuffer || ArrayBuffer.isView(source)) {
    const bytes = source instanceof ArrayBuffer ? new Uint8Array(source)
      : new Uint8Array(source.buffer, source.byteOffset, source.byteLength);
    return { size: bytes.length, slice: (begin, end) => bytes.subarray(begin, end), close() {} };
  }
  if (typeof source !== "string" && !(source instanceof URL))
    throw new TypeError("upload takes a Blob, a File, bytes, or in Node the name of a file");
  const files = "node:fs/promises"; // a name, so that bundlers for browsers leave it alone
  const { open } = await import(files);
  const file = await open(source, "r");
  return {
    size: (await file.stat()).size,
    async slice(begin, end) {
      const piece = new Uint8Array(end - begin);
      let have = 0;
      while (have < piece.length) {
        const { bytesRead } = await file.read(piece, have, piece.length - have, begin + have);
        if (!bytesRead) throw new Error(`${source} has become shorter`);
        have += bytesRead;
      }
      return piece;
    },
    close: () => file.close(),
  };
}

// ---------------------------------------------------------------------------------------------- the client

export class Client {
  #base;
  #token;
  #retries;
  #timeout;
  #fetch;
  #piece;

  constructor(url, { token, retries = 5, timeout = 60000, pieceBytes = PIECE_BYTES, fetch } = {}) {
    this.#base = new URL(url, globalThis.location?.href);
    this.#token = token;
    this.#retries = retries;
    this.#timeout = timeout;
    this.#piece = pieceBytes;
    this.#fetch = fetch ?? globalThis.fetch.bind(globalThis);
  }

  /* Of a path of the service, or of a link that it gave, which has the base's path already. */
  #url(path) {
    const base = this.#base.pathname.replace(/\/$/, "");
    const given = /^[a-z]+:\/\//i.test(path);
    return new URL(given || (base && path.startsWith(`${base}/`)) ? path : base + path, this.#base);
  }

  /* One exchange, in which something comes every `timeout` ms at least; take(response) reads it. */
  async #exchange(method, path, { headers, body, signal } = {}, take = (response) => response) {
    const url = this.#url(path);
    const sent = new Headers(headers);
    if (this.#token && url.origin === this.#base.origin) sent.set("Authorization", `Bearer ${this.#token}`);
    const own = new AbortController();
    const stop = () => own.abort(signal.reason);
    if (signal?.aborted) stop();
    else signal?.addEventListener("abort", stop, { once: true });
    let timer;
    const alive = () => {
      clearTimeout(timer);
      timer = setTimeout(() => own.abort(new Error(`no reply from ${url} for ${this.#timeout} ms`)), this.#timeout);
    };
    try {
      alive();
      const response = watched(await this.#fetch(url, { method, headers: sent, body, signal: own.signal }), alive);
      if (response.status >= 400) throw await problemOf(response);
      return await take(response);
    } catch (error) {
      throw own.signal.aborted && !(error instanceof Problem) ? own.signal.reason : error;
    } finally {
      clearTimeout(timer);
      signal?.removeEventListener("abort", stop);
    }
  }

  /** One exchange; throws Problem from 400 on.  What only reads is tried again where a connection breaks, and where a
   *  proxy doesn't reach the service. */
  async request(method, path, options = {}, take = undefined) {
    const retries = method === "GET" || method === "HEAD" ? this.#retries : 0;
    for (let tried = 0; ; tried++) {
      try {
        return await this.#exchange(method, path, options, take);
      } catch (error) {
        const passes = !(error instanceof Problem) || ABSENT.includes(error.status);
        if (!passes || error instanceof NoUpload || options.signal?.aborted || tried >= retries) throw error;
        await pause(tried, options.signal);
      }
    }
  }

  #document(method, path, value, { signal, headers } = {}) {
    const body = value === undefined ? undefined : JSON.stringify(value);
    const type = body === undefined ? {} : { "Content-Type": "application/json" };
    return this.request(method, path, { body, signal, headers: { ...type, ...headers } }, (r) => r.json());
  }

  // -------------------------------------------------------------------------------------------- clouds

  /* How much of an upload is there, and the cloud that came of it. */
  async #offset(location, signal) {
    return this.request("HEAD", location, { headers: TUS, signal }, stateOf);
  }

  /* The same after a piece; failed: what went wrong, and may pass. */
  async #sendPiece(location, body, offset, signal) {
    const headers = { ...TUS, "Upload-Offset": String(offset), "Content-Type": "application/offset+octet-stream" };
    try {
      return await this.request("PATCH", location, { headers, body, signal }, stateOf);
    } catch (failed) {
      const passes = [...ABSENT, 409, 423]; // the last two: a connection that is dead still has it
      if (signal?.aborted || failed instanceof NoUpload) throw failed;
      if (failed instanceof Problem && !passes.includes(failed.status)) throw failed;
      return { sent: offset, cloud: null, failed };
    }
  }

  /** Uploads a cloud piece by piece and returns its id.  A connection that breaks is taken up again; onStarted tells the
   *  upload's URL, with which resume goes on in another run. */
  async upload(source, { onProgress, onStarted, resume, signal } = {}) {
    const from = await openSource(source);
    try {
      const headers = { ...TUS, "Upload-Length": String(from.size) };
      const location = resume ?? await this.request("POST", "/v1/uploads", { headers, signal },
        (response) => response.headers.get("Location"));
      onStarted?.(this.#url(location).href);
      let state = await this.#offset(location, signal);
      for (let tried = 0, most = -1; ;) {
        onProgress?.(state.sent, from.size);
        if (state.cloud) return state.cloud;
        if (state.sent >= from.size)
          throw new Error("the source has changed: the upload is whole, and no cloud came of it");
        if (state.sent > most) [tried, most] = [0, state.sent];
        const piece = await from.slice(state.sent, Math.min(state.sent + this.#piece, from.size));
        state = await this.#sendPiece(location, piece, state.sent, signal);
        if (state.sent > most || state.cloud) continue;
        if (tried >= this.#retries) throw state.failed ?? new Error(`${location}: the service keeps nothing of what it is sent`);
        await pause(tried++, signal);
        state = await this.#offset(location, signal);
      }
    } finally {
      await from.close();
    }
  }

  /** The documents of the clouds that you have uploaded, newest first; a page of them. */
  async clouds(options) {
    return (await this.#document("GET", "/v1/clouds", undefined, options)).clouds;
  }

  // -------------------------------------------------------------------------------------------- jobs

  #cloud(cloud, signal) {
    return /^[0-9a-f]{64}$/.test(cloud) ? cloud : this.upload(cloud, { signal });
  }

  /** Submits a job for a cloud (an id of upload, or what upload takes), or for a list of clouds that are one. */
  async simplify(cloud, params = {}, { label, priority, webhook, signal } = {}) {
    const ids = [];
    for (const each of Array.isArray(cloud) ? cloud : [cloud]) ids.push(await this.#cloud(each, signal));
    const join = ids.length > 1 ? ids.slice(1).map((id) => `/v1/clouds/${id}`) : undefined;
    return this.#document("POST", `/v1/clouds/${ids[0]}/jobs`, { params, join, label, priority, webhook }, { signal });
  }

  /** Submits a job for each of these clouds, all or none, with one webhook; the jobs of the batch that comes back stand in
   *  the order of the clouds. */
  async batch(clouds, params = {}, { label, priority, webhook, signal } = {}) {
    const paths = [];
    for (const each of clouds) paths.push(`/v1/clouds/${await this.#cloud(each, signal)}`);
    return this.#document("POST", "/v1/batches", { clouds: paths, params, label, priority, webhook }, { signal });
  }

  /** The document of a batch all of whose jobs have ended, however they have. */
  waitBatch(batch, { onProgress, signal } = {}) {
    return this.#wait(`/v1/batches/${idOf(batch)}`, onProgress, signal);
  }

  /** Ends all jobs of a batch; where all have ended, deletes them. */
  cancelBatch(batch, options) {
    return this.#document("DELETE", `/v1/batches/${idOf(batch)}`, undefined, options);
  }

  /** The document of a job, by its id or an older document. */
  job(job, options) {
    return this.#document("GET", `/v1/jobs/${idOf(job)}`, undefined, options);
  }

  /** The documents of your jobs, newest first; a page of them. */
  async jobs({ status, label, limit, after, signal } = {}) {
    const query = new URLSearchParams();
    for (const [name, value] of Object.entries({ status, label, limit, after }))
      if (value !== undefined) query.set(name, value);
    return (await this.#document("GET", `/v1/jobs${query.size || String(query) ? `?${query}` : ""}`, undefined,
      { signal })).jobs;
  }

  /** The document of a job that has ended; onProgress is given it whenever it was read.  Throws Problem where it failed;
   *  to end the waiting, abort the signal. */
  async wait(job, { onProgress, signal } = {}) {
    const read = await this.#wait(`/v1/jobs/${idOf(job)}`, onProgress, signal);
    if (read.status === "failed") {
      const problem = read.problem ?? { title: "the job failed" };
      throw new Problem(problem.status ?? 500, problem);
    }
    return read;
  }

  /* The document at a path when it has ended. */
  async #wait(path, onProgress, signal) {
    const patience = Math.max(1, Math.min(20, Math.floor(this.#timeout / 2000)));
    for (let etag; ;) {
      const headers = { Prefer: `wait=${patience}`, ...(etag ? { "If-None-Match": etag } : {}) };
      const read = await this.request("GET", path, { headers, signal }, async (response) => {
        if (response.status === 304) return null;
        etag = response.headers.get("ETag");
        return response.json();
      });
      if (!read) continue;
      onProgress?.(read);
      if (ENDED.includes(read.status)) return read;
    }
  }

  /** Ends a job that waits or runs; returns its document.  One that has ended is deleted, with its outputs. */
  cancel(job, options) {
    return this.#document("DELETE", `/v1/jobs/${idOf(job)}`, undefined, options);
  }

  // -------------------------------------------------------------------------------------------- outputs

  /** Where an output is: points or ratio ask for the coarser cloud. */
  outputUrl(job, name, { points, ratio } = {}) {
    const url = this.#url(`/v1/jobs/${idOf(job)}/outputs/${encodeURIComponent(name)}`);
    if (points !== undefined) url.searchParams.set("points", points);
    if (ratio !== undefined) url.searchParams.set("ratio", ratio);
    return url.href;
  }

  /** The bytes of an output. */
  output(job, name, { points, ratio, signal } = {}) {
    return this.request("GET", this.outputUrl(job, name, { points, ratio }), { signal }, (r) => r.arrayBuffer());
  }

  /** The points of a PLY output, and their attributes. */
  async points(job, { name = "cloud.ply", ...options } = {}) {
    return readPly(await this.output(job, name, options));
  }

  /** The same of a mesh, with triangles. */
  async mesh(job, { name = "mesh.ply", ...options } = {}) {
    return readPly(await this.output(job, name, options));
  }
}

class NoUpload extends Error {}

function stateOf(response) {
  const cloud = response.headers.get("Whittle-Cloud"), offset = response.headers.get("Upload-Offset");
  if (!/^\d+$/.test(offset ?? "")) throw new NoUpload("the reply has no Upload-Offset, so this is no upload of the service's");
  return { sent: Number(offset), cloud: cloud ? cloud.split("/").pop() : null };
}

// ---------------------------------------------------------------------------------------------- PLY

const TYPES = {
  char: [1, Int8Array, "getInt8"], uchar: [1, Uint8Array, "getUint8"], short: [2, Int16Array, "getInt16"],
  ushort: [2, Uint16Array, "getUint16"], int: [4, Int32Array, "getInt32"], uint: [4, Uint32Array, "getUint32"],
  float: [4, Float32Array, "getFloat32"], double: [8, Float64Array, "getFloat64"],
};
for (const [name, type] of [["int8", "char"], ["uint8", "uchar"], ["int16", "short"], ["uint16", "ushort"],
  ["int32", "int"], ["uint32", "uint"], ["float32", "float"], ["float64", "double"]]) TYPES[name] = TYPES[type];

function readHeader(bytes) {
  const head = new TextDecoder("latin1").decode(bytes.subarray(0, 65536));
  const end = head.indexOf("end_header\n");
  if (!head.startsWith("ply") || end < 0) throw new Error("this is no PLY file");
  const elements = [];
  for (const [word, ...rest] of head.slice(0, end).split("\n").map((line) => line.trim().split(/\s+/))) {
    if (word === "format" && rest[0] !== "binary_little_endian")
      throw new Error(`PLY ${rest[0]} isn't read here; encoding=binary writes what is`);
    if (word === "element") elements.push({ name: rest[0], count: Number(rest[1]), properties: [] });
    if (word === "property")
      elements.at(-1).properties.push(rest[0] === "list" ? { name: rest[3], counts: TYPES[rest[1]], type: TYPES[rest[2]] }
        : { name: rest[1], type: TYPES[rest[0]] });
  }
  return { elements, begin: end + "end_header\n".length };
}

/* Faces of any number of corners become fans of triangles. */
function pushFace(view, at, { type: [size, , get] }, corners, triangles) {
  const corner = (k) => view[get](at + k * size, true);
  for (let k = 2; k < corners; k++) triangles.push(corner(0), corner(k - 1), corner(k));
}

/** A binary PLY file as typed arrays: count, positions (x, y, z of each, as float64 where the file has that, else
 *  float32), attributes (an array for each other property of a vertex), triangles (three ids of each). */
export function readPly(buffer) {
  const bytes = buffer instanceof Uint8Array ? buffer : new Uint8Array(buffer);
  const { elements, begin } = readHeader(bytes);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const result = { count: 0, positions: new Float32Array(0), attributes: {}, triangles: new Uint32Array(0) };
  let at = begin;
  for (const { name, count, properties } of elements) {
    const vertex = name === "vertex", triangles = [];
    const columns = properties.map((p) => (vertex && !p.counts ? new p.type[1](count) : null));
    for (let i = 0; i < count; i++)
      properties.forEach((p, j) => {
        if (p.counts) {
          const corners = view[p.counts[2]](at, true);
          at += p.counts[0];
          if (name === "face" && /^vertex_ind/.test(p.name)) pushFace(view, at, p, corners, triangles);
          at += corners * p.type[0];
        } else {
          if (columns[j]) columns[j][i] = view[p.type[2]](at, true);
          at += p.type[0];
        }
      });
    if (vertex) Object.assign(result, { count }, arrange(count, properties, columns));
    if (name === "face") result.triangles = Uint32Array.from(triangles);
  }
  return result;
}

function arrange(count, properties, columns) {
  const attributes = {};
  properties.forEach(({ name }, j) => {
    if (columns[j]) attributes[name] = columns[j];
  });
  const axes = ["x", "y", "z"].map((axis) => attributes[axis]);
  const Positions = axes.every((axis) => axis instanceof Float32Array) ? Float32Array : Float64Array;
  const positions = new Positions(3 * count);
  for (let i = 0; i < count; i++) for (let k = 0; k < 3; k++) positions[3 * i + k] = axes[k][i];
  for (const axis of ["x", "y", "z"]) delete attributes[axis];
  return { positions, attributes };
}
