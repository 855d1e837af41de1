// SPDX-License-Identifier: GPL-3.0-or-later
// Reads clouds and meshes as three.js, loaders.gl or web-e57 do, and prints a line of JSON for each: what they have of
// each point, by their names, and the number of corners of triangles.
//
// Usage: node read_cloud.mjs three|loaders.gl|web-e57 FILE ...
import { readFile } from "node:fs/promises";
import { extname } from "node:path";

globalThis.self ??= globalThis; // a worker's, which some ask for
const own = ["intensity", "classification", "gps_time", "label"];

async function byThree(bytes, buffer, kind) {
  const files = { ply: "PLY", pcd: "PCD", obj: "OBJ", stl: "STL", glb: "GLTF" };
  const name = `${files[kind]}Loader`;
  const loader = new (await import(`three/examples/jsm/loaders/${name}.js`))[name]();
  if (kind === "ply") loader.setCustomPropertyNameMapping(Object.fromEntries(own.map((each) => [each, [each]])));
  const made = kind === "glb" ? (await loader.parseAsync(buffer, "")).scene
    : loader.parse(kind === "obj" ? bytes.toString() : buffer);
  let geometry = made.isBufferGeometry ? made : undefined;
  made.traverse?.((each) => { geometry ??= each.geometry; });
  const attributes = Object.entries(geometry.attributes).map(([each, attribute]) =>
    [each, Array.from({ length: attribute.count }, (_, i) =>
      Array.from({ length: attribute.itemSize }, (_, axis) => attribute.getComponent(i, axis)))]);
  return { attributes: Object.fromEntries(attributes), corners: (geometry.index ?? geometry.attributes.position).count };
}

async function byLoaders(bytes, buffer, kind) {
  const files = { ply: "PLY", pcd: "PCD", las: "LAS", laz: "LAS", obj: "OBJ", glb: "GLTF" };
  const { parse } = await import("@loaders.gl/core");
  const loader = (await import(`@loaders.gl/${files[kind].toLowerCase()}`))[`${files[kind]}Loader`];
  let data = await parse(buffer, loader, { worker: false, las: { shape: "mesh", colorDepth: 16 } });
  if (kind === "glb") data = (await import("@loaders.gl/gltf")).postProcessGLTF(data).meshes[0].primitives[0];
  const attributes = Object.entries(data.attributes).map(([each, { value, size = 1, components = size }]) =>
    [each, Array.from({ length: value.length / components }, (_, i) =>
      Array.from(value.subarray(components * i, components * (i + 1)), Number))]);
  return { attributes: Object.fromEntries(attributes), corners: data.indices?.value?.length ?? 0 };
}

async function byWebE57(bytes) { // as a bundler would load it
  const folder = new URL("./node_modules/web-e57/", import.meta.url);
  const script = await import(new URL("e57_bg.js", folder));
  const { instance } = await WebAssembly.instantiate(await readFile(new URL("e57_bg.wasm", folder)),
    { "./e57_bg.js": script });
  script.__wbg_set_wasm(instance.exports);
  instance.exports.__wbindgen_start?.();
  const rows = Buffer.from(script.convertE57(new Uint8Array(bytes), "XYZ")).toString().trim().split("\n")
    .map((line) => line.split(" ").map(Number));
  return { attributes: { POSITION: rows.map((row) => row.slice(0, 3)), COLOR_0: rows.map((row) => row.slice(3)) },
    corners: 0 };
}

const [who, ...paths] = process.argv.slice(2);
for (const path of paths) {
  const bytes = await readFile(path);
  const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
  const read = { three: byThree, "loaders.gl": byLoaders, "web-e57": byWebE57 }[who];
  console.log(JSON.stringify(await read(bytes, buffer, extname(path).slice(1))));
}
