// SPDX-License-Identifier: GPL-3.0-or-later
// Puts the page together: gives each file a name with a hash of its content, writes those names wherever another file
// names it, packs it by gzip, and lists all for the compiler.
//
// Usage: node build.mjs SOURCE OUT      (npm ci has run in SOURCE)
//
// In sources, "./name.js" is a file beside them, "three" and "tus-js-client" are those of npm, and page/name in
// index.html is a file of the page.
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

const VENDOR = {
  three: "node_modules/three/build/three.module.min.js",
  "tus-js-client": "node_modules/tus-js-client/dist/tus.min.js",
};
const TYPES = { js: "text/javascript; charset=utf-8", css: "text/css; charset=utf-8" };

const [source, out] = process.argv.slice(2);
rmSync(out, { recursive: true, force: true });
mkdirSync(out, { recursive: true });
const made = []; // { name, type, path }
const named = new Map(); // name in sources -> name with hash

function put(name, text) {
  const [, stem, extension] = /^(.*)\.(\w+)$/.exec(name);
  const hash = createHash("sha256").update(text).digest("hex").slice(0, 16);
  const path = join(out, `${stem}-${hash}.${extension}`);
  writeFileSync(path, text);
  writeFileSync(`${path}.gz`, gzipSync(text, { level: 9 }));
  made.push({ name: `${stem}-${hash}.${extension}`, type: TYPES[extension], path });
  return `${stem}-${hash}.${extension}`;
}

// A module, after those that it names.
function putModule(name, within = []) {
  if (named.has(name)) return named.get(name);
  if (within.includes(name)) throw new Error(`modules name each other: ${[...within, name].join(", ")}`);
  const vendor = VENDOR[name];
  const text = readFileSync(join(source, vendor ?? name), "utf8").replace(/^\/\/# sourceMappingURL=.*$/m, "");
  const resolved = vendor ? text : text.replace(/"(\.\/([\w.-]+\.js)|three|tus-js-client)"/g, (whole, given, own) =>
    `"./${putModule(own ?? given, [...within, name])}"`);
  named.set(name, put(vendor ? `${name}.js` : name, resolved));
  return named.get(name);
}

for (const name of readdirSync(source).filter((each) => each.endsWith(".css"))) {
  named.set(name, put(name, readFileSync(join(source, name), "utf8")));
}
const index = readFileSync(join(source, "index.html"), "utf8").replace(/page\/([\w.-]+\.(js|css))/g, (whole, name) =>
  `page/${name.endsWith(".js") ? putModule(name) : named.get(name)}`);
writeFileSync(join(out, "index.html"), index);
const docs = putModule("docs.js"); // of /docs, which the service writes

const rows = made.map(({ name, type, path }, n) => `FILE(${n}, "${name}", "${type}", "${path}")`);
writeFileSync(join(out, "files.h"), `#define PAGE_INDEX "${join(out, "index.html")}"\n#define PAGE_DOCS "${docs}"\n` +
  `#define PAGE_FILES(FILE) ${rows.join(" ")}\n`);
console.log(`page: ${made.length} files in ${out}`);
