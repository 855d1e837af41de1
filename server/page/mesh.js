// SPDX-License-Identifier: GPL-3.0-or-later
// Reads whole meshes, of each kind that there is among the outputs, as ply.js reads PLY: plain arrays, so that it can run in
// a worker.
import { readGlbMesh } from "./gltf.js";
import { readWhole } from "./ply.js";

// Vertices as they are found: positions around `origin` in units of `unit`, and triangles.
function builder(origin, unit) {
  const position = [], triangle = [];
  return {
    position, triangle,
    add: (place) => position.push(...place.map((c, k) => (c - origin[k]) / unit)) / 3 - 1,
    made: (rgb) => ({ position: Float32Array.from(position), count: position.length / 3, origin, unit, rgb, normal: null, scalar: {}, triangle: Uint32Array.from(triangle) }),
  };
}

function readObj(buffer, origin, unit) {
  const text = new TextDecoder("latin1").decode(buffer), mesh = builder(origin, unit), rgb = [];
  for (let at = 0, end; at < text.length; at = end + 1) {
    end = text.indexOf("\n", at);
    if (end < 0) end = text.length;
    const [word, ...rest] = text.slice(at, end).trim().split(/\s+/);
    if (word === "v") {
      const [x, y, z, ...colour] = rest.map(Number);
      mesh.add([x, y, z]);
      if (colour.length === 3) rgb.push(...colour.map((c) => Math.round(255 * c)));
    }
    if (word === "f") for (let k = 2; k < rest.length; k++) mesh.triangle.push(...[0, k - 1, k].map((corner) => parseInt(rest[corner], 10) - 1));
  }
  return mesh.made(rgb.length && rgb.length === mesh.position.length ? Uint8Array.from(rgb) : null);
}

// Corners at the same place are one vertex.
function readStl(buffer, origin, unit) {
  const view = new DataView(buffer), mesh = builder(origin, unit), known = new Map();
  for (let facet = 84; facet + 50 <= 84 + 50 * view.getUint32(80, true); facet += 50) {
    for (let at = facet + 12; at < facet + 48; at += 12) {
      const place = [0, 4, 8].map((k) => view.getFloat32(at + k, true)), key = place.join();
      if (!known.has(key)) known.set(key, mesh.add(place));
      mesh.triangle.push(known.get(key));
    }
  }
  return mesh.made(null);
}

const READERS = { ply: readWhole, glb: readGlbMesh, obj: readObj, stl: readStl };
export const MESH_KINDS = Object.keys(READERS); // endings of files, the one that is read first where there are several

export const readMesh = (kind, buffer, origin, unit) => READERS[kind](buffer, origin, unit);
