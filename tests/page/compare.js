// SPDX-License-Identifier: GPL-3.0-or-later
// What a browser shows of a scan, and after how long: our page from the file on, or a viewer of glTF.
//
// Usage: node compare.js BROWSER page URL CLOUD PICTURE
//        node compare.js BROWSER gltf MODEL_VIEWER_JS MESH_GLB PICTURE
"use strict";
const { readFileSync } = require("node:fs");
const { createServer } = require("node:http");
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

async function gltf(tab, [script, mesh, picture]) {
  const files = { "/": [DOCUMENT, "text/html"], "/viewer.js": [readFileSync(script), "text/javascript"], "/mesh.glb": [readFileSync(mesh), "model/gltf-binary"] };
  const server = createServer((request, reply) => {
    const [body, type] = files[request.url] ?? ["", "text/plain"];
    reply.writeHead(files[request.url] ? 200 : 404, { "Content-Type": type });
    reply.end(body);
  });
  await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
  const began = Date.now();
  await tab.goto(`http://127.0.0.1:${server.address().port}/`);
  await tab.waitForFunction(() => document.querySelector("model-viewer").loaded);
  await settled(tab);
  const seconds = (Date.now() - began) / 1000;
  await tab.screenshot({ path: picture });
  server.close();
  return seconds;
}

async function main([executablePath, what, ...rest]) {
  await withBrowser(executablePath, async (browser) => {
    const tab = await browser.newPage();
    tab.setDefaultTimeout(600000);
    await tab.setViewport({ width: 1600, height: 900 });
    console.log(await { page, gltf }[what](tab, rest));
  });
}

run(main);
