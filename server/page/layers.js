// SPDX-License-Identifier: GPL-3.0-or-later
// Outputs as what three draws: points that grow with the level, and meshes.
import * as THREE from "three";

import { ask } from "./api.js";
import { attributesOf, CLAY, dots, linear, paint, widthOf } from "./dots.js";
import { arraysFor, comesInPieces, readHead } from "./ply.js";
import { rangeOf, shadeOf } from "./ramp.js";

const FIRST_BYTES = 64 * 1024; // the head, and the points of the first view
const PIECE_POINTS = 50000, MOST_POINTS = 400000; // of a request: twice as many each time

const worker = new Worker(new URL("./points_worker.js", import.meta.url), { type: "module" });
const waiting = new Map();
let last = 0, broken = null; // broken: why nothing is parsed
worker.onerror = ({ message }) => {
  broken = new Error(message || "the part of this page that reads points can't be loaded");
  for (const { reject } of waiting.values()) reject(broken);
  waiting.clear();
};
worker.onmessage = ({ data }) => {
  const { resolve, reject } = waiting.get(data.id);
  waiting.delete(data.id);
  if (data.error) reject(new Error(data.error));
  else resolve(data.result);
};

function parse(message, owned) {
  if (broken) return Promise.reject(broken);
  return new Promise((resolve, reject) => {
    waiting.set(++last, { resolve, reject });
    worker.postMessage({ id: last, ...message }, owned);
  });
}

async function bytesOf(url, from, to) {
  const reply = await ask(url, { headers: from === undefined ? {} : { Range: `bytes=${from}-${to - 1}` } });
  return reply.arrayBuffer();
}

const around = () => new THREE.Sphere(new THREE.Vector3(), 2); // of everything, also where some coordinates are no numbers

// The coordinates along an axis, in an array for all of `count` points; the first n are filled.
function heights({ position, origin, unit }, n, count, axis) {
  const height = new Float32Array(count);
  for (let i = 0; i < n; i++) height[i] = unit * position[3 * i + axis] + origin[axis];
  return height;
}

// Points of a PLY that come in pieces, the first ones first, around `origin` in units of `unit`, which no point is much
// farther away than.  area: of the surface, about, in squares of these; ranked: the first n of them are the cloud of n points.
export class PointLayer {
  static async open(url, { origin, unit, area, ranked }) {
    let buffer = await bytesOf(url, 0, FIRST_BYTES), head = readHead(buffer);
    if (!head) throw new Error("the file's head is too long");
    const layer = new PointLayer();
    Object.assign(layer, { url, origin, unit, area, ranked, head, count: head.vertex.count, loaded: 0, shown: 0, fetched: 0 });
    if (!comesInPieces(head)) {
      buffer = await bytesOf(url);
      layer.loaded = layer.count;
    }
    layer.fetched = buffer.byteLength;
    if (layer.loaded) layer.points = await parse({ what: "whole", buffer, origin, unit }, [buffer]);
    layer.make();
    if (layer.loaded) await layer.mix();
    else await layer.take(buffer, head.bytes, Math.floor((buffer.byteLength - head.bytes) / head.vertex.stride));
    return layer;
  }

  // Reads the next `count` points, or as many as there are, from a piece of the file.
  async take(buffer, start, most) {
    const { head, loaded: begin } = this, count = Math.min(most, this.count - begin);
    if (count <= 0) return;
    const piece = await parse({ what: "records", head, buffer, start, count, origin: this.origin, unit: this.unit }, [buffer]);
    this.points.position.set(piece.position, 3 * begin);
    if (piece.rgb) this.points.rgb.set(piece.rgb, 3 * begin);
    if (piece.normal) this.points.normal.set(piece.normal, 3 * begin);
    for (const name in piece.scalar) this.points.scalar[name].set(piece.scalar[name], begin);
    this.loaded = begin + count;
    for (const attribute of Object.values(this.geometry.attributes)) {
      attribute.addUpdateRange(attribute.itemSize * begin, attribute.itemSize * count);
      attribute.needsUpdate = true;
    }
    if (this.loaded === this.count) await this.mix();
  }

  make() {
    const n = this.count;
    this.points ??= { ...arraysFor(this.head, n), origin: this.origin, unit: this.unit };
    this.geometry = new THREE.BufferGeometry();
    this.geometry.setAttribute("position", new THREE.BufferAttribute(this.points.position, 3));
    if (this.points.rgb) this.geometry.setAttribute("tint", new THREE.BufferAttribute(this.points.rgb, 3, true));
    if (this.points.normal) this.geometry.setAttribute("normal", new THREE.BufferAttribute(this.points.normal, 3));
    this.material = dots();
    this.geometry.boundingSphere = around(); // points come later
    this.object = new THREE.Points(this.geometry, this.material);
    this.object.frustumCulled = false;
    Object.assign(this.object.userData, { uniforms: this.material.uniforms, part: (begin, count, whole) => this.part(begin, count, whole) });
    this.colourBy(this.points.rgb ? "own" : "plain");
    this.show(this.loaded);
  }

