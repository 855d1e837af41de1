// SPDX-License-Identifier: GPL-3.0-or-later
// The part of the page that shows a result: what is before, what is after, and how it is coloured.
import { Unreachable } from "./api.js";
import { areaOf, guessUp, mostOf } from "./extent.js";
import { MeshLayer, PointLayer } from "./layers.js";
import { MESH_KINDS } from "./mesh.js";
import { drawLegend } from "./ramp.js";
import { TilesLayer } from "./tiles.js";
import { Viewer } from "./viewer.js";
import { capital, count, figure, find, make, nameOf, percent } from "./words.js";

const MOST_AT_ONCE = 2000000; // points of the original that are fetched without being asked for
const FIRST = 50000; // points of the first view
const BUDGET = matchMedia("(pointer: coarse)").matches ? 200000 : 1000000; // points of tiles that are drawn at once

const PAUSE_MS = 2000; // before a service that doesn't answer is asked again

const SIDES = [0, 1]; // before, after

let viewer = null, now = null, picked = [];

function fill(id, options, chosen) {
  find(id).replaceChildren(...options.map(([value, text]) => make("option", { value, selected: value === chosen }, text)));
}

const FORMS = { glb: "glTF", obj: "OBJ", stl: "STL" }; // of meshes, where they aren't PLY

// The meshes among the outputs, {name, href, kind, ratio} of each, the finest first; of several files of the same mesh, one.
function meshesOf(outputs) {
  const found = new Map();
  for (const kind of MESH_KINDS) {
    for (const { name, href } of outputs) {
      const [whole, , ratio] = /^mesh(_(.*))?\.\w+$/.exec(name) ?? [];
      if (whole && name.endsWith(`.${kind}`) && !found.has(ratio)) found.set(ratio, { name, href, kind, ratio: Number(ratio ?? 1) });
    }
  }
  if (found.size > 1) found.delete(undefined); // it is the finest of the levels
  return [...found.values()].sort((a, b) => b.ratio - a.ratio);
}

// What there is to be seen: [value, text, url].
function sourcesOf(job, outputs) {
  const at = (name) => outputs.find((output) => output.name === name)?.href, before = [], after = [];
  if (at("error.ply")) before.push(["error", "deviation", at("error.ply")]);
  if (job.input.format?.startsWith("ply/")) before.push(["own", "the file itself", `/v1/clouds/${job.input.sha256}/data`]);
  if (at("dso.ply")) before.push(["dso", "shape operator", at("dso.ply")]);
  const meshes = meshesOf(outputs), levels = meshes.filter(({ name }) => name.startsWith("mesh_"));
  for (const { name, href, kind, ratio } of meshes) {
    const form = FORMS[kind] ? ` (${FORMS[kind]})` : "";
    after.push(levels.length ? [name, `mesh at ${percent(ratio)}${form}`, href] : ["mesh", `mesh${form}`, href]);
  }
  if (at("cloud.ply")) after.push(["cloud", "points", at("cloud.ply")]);
  if (at("tileset.3tz")) after.splice(job.report.points_out > BUDGET ? 0 : after.length, 0, ["tiles", "points, as tiles", `/v1/jobs/${job.id}/tileset/tileset.json`]);
  return { before, after, levels };
}

