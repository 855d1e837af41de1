// SPDX-License-Identifier: GPL-3.0-or-later
// Reads PLY: the head, and records of points as they come in pieces, or a whole file.  Everything here is plain arrays,
// so that it can run in a worker.

const SIZES = { char: 1, int8: 1, uchar: 1, uint8: 1, short: 2, int16: 2, ushort: 2, uint16: 2, int: 4, int32: 4,
  uint: 4, uint32: 4, float: 4, float32: 4, double: 8, float64: 8 };
const READ = {
  char: "getInt8", int8: "getInt8", uchar: "getUint8", uint8: "getUint8", short: "getInt16", int16: "getInt16",
  ushort: "getUint16", uint16: "getUint16", int: "getInt32", int32: "getInt32", uint: "getUint32",
  uint32: "getUint32", float: "getFloat32", float32: "getFloat32", double: "getFloat64", float64: "getFloat64",
};

// The head of a file's first bytes; null where it isn't whole.
export function readHead(buffer) {
  const text = new TextDecoder("latin1").decode(buffer.slice(0, 65536));
  const end = /end_header[ \t]*\r?\n/.exec(text);
  if (!text.startsWith("ply")) throw new Error("this is no PLY");
  if (!end) return null;
  const head = { bytes: end.index + end[0].length, elements: [], format: "ascii" };
  for (const line of text.slice(0, end.index).split(/\r?\n/)) {
    const words = line.trim().split(/\s+/);
    if (words[0] === "format") head.format = words[1];
    if (words[0] === "element") head.elements.push({ name: words[1], count: Number(words[2]), properties: [] });
    if (words[0] === "property") {
      const list = words[1] === "list";
      head.elements.at(-1).properties.push({ name: words.at(-1), type: list ? words[3] : words[1],
        count: list ? words[2] : null });
    }
  }
  for (const element of head.elements) {
    const flat = element.properties.every((property) => !property.count);
    element.stride = flat ? element.properties.reduce((sum, property) => sum + SIZES[property.type], 0) : 0;
  }
  head.vertex = head.elements.find((element) => element.name === "vertex");
  return head;
}

// Whether points can be read from a piece of the file.
export const comesInPieces = (head) => head.format !== "ascii" && head.elements[0] === head.vertex
  && head.vertex.stride > 0;

function places(element) {
  let offset = 0;
  return Object.fromEntries(element.properties.map((property) => {
    const place = [property.name, { type: property.type, offset }];
    offset += SIZES[property.type];
    return place;
  }));
}

const COLOURS = ["red", "green", "blue"], NORMALS = ["nx", "ny", "nz"];

// Empty arrays for n points: position (less origin, in units of `unit`), rgb and normal where the file has them, and each
// other scalar.
export function arraysFor(head, n) {
  const names = head.vertex.properties.filter((property) => !property.count).map((property) => property.name);
  const coloured = COLOURS.every((name) => names.includes(name)), facing = NORMALS.every((name) => names.includes(name));
  const others = names.filter((name) => !["x", "y", "z", "alpha"].includes(name)
    && !(coloured && COLOURS.includes(name)) && !(facing && NORMALS.includes(name)));
  return {
    position: new Float32Array(3 * n),
    rgb: coloured ? new Uint8Array(3 * n) : null,
    normal: facing ? new Float32Array(3 * n) : null,
    scalar: Object.fromEntries(others.map((name) => [name, new Float32Array(n)])),
  };
}

const colourScale = (type) => (/16|short/.test(type) ? 1 / 257 : /float|double/.test(type) ? 255 : 1);

