// SPDX-License-Identifier: GPL-3.0-or-later
// Numbers as colours: the same as in preview.png (core/picture/picture.c).

const RAMP = [[222, 224, 226], [250, 220, 138], [247, 150, 58], [214, 52, 38], [112, 6, 44]];

// sRGB, 0 .. 255, of a share from 0 to 1.
export function colourOf(share) {
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const stop = Math.min(Math.floor(at), RAMP.length - 2);
  return RAMP[stop].map((c, i) => c + (at - stop) * (RAMP[stop + 1][i] - c));
}

// Where the colours of these values begin and end: at 0 where none is negative, and where one in fifty is beyond.
export function rangeOf(values) {
  const step = Math.max(1, Math.floor(values.length / 50000)), some = [];
  for (let i = 0; i < values.length; i += step) if (Number.isFinite(values[i])) some.push(values[i]);
  some.sort((a, b) => a - b);
  if (!some.length) return { low: 0, high: 1, least: 0, most: 0 };
  const low = some[0] >= 0 ? 0 : some[Math.floor(0.02 * (some.length - 1))];
  let high = some[Math.floor(0.98 * (some.length - 1))];
  if (!(high > low)) high = some.at(-1) > low ? some.at(-1) : low + 1;
  return { low, high, least: some[0], most: some.at(-1), some };
}

// Bars of how many values there are in each part of the range, in the colours themselves.
export function drawHistogram(canvas, range) {
  const bins = new Array(48).fill(0), context = canvas.getContext("2d");
  for (const value of range.some ?? []) {
    const at = Math.floor((value - range.low) / (range.high - range.low) * bins.length);
    bins[Math.min(Math.max(at, 0), bins.length - 1)]++;
  }
  const most = Math.max(...bins, 1), wide = canvas.width / bins.length, floor = 10;
  context.clearRect(0, 0, canvas.width, canvas.height);
  bins.forEach((n, i) => {
    const high = (canvas.height - floor - 2) * Math.sqrt(n / most);
    context.fillStyle = `rgb(${colourOf((i + 0.5) / bins.length).map(Math.round).join(" ")})`;
    context.fillRect(i * wide, canvas.height - floor - high, wide - 1, high);
    context.fillRect(i * wide, canvas.height - floor + 2, wide + 1, floor);
  });
}
