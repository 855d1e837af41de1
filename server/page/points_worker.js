// SPDX-License-Identifier: GPL-3.0-or-later
// Parses off the page's own thread.  A message {id, what, ...} is answered by {id, result} or {id, error}.
import { readMesh } from "./mesh.js";
import { mixed, readRecords, readWhole } from "./ply.js";

const work = {
  records: ({ head, buffer, start, count, origin, unit }) => readRecords(head, buffer, start, count, origin, unit),
  mix: ({ count }) => ({ order: mixed(count) }),
  mesh: ({ kind, buffer, origin, unit }) => readMesh(kind, buffer, origin, unit),
  whole: ({ buffer, origin, unit }) => readWhole(buffer, origin, unit),
};

self.onmessage = ({ data }) => {
  try {
    const result = work[data.what](data);
    const owned = [result.order, result.position, result.rgb, result.normal, result.triangle, ...Object.values(result.scalar ?? {})]
      .filter(Boolean).map((array) => array.buffer);
    self.postMessage({ id: data.id, result }, owned);
  } catch (error) {
    self.postMessage({ id: data.id, error: String(error) });
  }
};
