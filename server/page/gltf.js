// SPDX-License-Identifier: GPL-3.0-or-later
// Reads binary glTF of one node with one primitive, as core/io/out/glb_write.c writes it.  Everything here is plain
// arrays, so that it can run in a worker.
import { readIndices, readPacked } from "./meshopt.js";

const FLOAT = 5126, ARRAYS = { 5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const WIDTHS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };

const toSrgb = (c) => (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
let bytesOfLinear = null; // linear, 16 bits, as sRGB of 8 bits; made when the first colours come

// The only primitive of a file: each of its attributes as packed numbers in an array, its corners (null: it has none), and
// its node.
export function readGlb(buffer) {
  const words = new DataView(buffer);
  if (buffer.byteLength < 28 || words.getUint32(0, true) !== 0x46546C67) throw new Error("this is no binary glTF");
  const head = words.getUint32(12, true), json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, head)));
  const binary = 20 + head + 8, found = {}, { attributes, indices } = json.meshes[0].primitives[0];
  for (const [name, at] of Object.entries(attributes)) {
    const { bufferView, componentType, count, type, normalized } = json.accessors[at], view = json.bufferViews[bufferView];
    const kind = ARRAYS[componentType], width = WIDTHS[type], stride = (view.byteStride ?? width * kind.BYTES_PER_ELEMENT) / kind.BYTES_PER_ELEMENT;
    const packed = view.extensions?.EXT_meshopt_compression, plain = packed ? readPacked(new Uint8Array(buffer, binary), packed).buffer : buffer;
    const all = new kind(plain, packed ? 0 : binary + (view.byteOffset ?? 0), Math.min(count * stride, view.byteLength / kind.BYTES_PER_ELEMENT));
    found[name] = { all, stride, count, scale: normalized && componentType !== FLOAT ? 1 / (2 ** (8 * kind.BYTES_PER_ELEMENT - (componentType % 2 ? 0 : 1)) - 1) : 1 };
  }
  return { found, node: json.nodes[0], triangle: indices === undefined ? null : cornersOf(json, indices, buffer, binary) };
}

function cornersOf({ accessors, bufferViews }, indices, buffer, binary) {
  const { bufferView, componentType, count } = accessors[indices], { byteOffset = 0, extensions } = bufferViews[bufferView];
  const packed = extensions?.EXT_meshopt_compression;
  return packed ? readIndices(new Uint8Array(buffer, binary), packed) : Uint32Array.from(new ARRAYS[componentType](buffer, binary + byteOffset, count));
}

// Colours as bytes of sRGB, three for each vertex; null where there are none.
export function coloursOf({ COLOR_0: colour }) {
  if (!colour) return null;
  bytesOfLinear ??= Uint8Array.from({ length: 65536 }, (_, c) => Math.round(255 * toSrgb(c / 65535)));
  const { all, stride, count } = colour, rgb = new Uint8Array(3 * count);
  for (let i = 0; i < count; i++) for (let k = 0; k < 3; k++) rgb[3 * i + k] = bytesOfLinear[all[stride * i + k]];
  return rgb;
}

export function every(n, value) {
  const all = new Float32Array(n);
  for (let i = 0; i < n; i++) all[i] = value(i);
  return all;
}

// Attributes that glTF has no name for, by their own names.
export function scalarsOf(found) {
  const own = Object.entries(found).filter(([name]) => name.startsWith("_"));
  return Object.fromEntries(own.map(([name, { all, stride, count }]) => [name.slice(1).toLowerCase(), every(count, (i) => all[stride * i])]));
}

// How large a step of the positions is and where they begin, in the axes that they have: a node may turn these so that y
// points upwards, as glTF has it.
function placeOf({ matrix, scale = [1, 1, 1], translation = [0, 0, 0] }) {
  if (!matrix) return { steps: scale, move: translation };
  const steps = [0, 4, 8].map((at) => Math.hypot(...matrix.slice(at, at + 3))), [x, y, z] = matrix.slice(12, 15);
  return { steps, move: steps.map((step, k) => (matrix[4 * k] * x + matrix[4 * k + 1] * y + matrix[4 * k + 2] * z) / step) };
}

// A mesh around `origin` in units of `unit`, in the axes of the file that it was made of.
export function readGlbMesh(buffer, origin, unit) {
  const { found, node, triangle } = readGlb(buffer), { all, stride, count, scale } = found.POSITION, { steps, move } = placeOf(node);
  const position = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < 3; k++) position[3 * i + k] = (all[stride * i + k] * scale * steps[k] + move[k] - origin[k]) / unit;
  }
  return { position, count, origin, unit, rgb: coloursOf(found), normal: null, scalar: scalarsOf(found), triangle };
}
