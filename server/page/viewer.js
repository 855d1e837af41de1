// SPDX-License-Identifier: GPL-3.0-or-later
// Two scenes under one camera: side by side (one above the other where that shows more), under a bar that swipes, or one
// of them alone.
//
// While something moves, the first of the points are drawn, as many as this device draws in a moment; all of them are
// when it stands still.  Nothing is handed to the device before it has done what it has, so that no task of the page
// waits for it (a browser without a graphics processor reads each picture back in a task).
//
// Everything is drawn into a target with its depth first; a second pass darkens what lies behind its neighbours in the
// picture, and lights points without normals (alpha 0) by the plane that the depths around them lie on.
//   Boucheny: Interactive Scientific Visualization of Large Datasets, 2009 (eye-dome lighting)
import * as THREE from "three";

import { endsOf } from "./extent.js";

const TURN = 0.008, STEP = Math.PI / 24; // radians for a pixel, for a key
const SMOOTH = 1.5, MOST_PIXELS = 2; // pixels drawn for one of the device, and at most for one of CSS
const COARSEST = 0.5; // while it moves, where the device is slow
const MOMENT_MS = 40, STILL_MS = 120, PIECE_MS = 100; // a picture while it moves; without a move, until all is drawn; a piece of that
const FIRST = 100000, LEAST = 10000, MOST = 4000000; // points that are drawn at once: to begin with, at least, at most
const ASIDE = Math.PI / 6, LONG = 1.2; // the widest side is turned away by; variances along it and across: what has less is round
const MARGIN = 1.08; // of the distance from which all is seen
const FAR = 1e6, CENTRINGS = 4; // where perspective makes no difference; times that the middle of the picture is looked for
const LARGER = 1.4; // of two ways to divide the canvas, what is drawn so many times as large as in the other
const LOOK_MS = 4; // between looks whether the device is done

// Processors that draw without a graphics device work out each sine and both sides of each branch, but leave loops: so places
// are written out, what is looked at less closely is a program of its own (QUICK), and paper is no branch.
const places = (call, n, angle, radius) => Array.from({ length: n }, (_, i) => `${call}(vec2(${
  [Math.cos, Math.sin].map((wave) => (radius(i) * wave(angle * i)).toFixed(6)).join(", ")}));`).join(" ");

const DOME = {
  uniforms: { colours: { value: null }, depths: { value: null }, pixel: { value: new THREE.Vector2() }, unit: { value: 1 }, reach: { value: 4 },
    ends: { value: new THREE.Vector2() }, strength: { value: 1 }, paper: { value: new THREE.Color() } },
  vertexShader: "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
  fragmentShader: `
    uniform sampler2D colours, depths;
    uniform vec2 pixel, ends; // ends: what makes a distance of a depth
    uniform float strength, unit, reach;
    uniform vec3 paper;
    varying vec2 at;
    float own, nearer = 1.0, n = 0.0, z = 0.0, xx = 0.0, xy = 0.0, yy = 0.0, xz = 0.0, yz = 0.0;
    vec2 middle = vec2(0.0);
    float far_away(vec2 p) {
      return 1.0 / (ends.x + ends.y * texture2D(depths, p).x);
    }
    void before(vec2 away) {
      nearer *= max(1.0, own / far_away(at + pixel * away));
    }
    void lies(vec2 way) {
      vec2 away = reach * way, d = away * unit * own;
      float deep = far_away(at + pixel * away) - own;
      if (abs(deep) > 5.0 * reach * unit * own) return;
      n += 1.0;
      middle += d;
      z += deep;
      xx += d.x * d.x;
      xy += d.x * d.y;
      yy += d.y * d.y;
      xz += d.x * deep;
      yz += d.y * deep;
    }
    // Depths around as a plane, those of what lies behind or before left out; returns its normal, to the camera.
    vec3 facing() {
      #ifdef QUICK
        ${places("lies", 4, Math.PI / 2, () => 0.7)}
      #else
        ${places("lies", 12, 2.399963, (i) => Math.sqrt((i + 0.7) / 12))}
      #endif
      if (n < 3.0) return vec3(0.0, 0.0, 1.0);
      middle /= n;
      z /= n;
      xx -= n * middle.x * middle.x;
      xy -= n * middle.x * middle.y;
      yy -= n * middle.y * middle.y;
      xz -= n * middle.x * z;
      yz -= n * middle.y * z;
      float det = xx * yy - xy * xy;
      if (det <= 0.01 * xx * yy) return vec3(0.0, 0.0, 1.0);
      return normalize(vec3((xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det, 1.0));
    }
    void main() {
      gl_FragColor = vec4(paper, 1.0);
      float depth = texture2D(depths, at).x;
      for (int once = 0; once < 1 && depth < 1.0; once++) {
        own = 1.0 / (ends.x + ends.y * depth);
        #ifdef QUICK
          ${places("before", 4, Math.PI / 2, () => 1.4)}
          nearer *= nearer;
        #else
          ${places("before", 8, Math.PI / 4, () => 1.4)}
        #endif
        vec4 colour = texture2D(colours, at);
        if (colour.a < 0.5) colour.rgb *= 0.4 + 0.75 * abs(dot(facing(), vec3(-0.497, 0.678, 0.542)));
        gl_FragColor.rgb = colour.rgb * max(exp(-strength * log2(nearer)), 0.35);
      }
      gl_FragColor = sRGBTransferOETF(gl_FragColor);
    }`,
};

