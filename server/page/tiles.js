// SPDX-License-Identifier: GPL-3.0-or-later
// A cloud as 3D Tiles, as core/tileset writes them: of the tree of tiles, those are fetched and drawn that show most from
// where the camera is, up to a budget of points.  What isn't seen for a while is given back.
//
// A tile's geometricError is the radius of the largest hole that is there without those below it, so what is below is
// wanted where that hole would be seen, the largest first.  Those above a tile are drawn with it (refine ADD).
import * as THREE from "three";

import { ask } from "./api.js";
import { attributesOf, dots, paint, widthOf } from "./dots.js";
import { coloursOf, every, readGlb, scalarsOf } from "./gltf.js";
import { mixed } from "./ply.js";
import { rangeOf } from "./ramp.js";

const HOLE_PX = 1.5; // a hole's radius on the screen that isn't worth another tile, in pixels of CSS
const DOT_PX = 2.2; // how wide a point is, at least; nearer, as wide as all of them have to be to cover the surface
const ABREAST = 6, TRIES = 4, PAUSE_MS = 2000; // requests at a time, of a tile; before one is asked for again
const GUESS = 16000; // points of a tile that hasn't come yet

// A tile's points around `origin` in units of `unit`, in the file's axes (y is upwards in glTF, z in a tileset); offset: the
// tileset's own.
function pointsOf(buffer, offset, { origin, unit }) {
  const { found, node } = readGlb(buffer), { all, stride, count: n } = found.POSITION;
  const scale = node.scale ?? [1, 1, 1], shift = node.translation ?? [0, 0, 0], position = new Float32Array(3 * n);
  const move = [shift[0] + offset[0] - origin[0], -shift[2] + offset[1] - origin[1], shift[1] + offset[2] - origin[2]];
  for (let i = 0; i < n; i++) {
    position[3 * i] = (all[stride * i] * scale[0] + move[0]) / unit;
    position[3 * i + 1] = (-all[stride * i + 2] * scale[2] + move[1]) / unit;
    position[3 * i + 2] = (all[stride * i + 1] * scale[1] + move[2]) / unit;
  }
  const points = { position, count: n, origin, rgb: coloursOf(found), normal: null, scalar: scalarsOf(found) };
  if (found.NORMAL) {
    const { all: from, stride: step, scale: by } = found.NORMAL;
    points.normal = new Float32Array(3 * n);
    for (let i = 0; i < n; i++) {
      points.normal[3 * i] = from[step * i] * by;
      points.normal[3 * i + 1] = -from[step * i + 2] * by;
      points.normal[3 * i + 2] = from[step * i + 1] * by;
    }
  }
  return points;
}

// The tree as the page walks it; boxes are around the origin, in units of `unit`.
function treeOf(tile, move, unit, folder) {
  const { box } = tile.boundingVolume, half = [box[3], box[7], box[11]].map((c) => c / unit), low = half.map((c, k) => (box[k] + move[k]) / unit - c);
  return { url: folder + tile.content.uri, hole: tile.geometricError / unit, box: new THREE.Box3(new THREE.Vector3(...low),
    new THREE.Vector3(...low.map((c, k) => c + 2 * half[k]))), below: (tile.children ?? []).map((each) => treeOf(each, move, unit, folder)),
  points: null, object: null, asked: false, tries: 0, seen: 0 };
}

const countOf = (tile) => 1 + tile.below.reduce((sum, each) => sum + countOf(each), 0);

export class TilesLayer {
  // url: of tileset.json; origin, unit, area: as in layers.js; budget: points that are drawn at most; changed(layer): when something has come; said(layer): when
  // other tiles are drawn.
  static async open(url, { origin, unit, area, budget, changed, said }) {
    const text = await (await ask(url)).text(), json = JSON.parse(text), layer = new TilesLayer(), { transform } = json.root;
    const offset = transform ? transform.slice(12, 15) : [0, 0, 0], move = offset.map((c, k) => c - origin[k]);
    Object.assign(layer, { origin, unit, offset, budget, most: budget, changed, said, count: json.metadata?.properties?.points ?? 0, fetched: text.length,
      root: treeOf(json.root, move, unit, url.slice(0, url.lastIndexOf("/") + 1)), object: new THREE.Group(), material: dots(), chosen: [], shown: 0,
      held: new Set(), flying: 0, turn: 0, by: { name: "plain", range: null }, stop: new AbortController(), fault: "" });
    layer.all = countOf(layer.root);
    layer.spread(area);
    Object.assign(layer.object.userData, { uniforms: layer.material.uniforms, dot: DOT_PX, shown: 0,
      part: (begin, count) => layer.part(begin, count), see: (camera, root, high) => layer.see(camera, root, high) });
    await layer.fetch(layer.root);
    if (!layer.root.points) throw new Error(layer.fault);
    const { points } = layer.root;
    layer.attributes = attributesOf(points, Boolean(points.normal));
    layer.colourBy(points.rgb ? "own" : "plain");
    return layer;
  }

  // Has all points together cover a surface of that area.
  spread(area) {
    this.material.uniforms.size.value = widthOf(area, this.count);
  }

