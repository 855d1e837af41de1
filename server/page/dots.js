// SPDX-License-Identifier: GPL-3.0-or-later
// Points as discs: how they are drawn, and what they are coloured by.
import * as THREE from "three";

import { shadesOf } from "./ramp.js";

export const CLAY = [203, 196, 186]; // sRGB, of what has no colour

export const linear = Float32Array.from({ length: 256 }, (_, c) => new THREE.Color().setRGB(c / 255, 0, 0, THREE.SRGBColorSpace).r);

const DISC = 2, WIDEST = 0.25; // how wide points are that cover a surface, of the square root of its area for each; at most
export const widthOf = (area, n) => Math.min(WIDEST, DISC * Math.sqrt(area / Math.max(n, 1)));

// Values from low to high, or classes, as a picture of one line.
const SHADES = 256;
const shadesTexture = () => Object.assign(new THREE.DataTexture(new Uint8Array(4 * SHADES), SHADES, 1), {
  colorSpace: THREE.SRGBColorSpace, magFilter: THREE.LinearFilter, minFilter: THREE.LinearFilter });

// Points are discs of `size` in the file's units, lit here where they have normals; what they are coloured by is chosen when
// they are drawn, so that nothing is computed for each of a million points here.
const DOT = {
  vertexShader: `
    attribute vec3 tint;
    attribute float value;
    uniform sampler2D ramp;
    uniform vec3 clay;
    uniform float size, half_height, least, low, high;
    uniform int by;
    uniform bool lit;
    varying vec3 shade;
    varying float wide;
    vec3 linear(vec3 c) {
      return c * (c * (c * 0.305306 + 0.682171) + 0.012523); // sRGB's curve within two thousandths
    }
    void main() {
      vec4 at = modelViewMatrix * vec4(position, 1.0);
      gl_Position = projectionMatrix * at;
      gl_PointSize = wide = max(size * half_height / -at.z, least);
      if (by == 0) shade = clay;
      else if (by == 1) shade = linear(tint);
      else if (by == 3) shade = linear(0.5 + 0.5 * normal);
      else shade = texture2D(ramp, vec2(by == 4 ? (value + 0.5) / 256.0 : clamp((value - low) / (high - low), 0.002, 0.998), 0.5)).rgb;
      if (lit) shade *= 0.4 + 0.75 * abs(dot(normalize(normalMatrix * normal + vec3(0.0, 0.0, 1e-6)), vec3(-0.497, 0.678, 0.542)));
    }`,
  fragmentShader: `
    uniform bool bare;
    varying vec3 shade;
    varying float wide;
    void main() {
      vec2 from = gl_PointCoord - 0.5;
      if (wide > 3.0 && dot(from, from) > 0.25) discard;
      gl_FragColor = vec4(shade, bare ? 0.0 : 1.0); // 0: viewer.js lights it
    }`,
};
const BY = { plain: 0, own: 1, normals: 3 }, BY_VALUE = 2, BY_CLASS = 4;

export const dots = () => new THREE.ShaderMaterial({ ...DOT, uniforms: { ramp: { value: shadesTexture() }, size: { value: 1 }, lit: { value: false }, bare: { value: true },
  clay: { value: new THREE.Vector3(...CLAY.map((c) => linear[c])) }, half_height: { value: 1 }, least: { value: 1 }, low: { value: 0 },
  high: { value: 1 }, by: { value: 0 } } });

// Names that points or vertices can be coloured by.
export const attributesOf = (points, facing) => [...(points.rgb ? ["own"] : []), "plain", "height", ...(facing ? ["normals"] : []),
  ...Object.keys(points.scalar)];

// Has points coloured by `by`: the name of an attribute and the range of its values, null where it has none.
export function paint(uniforms, { name, range }, hasNormals) {
  uniforms.by.value = range?.classes ? BY_CLASS : BY[name] ?? (range ? BY_VALUE : BY.plain);
  uniforms.low.value = range?.low ?? 0;
  uniforms.high.value = range?.high ?? 1;
  uniforms.lit.value = hasNormals && name !== "normals";
  uniforms.bare.value = !hasNormals;
  if (!range) return;
  const shades = uniforms.ramp.value;
  shades.image.data.set(shadesOf(range));
  shades.magFilter = shades.minFilter = range.classes ? THREE.NearestFilter : THREE.LinearFilter;
  shades.needsUpdate = true;
}
