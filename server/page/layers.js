// SPDX-License-Identifier: GPL-3.0-or-later
// Outputs as what three draws: points that grow with the level, and meshes.
import * as THREE from "three";

import { ask } from "./api.js";
import { comesInPieces, readHead } from "./ply.js";
import { colourOf, rangeOf } from "./ramp.js";

const FIRST_BYTES = 64 * 1024, PIECE_POINTS = 50000, MOST_POINTS = 400000; // of a request: twice as many each time
const CLAY = [203, 196, 186];

const worker = new Worker(new URL("./points_worker.js", import.meta.url), { type: "module" });
const waiting = new Map();
let last = 0;
worker.onmessage = ({ data }) => {
  const { resolve, reject } = waiting.get(data.id);
  waiting.delete(data.id);
  if (data.error) reject(new Error(data.error));
  else resolve(data.result);
};

function parse(message, owned) {
  return new Promise((resolve, reject) => {
    waiting.set(++last, { resolve, reject });
    worker.postMessage({ id: last, ...message }, owned);
  });
}

async function bytesOf(url, from, to) {
  const reply = await ask(url, { headers: from === undefined ? {} : { Range: `bytes=${from}-${to - 1}` } });
  return reply.arrayBuffer();
}

const linear = new Float32Array(256).map((_, c) => new THREE.Color().setRGB(c / 255, 0, 0, THREE.SRGBColorSpace).r);

const SHADES = 512; // of the ramp
const shades = Float32Array.from({ length: 3 * (SHADES + 1) }, (_, i) =>
  linear[Math.round(colourOf(Math.floor(i / 3) / SHADES)[i % 3])]);

// Fills colour (linear, three for each point) of the points from begin to end.
function paint(points, by, colour, begin, end) {
  const values = points.scalar[by.name], rgb = by.name === "own" ? points.rgb : null;
  if (values) {
    const { low, high } = by.range, scale = SHADES / (high - low);
    for (let i = begin; i < end; i++) {
      const shade = 3 * Math.max(0, Math.min(SHADES, Math.floor((values[i] - low) * scale) || 0));
      for (let c = 0; c < 3; c++) colour[3 * i + c] = shades[shade + c];
    }
    return;
  }
  for (let k = 3 * begin; k < 3 * end; k++) colour[k] = linear[rgb ? rgb[k] : CLAY[k % 3]];
}

// Points of a PLY that come in pieces, the first ones first.  area: of the surface, about, in square units; reach: of
// the farthest point from the origin, at most.
export class PointLayer {
  static async open(url, origin, area, reach) {
    let buffer = await bytesOf(url, 0, FIRST_BYTES), head = readHead(buffer);
    if (!head) throw new Error("the file's head is too long");
    const layer = new PointLayer();
    Object.assign(layer, { url, origin, area, reach, head, count: head.vertex.count, loaded: 0, shown: 0, fetched: 0 });
    if (!comesInPieces(head)) {
      buffer = await bytesOf(url);
      layer.loaded = layer.count;
    }
    layer.fetched = buffer.byteLength;
    if (layer.loaded) layer.points = await parse({ what: "whole", buffer, origin }, [buffer]);
    layer.make();
    return layer;
  }

