// SPDX-License-Identifier: GPL-3.0-or-later
// Numbers as colours, and their legend: deviations as in preview.png (core/picture/picture.c), intensities as greys,
// heights as on a map, and numbers that name classes each in a colour of its own.
import { count, figure, make, percent } from "./words.js";

const RAMPS = {
  deviation: [[222, 224, 226], [250, 220, 138], [247, 150, 58], [214, 52, 38], [112, 6, 44]],
  grey: [[38, 38, 40], [236, 236, 232]],
  height: [[44, 82, 150], [74, 158, 150], [150, 190, 92], [226, 204, 120], [176, 116, 72], [240, 236, 232]],
};
const MOST_CLASSES = 24, SHADES = 256;

// ASPRS LAS 1.4, table 17
const LAS_CLASSES = ["never classified", "unclassified", "ground", "low vegetation", "medium vegetation", "high vegetation",
  "building", "low point", "key point", "water", "rail", "road", "overlap", "wire guard", "wire conductor", "tower",
  "wire connector", "bridge deck", "high noise"];
const LAS_COLOURS = [[120, 120, 124], [170, 170, 172], [166, 118, 70], [164, 204, 110], [92, 170, 76], [36, 118, 52],
  [214, 84, 62], [230, 60, 170], [240, 200, 60], [62, 128, 214], [110, 84, 150], [96, 98, 112], [214, 160, 210],
  [250, 210, 120], [244, 180, 40], [120, 60, 140], [200, 140, 40], [140, 150, 200], [255, 40, 120]];

// sRGB, 0 .. 255, of a share from 0 to 1.
export function colourOf(share, kind = "deviation") {
  const ramp = RAMPS[kind], at = Math.min(Math.max(share, 0), 1) * (ramp.length - 1);
  const stop = Math.min(Math.floor(at), ramp.length - 2);
  return ramp[stop].map((c, i) => c + (at - stop) * (ramp[stop + 1][i] - c));
}

const isClass = (name) => /class/.test(name);

// A colour for a whole number from 0 to 255: neighbours are far apart on the circle of hues.
function colourOfClass(name, value) {
  if (isClass(name) && LAS_COLOURS[value]) return LAS_COLOURS[value];
  const hue = (value * 137.508) % 360, tone = (n) => {
    const k = (n + hue / 30) % 12;
    return 255 * (0.52 - 0.3 * Math.max(-1, Math.min(k - 3, 9 - k, 1)));
  };
  return [tone(0), tone(8), tone(4)];
}

// Numbers that occur, with how often, where they are few whole ones from 0 to 255; else null.
function classesIn(name, values) {
  const counts = new Uint32Array(256);
  let found = 0;
  for (let i = 0; i < values.length; i++) {
    const value = values[i];
    if (!(value >= 0 && value <= 255) || value !== Math.floor(value)) return null;
    if (!counts[value]++ && ++found > MOST_CLASSES) return null;
  }
  return found < 2 && !isClass(name) ? null : [...counts.keys()].filter((value) => counts[value]).map((value) => ({ value, count: counts[value],
    text: isClass(name) && LAS_CLASSES[value] ? `${value} ${LAS_CLASSES[value]}` : String(value), colour: colourOfClass(name, value) }));
}

// Where the colours of an attribute's values begin and end: at 0 where none is negative, and where one in fifty is
// beyond; or the classes that they name.  `kind` is the ramp.
export function rangeOf(name, values) {
  const classes = name === "distance" || name === "height" ? null : classesIn(name, values);
  if (classes) return { name, classes, low: 0, high: 255 };
  const kind = name === "height" ? "height" : /intensity|reflectance|grey|gray/.test(name) ? "grey" : "deviation";
  const step = Math.max(1, Math.floor(values.length / 50000));
  const some = new Float32Array(Math.ceil(values.length / step)).map((_, i) => values[i * step]).filter(Number.isFinite).sort();
  if (!some.length) return { name, kind, low: 0, high: 1, least: 0, most: 0, some };
  const low = some[0] >= 0 && kind === "deviation" ? 0 : some[Math.floor(0.02 * (some.length - 1))];
  let high = some[Math.floor(0.98 * (some.length - 1))];
  if (!(high > low)) high = some.at(-1) > low ? some.at(-1) : low + 1;
  let most = some.at(-1);
  for (let i = 0; i < values.length; i++) if (values[i] > most) most = values[i];
  return { name, kind, low, high, least: some[0], most, some };
}

// The colour of a value in a range.
export const shadeOf = (range, value) => (range.classes ? colourOfClass(range.name, value)
  : colourOf((value - range.low) / (range.high - range.low), range.kind));

// 256 colours, RGBA: of values from low to high, or of the classes 0 to 255.
export function shadesOf(range) {
  const shades = new Uint8Array(4 * SHADES).fill(255);
  for (let i = 0; i < SHADES; i++) {
    const colour = range.classes ? colourOfClass(range.name, i) : colourOf(i / (SHADES - 1), range.kind);
    colour.forEach((c, k) => { shades[4 * i + k] = Math.round(c); });
  }
  return shades;
}

// Bars of how many values there are in each part of the range, in the colours themselves.
function drawHistogram(canvas, range) {
  const bins = new Array(48).fill(0), context = canvas.getContext("2d");
  for (const value of range.some) {
    const at = Math.floor((value - range.low) / (range.high - range.low) * bins.length);
    bins[Math.min(Math.max(at, 0), bins.length - 1)]++;
  }
  const most = Math.max(...bins, 1), wide = canvas.width / bins.length, floor = 12;
  context.clearRect(0, 0, canvas.width, canvas.height);
  bins.forEach((n, i) => {
    const high = (canvas.height - floor - 2) * Math.sqrt(n / most);
    context.fillStyle = `rgb(${colourOf((i + 0.5) / bins.length, range.kind).map(Math.round).join(" ")})`;
    context.fillRect(i * wide, canvas.height - floor - high, wide - 1, high);
    context.fillRect(i * wide, canvas.height - floor + 2, wide + 1, floor);
  });
}

function classRows({ classes }) {
  const all = classes.reduce((sum, each) => sum + each.count, 0);
  return classes.map(({ text, count: n, colour }) => {
    const chip = make("canvas", { class: "chip", width: 12, height: 12, "aria-hidden": "true" }), context = chip.getContext("2d");
    context.fillStyle = `rgb(${colour.map(Math.round).join(" ")})`;
    context.fillRect(0, 0, 12, 12);
    return make("li", {}, chip, make("span", {}, text), make("span", { class: "number" }, `${count(n)} (${percent(n / all)})`));
  });
}

// Fills an element with what the colours mean; `title` names the attribute, with its unit.
export function drawLegend(element, range, title) {
  element.hidden = !range;
  if (!range) return element.replaceChildren();
  if (range.classes) return element.replaceChildren(make("p", { class: "note" }, title), make("ul", { class: "classes", tabindex: 0, "aria-label": title }, ...classRows(range)));
  const middle = range.some[range.some.length >> 1] ?? 0;
  const bars = make("canvas", { width: 480, height: 72, role: "img",
    "aria-label": `${title}: half of the points below ${figure(middle)}, 98 of 100 below ${figure(range.high)}, largest ${figure(range.most)}` });
  drawHistogram(bars, range);
  element.replaceChildren(make("p", { class: "note" }, title), bars, make("div", { class: "scale" }, make("span", {}, figure(range.low)),
    make("span", {}, `half below ${figure(middle)}`), make("span", {}, `${range.most > range.high ? "≥ " : ""}${figure(range.high)}`)),
  make("p", { class: "note" }, `largest ${figure(range.most)}`));
}
