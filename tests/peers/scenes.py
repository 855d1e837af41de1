#!/usr/bin/env python3
"""Scans of made scenes, as scanners of several kinds would take them, for what no scan at hand shows.

Usage: scenes.py KIND SEED CLOUD.ply [--points 200000]      KIND: see KINDS

A scene is a ground and convex solids (houses, furniture, cars, trunks) and crowns of trees, which a beam enters before
it meets a leaf.  A scanner is a set of beams, an error of range, and an order of its points.  Lengths are metres.  One
seed is one scene, the same bytes each time.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import collections
import pathlib
import sys

import numpy as np
from scipy.spatial import HalfspaceIntersection

FAR = 1e9
BEAMS_AT_ONCE = 100_000

# scanner: where it stood, of a single view; ground: whether it was seen from above.
Scan = collections.namedtuple("Scan", "points scanner ground", defaults=(None, False))


# ---------------------------------------------------------------------------------------------------- solids
class Convex:
    """Points x with normals @ x <= offsets: unit normals; `inside` is one of them."""

    def __init__(self, normals, offsets, inside, crown):
        self.normals, self.offsets, self.inside, self.crown = normals, offsets, inside, crown
        corners = HalfspaceIntersection(np.column_stack([normals, -offsets]), inside).intersections
        self.reach = np.linalg.norm(corners - inside, axis=1).max()

    def chord(self, origins, ways):
        """Where each beam enters and leaves (FAR, -FAR where it misses)."""
        enters, leaves = np.full(len(ways), FAR), np.full(len(ways), -FAR)
        to = self.inside - origins
        aside = (to * to).sum(1) - (to * ways).sum(1) ** 2
        near = np.flatnonzero(aside <= self.reach ** 2)
        enters[near], leaves[near] = self._chord(origins[near], ways[near])
        return enters, leaves

    def _chord(self, origins, ways):
        towards, room = ways @ self.normals.T, self.offsets - origins @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = room / towards
        enters = np.where(towards < 0, at, -FAR).max(1)
        leaves = np.where(towards > 0, at, FAR).min(1)
        misses = (enters >= leaves) | ((towards == 0) & (room < 0)).any(1)
        return np.where(misses, FAR, enters), np.where(misses, -FAR, leaves)


def turned(yaw):
    return np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])


def convex(normals, heights, centre, yaw=0.0, crown=False):
    """A solid whose sides have these normals and distances from its centre, before it is turned and moved there."""
    normals = np.asarray(normals, float)
    normals = normals / np.linalg.norm(normals, axis=1)[:, None] @ turned(yaw).T
    centre = np.asarray(centre, float)
    return Convex(normals, np.asarray(heights, float) + normals @ centre, centre, crown)


def box(centre, half, yaw=0.0):
    return convex(np.vstack([np.eye(3), -np.eye(3)]), [*half, *half], centre, yaw)


def house(foot, half, eaves, rise, yaw):
    """Walls up to the eaves and a roof with a ridge `rise` higher (0: flat), on the ground at `foot`."""
    if rise <= 0:
        return box(np.add(foot, (0, 0, eaves / 2 - 1)), (*half, eaves / 2 + 1), yaw)
    sides = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, rise, half[1]], [0, -rise, half[1]], [0, 0, -1]])
    slope = (eaves + rise) * half[1] / np.hypot(rise, half[1])
    return convex(sides, [half[0], half[0], half[1], half[1], slope, slope, 2], foot, yaw)


def column(foot, radius, height, sides=12):
    angles = np.arange(sides) * 2 * np.pi / sides
    around = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    return convex(np.vstack([around, [[0, 0, 1], [0, 0, -1]]]), [*[radius] * sides, height, .5], foot)


def ball(centre, radius, sides=120, crown=False, squeeze=(1, 1, 1)):
    """A polyhedron around a ball, its sides spread evenly (a spiral), squeezed along the axes."""
    k = np.arange(sides) + .5
    z, angle = 1 - 2 * k / sides, np.pi * (1 + 5 ** .5) * k
    out = np.column_stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])
    normals = out / np.asarray(squeeze)
    return convex(normals, radius / np.linalg.norm(normals, axis=1), centre, crown=crown)


def cone(foot, radius, height, crown=True, sides=14):
    angles = np.arange(sides) * 2 * np.pi / sides
    around = np.column_stack([height * np.cos(angles), height * np.sin(angles), 0 * angles + radius])
    down = radius * height / np.hypot(radius, height)
    return convex(np.vstack([around, [[0, 0, -1]]]), [*[down] * sides, .01], foot, crown=crown)


class Ground:
    """Waves of random ways and lengths, about `relief` high; flat with relief 0."""

    FURTHEST = 300  # metres of a beam that are looked at, from the height of the highest ground on

    def __init__(self, rng, relief, longest, octaves=4):
        self.waves = []
        for octave in range(octaves if relief else 0):
            for _ in range(4):
                angle, length = rng.uniform(0, 2 * np.pi), longest / 2.1 ** octave * rng.uniform(.7, 1.3)
                self.waves.append((2 * np.pi / length * np.array([np.cos(angle), np.sin(angle)]),
                                   rng.uniform(0, 2 * np.pi), relief / 4 * .42 ** octave))

    def height(self, x, y):
        z = np.zeros(np.shape(x))
        for way, phase, high in self.waves:
            z += high * np.sin(way[0] * x + way[1] * y + phase)
        return z

    def meet(self, origins, ways):
        """Where each beam meets the ground first: steps along it, then halving."""
        def above(t):
            at = origins + t[:, None] * ways
            return at[:, 2] - self.height(at[:, 0], at[:, 1])

        down = np.minimum(ways[:, 2], -1e-9)
        if not self.waves:
            return np.where((ways[:, 2] < 0) & (origins[:, 2] > 0), -origins[:, 2] / down, FAR)
        most = sum(high for _, _, high in self.waves)
        low = np.maximum(0, (most - origins[:, 2]) / down)
        high = np.clip((-most - origins[:, 2]) / down, low, low + self.FURTHEST)
        near, far, found = low.copy(), high.copy(), np.zeros(len(ways), bool)
        for step in range(1, 65):
            t = low + (high - low) * step / 64
            hit = ~found & (above(t) < 0)
            far[hit], found[hit] = t[hit], True
            near[~found] = t[~found]
        for _ in range(24):
            middle = (near + far) / 2
            over = above(middle) > 0
            near, far = np.where(over, middle, near), np.where(over, far, middle)
        return np.where(found, far, FAR)


class Scene:
    """A ground (or none) and solids; `room`: a solid seen from within."""

    def __init__(self, ground=None, room=None):
        self.ground, self.room, self.solids = ground, room, []

    def height(self, x, y):
        return float(self.ground.height(np.array(x), np.array(y)))

    def meet(self, rng, origins, ways, leaves=.8):
        """How far each beam goes (FAR: nothing there); a beam goes `leaves` metres through a crown on average."""
        return np.concatenate([self._meet(rng, origins[i:i + BEAMS_AT_ONCE], ways[i:i + BEAMS_AT_ONCE], leaves)
                               for i in range(0, len(ways) or 1, BEAMS_AT_ONCE)])

    def _meet(self, rng, origins, ways, leaves):
        first = np.full(len(ways), FAR)
        if self.ground:
            first = self.ground.meet(origins, ways)
        if self.room:
            first = np.minimum(first, self.room.chord(origins, ways)[1])
        for solid in self.solids:
            enters, exits = solid.chord(origins, ways)
            at = np.where(enters > 1e-6, enters, FAR)
            if solid.crown:
                at = np.maximum(enters, 0) + rng.exponential(leaves, len(ways))
                at = np.where(at < exits, at, FAR)
            first = np.minimum(first, at)
        return first


# ---------------------------------------------------------------------------------------------------- scanners
def measured(rng, origins, ways, far, error, furthest=FAR):
    """Points where beams end, off by `error` (a number, or one for each beam) along them."""
    met = far < min(furthest, FAR / 2)
    far = far + error * rng.standard_normal(len(far))
    return (origins + far[:, None] * ways)[met]


def from_the_air(rng, scene, side, count, high=500, lines=3, again=.5):
    """Flight lines that overlap, 20 degrees to both sides; half of the beams that meet leaves go on to what is below."""
    parts, width = [], side / lines
    for line in range(lines):
        n = int(count / lines)
        y = (line + .5) * width - side / 2
        origins = np.column_stack([rng.uniform(-side / 2, side / 2, n), np.full(n, y), np.full(n, float(high))])
        feet = np.column_stack([origins[:, 0] + rng.normal(0, .05, n), y + rng.uniform(-.65, .65, n) * width, 0 * y
                                + np.zeros(n)])
        feet[:, 1] += .15 * (feet[:, 1] - y)
        ways = feet - origins
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        shift = rng.normal(0, .03, 3)
        for _ in range(2):
            far = scene.meet(rng, origins, ways)
            parts.append(measured(rng, origins, ways, far, .02) + shift)
            on = (rng.random(len(far)) < again) & (far < FAR / 2)
            origins, ways = (origins + (far + .05)[:, None] * ways)[on], ways[on]
            among_leaves = np.zeros(len(ways), bool)
            for solid in scene.solids:
                enters, leaves = solid.chord(origins, ways)
                among_leaves = (among_leaves | (enters < 0) & (leaves > 0)) if solid.crown else (
                    among_leaves & ~((enters < 0) & (leaves > 0)))
            origins, ways = origins[among_leaves], ways[among_leaves]
    points = np.vstack(parts)
    return points[np.abs(points[:, :2]).max(1) < side / 2]


def looking(eye, to, columns, rows, wide):
    """Beams of a camera, a row after another; `wide`: tangent of half its angle."""
    ahead = np.subtract(to, eye) / np.linalg.norm(np.subtract(to, eye))
    right = np.cross(ahead, (0, 0, 1))
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    u, v = np.meshgrid(np.linspace(-wide, wide, columns), np.linspace(-wide, wide, rows) * rows / columns)
    ways = ahead + u.reshape(-1, 1) * right + v.reshape(-1, 1) * down
    depth = 1 / np.linalg.norm(ways, axis=1)
    return ways * depth[:, None], depth  # unit, and how much of a beam is depth


def depth_camera(rng, scene, eye, to, columns=320, rows=240, flying=.3):
    """A structured-light camera: error and steps of depth grow with its square; pixels at edges fly between."""
    ways, ahead = looking(eye, to, columns, rows, .56)
    origins = np.tile(np.asarray(eye, float), (len(ways), 1))
    depth = scene.meet(rng, origins, ways) * ahead
    grid = depth.reshape(rows, columns)
    beside = np.abs(np.diff(grid, axis=1, append=grid[:, -1:])) > .15
    mixed = grid + rng.random(grid.shape) * (np.roll(grid, -1, axis=1) - grid)
    depth = np.where(beside & (rng.random(grid.shape) < flying), mixed, grid).ravel()
    depth = depth + (.0008 + .0016 * depth ** 2) * rng.standard_normal(len(depth)) * .7
    step = .0007 * depth ** 2 + 1e-4
    depth = np.round(depth / step) * step
    good = (depth > .4) & (depth < 7)
    return (origins + (depth / ahead)[:, None] * ways)[good]


def stereo_pair(rng, scene, eye, to, columns, rows, focal=1200.0, base=.5, wrong=.004):
    """Disparities in sixteenths of a pixel, off by a fifth of one; a few are of something else."""
    ways, ahead = looking(eye, to, columns, rows, .6)
    origins = np.tile(np.asarray(eye, float), (len(ways), 1))
    depth = scene.meet(rng, origins, ways) * ahead
    shift = focal * base / depth + rng.normal(0, .2, len(depth))
    swap = rng.random(len(depth)) < wrong
    shift = np.where(swap, rng.uniform(4, 120, len(depth)), shift)
    shift = np.round(shift * 16) / 16
    good = (depth < 90) & (shift > 2)
    with np.errstate(divide="ignore"):
        depth = focal * base / shift
    return (origins + (depth / ahead)[:, None] * ways)[good]


def turning(rng, scene, eye, pitches, columns, error=.015, furthest=100):
    """A scanner that turns: one ring after another around it for each pitch (radians)."""
    yaw, pitch = np.meshgrid(np.linspace(0, 2 * np.pi, columns, endpoint=False), pitches)
    yaw, pitch = yaw.T.ravel(), pitch.T.ravel()
    ways = np.column_stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    origins = np.tile(np.asarray(eye, float), (len(ways), 1))
    return measured(rng, origins, ways, scene.meet(rng, origins, ways), error, furthest)


# ---------------------------------------------------------------------------------------------------- scenes
def plant(rng, scene, x, y, pointed=None):
    z, height = scene.height(x, y), rng.uniform(6, 18)
    if pointed if pointed is not None else rng.random() < .3:
        scene.solids.append(cone((x, y, z + height * .12), height * rng.uniform(.17, .27), height * .9))
    else:
        radius = height * rng.uniform(.2, .32)
        scene.solids.append(ball((x, y, z + height - radius), radius, 40, True, (1, 1, rng.uniform(.8, 1.3))))
    scene.solids.append(column((x, y, z), .2 + height / 80, height * .6, 8))


def city(rng, count, tall, green):
    side, scene = 160, Scene(Ground(rng, 2.0, 150))
    for x in np.arange(-64, 65, 32.0):
        for y in np.arange(-64, 65, 32.0):
            at = (x + rng.uniform(-5, 5), y + rng.uniform(-5, 5))
            half = rng.uniform(5, 10, 2)
            scene.solids.append(house((*at, scene.height(*at)), half, rng.uniform(*tall),
                                      0 if rng.random() < .4 else rng.uniform(1.5, 4), rng.uniform(0, np.pi)))
            for _ in range(rng.poisson(green)):
                plant(rng, scene, x + 16 + rng.uniform(-3, 3), y + rng.uniform(-14, 14))
    return Scan(from_the_air(rng, scene, side, count), ground=True)


def forest(rng, count, pointed, apart):
    side, scene = 100, Scene(Ground(rng, 12.0, 120))
    steps = np.arange(-side / 2, side / 2, apart)
    for x in steps:
        for y in steps:
            plant(rng, scene, x + rng.uniform(-.4, .4) * apart, y + rng.uniform(-.4, .4) * apart, pointed)
    return Scan(from_the_air(rng, scene, side, count), ground=True)


def hills(rng, count):
    scene = Scene(Ground(rng, 60.0, 300, 6))
    return Scan(from_the_air(rng, scene, 400, count, high=1200), ground=True)


def furnish(rng, half, height):
    """A room on z = 0 with things along its walls and one in its middle."""
    scene = Scene(room=box((0, 0, height / 2), (*half, height / 2)))
    for side in range(4):
        along = rng.uniform(-.6, .6)
        wide, deep, high = rng.uniform(.4, .9), rng.uniform(.2, .35), rng.uniform(.4, 2.0)
        wall = side % 2
        centre = np.zeros(3)
        centre[wall] = (half[wall] - deep) * (1 if side < 2 else -1)
        centre[1 - wall] = along * half[1 - wall]
        centre[2] = high / 2
        size = (deep, wide) if wall == 0 else (wide, deep)
        scene.solids.append(box(centre, (*size, high / 2)))
    at = rng.uniform(-.4, .4, 2)
    scene.solids += [box((*at, .72), (.6, .4, .02), yaw := rng.uniform(0, np.pi)), box((*at, .35), (.05, .05, .35), yaw),
                     ball((*(at + .1), .88), .14), column((*(at - .15), .74), .06, .25)]
    return scene


def room_by_depth_camera(rng, count):
    scene, parts = furnish(rng, rng.uniform(1.8, 2.6, 2), 2.5), []
    for k in range(24):
        angle = k * 2 * np.pi / 24
        eye = np.array([.5 * np.cos(angle + 3), .5 * np.sin(angle + 3), 1.4 + .2 * np.sin(2 * angle)])
        to = eye + [np.cos(angle), np.sin(angle), rng.uniform(-.6, .1)]
        parts.append(depth_camera(rng, scene, eye, to, 160, 120) + rng.normal(0, .003, 3))
    points = np.vstack(parts)
    return Scan(points[np.sort(rng.permutation(len(points))[:count])])


def room_by_two_scanners(rng, count):
    half, height = rng.uniform(2.0, 3.5, 2), 2.6
    scene, parts = furnish(rng, half, height), []
    rows = int(np.sqrt(count / 2 / 2.6))
    for place in ((-.55, -.6), (.6, .5)):
        eye = (place[0] * half[0], place[1] * half[1], 1.5)
        parts.append(turning(rng, scene, eye, np.linspace(-1.1, 1.5, rows), int(2.6 * rows), .002))
    return Scan(np.vstack(parts))


def view_of_a_table(rng, count):
    scene = Scene(Ground(rng, 0, 1), None)
    scene.solids = [box((0, 0, .7), (.8, .5, .03))] + [
        make(rng.uniform(-.6, .6), rng.uniform(-.35, .35)) for make in [
            lambda x, y: ball((x, y, .82), .1), lambda x, y: box((x, y, .8), (.1, .07, .08), 1.0),
            lambda x, y: column((x, y, .73), .05, .2), lambda x, y: cone((x, y, .73), .1, .25, False)] * 2]
    eye = np.array([rng.uniform(-.4, .4), -1.6, 1.5])
    rows = int(np.sqrt(count * .75))
    return Scan(depth_camera(rng, scene, eye, (0, 0, .7), int(rows / .75), rows), tuple(eye))


def street(rng, cars=6):
    scene = Scene(Ground(rng, .3, 60))
    for side in (-1, 1):
        x = -45.0
        while x < 45:
            wide = rng.uniform(4, 9)
            deep = rng.uniform(4, 6)
            scene.solids.append(house((x + wide, side * (8 + deep + rng.uniform(0, 2)), 0), (wide, deep),
                                      rng.uniform(5, 14), rng.uniform(0, 3), 0))
            x += 2 * wide + rng.uniform(.5, 5)
        for x in np.arange(-40, 41, rng.uniform(9, 14)):
            plant(rng, scene, x, side * 6.0, False)
    for _ in range(cars):
        x, y = rng.uniform(-30, 30), rng.choice((-3.5, 3.5))
        scene.solids += [box((x, y, .75), (2.1, .85, .45)), box((x - .2, y, 1.35), (1.1, .75, .25))]
    return scene


def street_by_stereo(rng, count):
    scene, eye, rows = street(rng), (-20.0, .8, 1.7), int(np.sqrt(count * .6))
    return Scan(stereo_pair(rng, scene, eye, (20, -.5, 1.2), int(rows / .6), rows), eye)


def street_by_turning_scanner(rng, count):
    scene, eye = street(rng), (0.0, .5, 1.9)
    return Scan(turning(rng, scene, eye, np.radians(np.linspace(-24, 14, 64)), max(64, count // 64), .02), eye)


def merged_views(rng, count):
    """A figure on a stand from ten sides, each view off by a little; its bottom isn't seen."""
    scene = Scene()
    scene.solids = [column((0, 0, .05), .35, .1, 24), ball((0, 0, .55), .3, 160, False, (1, .8, 1.4)),
                    ball((.05, 0, 1.1), .18, 120), box((0, .3, .5), (.08, .2, .08), .3), box((0, -.3, .7), (.08, .2, .06)),
                    cone((.05, 0, 1.2), .15, .3, False)]
    parts, rows = [], int(np.sqrt(count / 10 * 1.6))
    for k in range(10):
        eye = 3 * np.array([np.cos(k * 1.257), np.sin(k * 1.257), .25 if k < 5 else .6]) + [0, 0, .6]
        ways, _ = looking(eye, (0, 0, .65), rows, rows, .3)
        origins = np.tile(eye, (len(ways), 1))
        parts.append(measured(rng, origins, ways, scene.meet(rng, origins, ways), .0008) + rng.normal(0, .001, 3))
    return Scan(np.vstack(parts))


