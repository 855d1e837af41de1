// SPDX-License-Identifier: GPL-3.0-or-later
// The page's modules that need no window, one hazard each: numbers, PLY, colours, layers, tiles.  What fetches is given
// files from memory, and what works aside does it at once.
//
// Usage: node modules.mjs MESHES_FOLDER [TILESET_FOLDER]      meshes of a tetrahedron whose corners places.json has, with their
// colours; a tileset of the cloud tilesOf() describes
import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";

import { Group, PerspectiveCamera } from "../../server/page/node_modules/three/build/three.module.js";

const files = new Map(), asked = [];

globalThis.document = { querySelector: () => ({ content: "" }), getElementById: () => null, dispatchEvent() {} };
globalThis.fetch = async (url, { headers = {} } = {}) => {
  asked.push([url, headers.Range ?? ""]);
  if (!files.has(url)) return { ok: false, status: 503, statusText: "away", text: async () => "{}" };
  const [, from, to] = /bytes=(\d+)-(\d+)/.exec(headers.Range) ?? [0, 0, files.get(url).byteLength];
  const piece = files.get(url).slice(Number(from), Number(to) + 1);
  return { ok: true, arrayBuffer: async () => piece, text: async () => new TextDecoder().decode(piece) };
};
const aside = { postMessage: (message) => queueMicrotask(() => aside.answer(message)) };
globalThis.self = aside;
globalThis.Worker = class {
  constructor() {
    aside.answer = (message) => this.onmessage({ data: message });
  }

  postMessage(data) {
    queueMicrotask(() => aside.onmessage({ data }));
  }
};

const page = (name) => import(`../../server/page/${name}.js`);
await page("points_worker");
const { bytes, count, figure, percent, seconds, sentence, together } = await page("words");
const ply = await page("ply"), ramp = await page("ramp"), { MeshLayer, PointLayer } = await page("layers"), { TilesLayer } = await page("tiles");
const extent = await page("extent"), { mixed } = ply, near = (found, wanted, by = 1e-5) => found.length === wanted.length && [...found].every((x, i) => Math.abs(x - wanted[i]) <= by);

// A PLY of rows: properties as "type name", each row's numbers.
const SETTERS = { float: ["setFloat32", 4], double: ["setFloat64", 8], uchar: ["setUint8", 1], ushort: ["setUint16", 2] };
function binary(format, properties, rows) {
  const head = `ply\nformat ${format} 1.0\nelement vertex ${rows.length}\n${properties.map((each) => `property ${each}\n`).join("")}end_header\n`;
  const kinds = properties.map((each) => SETTERS[each.split(" ")[0]]), body = new DataView(new ArrayBuffer(rows.length * kinds.reduce((sum, [, n]) => sum + n, 0)));
  let at = 0;
  for (const row of rows) row.forEach((value, k) => {
    body[kinds[k][0]](at, value, format !== "binary_big_endian");
    at += kinds[k][1];
  });
  return new Uint8Array([...new TextEncoder().encode(head), ...new Uint8Array(body.buffer)]).buffer;
}
const text = (lines) => new TextEncoder().encode(`${lines.join("\n")}\n`).buffer;

