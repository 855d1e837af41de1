// SPDX-License-Identifier: GPL-3.0-or-later
// Requests to the service that this page came from, with the token where one was given.

export const base = document.querySelector('meta[name="base"]').content;

const KEY = `whittled-token${base}`; // kept until the tab is closed

export const token = () => sessionStorage.getItem(KEY) ?? "";

export function setToken(value) {
  if (value) sessionStorage.setItem(KEY, value);
  else sessionStorage.removeItem(KEY);
}

export const authorization = () => (token() ? { Authorization: `Bearer ${token()}` } : {});

// What went wrong, as the service says it (RFC 9457).
export class Problem extends Error {
  constructor(status, document) {
    super(document.detail || document.title || `status ${status}`);
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

// path begins with /v1; links of documents have the base path already and are given as they are.
export async function ask(path, { headers = {}, ...options } = {}) {
  const url = base && path.startsWith(`${base}/`) ? path : base + path;
  const reply = await fetch(url, { ...options, headers: { ...authorization(), ...headers }, credentials: "omit" });
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
