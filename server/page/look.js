// SPDX-License-Identifier: GPL-3.0-or-later
// The part of the page that shows a result: what is before, what is after, and how it is coloured.
import { MeshLayer, PointLayer } from "./layers.js";
import { drawHistogram } from "./ramp.js";
import { Viewer } from "./viewer.js";
import { count, figure, find, make, percent } from "./words.js";

const MOST_AT_ONCE = 2000000; // points of the original that are fetched without being asked for
const FIRST = 50000; // points of the first view

let viewer = null, now = null, picked = [];

function fill(id, options, chosen) {
  find(id).replaceChildren(...options.map(([value, text]) => make("option", { value, selected: value === chosen }, text)));
}

// How much of the box what is lowest along an axis spans, in the other two (as core/picture/view.c has it).
function footing(position, count, axis, size) {
  const others = [0, 1, 2].filter((other) => other !== axis), spans = others.map(() => [Infinity, -Infinity]);
  for (let i = 0; i < count; i++) {
    if (position[3 * i + axis] > (0.03 - 0.5) * size[axis]) continue;
    others.forEach((other, k) => {
      const x = position[3 * i + other];
      spans[k] = [Math.min(spans[k][0], x), Math.max(spans[k][1], x)];
    });
  }
  return spans.reduce((share, [low, high], k) => share * Math.max(0, high - low) / size[others[k]], 1);
}

const isFlat = (size) => size[2] < 0.4 * size[0] && size[2] < 0.4 * size[1];

// Which axis points upwards: z of what is flat, else the one that the points stand on.
function guessUp({ points, loaded = points.count }, size) {
  if (isFlat(size)) return "z";
  return footing(points.position, loaded, 1, size) > footing(points.position, loaded, 2, size) ? "y" : "z";
}

// What there is to be seen: [value, text, url].
function sourcesOf(job, outputs) {
  const at = (name) => outputs.find((output) => output.name === name)?.href, before = [], after = [];
  if (at("error.ply")) before.push(["error", "deviation", at("error.ply")]);
  if (job.input.format?.startsWith("ply/")) before.push(["own", "the file's points", `/v1/clouds/${job.input.sha256}/data`]);
  if (at("dso.ply")) before.push(["dso", "shape operator", at("dso.ply")]);
  if (at("mesh.ply")) after.push(["mesh", "mesh", at("mesh.ply")]);
  if (at("cloud.ply")) after.push(["cloud", "points", at("cloud.ply")]);
  for (const output of outputs.filter((each) => /^mesh_.*\.ply$/.test(each.name))) {
    after.push([output.name, `mesh at ${percent(Number(output.name.slice(5, -4)))}`, output.href]);
  }
  return { before, after };
}

function put(side, layer) {
  const { root } = viewer.sides[side], old = now.layers[side];
  if (old) {
    root.remove(old.object);
    old.dispose();
  }
  now.layers[side] = layer;
  if (layer) root.add(layer.object);
  viewer.ask();
}

function legend(layer, range) {
  find("legend").hidden = !range;
  if (!range) return;
  drawHistogram(find("legend-bars"), range);
  const name = layer.by.name;
  find("legend-low").textContent = figure(range.low);
  find("legend-high").textContent = `${range.most > range.high ? "over " : ""}${figure(range.high)}`;
  find("legend-name").textContent = name === "distance" ? `deviation, largest ${figure(range.most)}` : name;
}

// Colours of the side that the list is for: before, where that is seen, else after.
const colouredSide = () => (viewer.layout === "after" || !now.layers[0] ? 1 : 0);

function listColours() {
  const layer = now.layers[colouredSide()], names = layer?.attributes ?? ["own", "plain"];
  fill("look-colour", names.map((name) => [name, { own: "its own", plain: "none", distance: "deviation" }[name] ?? name]), layer?.by?.name);
}

function colour(name) {
  const side = colouredSide(), layer = now.layers[side];
  const range = layer?.colourBy(name) ?? null;
  legend(layer, range);
  viewer.ask();
}

function sayLevel() {
  const layer = now.layers[1], row = find("level-row"), isCloud = layer instanceof PointLayer;
  row.hidden = !layer;
  find("look-level").disabled = !isCloud && !now.sources.after.some(([name]) => name === "cloud");
  if (!layer) return;
  const text = isCloud ? `${count(layer.shown)} of ${count(layer.count)} points, ${percent(layer.shown / now.pointsIn)} of the original`
    : `${count(layer.triangles)} triangles`;
  find("level-text").textContent = text;
  find("look-level").setAttribute("aria-valuetext", text);
}

// The slider's places are even in powers of ten, from one point in a thousand.
const levelPoints = (layer) => Math.max(1, Math.round(layer.count * 10 ** (3 * (find("look-level").value / 1000 - 1))));

async function level() {
  const layer = now.layers[1];
  if (!(layer instanceof PointLayer)) return sayLevel();
  const wanted = levelPoints(layer);
  layer.show(wanted);
  sayLevel();
  viewer.ask();
  await layer.load(wanted, () => {
    if (now.layers[1] !== layer) return;
    layer.show(levelPoints(layer));
    sayLevel();
    viewer.ask();
  });
}

const openPoints = (url, ranked) => PointLayer.open(url,
  { origin: now.origin, area: now.area, reach: Math.hypot(...now.size), ranked });