const hazards = {
  numbers_are_said_with_their_units() {
    assert.deepEqual([999, 1000, 1023, 1024, 102400, 5 * 1024 ** 3].map(bytes), ["999 B", "1000 B", "1023 B", "1.0 KiB", "100 KiB", "5.0 GiB"]);
    assert.deepEqual([0.04, 9.96, 12, 119, 120, 3600].map(seconds), ["0.0 s", "10.0 s", "12 s", "119 s", "2 min", "60 min"]);
    assert.deepEqual([0, 0.001234567, 1.23456, 12.5, 123456.7, 1e-20, 2e30, -0.5].map(figure),
      ["0", "0.001235", "1.235", "12.5", "123\u202f457", "1.00 × 10^-20", "2.00 × 10^30", "-0.5"]);
    assert.deepEqual([0.1, 0.12345, 1, 0.00001, 4.5e-19].map(percent), ["10 %", "12.3 %", "100 %", "0.001 %", "4.50 × 10^-17 %"]);
    assert.deepEqual(["noise is large", "x, y, ...", ""].map(sentence), ["Noise is large.", "X, y, ...", "."]);
    assert.equal(count(1234567), "1\u202f234\u202f567");
    assert.equal(together("5 % of 3 MiB in 2 s"), "5\u00a0% of 3\u00a0MiB in 2\u00a0s");
  },

  binary_points_of_either_order_are_the_same() {
    const properties = ["double x", "double y", "double z", "ushort red", "ushort green", "ushort blue", "float nx", "float ny", "float nz", "uchar kind"];
    const rows = [[11, 22, 33, 65535, 257, 0, 1, 0, 0, 7], [12, 24, 36, 0, 514, 65535, 0, -1, 0, 9]];
    for (const format of ["binary_little_endian", "binary_big_endian"]) {
      const file = binary(format, properties, rows), head = ply.readHead(file);
      assert.ok(ply.comesInPieces(head));
      const { position, rgb, normal, scalar } = ply.readRecords(head, file, head.bytes, 2, [10, 20, 30], 2);
      assert.deepEqual([...position], [0.5, 1, 1.5, 1, 2, 3]);
      assert.deepEqual([...rgb], [255, 1, 0, 0, 2, 255]);
      assert.deepEqual([...normal], [1, 0, 0, 0, -1, 0]);
      assert.deepEqual([...scalar.kind], [7, 9]);
    }
  },

  faces_are_fans_of_triangles() {
    const file = text(["ply", "format ascii 1.0", "element vertex 5", "property float x", "property float y", "property float z", "property float red", "property float green",
      "property float blue", "element face 2", "property list uchar float shade", "property list uchar int vertex_indices", "end_header",
      ...[0, 1, 2, 3, 4].map((i) => `${i} 0 1 0 0.2 1`), "2 0.5 0.5 4 0 1 2 3", "0 3 2 3 4"]);
    const { triangle, position, rgb, count: n } = ply.readWhole(file, [0, 0, 1]);
    assert.equal(n, 5);
    assert.deepEqual([...triangle], [0, 1, 2, 0, 2, 3, 2, 3, 4]);
    assert.deepEqual([...position].slice(12), [4, 0, 0]);
    assert.deepEqual([...rgb].slice(0, 3), [0, 51, 255]);
  },

  any_first_part_of_the_mixed_order_is_spread_over_all() {
    for (const n of [1, 2, 3, 10, 1000]) {
      const order = mixed(n);
      assert.deepEqual([...order].sort((a, b) => a - b), Array.from({ length: n }, (_, i) => i));
    }
    const first = [...mixed(1000)].slice(0, 50).sort((a, b) => a - b);
    assert.ok(Math.max(...first.slice(1).map((at, i) => at - first[i])) < 60);
  },

  colours_go_from_pale_to_dark_and_end_where_one_in_fifty_is_beyond() {
    assert.deepEqual(ramp.colourOf(0), [222, 224, 226]);
    assert.deepEqual(ramp.colourOf(0.25), [250, 220, 138]);
    assert.deepEqual(ramp.colourOf(2), [112, 6, 44]);
    const range = ramp.rangeOf("distance", Float32Array.from({ length: 120001 }, (_, i) => (i === 60001 ? 1e6 : i / 100000)));
    assert.deepEqual([range.low, range.kind], [0, "deviation"]);
    assert.ok(Math.abs(range.high - 1.176) < 0.001, String(range.high));
    assert.equal(range.most, 1e6); // also where no sample is
    assert.equal(ramp.rangeOf("height", Float32Array.of(-3, 4, 5)).low, -3);
    assert.equal(ramp.rangeOf("intensity", Float32Array.of(0.5, 700)).kind, "grey");
  },

  few_whole_numbers_are_classes_with_how_often_they_are() {
    const { classes } = ramp.rangeOf("classification", Float32Array.of(2, 6, 2, 2, 200));
    assert.deepEqual(classes.map(({ text: said, count: n }) => [said, n]), [["2 ground", 3], ["6 building", 1], ["200", 1]]);
    assert.equal(ramp.rangeOf("time", Float32Array.from({ length: 30 }, (_, i) => i)).classes, undefined);
    assert.equal(ramp.rangeOf("distance", Float32Array.of(0, 1, 2)).classes, undefined);
    assert.equal(ramp.shadesOf({ name: "classification", classes })[4 * 6], 214);
  },

  strays_are_left_out_and_a_mesh_stands_on_its_edges_too() {
    const many = Float32Array.from({ length: 2000 }, (_, i) => i / 1999);
    assert.ok(near(extent.endsOf(many), [0, 1]));
    assert.ok(near(extent.endsOf([...many, 50]), [0, 1], 0.01) && near(extent.endsOf([...many, 1.2]), [0, 1.2]));
    assert.deepEqual([[], [7], [1, 0, 0, 0, 0]].map(extent.endsOf), [[0, 0], [7, 7], [0, 1]]); // of few, none is a stray
    const { middle, size, places } = extent.mostOf({ points: { position: Float32Array.of(1, 2, 3, NaN, 0, 0, 3, 6, 9), count: 3 } });
    assert.deepEqual([middle[2], size[2], places], [4.5, 9, [1, 2, 3, 3, 6, 9]]);
    const foot = [-1, -1, -1, 1, -0.93, -1, 0, -0.93, 1, 0, 1, 0]; // one corner lower than the others
    for (const [up, position] of [["y", foot], ["z", foot.map((_, i) => foot[[0, 2, 1][i % 3] + i - (i % 3)])]]) {
      const points = { position: Float32Array.from(position), count: 4, triangle: Uint32Array.of(0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3) };
      assert.equal(extent.guessUp({ points }, [2, 2, 2]), up);
    }
    assert.equal(extent.guessUp({ points: { position: Float32Array.of(0, 0, 0), count: 1 } }, [2, 2, 0.5]), "z");
  },

  async pieces_of_a_file_are_put_where_they_belong() {
    const n = 60000, rows = Array.from({ length: n }, (_, i) => [i, -i, 2 * i, i % 50]);
    files.set("/v1/cloud.ply", binary("binary_little_endian", ["float x", "float y", "float z", "float distance"], rows));
    for (const ranked of [true, false]) {
      asked.length = 0;
      const layer = await PointLayer.open("/v1/cloud.ply", { origin: [1, 2, 3], unit: 10, area: 1, ranked });
      assert.ok(layer.loaded > 3000 && layer.loaded < n);
      layer.show(10);
      await layer.load(n);
      assert.equal(asked.length, 3); // a beginning, 50 000, the rest
      assert.deepEqual([layer.loaded, layer.shown], [n, 10]);
      assert.ok(layer.fetched - files.get("/v1/cloud.ply").byteLength < 16); // nothing twice but a part of a point
      for (const i of [0, 5000, 59999]) {
        assert.ok(near(layer.points.position.subarray(3 * i, 3 * i + 3), [(i - 1) / 10, (-i - 2) / 10, (2 * i - 3) / 10], 1e-2));
        assert.equal(layer.points.scalar.distance[i], i % 50);
      }
      const { index, drawRange } = layer.geometry; // ranked: the first ones first; else everywhere at once
      assert.equal(Boolean(index), !ranked);
      assert.deepEqual([drawRange.start, drawRange.count], [0, 10]);
      layer.colourBy("height", 1);
      assert.ok(near(layer.points.height.subarray(0, 3), [0, -1, -2], 1e-3));
      const before = layer.material.uniforms.size.value;
      layer.show(n);
      assert.ok(layer.material.uniforms.size.value < before); // more points are smaller
    }
  },

  async a_mesh_is_flat_smooth_or_lines() {
    files.set("/v1/mesh.ply", text(["ply", "format ascii 1.0", "element vertex 4", "property float x", "property float y", "property float z", "property float heat",
      "element face 1", "property list uchar int vertex_indices", "end_header", "0 0 0 1", "2 0 0 2", "2 2 0 3.5", "0 2 0 9", "4 0 1 2 3"]));
    const mesh = await MeshLayer.open("/v1/mesh.ply", { origin: [0, 0, 0], unit: 1 });
    assert.equal(mesh.triangles, 2);
    assert.deepEqual([...mesh.geometry.attributes.normal.array], [0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1]);
    for (const how of ["wireframe", "smooth", "flat"]) {
      mesh.shade(how);
      assert.deepEqual([mesh.material.wireframe, mesh.material.flatShading], [how === "wireframe", how === "flat"]);
    }
    assert.equal(mesh.colourBy("heat").high, 3.5);
    assert.equal(mesh.colourBy("height", 1).high, 2);
    mesh.colourBy("normals");
    assert.ok(mesh.colour[2] > 0.99 && Math.abs(mesh.colour[0] - mesh.colour[1]) < 1e-6 && mesh.colour[0] < 0.3);
  },

  async meshes_of_every_form_are_where_the_file_had_them(folder) {
    const wanted = { origin: [512345, 4123456, 100], unit: 2 }, places = JSON.parse(readFileSync(`${folder}/places.json`));
    for (const name of readdirSync(folder).filter((each) => each.startsWith("mesh"))) {
      files.set(`/v1/${name}`, new Uint8Array(readFileSync(`${folder}/${name}`)).buffer);
      const { points: { position, rgb, count: n }, triangles, geometry } = await MeshLayer.open(`/v1/${name}`, wanted);
      const own = !name.endsWith("stl"), off = own ? 1e-3 : 0.3, { array } = geometry.index; // STL has single precision
      assert.equal(triangles, 4, name);
      for (let i = 0; i < 12; i++) {
        const at = array[i], place = [0, 1, 2].map((k) => 2 * position[3 * at + k] + wanted.origin[k]), colour = rgb && [...rgb.slice(3 * at, 3 * at + 3)];
        const found = places.find(([x, y, z]) => near(place, [x, y, z], off));
        assert.ok(found, `${name}: ${place}`);
        if (own) assert.deepEqual(colour, found.slice(3), name);
      }
      assert.equal(n, 4, name);
    }
  },
};