  async fetch(tile) {
    tile.asked = true;
    tile.tries++;
    this.flying++;
    try {
      const buffer = await (await ask(tile.url, { signal: this.stop.signal })).arrayBuffer();
      this.fetched += buffer.byteLength;
      tile.points = pointsOf(buffer, this.offset, this);
      this.make(tile);
      this.held.add(tile);
      this.fault = "";
    } catch (error) {
      if (this.stop.signal.aborted) return;
      this.fault = error.message;
      setTimeout(() => {
        tile.asked = false;
        this.changed(this);
      }, PAUSE_MS);
    } finally {
      this.flying--;
    }
    this.changed(this);
  }

  make(tile) {
    const { position, rgb, normal } = tile.points, geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
    if (rgb) geometry.setAttribute("tint", new THREE.BufferAttribute(rgb, 3, true));
    if (normal) geometry.setAttribute("normal", new THREE.BufferAttribute(normal, 3));
    geometry.setIndex(new THREE.BufferAttribute(mixed(tile.points.count), 1)); // a tile's first points show all of it
    geometry.boundingSphere = tile.box.getBoundingSphere(new THREE.Sphere());
    tile.object = new THREE.Points(geometry, this.material);
    tile.object.frustumCulled = false; // only tiles that are seen are in the group
    this.value(tile);
  }

  // What a tile's points are coloured by.
  value(tile) {
    const { name, axis } = this.by, { points, object: { geometry } } = tile;
    const values = name === "height" ? every(points.count, (i) => this.unit * points.position[3 * i + axis] + this.origin[axis]) : points.scalar[name];
    if (values) geometry.setAttribute("value", new THREE.BufferAttribute(values, 1));
    else geometry.deleteAttribute("value");
    return values;
  }

  // Returns the range of the values of what has come, null where there is none.  axis: which of x, y, z is height.
  colourBy(name, axis = 2) {
    this.by = { name, axis, range: null };
    const values = [...this.held].map((tile) => this.value(tile));
    if (values.length && values[0]) {
      const together = new Float32Array(values.reduce((sum, each) => sum + each.length, 0));
      let at = 0;
      for (const each of values) {
        together.set(each, at);
        at += each.length;
      }
      this.by.range = rangeOf(name, together);
    }
    paint(this.material.uniforms, this.by, Boolean(this.root.points?.normal));
    return this.by.range;
  }

  // Chooses what is drawn: of the tiles within the picture, those first whose absence would leave the largest holes.
  // root: what turns this group; high: pixels of CSS that a unit at distance 1 is high.
  see(camera, root, high) {
    root.updateMatrixWorld();
    const turned = new THREE.Matrix4().multiplyMatrices(camera.matrixWorldInverse, root.matrixWorld);
    const view = new THREE.Frustum().setFromProjectionMatrix(new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, turned));
    const eye = root.worldToLocal(camera.position.clone()), queue = [{ tile: this.root, need: Infinity }], chosen = [], wanted = [];
    this.turn++;
    for (let points = 0; queue.length && points < this.budget;) {
      const { tile } = queue.splice(queue.reduce((best, each, i) => (each.need > queue[best].need ? i : best), 0), 1)[0];
      if (!view.intersectsBox(tile.box)) continue;
      points += tile.points?.count ?? GUESS;
      if (points > this.budget && tile !== this.root) break;
      if (!tile.points) {
        if (!tile.asked && tile.tries < TRIES) wanted.push(tile);
        continue;
      }
      chosen.push(tile);
      tile.seen = this.turn;
      const need = tile.hole * high / Math.max(tile.box.distanceToPoint(eye), camera.near);
      if (need > HOLE_PX) for (const below of tile.below) queue.push({ tile: below, need });
    }
    for (const tile of wanted) if (this.flying < ABREAST) this.fetch(tile);
    this.draw(chosen);
  }

  draw(chosen) {
    this.object.clear();
    for (const { object } of chosen) this.object.add(object);
    const differs = chosen.length !== this.chosen.length || chosen.some((tile, i) => tile !== this.chosen[i]);
    const before = this.shown;
    this.chosen = chosen;
    this.shown = this.object.userData.shown = Math.min(this.budget, chosen.reduce((sum, { points }) => sum + points.count, 0));
    let held = [...this.held].reduce((sum, { points }) => sum + points.count, 0);
    for (const tile of [...this.held].sort((a, b) => a.seen - b.seen)) {
      if (held <= 2 * this.most || tile.seen === this.turn || tile === this.root) break;
      held -= tile.points.count;
      this.free(tile);
    }
    if (differs || this.shown !== before || this.fault) this.said(this);
  }

  free(tile) {
    tile.object.geometry.dispose();
    Object.assign(tile, { points: null, object: null, asked: false, tries: 0 });
    this.held.delete(tile);
  }

  // Draws count of the points that are chosen, from begin on.
  part(begin, count) {
    for (const { points, object } of this.chosen) {
      const from = Math.max(0, begin), to = Math.min(points.count, begin + count);
      object.geometry.setDrawRange(from, Math.max(0, to - from));
      object.visible = to > from;
      begin -= points.count;
    }
  }

  get points() {
    return this.root.points;
  }

  get waiting() {
    return this.flying > 0;
  }

  dispose() {
    this.stop.abort();
    for (const tile of [...this.held]) this.free(tile);
    this.material.uniforms.ramp.value.dispose();
    this.material.dispose();
  }
}