const COPY = {
  uniforms: { picture: { value: null } },
  vertexShader: DOME.vertexShader,
  fragmentShader: "uniform sampler2D picture; varying vec2 at; void main() { gl_FragColor = texture2D(picture, at); }",
};

// How many times as much is to be done next, where something took ms and is wanted to take `wanted`.
const stepTo = (wanted, ms) => Math.max(0.5, Math.min(2, wanted / Math.max(ms, 1)));

export class Viewer {
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: false, alpha: false });
    this.sides = ["before", "after"].map(() => {
      const scene = new THREE.Scene(), root = new THREE.Group(), light = new THREE.DirectionalLight(0xffffff, 2.6);
      scene.add(root, new THREE.HemisphereLight(0xffffff, 0x8a8078, 1.3), light, light.target);
      return { scene, root, light };
    });
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
    [this.target, this.fine] = [0, 1].map(() => new THREE.WebGLRenderTarget(1, 1, { type: THREE.HalfFloatType,
      depthTexture: new THREE.DepthTexture(1, 1, THREE.UnsignedIntType) }));
    [this.dome, this.quick] = [{}, { QUICK: 1 }].map((defines) => new THREE.ShaderMaterial({ ...DOME, defines, depthTest: false, depthWrite: false }));
    this.shaded = new THREE.WebGLRenderTarget(1, 1, { depthBuffer: false });
    this.copy = new THREE.ShaderMaterial({ ...COPY, depthTest: false, depthWrite: false });
    this.screen = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), this.dome);
    this.screen.frustumCulled = false;
    Object.assign(this, { layout: "side", bar: 0.5, radius: 1, centre: new THREE.Vector3(), distance: 4,
      azimuth: ASIDE, elevation: 0.4, picking: null, frames: 0, budget: FIRST,
      fine_budget: FIRST, ratio: Math.min(1, this.finest()), stale: false, drawing: null, wake: () => {} });
    this.listen();
    new ResizeObserver(() => this.shape()).observe(canvas);
    canvas.addEventListener("webglcontextrestored", () => this.ask());
  }

  // size: the box's sides, in the units of all positions; nearly: the middle and the sides of what nearly all of them are
  // in, and some of them; up: "x", "y" or "z"
  frame(size, up, nearly = { middle: [0, 0, 0], size, places: [] }) {
    Object.assign(this, { size, nearly, radius: Math.hypot(...size) / 2 || 1 });
    this.turnUp(up);
    this.reset();
  }

  turnUp(up) {
    const [{ root }] = this.sides;
    root.updateMatrixWorld();
    root.worldToLocal(this.centre); // the same place stays in the middle
    this.up = up;
    for (const side of this.sides) side.root.rotation.set(up === "z" ? -Math.PI / 2 : 0, 0, up === "x" ? Math.PI / 2 : 0);
    root.updateMatrixWorld();
    root.localToWorld(this.centre);
    this.ask();
  }

  // The canvas has another shape, or is divided in another way: a camera that nobody has moved is placed anew.
  shape() {
    if (this.untouched) this.reset();
    else this.divide();
    this.ask();
  }

  // From a little above, at the widest side.
  reset() {
    const { middle, size } = this.nearly, [x, y, z] = size, flat = Math.max(x, y, z) > 3 * { x, y, z }[this.up];
    this.sides[0].root.updateMatrixWorld();
    Object.assign(this, { untouched: true, azimuth: this.widest(), elevation: flat ? 0.7 : 0.4, distance: 1.55 * Math.hypot(...size) || 3.1 * this.radius });
    this.sides[0].root.localToWorld(this.centre.set(...middle));
    this.fit();
    this.ask();
  }

  // From where the widest side is seen, turned by ASIDE to show its depth, and the front as little turned away as can be (as
  // core/picture/view.c has it): the longer axis of the ellipse that the places are, from above.
  widest() {
    const [{ root }] = this.sides, { middle, size, places } = this.nearly, all = [];
    for (let i = 0; i < places.length; i += 3) {
      const place = places.slice(i, i + 3);
      if (place.every((c, k) => Math.abs(c - middle[k]) <= 0.5001 * size[k])) all.push(root.localToWorld(new THREE.Vector3(...place)));
    }
    const mean = (of) => all.reduce((sum, place) => sum + of(place), 0) / (all.length || 1), [x, z] = [mean((p) => p.x), mean((p) => p.z)];
    const [xx, xz, zz] = [mean((p) => (p.x - x) ** 2), mean((p) => (p.x - x) * (z - p.z)), mean((p) => (p.z - z) ** 2)];
    const half = (xx + zz) / 2, apart = Math.hypot((xx - zz) / 2, xz), angle = Math.atan2(2 * xz, xx - zz) / 2;
    if (!(half + apart > LONG * (half - apart))) return ASIDE;
    const near = [-1, 0, 1].flatMap((turn) => [-1, 1].map((sign) => angle + Math.PI * turn + ASIDE * sign - ASIDE));
    return ASIDE + near.reduce((a, b) => (Math.abs(b) < Math.abs(a) ? b : a));
  }

  // Of what there is, as the camera sees it: a function that says from how far away, and around which place, all of it is seen in
  // the first picture, strays left out; null where there is nothing or one place.
  framing() {
    const { azimuth: a, elevation: e, camera, nearly: { places } } = this, [{ root }] = this.sides, n = places.length / 3;
    if (n < 2) return null;
    const towards = new THREE.Vector3(Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e));
    const right = new THREE.Vector3(Math.cos(a), 0, -Math.sin(a)), above = new THREE.Vector3().crossVectors(towards, right), seen = new THREE.Vector3();
    const [x, y, z] = [right, above, towards].map((way) => Float32Array.from({ length: n }, (_, i) => way.dot(root.localToWorld(seen.fromArray(places, 3 * i)).sub(this.centre))));
    return () => {
      this.lens(this.parts()[0].view);
      const high = this.spread() / 2, wide = high * camera.aspect;
      let across = 0, along = 0, distance = FAR;
      const centred = (values, middle) => {
        const [low, most] = endsOf(values.map((value, i) => (value - middle) / Math.max(distance - z[i], distance / 10)));
        return middle + distance * (low + most) / 2;
      };
      for (let turn = 0; turn < CENTRINGS; turn++) { // what is near is larger, so what is the middle depends on the distance
        [across, along] = [centred(x, across), centred(y, along)];
        distance = endsOf(x.map((_, i) => Math.max(Math.abs(x[i] - across) / wide, Math.abs(y[i] - along) / high) + z[i]))[1] || FAR;
      }
      return { distance: MARGIN * distance, middle: this.centre.clone().addScaledVector(right, across).addScaledVector(above, along) };
    };
  }

  // Two pictures are beside each other, or one above the other: as what there is is larger; where that makes little difference, as
  // the canvas is longer.
  divide(framing = this.framing()) {
    const [beside, above] = [false, true].map((stacked) => {
      this.stacked = stacked;
      return framing?.().distance ?? 1;
    }), { clientWidth: wide, clientHeight: high } = this.canvas;
    this.stacked = Math.max(beside, above) > LARGER * Math.min(beside, above) ? above < beside : wide < high;
    this.canvas.dataset.stacked = this.stacked;
  }

  // Puts what there is into the middle of the picture, and as near as all of it is seen, but strays.
  fit() {
    const framing = this.framing();
    this.divide(framing);
    if (!framing) return;
    const { distance, middle } = framing();
    if (distance < FAR) Object.assign(this, { distance, centre: middle });
  }

  // Draws soon, once.
  ask() {
    this.stale = true;
    this.wake();
    this.drawing ??= new Promise(requestAnimationFrame).then(() => this.draw()).finally(() => {
      this.drawing = null;
      if (this.stale) this.ask();
    });
  }

  place() {
    const { azimuth: a, elevation: e, distance: d, camera, centre } = this;
    camera.position.set(Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)).multiplyScalar(d).add(centre);
    camera.lookAt(centre);
    camera.near = Math.max(d - 2.5 * this.radius, d / 500);
    camera.far = d + 2.5 * this.radius;
    const from = new THREE.Vector3(-1.1, 1.5, 1.2).applyQuaternion(camera.quaternion);
    for (const { light } of this.sides) light.position.copy(from);
  }

  // For each side that is seen: where its picture is, and the part of it that is drawn, as left, bottom, width and height
  // in shares of the canvas.
  parts() {
    const { bar, layout } = this, all = [0, 0, 1, 1];
    if (layout === "swipe") return [{ side: 0, view: all, clip: [0, 0, bar, 1] }, { side: 1, view: all, clip: [bar, 0, 1 - bar, 1] }];
    if (layout !== "side") return [{ side: layout === "after" ? 1 : 0, view: all, clip: all }];
    const halves = this.stacked ? [[0, 0.5, 1, 0.5], [0, 0, 1, 0.5]] : [[0, 0, 0.5, 1], [0.5, 0, 0.5, 1]];
    return halves.map((half, side) => ({ side, view: half, clip: half }));
  }

  // Width of a picture by its height.
  aspectOf([, , width, height]) {
    return width * this.canvas.clientWidth / Math.max(1, height * this.canvas.clientHeight);
  }

  // Draws what the camera sees until nothing has changed meanwhile: as much as is drawn in a moment at once, and all of
  // it, piece by piece, when nothing has moved for a while.
  async draw() {
    while (this.stale) {
      this.stale = false;
      this.choose();
      const most = this.most(), began = performance.now();
      this.piece(this.target, 0, this.budget, Math.min(this.budget, most), this.ratio);
      await this.done();
      await this.show(this.target, this.ratio < Math.min(1, this.finest()));
      const whole = most <= this.budget && this.ratio >= this.finest();
      this.learn(performance.now() - began);
      await this.taken();
      if (whole) continue;
      if (!this.stale) await this.rest(STILL_MS);
      for (let begin = 0, at; begin < most && !this.stale; begin += at) {
        const from = performance.now();
        at = this.fine_budget;
        this.piece(this.fine, begin, at, most, this.finest());
        await this.done();
        this.fine_budget = Math.round(Math.max(LEAST, Math.min(MOST, at * stepTo(PIECE_MS, performance.now() - from))));
      }
      if (this.stale) continue;
      await this.show(this.fine);
      await this.taken();
    }
  }

  // Until the browser has taken the picture over: without a graphics processor it reads it back in a task of the page, which
  // would wait for whatever is asked for meanwhile.
  taken() {
    return new Promise((resolve) => {
      requestAnimationFrame(() => setTimeout(resolve, 0));
    });
  }

  // Waits, or until something is asked for.
  rest(ms) {
    return new Promise((resolve) => {
      this.wake = resolve;
      setTimeout(resolve, ms);
    });
  }

  // How high the picture is at distance 1.
  spread() {
    return 2 * Math.tan(this.camera.fov * Math.PI / 360);
  }

  // Has layers choose what they show of themselves from where the camera is.
  choose() {
    this.place();
    this.camera.updateMatrixWorld();
    for (const { side, view } of this.parts()) {
      const { root } = this.sides[side];
      this.lens(view);
      for (const { userData: { see } } of root.children) see?.(this.camera, root, view[3] * this.canvas.clientHeight / this.spread());
    }
  }

  // How many points there are to draw, of the side that has more.
  most() {
    const objects = this.parts().flatMap(({ side }) => this.sides[side].root.children);
    return Math.max(1, ...objects.map((o) => (o.userData.part && o.userData.shown) || 0));
  }

  finest() {
    return Math.min(SMOOTH * devicePixelRatio, MOST_PIXELS);
  }

  // Draws count of the points from begin on, of `whole` that there will be, and all else with the first of them.
  piece(target, begin, count, whole, ratio) {
    const { renderer, camera, canvas } = this;
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (target.width !== width || target.height !== height) target.setSize(width, height);
    this.place();
    target.scissorTest = false;
    renderer.setRenderTarget(target);
    renderer.setClearColor(0, 1);
    renderer.autoClear = false;
    if (!begin) renderer.clear();
    const pixels = ([left, bottom, wide, high]) => [left * width, bottom * height, wide * width, high * height].map(Math.round);
    for (const { side, view, clip } of this.parts()) {
      const { root, scene } = this.sides[side];
      this.lens(view);
      target.viewport.set(...pixels(view));
      target.scissor.set(...pixels(clip));
      target.scissorTest = true;
      renderer.setRenderTarget(target);
      for (const { userData: { part: take, shown, uniforms, dot } } of root.children) {
        if (!take) continue;
        take(begin, Math.max(0, Math.min(count, shown - begin)), Math.min(whole, shown));
        uniforms.half_height.value = view[3] * height / this.spread();
        uniforms.least.value = Math.max(1, (dot ?? 0) * height / Math.max(1, canvas.clientHeight));
      }
      if (!begin || root.children.some((o) => o.userData.shown > begin)) renderer.render(scene, camera);
    }
  }

  // Shades what a target holds, and shows it; quick: with fewer looks around each pixel.
  async show(target, quick = false) {
    const { renderer, camera, canvas, shaded, screen } = this, { width, height } = target, dome = quick ? this.quick : this.dome, { uniforms } = dome;
    if (shaded.width !== width || shaded.height !== height) shaded.setSize(width, height);
    uniforms.colours.value = target.texture;
    uniforms.depths.value = target.depthTexture;
    uniforms.pixel.value.set(1 / Math.max(canvas.clientWidth, 1), 1 / Math.max(canvas.clientHeight, 1));
    const high = this.parts()[0].view[3] * Math.max(canvas.clientHeight, 1), wide = Math.max(0, ...this.sides.flatMap(({ root }) => root.children)
      .map(({ userData }) => (userData.uniforms ? userData.uniforms.size.value * high / this.spread() / this.distance : 0)));
    uniforms.unit.value = this.spread() / high;
    uniforms.reach.value = Math.min(Math.max(1.3 * wide, 4), 20);
    uniforms.ends.value.set(1 / camera.near, (camera.near - camera.far) / (camera.near * camera.far));
    uniforms.strength.value = 6;
    uniforms.paper.value.set(getComputedStyle(canvas).backgroundColor);
    screen.material = dome;
    renderer.setRenderTarget(shaded);
    renderer.render(screen, camera);
    await this.done();
    renderer.setPixelRatio(1);
    if (canvas.width !== width || canvas.height !== height) renderer.setSize(width, height, false);
    this.copy.uniforms.picture.value = shaded.texture;
    screen.material = this.copy;
    renderer.setRenderTarget(null);
    renderer.render(screen, camera);
    this.frames++;
    this.drawn?.();
  }

  // Once all that was asked for is drawn, looked at now and then: nobody waits for it.
  done() {
    const gl = this.renderer.getContext(), fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    return new Promise((resolve) => {
      const look = () => {
        if (!gl.isContextLost() && gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) {
          setTimeout(look, LOOK_MS);
          return;
        }
        gl.deleteSync(fence);
        resolve();
      };
      setTimeout(look, 0);
    });
  }

  // Fewer points, and then fewer pixels, where a picture takes longer than a moment; more where it takes less.
  learn(ms) {
    const by = stepTo(MOMENT_MS, ms);
    if (by < 0.8 && this.budget <= LEAST) this.ratio = Math.max(COARSEST, this.ratio * 0.8);
    else if (by > 1.25 && this.ratio < this.finest()) this.ratio = Math.min(this.finest(), this.ratio * 1.25);
    else this.budget = Math.round(Math.max(LEAST, Math.min(MOST, this.budget * by)));
  }

  // Where a place of the window is: side, and x and y from -1 to 1 in that side's picture.
  sideAt(clientX, clientY) {
    const box = this.canvas.getBoundingClientRect(), x = (clientX - box.left) / box.width, y = (clientY - box.top) / box.height;
    const within = ({ clip: [left, bottom, wide, high] }) => x >= left && x < left + wide && 1 - y >= bottom && 1 - y < bottom + high;
    const { side, view } = this.parts().find(within) ?? this.parts()[0], [left, bottom, wide, high] = view;
    return { side, view, x: 2 * (x - left) / wide - 1, y: 2 * (1 - y - bottom) / high - 1 };
  }

  // The middle of the first picture, as a place of the window: where keys pick.
  middle() {
    const box = this.canvas.getBoundingClientRect(), { view: [left, bottom, wide, high] } = this.parts()[0];
    return [box.left + (left + wide / 2) * box.width, box.top + (1 - bottom - high / 2) * box.height];
  }

  // The camera's angle and shape for a picture.
  lens(view) {
    const { camera } = this;
    camera.aspect = this.aspectOf(view);
    camera.fov = camera.aspect < 1 ? 2 * Math.atan(Math.tan(35 * Math.PI / 360) / camera.aspect) * 180 / Math.PI : 35;
    camera.updateProjectionMatrix();
  }

  // The point of the layer's data that is seen there, in the units of positions; null where there is nothing.
  pick(clientX, clientY) {
    const at = this.sideAt(clientX, clientY), ray = new THREE.Raycaster(), { camera } = this;
    this.lens(at.view);
    ray.setFromCamera(new THREE.Vector2(at.x, at.y), camera);
    const root = this.sides[at.side].root, dots = root.children.find((o) => o.userData.part);
    dots?.userData.part(0, dots.userData.shown, dots.userData.shown);
    const wide = dots?.material.uniforms.size.value ?? 0;
    ray.params.Points.threshold = Math.max(this.distance * 0.004, wide / 2);
    const hits = ray.intersectObjects(root.children.filter((o) => o.visible && !o.userData.mark && !o.userData.box), true);
    if (!hits.length) return null;
    const nearest = hits.reduce((a, b) => ((b.distanceToRay ?? 0) + 0.02 * b.distance < (a.distanceToRay ?? 0) + 0.02 * a.distance ? b : a));
    const { object, index } = nearest;
    return object.isPoints ? new THREE.Vector3().fromBufferAttribute(object.geometry.attributes.position, index)
      : root.worldToLocal(nearest.point.clone());
  }

  listen() {
    const { canvas } = this, down = new Map();
    let spread = 0, moved = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      down.set(event.pointerId, event);
      const [a, b] = [...down.values()];
      spread = b ? Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY) : 0;
      moved = 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = down.get(event.pointerId);
      if (!before) return;
      const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
      moved += Math.abs(dx) + Math.abs(dy);
      down.set(event.pointerId, event);
      const [a, b] = [...down.values()];
      if (b) {
        const now = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
        if (spread && now) this.zoom(spread / now);
        spread = now;
        this.shift(dx / 2, dy / 2);
      } else if (event.buttons & 2 || event.shiftKey) this.shift(dx, dy);
      else this.turn(-dx * TURN, dy * TURN);
    });
    const up = (event) => {
      down.delete(event.pointerId);
      spread = 0;
      if (event.type === "pointerup" && moved < 6 && this.picking) this.picking(this.pick(event.clientX, event.clientY));
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) * 0.003));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const shift = event.shiftKey;
      const keys = { ArrowLeft: () => (shift ? this.shift(20, 0) : this.turn(-STEP, 0)), ArrowRight: () => (shift ? this.shift(-20, 0) : this.turn(STEP, 0)),
        ArrowUp: () => (shift ? this.shift(0, 20) : this.turn(0, STEP)), ArrowDown: () => (shift ? this.shift(0, -20) : this.turn(0, -STEP)),
        "+": () => this.zoom(0.85), "=": () => this.zoom(0.85), "-": () => this.zoom(1 / 0.85), Home: () => this.reset(),
        ...(this.picking && { Enter: () => this.picking(this.pick(...this.middle())) }) };
      if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  turn(azimuth, elevation) {
    this.untouched = false;
    this.azimuth += azimuth;
    this.elevation = Math.max(-1.55, Math.min(1.55, this.elevation + elevation));
    this.ask();
  }

  zoom(factor) {
    this.untouched = false;
    this.distance = Math.max(this.radius / 200, Math.min(20 * this.radius, this.distance * factor));
    this.ask();
  }

  shift(dx, dy) {
    this.untouched = false;
    const unit = this.distance * Math.tan(35 * Math.PI / 360) * 2 / this.canvas.clientHeight;
    const move = new THREE.Vector3(-dx * unit, dy * unit, 0).applyQuaternion(this.camera.quaternion);
    this.centre.add(move);
    this.ask();
  }

  // A line through places, in both pictures; null takes it away.
  mark(places) {
    for (const { root } of this.sides) {
      for (const old of root.children.filter((o) => o.userData.mark)) root.remove(old);
      if (!places?.length) continue;
      const group = new THREE.Group(), geometry = new THREE.BufferGeometry().setFromPoints(places);
      group.userData.mark = true;
      group.add(new THREE.Points(geometry, new THREE.PointsMaterial({ color: 0x1450c8, size: 0.03 * this.radius })));
      if (places.length > 1) group.add(new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: 0x1450c8 })));
      root.add(group);
    }
    this.ask();
  }

  // The box, with the sides that `size` said.
  showBox(visible) {
    for (const { root } of this.sides) {
      for (const old of root.children.filter((o) => o.userData.box)) root.remove(old);
      if (!visible) continue;
      const box = new THREE.LineSegments(new THREE.EdgesGeometry(new THREE.BoxGeometry(...this.size)),
        new THREE.LineBasicMaterial({ color: 0x777777 }));
      box.userData.box = true;
      root.add(box);
    }
    this.ask();
  }

  // A PNG of what is seen, all of it.
  async picture() {
    await this.drawing;
    const most = this.most();
    this.piece(this.fine, 0, most, most, this.finest());
    await this.show(this.fine);
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/png"));
  }
}