  make() {
    const n = this.count, names = this.head.vertex.properties.filter((p) => !p.count).map((p) => p.name);
    const coloured = names.includes("red");
    this.points ??= {
      position: new Float32Array(3 * n), rgb: coloured ? new Uint8Array(3 * n) : null,
      scalar: Object.fromEntries(names.filter((name) => !["x", "y", "z", "alpha"].includes(name)
        && !(coloured && ["red", "green", "blue"].includes(name))).map((name) => [name, new Float32Array(n)])),
    };
    this.colour = new Float32Array(3 * n);
    this.by = { name: this.points.rgb ? "own" : "plain" };
    this.geometry = new THREE.BufferGeometry();
    this.geometry.setAttribute("position", new THREE.BufferAttribute(this.points.position, 3));
    this.geometry.setAttribute("color", new THREE.BufferAttribute(this.colour, 3));
    this.material = new THREE.PointsMaterial({ vertexColors: true, size: 1 });
    this.geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(), this.reach); // points come later
    this.object = new THREE.Points(this.geometry, this.material);
    this.object.frustumCulled = false;
    paint(this.points, this.by, this.colour, 0, this.loaded);
    this.show(this.loaded);
  }

  // Names that points can be coloured by.
  get attributes() {
    return [...(this.points.rgb ? ["own"] : []), "plain", ...Object.keys(this.points.scalar)];
  }

  colourBy(name) {
    this.by = { name, range: this.points.scalar[name] && rangeOf(this.points.scalar[name].subarray(0, this.loaded)) };
    paint(this.points, this.by, this.colour, 0, this.loaded);
    this.geometry.attributes.color.addUpdateRange(0, 3 * this.loaded);
    this.geometry.attributes.color.needsUpdate = true;
    return this.by.range ?? null;
  }

  // Shows the first n points, of those that are there.
  show(n) {
    this.shown = Math.min(n, this.loaded);
    this.geometry.setDrawRange(0, this.shown);
    this.material.size = 2.4 * Math.sqrt(this.area / Math.max(this.shown, 1));
  }

  // Fetches what is missing of the first n points, piece by piece; more(layer) is called after each.
  async load(n, more) {
    this.wanted = Math.min(n, this.count);
    if (this.loading) return this.loading;
    this.loading = this.fetchPieces(more).finally(() => { this.loading = null; });
    return this.loading;
  }

  async fetchPieces(more) {
    const { head } = this, stride = head.vertex.stride;
    for (let most = PIECE_POINTS; this.loaded < this.wanted; most = Math.min(2 * most, MOST_POINTS)) {
      const begin = this.loaded, count = Math.min(most, this.count - begin);
      const from = head.bytes + begin * stride, buffer = await bytesOf(this.url, from, from + count * stride);
      this.fetched += buffer.byteLength;
      const piece = await parse({ what: "records", head, buffer, start: 0, count, origin: this.origin }, [buffer]);
      this.points.position.set(piece.position, 3 * begin);
      if (piece.rgb) this.points.rgb.set(piece.rgb, 3 * begin);
      for (const name in piece.scalar) this.points.scalar[name].set(piece.scalar[name], begin);
      paint(this.points, this.by, this.colour, begin, begin + count);
      this.loaded = begin + count;
      for (const attribute of Object.values(this.geometry.attributes)) {
        attribute.addUpdateRange(3 * begin, 3 * count);
        attribute.needsUpdate = true;
      }
      more?.(this);
    }
  }

  dispose() {
    this.geometry.dispose();
    this.material.dispose();
  }
}

export class MeshLayer {
  static async open(url, origin) {
    const buffer = await bytesOf(url), bytes = buffer.byteLength, layer = new MeshLayer();
    layer.points = await parse({ what: "whole", buffer, origin }, [buffer]);
    layer.fetched = bytes;
    layer.geometry = new THREE.BufferGeometry();
    layer.geometry.setAttribute("position", new THREE.BufferAttribute(layer.points.position, 3));
    layer.colour = new Float32Array(layer.points.position.length);
    layer.geometry.setAttribute("color", new THREE.BufferAttribute(layer.colour, 3));
    layer.geometry.setIndex(new THREE.BufferAttribute(layer.points.triangle, 1));
    layer.geometry.computeVertexNormals();
    layer.material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide, flatShading: true });
    layer.object = new THREE.Mesh(layer.geometry, layer.material);
    layer.triangles = layer.points.triangle.length / 3;
    layer.colourBy(layer.points.rgb ? "own" : "plain");
    return layer;
  }

  colourBy(name) {
    paint(this.points, { name }, this.colour, 0, this.points.count);
    this.geometry.attributes.color.needsUpdate = true;
  }

  // flat, smooth or wireframe
  shade(how) {
    this.material.flatShading = how === "flat";
    this.material.wireframe = how === "wireframe";
    this.material.needsUpdate = true;
  }

  dispose() {
    this.geometry.dispose();
    this.material.dispose();
  }
}
