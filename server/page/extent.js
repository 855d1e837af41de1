// SPDX-License-Identifier: GPL-3.0-or-later
// What points extend over: nearly all of them, and which axis points upwards (as core/picture/view.c has it).

const STRAYS = 0.002, HARDLY = 1.25; // of values, at each end; what all of them extend over more than the others, where there are no strays
const LOOKED_AT = 10000, PLACES = 3000; // points that are sorted, and that are put into the picture, at most
const LOWEST = 0.03, FLAT = 0.4; // of the height is what things stand on; of both other sides: what is lower lies, as terrain does

// The ends of what finite values extend over, without the strays; of none: 0 and 0.
export function endsOf(values) {
  const sorted = Float32Array.from(values).sort(), last = sorted.length - 1, strays = Math.floor(STRAYS * last);
  if (last < 0) return [0, 0];
  const [least, low, high, most] = [0, strays, last - strays, last].map((i) => sorted[i]);
  return most - least <= HARDLY * (high - low) ? [least, most] : [low, high];
}

// The middle and the sides of the box around nearly all places, and some of them: strays of a scan would make all else small.
export function mostOf({ points: { position, count: n }, loaded = n }) {
  const step = Math.max(1, Math.ceil(loaded / LOOKED_AT)), ends = [0, 1, 2].map((axis) =>
    endsOf(Float32Array.from({ length: Math.floor(loaded / step) }, (_, i) => position[3 * i * step + axis]).filter(Number.isFinite)));
  const some = Math.min(loaded, PLACES), places = Array.from({ length: some }, (_, i) => position.subarray(3 * Math.floor(i * loaded / some)).subarray(0, 3));
  return { middle: ends.map(([low, high]) => (low + high) / 2), size: ends.map(([low, high]) => high - low),
    places: places.filter((place) => place.every(Number.isFinite)).flatMap((place) => [...place]) };
}

// How much of its box what is lowest along an axis spans, in the other two; of a mesh, whose vertices may be far apart, also what
// is lowest of its edges.
function footing({ position, triangle }, count, axis, size) {
  const others = [0, 1, 2].filter((other) => other !== axis), spans = others.map(() => [Infinity, -Infinity]);
  const base = (LOWEST - 0.5) * size[axis], isLow = (i) => position[3 * i + axis] <= base; // no number isn't
  const take = (a, b, share) => others.forEach((other, k) => {
    const x = (1 - share) * position[3 * a + other] + share * position[3 * b + other];
    spans[k] = [Math.min(spans[k][0], x), Math.max(spans[k][1], x)];
  });
  for (let i = 0; i < count; i++) if (isLow(i)) take(i, i, 0);
  for (let i = 0; i < (triangle?.length ?? 0); i++) {
    const a = triangle[i], b = triangle[i % 3 < 2 ? i + 1 : i - 2], height = (v) => position[3 * v + axis];
    if (isLow(a) && height(b) > base) take(a, b, (base - height(a)) / (height(b) - height(a)));
    if (isLow(b) && height(a) > base) take(b, a, (base - height(b)) / (height(a) - height(b)));
  }
  return spans.reduce((share, [low, high], k) => share * (Math.max(0, high - low) / size[others[k]] || 0), 1);
}

// Which axis points upwards: z of what is flat, else the one that the points stand on.  size: the box's sides, around the origin.
export function guessUp({ points, loaded = points.count }, size) {
  if (size[2] < FLAT * size[0] && size[2] < FLAT * size[1]) return "z";
  return footing(points, loaded, 1, size) > footing(points, loaded, 2, size) ? "y" : "z";
}

// Of the surface that points in a box are of, about.
export const areaOf = ([a, b, c]) => 0.8 * (a * b + b * c + c * a) || Math.max(a, b, c) ** 2 || 1;
