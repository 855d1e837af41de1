// SPDX-License-Identifier: GPL-3.0-or-later
// Requests to the service that this page came from, with the token where one was given.

export const base = document.querySelector('meta[name="base"]').content;

const KEY = `whittled-token${base}`; // kept until the tab is closed

let kept = null; // where the browser keeps nothing: until the page is closed

export function token() {
  try {
    return kept ?? sessionStorage.getItem(KEY) ?? "";
  } catch {
    return "";
  }
}

export function setToken(value) {
  kept = null;
  try {
    if (value) sessionStorage.setItem(KEY, value);
    else sessionStorage.removeItem(KEY);
  } catch {
    kept = value;
  }
}

export const authorization = () => (token() ? { Authorization: `Bearer ${token()}` } : {});

// What went wrong, as the service says it (RFC 9457).
export class Problem extends Error {
  constructor(status, document) {
    super([document.detail || document.title || `status ${status}`, adviceOn(document)].filter(Boolean).map((text) => text.replace(/[^.!?]$/, "$&.")).join(" "));
    this.status = status;
    this.document = document;
  }

  static async of(reply) {
    let document = {};
    try {
      document = JSON.parse(await reply.text());
    } catch {
      document = { title: reply.statusText };
    }
    return new Problem(reply.status, document);
  }
}

// No answer came at all.
export class Unreachable extends Error {
  constructor() {
    super("The service doesn't answer. Is it running, and is this device online?");
  }
}

// What a person can do about a problem, beyond what it says itself.
const ADVICE = {
  "storage-full": "The service's disk is full: delete jobs that nobody needs any more, or ask its operator for room.",
  "rate-limited": "This is a limit of the service for each user: delete jobs and clouds that you don't need any more, then try again.",
  "body-too-large": "Compress the file, or cut it into parts.", "too-many-points": "Cut the cloud into parts.",
  "unsupported-format": "Save it as PLY, LAS, LAZ, E57 or text and drop that.",
  "malformed-cloud": "Is it a point cloud, and whole? Save it again from the program that made it.",
  "degenerate-cloud": "A mesh needs at least four points that aren't all on one line, a closed mesh such that aren't all on one plane. Without a mesh, fewer will do.",
  "would-exceed-memory": "Keep fewer points, or make points without a mesh.", "out-of-memory": "Keep fewer points, or make points without a mesh.",
  "time-limit": "Keep fewer points, or make points without a mesh.",
  "engine-error": "This is a fault of the service: its log, below, helps whoever mends it.",
  "worker-crashed": "This is a fault of the service: its log, below, helps whoever mends it.",
  "queue-full": "Try again in a while.", draining: "Try again in a minute.", "not-ready": "Try again in a minute.", "too-many-uploads": "Try again in a while.",
  forbidden: "Ask the service's operator for a token that may do this.", "no-such-cloud": "The file was deleted meanwhile; drop it again.",
  "no-such-job": "It was deleted, it has expired, or it belongs to another token.", "job-gone": "Its files are no more; drop the scan again.",
};

// Whether it is about the columns of a text, which can be named.
export const isOfColumns = (problem) => /parameter columns/.test(problem?.detail);

export const adviceOn = (problem) => (isOfColumns(problem) ? "Name its columns under “Change parameters”."
  : ADVICE[problem?.type?.split("/").pop()] ?? "");

// path begins with /v1; links of documents have the base path already and are given as they are.
export async function ask(path, { headers = {}, ...options } = {}) {
  const url = base && path.startsWith(`${base}/`) ? path : base + path;
  const reply = await fetch(url, { ...options, headers: { ...authorization(), ...headers }, credentials: "omit" }).catch((error) => {
    throw error.name === "AbortError" ? error : new Unreachable();
  });
  if (!reply.ok) {
    const problem = await Problem.of(reply);
    if (reply.status === 401) document.dispatchEvent(new CustomEvent("token-wanted"));
    throw problem;
  }
  return reply;
}

export const askJson = async (path, options) => (await ask(path, options)).json();

export const sendJson = (path, value) => askJson(path, {
  method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value),
});

// A job's news, one object each, until it has ended; signal ends it earlier.
export async function* events(id, signal) {
  const reply = await ask(`/v1/jobs/${id}/events`, { signal });
  const reader = reply.body.pipeThrough(new TextDecoderStream()).getReader();
  for (let rest = ""; ;) {
    const { value, done } = await reader.read();
    if (done) return;
    const blocks = (rest + value).split(/\r?\n\r?\n/);
    rest = blocks.pop();
    for (const block of blocks) {
      const lines = block.split(/\r?\n/);
      const kind = lines.find((line) => line.startsWith("event: "))?.slice(7);
      const data = lines.filter((line) => line.startsWith("data: ")).map((line) => line.slice(6)).join("\n");
      if (kind && data) yield { kind, ...JSON.parse(data) };
    }
  }
}
