// Reads COPC by npm's copc, cube after cube, and prints what it finds as JSON: node read_copc.mjs FILE
// SPDX-License-Identifier: GPL-3.0-or-later
import { Copc } from "copc";

const file = process.argv[2];
const copc = await Copc.create(file);
const { nodes } = await Copc.loadHierarchyPage(file, copc.info.rootHierarchyPage);
const [low, high] = [copc.info.cube.slice(0, 3), copc.info.cube.slice(3)];
let read = 0, outside = 0, intensities = 0;
for (const [key, node] of Object.entries(nodes)) {
  const [level, ...at] = key.split("-").map(Number);
  const view = await Copc.loadPointDataView(file, copc, node);
  const axes = ["X", "Y", "Z"].map((axis) => view.getter(axis)), intensity = view.getter("Intensity");
  for (let i = 0; i < view.pointCount; i++) {
    axes.forEach((axis, k) => {
      const edge = (high[k] - low[k]) / 2 ** level, begin = low[k] + at[k] * edge;
      if (axis(i) < begin || axis(i) > begin + edge) outside++;
    });
    intensities += intensity(i);
  }
  read += view.pointCount;
}
console.log(JSON.stringify({ points: copc.header.pointCount, read, outside, intensities, cubes: Object.keys(nodes).length }));