// Why a side shows nothing, and what would be shown.
function sayWhy({ input }, outputs) {
  const { before, after } = now.sources, said = [], form = input.format?.split("/")[0].toUpperCase() ?? "The file";
  if (!before.length) said.push(`Before: ${form} isn't drawn here. Make “deviation of every point” too, and its points are shown.`);
  if (!after.length) {
    const made = outputs.map(({ name }) => name).filter((name) => name.startsWith("cloud"));
    said.push(`After: ${made.length ? `${made.join(", ")} can't be drawn here` : "nothing was made that is drawn here"}. Points as PLY or 3D Tiles and meshes of any form are shown.`);
  }
  find("look-why").textContent = said.join(" ");
  find("look-why").hidden = !said.length;
}

function put(side, layer) {
  const { root } = viewer.sides[side], old = now.layers[side];
  if (old) {
    root.remove(old.object);
    old.dispose();
  }
  now.layers[side] = layer;
  layer?.spread?.(now.area);
  if (layer) root.add(layer.object);
  viewer.ask();
}

const NAMES = { own: "own colours", plain: "one colour", distance: "deviation", dso: "shape operator", rgb: "colour" };
const TITLES = { distance: "Deviation of each point, in the file's units", height: "Height, in the file's units",
  dso: "Discrete shape operator: how much the surface bends" };

const attributeName = (name) => NAMES[name] ?? name.replace(/^scalar_/, "").replaceAll("_", " ");

function listColours(side) {
  const names = now.layers[side]?.attributes ?? ["plain"];
  fill(`look-colour-${side}`, names.map((name) => [name, attributeName(name)]), now.layers[side]?.by?.name);
}

// Colours a side by an attribute that it has, and says what the colours mean.
function colour(side, name) {
  const layer = now.layers[side], range = layer?.colourBy(name, "xyz".indexOf(viewer.up)) ?? null;
  drawLegend(find(`legend-${side}`), range, TITLES[name] ?? capital(attributeName(name)));
  viewer.ask();
}

// What a side is coloured by when it is first seen, or when what it shows was changed.
function firstColour(side, source) {
  const { attributes } = now.layers[side], wanted = { error: "distance", dso: "dso" }[source];
  return [wanted, now.colours[side], "own", "plain"].find((name) => attributes.includes(name));
}

function sayLevelText(text) {
  find("level-text").textContent = text;
  find("look-level").setAttribute("aria-valuetext", text);
}

// Of tiles the slider says how many points may be drawn at once; which ones follows the camera.
function sayTiles(layer) {
  sayLevelText(`${count(layer.shown)} of ${count(layer.count)} points, in ${count(layer.chosen.length)} of ${count(layer.all)} tiles`);
  find("level-help").textContent = layer.fault || `Nearer shows more, up to ${count(layer.budget)} points at once.`;
}

function sayLevel() {
  const layer = now.layers[1], isCloud = layer instanceof PointLayer, { levels } = now.sources;
  find("level-row").hidden = !layer;
  find("look-level").disabled = layer instanceof MeshLayer && levels.length < 2 && !hasCloud();
  if (!layer) return;
  if (layer instanceof TilesLayer) return sayTiles(layer);
  const share = isCloud ? layer.shown / now.pointsIn : levels.find(({ name }) => name === find("look-after").value)?.ratio;
  let text = isCloud ? `${count(layer.shown)} of ${count(layer.count)} points, ${percent(share)} of the original` : `${count(layer.triangles)} triangles`;
  if (!isCloud && share) text += `, of ${percent(share)} of the points`;
  sayLevelText(text);
  find("level-help").textContent = isCloud || levels.length > 1 ? "" : hasCloud() ? "Move it to see the points: the first ones of the file are a coarser cloud." : "";
}

const hasCloud = () => now.sources.after.some(([name]) => name === "cloud");

// The slider's places are even in powers of ten, from one point in a thousand.
const levelShare = () => 10 ** (3 * (find("look-level").value / 1000 - 1));
const levelPoints = (layer) => Math.max(1, Math.round(layer.count * levelShare()));

async function level() {
  const layer = now.layers[1];
  if (layer instanceof TilesLayer) {
    layer.budget = Math.round(layer.most * levelShare());
    viewer.ask();
  }
  if (!(layer instanceof PointLayer)) return sayLevel();
  const wanted = levelPoints(layer);
  layer.show(wanted);
  sayLevel();
  viewer.ask();
  await fetchPoints(layer, wanted, () => {
    if (now.layers[1] !== layer) return;
    layer.show(levelPoints(layer));
    sayLevel();
    viewer.ask();
  });
}

// The level was moved: of meshes, the nearest that there is; of a mesh alone, its cloud.
function moveLevel() {
  if (!(now.layers[1] instanceof MeshLayer)) return level();
  const { levels } = now.sources, wanted = Math.log(levelShare() * (levels[0]?.ratio ?? 1));
  const nearest = levels.reduce((a, b) => (a && Math.abs(Math.log(a.ratio) - wanted) <= Math.abs(Math.log(b.ratio) - wanted) ? a : b), null);
  const value = levels.length > 1 ? nearest.name : hasCloud() ? "cloud" : find("look-after").value;
  if (find("look-after").value === value) return;
  find("look-after").value = value;
  return showAfter(value);
}

// Does work that fetches something while isWanted(), also from a service that is away for a while.
async function patiently(work, isWanted) {
  for (let lost = false; ;) {
    try {
      const made = await work();
      if (lost) find("news").textContent = "";
      return made;
    } catch (error) {
      if (!(error instanceof Unreachable) || !isWanted()) throw error;
      lost = true;
      find("news").textContent = `${error.message} What is missing comes as soon as it answers.`;
      await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
    }
  }
}

// The first n points of a layer, while it is looked at.
const fetchPoints = (layer, n, more) => patiently(() => layer.load(n, more), () => now.layers.includes(layer));

// Tiles come while the camera moves; the colours' range is that of all that had come when nothing more was wanted.
async function openTiles(url) {
  let wholly = false;
  const isShown = (layer) => now?.layers[1] === layer;
  return TilesLayer.open(url, { origin: now.origin, unit: now.unit, area: now.area, budget: BUDGET, said: (layer) => isShown(layer) && sayLevel(), changed: (layer) => {
    if (!isShown(layer)) return;
    if (!layer.waiting && !wholly && layer.by.range) {
      wholly = true;
      colour(1, layer.by.name);
    }
    viewer.ask();
  } });
}

const openPoints = (url, ranked) => PointLayer.open(url,
  { origin: now.origin, unit: now.unit, area: now.area, ranked });

async function showBefore(value) {
  const source = now.sources.before.find(([name]) => name === value), shown = now;
  if (!source) return;
  const isWanted = () => shown === now && find("look-before").value === value;
  const layer = await patiently(() => openPoints(source[2], false), isWanted);
  if (!isWanted()) {
    layer.dispose();
    return;
  }
  put(0, layer);
  const here = () => now.layers[0] === layer;
  const more = () => {
    layer.show(layer.loaded);
    viewer.ask();
  };
  colour(0, firstColour(0, value));
  listColours(0);
  more();
  await fetchPoints(layer, FIRST, more);
  if (here()) colour(0, layer.by.name); // of all that have come
  if (layer.count <= MOST_AT_ONCE) await fetchPoints(layer, layer.count, more);
  if (!here()) return;
  colour(0, layer.by.name);
  more();
}

async function showAfter(value) {
  const source = now.sources.after.find(([name]) => name === value), shown = now;
  if (!source) return;
  const isWanted = () => shown === now && find("look-after").value === value;
  const layer = await patiently(() => (value === "tiles" ? openTiles(source[2]) : value === "cloud" ? openPoints(source[2], true)
    : MeshLayer.open(source[2], now)), isWanted);
  if (!isWanted()) {
    layer.dispose();
    return;
  }
  put(1, layer);
  const isMesh = layer instanceof MeshLayer;
  find("look-mesh").disabled = !isMesh;
  if (isMesh) layer.shade(find("look-mesh").value);
  const name = firstColour(1, value);
  colour(1, name);
  listColours(1);
  await level();
  if (now.layers[1] !== layer) return;
  if (!isMesh && layer.by.range) colour(1, layer.by.name); // of all that have come
  sayLevel();
}

// Distances and coordinates are those of the file.
function measure(place) {
  if (!place) {
    find("measure-text").textContent = "There is nothing at that place.";
    return;
  }
  picked = picked.length === 2 ? [place] : [...picked, place];
  viewer.mark(picked);
  const [a, b] = picked, parts = (v) => ["x", "y", "z"].map((axis) => `${axis} ${figure(v[axis])}`).join(", ");
  find("measure-text").textContent = b ? `${figure(now.unit * a.distanceTo(b))} between the two places (${parts(b.clone().sub(a).multiplyScalar(now.unit))}), in the file's units`
    : `First place: ${["x", "y", "z"].map((axis, i) => (now.unit * a[axis] + now.origin[i]).toFixed(now.digits)).join(", ")}. Pick the second one.`;
}

function layOut(layout) {
  viewer.layout = layout;
  find("look-bar").hidden = layout !== "swipe";
  find("look-left").hidden = layout === "after";
  find("look-right").hidden = layout === "before";
  find("look-stage").dataset.layout = layout;
  aim();
  viewer.shape();
}

// Where keys pick, while places are picked.
function aim() {
  const [x, y] = viewer.middle(), box = find("look-canvas").getBoundingClientRect(), cross = find("look-aim");
  cross.hidden = !viewer.picking;
  cross.style.left = `${x - box.left}px`;
  cross.style.top = `${y - box.top}px`;
}

function listen() {
  const trying = async (work) => {
    find("news").textContent = "";
    try {
      await work();
    } catch (error) {
      find("news").textContent = error.message;
    }
  };
  const on = (id, what) => find(id).addEventListener("change", (event) => trying(() => what(event.target.value)));
  on("look-layout", layOut);
  on("look-before", showBefore);
  on("look-after", showAfter);
  for (const side of SIDES) {
    on(`look-colour-${side}`, (name) => {
      now.colours[side] = name;
      colour(side, name);
    });
  }
  on("look-up", (up) => {
    viewer.turnUp(up);
    for (const side of SIDES) if (now.layers[side]?.by?.name === "height") colour(side, "height");
  });
  new ResizeObserver(aim).observe(find("look-canvas"));
  on("look-mesh", (how) => {
    if (now.layers[1] instanceof MeshLayer) now.layers[1].shade(how);
    viewer.ask();
  });
  find("look-level").addEventListener("input", () => trying(moveLevel));
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
    find("measure-text").textContent = pressed ? "Pick two places: click them, or turn them under the cross and press Enter." : "";
    aim();
    if (pressed) find("look-canvas").focus({ preventScroll: true });
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
  const unit = Math.hypot(...size) / 2 || 1, [a, b, c] = size.map((side) => side / unit); // Math.hypot doesn't overflow
  now = { name: nameOf(job), origin: low.map((x, i) => x / 2 + high[i] / 2), size, unit, layers: [null, null],
    colours: [null, null], digits: Math.max(0, Math.min(9, 4 - Math.floor(Math.log10(Math.hypot(...size) || 1)))),
    area: job.report.mesh?.area / unit ** 2 || areaOf([a, b, c]), pointsIn: job.report.points_in, sources: sourcesOf(job, outputs) };
  viewer.frame([a, b, c], "z");
  find("look-level").value = 1000;
  const { before, after } = now.sources;
  sayWhy(job, outputs);
  fill("look-before", before.length ? before : [["", "nothing"]]);
  fill("look-after", after.length ? after : [["", "nothing"]]);
  const layout = before.length && after.length ? "side" : before.length ? "before" : "after";
  find("look-layout").value = layout;
  layOut(layout);
  const shown = now, first = after.length ? showAfter(after[0][0]) : showBefore(before[0]?.[0]);
  const turned = first.then(() => {
    const layer = now.layers[1] ?? now.layers[0];
    if (shown !== now || !layer) return;
    const most = mostOf(layer);
    find("look-up").value = guessUp(layer, [a, b, c]);
    viewer.frame([a, b, c], find("look-up").value, most);
    now.area = job.report.mesh?.area / unit ** 2 || areaOf(most.size);
    for (const side of SIDES) now.layers[side]?.spread?.(now.area);
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
  for (const side of SIDES) drawLegend(find(`legend-${side}`), null);
  aim();
}

// For tests: what is drawn.
export const drawn = () => ({ frames: viewer?.frames ?? 0, busy: Boolean(viewer?.drawing), view: viewer && { azimuth: viewer.azimuth,
  elevation: viewer.elevation, distance: viewer.distance, centre: viewer.centre.toArray() }, layers: (now?.layers ?? []).map((layer) => layer && {
  shown: layer.shown ?? null, count: layer.count ?? null, triangles: layer.triangles ?? null, fetched: layer.fetched,
  tiles: layer.chosen && { shown: layer.chosen.length, held: layer.held.size, all: layer.all, waiting: layer.waiting, budget: layer.budget } }),
  marks: viewer?.sides.map(({ root }) => root.children.filter(({ userData: { mark, box } }) => mark || box).length),
  geometries: viewer?.renderer.info.memory.geometries ?? 0 });