// Of a tileset made of points whose colours, normals and intensity tell their place: x = red, y = green, z = blue, intensity = x.
async function tilesOf(folder) {
  const tree = JSON.parse(readFileSync(`${folder}/tileset.json`)), all = [];
  const put = (tile) => {
    files.set(`/v1/t/${tile.content.uri}`, new Uint8Array(readFileSync(`${folder}/${tile.content.uri}`)).buffer);
    for (const below of tile.children ?? []) put(below);
  };
  files.set("/v1/t/tileset.json", new Uint8Array(readFileSync(`${folder}/tileset.json`)).buffer);
  put(tree.root);
  const layer = await TilesLayer.open("/v1/t/tileset.json", { origin: [10, 20, 30], unit: 2, area: 1, budget: 1e6, changed() {}, said() {} });
  const visit = async (tile) => {
    if (!tile.points) await layer.fetch(tile);
    all.push(tile);
    for (const below of tile.below) await visit(below);
  };
  await visit(layer.root);
  return { layer, all };
}

async function tiles_have_their_points_where_the_file_had_them(folder) {
  const { layer, all } = await tilesOf(folder);
  let n = 0;
  for (const { points: { position, rgb, normal, scalar, count: m }, box } of all) {
    for (let i = 0; i < m; i++) {
      const place = [0, 1, 2].map((k) => 2 * position[3 * i + k] + [10, 20, 30][k]);
      assert.ok(near(place, [...rgb.subarray(3 * i, 3 * i + 3)], 0.51), `${place} has ${rgb.subarray(3 * i, 3 * i + 3)}`);
      const length = Math.hypot(...place.map((c) => c - 128));
      assert.ok(near(normal.subarray(3 * i, 3 * i + 3), place.map((c) => (c - 128) / length), 0.02));
      assert.ok(Math.abs(scalar.intensity[i] - place[0]) < 0.51);
      assert.ok([0, 1, 2].every((k) => position[3 * i + k] >= box.min.getComponent(k) - 1e-4 && position[3 * i + k] <= box.max.getComponent(k) + 1e-4));
    }
    n += m;
  }
  assert.equal(n, layer.count);
  assert.equal(layer.colourBy("height", 2).name, "height");
}