  // Names that points can be coloured by.
  get attributes() {
    return attributesOf(this.points, Boolean(this.points.normal));
  }

  // Returns the range of the values that the legend shows, null where there is none.  axis: which of x, y, z is height.
  colourBy(name, axis) {
    if (name === "height") this.points.height = heights(this.points, this.loaded, this.count, axis);
    const values = name === "height" ? this.points.height : this.points.scalar[name];
    const range = values ? rangeOf(name, values.subarray(0, this.loaded)) : null;
    this.by = { name, range };
    if (values && (this.values !== values || name === "height")) {
      this.geometry.setAttribute("value", new THREE.BufferAttribute(values, 1));
      this.values = values;
    }
    paint(this.material.uniforms, this.by, Boolean(this.points.normal));
    return range;
  }

  // Has the points cover a surface of another area.
  spread(area) {
    this.area = area;
  }

  // Shows the first n points, of those that are there.
  show(n) {
    this.shown = Math.min(n, this.loaded);
    this.object.userData.shown = this.shown;
    this.part(0, this.shown, this.shown);
  }

  // Draws count of the points from begin on, as large as the first `whole` of them have to be to cover the surface.
  part(begin, count, whole) {
    this.geometry.setDrawRange(begin, count);
    this.material.uniforms.size.value = widthOf(this.area, whole);
  }

  // A file's own order is how it was scanned: its points are drawn in one that is everywhere at once, so that any first
  // part of them shows the whole.
  async mix() {
    if (this.ranked) return;
    const { order } = await parse({ what: "mix", count: this.count }, []);
    if (!this.gone) this.geometry.setIndex(new THREE.BufferAttribute(order, 1));
  }

  // Fetches what is missing of the first n points, piece by piece; more(layer) is called after each.
  async load(n, more) {
    this.wanted = Math.min(n, this.count);
    if (this.loading) return this.loading;
    this.loading = this.fetchPieces(more).finally(() => { this.loading = null; });
    return this.loading;
  }

  async fetchPieces(more) {
    const { head } = this, { stride } = head.vertex;
    for (let most = PIECE_POINTS; this.loaded < this.wanted; most = Math.min(2 * most, MOST_POINTS)) {
      const begin = this.loaded, count = Math.min(most, this.count - begin);
      const from = head.bytes + begin * stride, buffer = await bytesOf(this.url, from, from + count * stride);
      this.fetched += buffer.byteLength;
      await this.take(buffer, 0, count);
      more?.(this);
    }
  }

  dispose() {
    this.gone = true;
    this.geometry.dispose();
    this.material.uniforms.ramp.value.dispose();
    this.material.dispose();
  }
}

export class MeshLayer {
  // url: its ending tells what it is
  static async open(url, { origin, unit }) {
    const buffer = await bytesOf(url), bytes = buffer.byteLength, layer = new MeshLayer();
    layer.points = await parse({ what: "mesh", kind: url.split(".").pop(), buffer, origin, unit }, [buffer]);
    layer.fetched = bytes;
    layer.geometry = new THREE.BufferGeometry();
    layer.geometry.setAttribute("position", new THREE.BufferAttribute(layer.points.position, 3));
    layer.colour = new Float32Array(layer.points.position.length);
    layer.geometry.setAttribute("color", new THREE.BufferAttribute(layer.colour, 3));
    layer.geometry.setIndex(new THREE.BufferAttribute(layer.points.triangle, 1));
    layer.geometry.computeVertexNormals();
    layer.geometry.boundingSphere = around();
    layer.material = new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide, flatShading: true });
    layer.object = new THREE.Mesh(layer.geometry, layer.material);
    layer.object.frustumCulled = false;
    layer.triangles = layer.points.triangle.length / 3;
    layer.colourBy(layer.points.rgb ? "own" : "plain");
    return layer;
  }

  get attributes() {
    return attributesOf(this.points, true);
  }

  // Returns the range of the values that the legend shows, null where there is none.  axis: which of x, y, z is height.
  colourBy(name, axis) {
    const { points, colour } = this, n = points.count, normal = this.geometry.attributes.normal.array;
    const values = name === "height" ? heights(points, n, n, axis) : points.scalar[name];
    const range = values ? rangeOf(name, values) : null;
    this.by = { name, range };
    if (range) for (let i = 0; i < n; i++) shadeOf(range, values[i]).forEach((c, k) => { colour[3 * i + k] = linear[Math.round(c)]; });
    else if (name === "normals") for (let k = 0; k < colour.length; k++) colour[k] = linear[Math.round(127.5 + 127.5 * normal[k])];
    else for (let k = 0; k < colour.length; k++) colour[k] = linear[name === "own" ? points.rgb[k] : CLAY[k % 3]];
    this.geometry.attributes.color.needsUpdate = true;
    return range;
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