KINDS = {
    "houses": lambda rng, count: city(rng, count, (3, 8), 3),
    "towers": lambda rng, count: city(rng, count, (15, 45), 1),
    "broadleaves": lambda rng, count: forest(rng, count, False, 6.5),
    "conifers": lambda rng, count: forest(rng, count, True, 4.5),
    "hills": hills,
    "room-rgbd": room_by_depth_camera,
    "room-scanners": room_by_two_scanners,
    "table": view_of_a_table,
    "stereo": street_by_stereo,
    "street": street_by_turning_scanner,
    "figure": merged_views,
}


def write(path, points):
    """As whole numbers of tenths of millimetres, written as double."""
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    pathlib.Path(path).write_bytes(header.encode() + (np.round(points * 1e4) / 1e4).astype("<f8").tobytes())


def make(kind, seed, count):
    """Scan; its `points` is an array of about `count` rows."""
    return KINDS[kind](np.random.default_rng([seed, *kind.encode()]), count)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("seed", type=int)
    parser.add_argument("cloud")
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--shuffled", action="store_true", help="in random order, which tells nothing of the scanner")
    options = parser.parse_args()
    scan = make(options.kind, options.seed, options.points)
    points = scan.points
    if options.shuffled:
        points = points[np.random.default_rng(options.seed).permutation(len(points))]
    write(options.cloud, points)
    print(f"{len(points)} points" + (f", seen from {scan.scanner}" if scan.scanner else ""), file=sys.stderr)


if __name__ == "__main__":
    main()
