// SPDX-License-Identifier: GPL-3.0-or-later
// What a browser shows of a scan, and after how long: our page from the file on, a viewer of glTF, or Potree's renderer.
//
// Usage: node compare.js BROWSER page URL CLOUD PICTURE
//        node compare.js BROWSER gltf MODEL_VIEWER_JS MESH_GLB PICTURE
//        node compare.js BROWSER potree NODE_MODULES OCTREE_FOLDER PICTURE
"use strict";
const { readFileSync } = require("node:fs");
const { createServer } = require("node:http");
const { join } = require("node:path");
const { run, settled, withBrowser } = require("./browser.js");

const STYLE = "<style>html, body, model-viewer, canvas { margin: 0; width: 100%; height: 100%; display: block }</style>";

const GLTF = `<!doctype html><title>a viewer</title>${STYLE}
<script type="module" src="/viewer.js"></script><model-viewer src="/mesh.glb" camera-controls></model-viewer>`;

// All of an octree, in the colours of its points' intensities.
const POTREE = `<!doctype html><title>a viewer</title>${STYLE}<canvas></canvas>
<script type="importmap">{ "imports": { "three": "/three.module.js" } }</script>
<script type="module">
import * as THREE from "three";
import { PointColorType, PointSizeType, Potree } from "/potree.js";
const canvas = document.querySelector("canvas"), renderer = new THREE.WebGLRenderer({ canvas }), scene = new THREE.Scene();
renderer.setSize(innerWidth, innerHeight, false);
const camera = new THREE.PerspectiveCamera(35, innerWidth / innerHeight, 0.001, 1000), potree = new Potree();
const cloud = await potree.loadPointCloud("metadata.json", (name) => new URL(name, location.href).href);
const { boundingSphere: { center, radius } } = cloud.pcoGeometry, { points } = await (await fetch("metadata.json")).json();
Object.assign(cloud.material, { pointColorType: PointColorType.INTENSITY_GRADIENT, pointSizeType: PointSizeType.ADAPTIVE, size: 1, intensityRange: [0, 65535] });
scene.add(cloud);
const middle = center.clone().add(cloud.position);
camera.position.copy(middle).add(new THREE.Vector3(1, 1, 2).setLength(2.2 * radius));
camera.near = radius / 100;
camera.far = 10 * radius;
camera.updateProjectionMatrix();
camera.lookAt(middle);
function frame() {
  const { numVisiblePoints } = potree.updatePointClouds([cloud], camera, renderer);
  renderer.render(scene, camera);
  globalThis.whole = numVisiblePoints === points && !cloud.pcoGeometry.numNodesLoading;
  requestAnimationFrame(frame);
}
frame();
</script>`;

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

// Serves documents, { address: [content, type] }, also by ranges, while work(URL) lasts.
async function serving(files, work) {
  const server = createServer((request, reply) => {
    const [body, type] = files[request.url] ?? ["", "text/plain"], range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range);
    reply.writeHead(files[request.url] ? (range ? 206 : 200) : 404, { "Content-Type": type });
    reply.end(range ? body.subarray(Number(range[1]), Number(range[2]) + 1) : body);
  });
  await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
  try {
    return await work(`http://127.0.0.1:${server.address().port}/`);
  } finally {
    server.close();
  }
}

// Seconds until a document's page says that it shows everything; leaves its picture.
async function shown(tab, files, ready, picture) {
  return serving(files, async (url) => {
    const began = Date.now();
    await tab.goto(url);
    await tab.waitForFunction(ready);
    await settled(tab);
    const seconds = (Date.now() - began) / 1000;
    await tab.screenshot({ path: picture });
    return seconds;
  });
}

const gltf = (tab, [script, mesh, picture]) => shown(tab, { "/": [GLTF, "text/html"], "/viewer.js": [readFileSync(script), "text/javascript"],
  "/mesh.glb": [readFileSync(mesh), "model/gltf-binary"] }, () => document.querySelector("model-viewer").loaded, picture);

function potree(tab, [modules, octree, picture]) {
  const script = (path) => [readFileSync(join(modules, path)), "text/javascript"], files = { "/": [POTREE, "text/html"], "/potree.js": script("potree-core/dist/index.js"),
    "/three.module.js": script("three/build/three.module.js"), "/three.core.js": script("three/build/three.core.js") };
  for (const name of ["metadata.json", "hierarchy.bin", "octree.bin"]) files[`/${name}`] = [readFileSync(join(octree, name)), "application/octet-stream"];
  return shown(tab, files, () => globalThis.whole, picture);
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