// A tile that can't be fetched is asked for again, and said.
async function tiles_that_do_not_come_are_asked_for_again(folder) {
  const { layer, all } = await tilesOf(folder), [, tile] = all, url = [...files.keys()].find((each) => each.endsWith(tile.url.split("/").pop()));
  const kept = files.get(url), usual = globalThis.setTimeout;
  layer.free(tile);
  files.delete(url);
  globalThis.setTimeout = (work) => usual(work, 0);
  await layer.fetch(tile);
  await new Promise((resolve) => usual(resolve, 5));
  globalThis.setTimeout = usual;
  assert.ok(layer.fault && !tile.asked && !tile.points);
  files.set(url, kept);
  await layer.fetch(tile);
  assert.ok(!layer.fault && tile.points.count > 0);
}

// Of tiles that are all there, those within the picture are drawn, and no more than the budget has points for; the first one always.
async function tiles_that_are_drawn_are_within_the_budget_and_the_picture(folder) {
  const { layer, all } = await tilesOf(folder), camera = new PerspectiveCamera(35, 1, 0.01, 1000), nearby = 20000; // pixels of a unit
  const drawn = (budget) => {
    layer.budget = budget;
    layer.see(camera, new Group(), nearby);
    return layer.chosen.reduce((sum, { points }) => sum + points.count, 0);
  };
  const middle = [10, 20, 30].map((c) => (128 - c) / 2);
  camera.position.set(...middle).z += 300;
  camera.lookAt(...middle);
  camera.updateMatrixWorld();
  assert.equal(drawn(layer.count), layer.count);
  assert.deepEqual(layer.chosen.map(({ url }) => url).sort(), all.map(({ url }) => url).sort());
  const first = layer.root.points.count;
  for (let budget = 1; budget < layer.count; budget += Math.ceil(layer.count / 23)) {
    const points = drawn(budget);
    assert.ok(points <= Math.max(budget, first) && points >= first, `${points} of ${budget}`);
    assert.ok(layer.shown <= budget);
  }
  camera.lookAt(middle[0], middle[1], 1000);
  camera.updateMatrixWorld();
  assert.equal(drawn(layer.count), 0);
}

const [, , meshes, folder] = process.argv;
const tileHazards = folder ? { tiles_have_their_points_where_the_file_had_them, tiles_that_do_not_come_are_asked_for_again,
  tiles_that_are_drawn_are_within_the_budget_and_the_picture } : {};
for (const [name, hazard] of Object.entries({ ...hazards, ...tileHazards })) {
  await hazard(name in hazards ? meshes : folder);
  console.log(name);
}
