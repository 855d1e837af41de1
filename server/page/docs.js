// SPDX-License-Identifier: GPL-3.0-or-later
// The reference at /docs: tries each operation out.  What is sent is what the line above it says, and may be changed.
const base = location.pathname.replace(/\/docs$/, ""), KEY = `whittled-token${base}`; // the token of server/page/api.js
const MOST_SHOWN = 20000; // characters of an answer
const known = {}; // the ids that were answered last: of jobs, clouds, uploads

const make = (name, attributes = {}, ...children) => {
  const element = Object.assign(document.createElement(name), attributes);
  element.append(...children);
  return element;
};

const spec = await (await fetch(`${base}/openapi.json`)).json();
const resolve = (node) => (node.$ref ? node.$ref.split("/").slice(1).reduce((at, name) => at[name], spec) : node);

// What is in the line for a shell above: the address below the base path, and its headers.
function lineOf(heading) {
  const line = heading.parentElement.querySelector(`#${heading.id} ~ pre`).textContent, address = / '(?:https?:\/\/)?[^/']*(\/[^']*)'$/.exec(line)[1];
  return { address: address.slice(base.length), headers: [...line.matchAll(/ -H '([^:]+): ([^']*)'/g)].map((each) => each.slice(1)),
    document: / --json '(.*?)' '/.exec(line)?.[1], file: / -T /.test(line) };
}

// Ids of the examples give way to those that were answered.
const withKnown = (address) => address.replace(/\/v1\/(jobs|clouds|uploads)\/[^/?]+/, (whole, kind) => (known[kind] ? `/v1/${kind}/${known[kind]}` : whole));

function learn(address, text) {
  try {
    const { id } = JSON.parse(text), kind = /^\/v1\/(?:clouds\/[^/]+\/)?(jobs|clouds|uploads)/.exec(address)?.[1];
    if (id && kind) known[kind] = id;
  } catch {
    // no JSON names nothing
  }
}

async function send(method, { address, file, document: body, headers }, token, shown, signal) {
  const reply = await fetch(base + address, { method, signal, credentials: "omit", body: file ?? body,
    headers: [...headers, ...(body ? [["Content-Type", "application/json"]] : []), ...(token ? [["Authorization", `Bearer ${token}`]] : [])] });
  const type = reply.headers.get("Content-Type") ?? "", said = [...reply.headers].map(([name, value]) => `${name}: ${value}`).join("\n");
  shown.replaceChildren(make("p", {}, make("strong", {}, `${reply.status} ${reply.statusText}`)), make("pre", { tabIndex: 0 }, said));
  if (/json|text|^$/.test(type)) {
    const text = await reply.text();
    learn(address, text);
    let plain = text;
    try {
      plain = JSON.stringify(JSON.parse(text), null, 2);
    } catch {
      // as it is
    }
    if (plain) shown.append(make("pre", { tabIndex: 0 }, plain.length > MOST_SHOWN ? `${plain.slice(0, MOST_SHOWN)}\n...` : plain));
  } else {
    const blob = await reply.blob(), name = /filename="([^"]+)"/.exec(reply.headers.get("Content-Disposition"))?.[1] ?? address.split("?")[0].split("/").pop();
    shown.append(make("p", {}, make("a", { href: URL.createObjectURL(blob), download: name }, `Save ${name}, ${blob.size} bytes`)));
  }
}

function formOf(heading, method, details) {
  const line = lineOf(heading), shown = make("div", { ariaLive: "polite" }), id = (part) => `try-${heading.id}-${part}`;
  const field = (part, text, input) => [make("label", { htmlFor: id(part) }, text), Object.assign(input, { id: id(part) })];
  const address = make("input", { value: withKnown(line.address), spellcheck: false }), token = make("input", { type: "password", autocomplete: "off", value: sessionStorage.getItem(KEY) ?? "" });
  const file = line.file ? make("input", { type: "file" }) : null, text = line.document ? make("textarea", { value: line.document, rows: 4, spellcheck: false }) : null;
  let stop = null;
  const form = make("form", { onsubmit: async (event) => {
    event.preventDefault();
    stop?.abort();
    stop = new AbortController();
    shown.textContent = "Sent ...";
    const sent = file?.files[0];
    const headers = line.headers.map(([name, value]) => [name, name === "Upload-Length" && sent ? String(sent.size) : value]);
    await send(method, { address: address.value, file: sent, document: text?.value, headers }, token.value.trim(), shown, stop.signal)
      .catch((error) => error.name !== "AbortError" && (shown.textContent = "The service doesn't answer."));
  } }, ...field("path", "Path, below the service's address", address), ...(file ? field("file", "File", file) : []),
  ...(text ? field("body", "Document", text) : []), ...field("token", "Token, where the service wants one", token), make("button", {}, `Send ${method}`), shown);
  details.append(form);
  details.addEventListener("toggle", () => details.open && (address.value = withKnown(address.value)));
}

for (const item of Object.values(spec.paths)) {
  for (const [method, operation] of Object.entries(resolve(item))) {
    const heading = document.getElementById(operation.operationId);
    if (!heading) continue;
    const details = make("details", { className: "try" }, make("summary", {}, "Try it"));
    details.addEventListener("toggle", () => details.open && formOf(heading, method.toUpperCase(), details), { once: true });
    heading.parentElement.querySelector(`#${heading.id} ~ pre`).after(details);
  }
}
document.documentElement.dataset.ready = true; // for tests