// Reads n records from a piece; origin (three numbers) is taken off, or null: it is the first point.  What is left is
// counted in units of `unit`, so that no file's numbers are too large or too small for a graphics device.
export function readRecords(head, buffer, start, n, origin, unit = 1) {
  const view = new DataView(buffer), little = head.format !== "binary_big_endian";
  const at = places(head.vertex), into = arraysFor(head, n), stride = head.vertex.stride;
  const value = (name, i) => view[READ[at[name].type]](start + i * stride + at[name].offset, little);
  const zero = origin ?? ["x", "y", "z"].map((name) => (n ? value(name, 0) : 0));
  for (let i = 0; i < n; i++) {
    for (let axis = 0; axis < 3; axis++) into.position[3 * i + axis] = (value("xyz"[axis], i) - zero[axis]) / unit;
    if (into.rgb) COLOURS.forEach((name, c) => { into.rgb[3 * i + c] = value(name, i) * colourScale(at[name].type); });
    if (into.normal) NORMALS.forEach((name, c) => { into.normal[3 * i + c] = value(name, i); });
    for (const name in into.scalar) into.scalar[name][i] = value(name, i);
  }
  return { ...into, count: n, origin: zero, unit };
}

// The numbers of a body one after the other, whatever the format is: next(type) gives one, skip(n, bytes) leaves n out.
function cursorOf(head, buffer) {
  if (head.format === "ascii") {
    const words = new TextDecoder("latin1").decode(buffer.slice(head.bytes)).split(/\s+/);
    let at = words[0] === "" ? 1 : 0;
    return { next: () => Number(words[at++]), skip: (n) => { at += n; } };
  }
  const view = new DataView(buffer), little = head.format !== "binary_big_endian";
  let at = head.bytes;
  return {
    next: (type) => {
      const value = view[READ[type]](at, little);
      at += SIZES[type];
      return value;
    },
    skip: (n, bytes) => { at += bytes; },
  };
}

// A whole file: points, and the triangles of its faces (fans).
export function readWhole(buffer, origin, unit = 1) {
  const head = readHead(buffer), cursor = cursorOf(head, buffer), triangle = [];
  let points = null;
  for (const element of head.elements) {
    const n = element.count;
    if (element === head.vertex && comesInPieces(head)) {
      points = readRecords(head, buffer, head.bytes, n, origin, unit);
      cursor.skip(n * element.properties.length, n * element.stride);
      continue;
    }
    if (element === head.vertex) points = { ...arraysFor(head, n), count: n, origin, unit };
    for (let i = 0; i < n; i++) readElement(element, i, element === head.vertex);
  }
  return { ...points, origin: points.origin ?? [0, 0, 0], triangle: triangle.length ? new Uint32Array(triangle) : null };

  function readElement(element, i, isVertex) {
    const found = {};
    for (const property of element.properties) {
      if (!property.count) {
        found[property.name] = cursor.next(property.type) * (COLOURS.includes(property.name) ? colourScale(property.type) : 1);
        continue;
      }
      const length = cursor.next(property.count), isFace = /^vertex_ind/.test(property.name);
      let first = 0, before = 0;
      for (let k = 0; k < length; k++) {
        const corner = cursor.next(property.type);
        if (k === 0) first = corner;
        else if (k > 1 && isFace) triangle.push(first, before, corner);
        before = corner;
      }
    }
    if (!isVertex) return;
    points.origin ??= [found.x, found.y, found.z];
    [found.x, found.y, found.z].forEach((value, axis) => { points.position[3 * i + axis] = (value - points.origin[axis]) / unit; });
    if (points.rgb) COLOURS.forEach((name, c) => { points.rgb[3 * i + c] = found[name]; });
    if (points.normal) NORMALS.forEach((name, c) => { points.normal[3 * i + c] = found[name]; });
    for (const name in points.scalar) points.scalar[name][i] = found[name];
  }
}

// The numbers from 0 to n - 1 in an order that is everywhere at once: any first part of it is spread over all.
export function mixed(n) {
  const order = new Uint32Array(n), divides = (a, b) => (b ? divides(b, a % b) : a);
  let step = Math.max(1, Math.floor(n * 0.618));
  while (divides(n, step) > 1) step++;
  for (let i = 0, at = 0; i < n; i++, at = at + step >= n ? at + step - n : at + step) order[i] = at;
  return order;
}
