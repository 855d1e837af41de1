// SPDX-License-Identifier: GPL-3.0-or-later
// Shows a folder of 3D Tiles in a real browser by 3d-tiles-renderer, from far off and then with every tile, or with
// those that errors of so many PIXELS ask for, and prints as JSON how many tiles and points it held, how many pixels
// they took, and where they lay.
//
// Usage: node show_tileset.mjs BROWSER FOLDER PICTURES [PIXELS]
import { createServer } from "node:http";
import { readFile } from "node:fs/promises";
import { join, normalize } from "node:path";
import { build } from "esbuild";
import puppeteer from "puppeteer-core";

// Runs in the page.
const PAGE = `
import * as three from "three";
import { TilesRenderer } from "3d-tiles-renderer";
import { GLTFExtensionsPlugin } from "3d-tiles-renderer/plugins";
import { MeshoptDecoder } from "three/examples/jsm/libs/meshopt_decoder.module.js";

const WIDTH = 800, HEIGHT = 600;
const renderer = new three.WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setSize(WIDTH, HEIGHT);
document.body.append(renderer.domElement);
const scene = new three.Scene();
const camera = new three.PerspectiveCamera(40, WIDTH / HEIGHT, 0.01, 1e9);
scene.add(new three.AmbientLight(0xffffff, 3));

globalThis.failed = [];
globalThis.show = async (url, distance, errorTarget) => {
  const tiles = new TilesRenderer(url);
  tiles.registerPlugin(new GLTFExtensionsPlugin({ meshoptDecoder: MeshoptDecoder }));
  tiles.errorTarget = errorTarget;
  tiles.addEventListener("load-error", ({ error }) => failed.push(String(error)));
  const root = new three.Group();
  root.add(tiles.group);
  scene.add(root);
  tiles.setCamera(camera);
  let box = null;
  for (let still = 0; still < 5;) {
    const sphere = new three.Sphere();
    if (tiles.getBoundingSphere(sphere)) {
      // The middle of the cloud is where the camera looks, so that numbers are small where it is drawn.
      root.position.copy(sphere.center).negate();
      camera.position.set(0, -0.5, 1).multiplyScalar(distance * sphere.radius);
      camera.near = 0.01 * sphere.radius, camera.far = 2 * (distance + 1) * sphere.radius;
      camera.updateProjectionMatrix();
      camera.lookAt(0, 0, 0);
    }
    scene.updateMatrixWorld(true);
    tiles.setResolutionFromRenderer(camera, renderer);
    tiles.update();
    renderer.render(scene, camera);
    const busy = tiles.stats.downloading + tiles.stats.parsing + (tiles.stats.queued || 0);
    still = busy || !tiles.root || !tiles.visibleTiles.size ? 0 : still + 1;
    if (failed.length) break;
    await new Promise((done) => requestAnimationFrame(done));
  }
  const seen = { tiles: 0, points: 0, pixels: 0 };
  const low = new three.Vector3(Infinity, Infinity, Infinity), high = low.clone().negate();
  tiles.group.traverse((object) => {
    if (!object.isPoints) return;
    seen.tiles++;
    const place = object.geometry.attributes.position, p = new three.Vector3();
    seen.points += place.count;
    for (let i = 0; i < place.count; i++) {
      p.fromBufferAttribute(place, i).applyMatrix4(object.matrixWorld).sub(root.position);
      low.min(p), high.max(p);
    }
  });
  const pixel = new Uint8Array(4 * WIDTH * HEIGHT), gl = renderer.getContext();
  gl.readPixels(0, 0, WIDTH, HEIGHT, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  for (let i = 0; i < pixel.length; i += 4) seen.pixels += pixel[i] + pixel[i + 1] + pixel[i + 2] > 0;
  scene.remove(root);
  tiles.dispose();
  return { ...seen, low: low.toArray(), high: high.toArray() };
};
`;

async function main([executablePath, folder, pictures, pixels = "1e-9"]) {
  const page = await build({
    stdin: { contents: PAGE, resolveDir: import.meta.dirname ?? new URL(".", import.meta.url).pathname },
    bundle: true, format: "esm", write: false, logLevel: "error",
  });
  const script = page.outputFiles[0].contents;
  const server = createServer(async (request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url, "http://localhost").pathname));
    try {
      if (path === "/") response.setHeader("Content-Type", "text/html").end('<link rel="icon" href="data:,"><script type="module" src="page.js"></script>');
      else if (path === "/page.js") response.setHeader("Content-Type", "text/javascript").end(script);
      else response.end(await readFile(join(folder, path.replace(/^\/set\//, "/"))));
    } catch {
      response.writeHead(404).end();
    }
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  const url = `http://127.0.0.1:${server.address().port}`;
  const browser = await puppeteer.launch({
    executablePath, protocolTimeout: 600000,
    args: ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-background-networking",
      "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"],
  });
  const errors = [];
  try {
    const tab = await browser.newPage();
    tab.on("pageerror", (error) => errors.push(String(error)));
    tab.on("console", (message) => message.type() === "error" && errors.push(message.text()));
    await tab.goto(url);
    await tab.waitForFunction(() => globalThis.show, { timeout: 300000 });
    const far = await tab.evaluate(() => show(new URL("set/tileset.json", location).href, 40, 1));
    const all = await tab.evaluate((target) => show(new URL("set/tileset.json", location).href, 2, target), Number(pixels));
    await tab.screenshot({ path: join(pictures, "tileset.png") });
    const failed = await tab.evaluate(() => failed);
    console.log(JSON.stringify({ far, all, failed, errors }));
  } finally {
    await browser.close();
    server.close();
  }
}

main(process.argv.slice(2)).catch((error) => {
  console.error(error);
  process.exitCode = 1;
});