async function showBefore(value) {
  const source = now.sources.before.find(([name]) => name === value), shown = now;
  if (!source) return;
  const layer = await openPoints(source[2], false);
  if (shown !== now) return;
  put(0, layer);
  const more = () => {
    layer.show(layer.loaded);
    viewer.ask();
  };
  const name = { error: "distance", dso: "dso" }[value], dye = () => {
    if (now.layers[0] === layer) legend(layer, name ? layer.colourBy(name) : null);
  };
  dye();
  more();
  await layer.load(FIRST, more);
  dye();
  if (layer.count <= MOST_AT_ONCE) await layer.load(layer.count, more);
  if (now.layers[0] !== layer) return;
  dye();
  more();
  listColours();
}

async function showAfter(value) {
  const source = now.sources.after.find(([name]) => name === value), shown = now;
  if (!source) return;
  const layer = await (value === "cloud" ? openPoints(source[2], true) : MeshLayer.open(source[2], now.origin));
  if (shown !== now) return;
  put(1, layer);
  if (layer instanceof MeshLayer) layer.shade(find("look-mesh").value);
  await level();
  sayLevel();
  if (colouredSide() === 1) listColours();
}

function measure(place) {
  if (!place) return;
  picked = picked.length === 2 ? [place] : [...picked, place];
  viewer.mark(picked);
  find("measure-text").textContent = picked.length === 2
    ? `${figure(picked[0].distanceTo(picked[1]))} between the two places, in the file's units` : "Pick the second place.";
}

function layOut(layout) {
  viewer.layout = layout;
  find("look-bar").hidden = layout !== "swipe";
  find("look-left").hidden = layout === "after";
  find("look-right").hidden = layout === "before";
  listColours();
  viewer.ask();
}

function listen() {
  const on = (id, what) => find(id).addEventListener("change", (event) => what(event.target.value));
  on("look-layout", layOut);
  on("look-before", showBefore);
  on("look-after", showAfter);
  on("look-colour", colour);
  on("look-up", (up) => viewer.turnUp(up));
  on("look-mesh", (how) => {
    if (now.layers[1] instanceof MeshLayer) now.layers[1].shade(how);
    viewer.ask();
  });
  find("look-level").addEventListener("input", () => { // levels are those of points
    if (!(now.layers[1] instanceof MeshLayer)) return level();
    if (now.sources.after.some(([name]) => name === "cloud") && find("look-after").value !== "cloud") {
      find("look-after").value = "cloud";
      return showAfter("cloud");
    }
  });
  find("look-bar").addEventListener("input", (event) => {
    viewer.bar = event.target.value / 100;
    viewer.ask();
  });
  find("look-reset").addEventListener("click", () => viewer.reset());
  const toggle = (id, what) => find(id).addEventListener("click", ({ currentTarget: button }) => {
    const pressed = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", pressed);
    what(pressed);
  });
  toggle("look-measure", (pressed) => {
    viewer.picking = pressed ? measure : null;
    find("look-canvas").classList.toggle("picking", pressed);
    picked = [];
    viewer.mark(null);
    find("measure-text").textContent = pressed ? "Pick two places." : "";
  });
  toggle("look-box", (pressed) => {
    viewer.showBox(pressed);
    find("measure-text").textContent = pressed ? `${now.size.map(figure).join(" × ")} in the file's units` : "";
  });
  find("look-shot").addEventListener("click", async () => {
    const url = URL.createObjectURL(await viewer.picture());
    make("a", { href: url, download: `${now.name}.png` }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => viewer.ask());
}

// Shows a job that has ended well.  Throws where there is no WebGL.
export async function look(job, outputs) {
  if (!viewer) {
    viewer = new Viewer(find("look-canvas"));
    listen();
  }
  leave();
  const { box_min: low, box_max: high } = job.report.input, size = high.map((x, i) => x - low[i]);
  const [a, b, c] = size;
  now = { name: job.label || job.id, origin: low.map((x, i) => (x + high[i]) / 2), size, layers: [null, null],
    area: job.report.mesh?.area || 0.8 * (a * b + b * c + c * a) || Math.max(a, b, c) ** 2 || 1, pointsIn: job.report.points_in, sources: sourcesOf(job, outputs) };
  viewer.frame(size, "z");
  find("look-level").value = 1000;
  const { before, after } = now.sources;
  fill("look-before", before.length ? before : [["", "nothing"]]);
  fill("look-after", after.length ? after : [["", "nothing"]]);
  const layout = before.length && after.length ? (innerWidth < 700 ? "swipe" : "side") : before.length ? "before" : "after";
  find("look-layout").value = layout;
  layOut(layout);
  const shown = now, first = after.length ? showAfter(after[0][0]) : showBefore(before[0]?.[0]);
  const turned = first.then(() => {
    const layer = now.layers[1] ?? now.layers[0];
    if (shown !== now || !layer) return;
    find("look-up").value = guessUp(layer, size);
    viewer.turnUp(find("look-up").value);
  });
  await Promise.all([turned, after.length ? showBefore(before[0]?.[0]) : null]);
  sayLevel();
}

// Frees what is shown.
export function leave() {
  if (!viewer || !now) return;
  for (const side of [0, 1]) put(side, null);
  viewer.mark(null);
  viewer.showBox(false);
  for (const id of ["look-measure", "look-box"]) find(id).setAttribute("aria-pressed", "false");
  viewer.picking = null;
  find("measure-text").textContent = "";
  find("legend").hidden = true;
}

// For tests: what is drawn.
export const drawn = () => ({ frames: viewer.frames, busy: Boolean(viewer.drawing), layers: now.layers.map((layer) => layer && {
  shown: layer.shown ?? null, count: layer.count ?? null, triangles: layer.triangles ?? null, fetched: layer.fetched }) });
