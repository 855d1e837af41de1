#!/usr/bin/env python3
"""How near whittle's meshes of real scans come to their points, beside the peers, with pictures.

Usage: real_scans.py [--build build/release] [--models samp53g,lion,towers:3] [--points 100000]
                     [--ratios 0.2,0.1,0.05] [--surface auto]
                     [--peers front,delaunay] [--no-halves] [--no-pictures] [--rounds 3] [-o out/real_scans.md]

The scans lie in ../shared/data/scans, and what measures them is ../shared/tools/open_scan.cpp; without these nothing is
done.  A model may be a made scene as well: `towers:3` is the kind `towers` of scenes.py with the seed 3; --points says of
about how many points.  Or any other scan: a file's path, with :ground for terrain that was seen from above and :origin
for a scan whose scanner stood at the origin, as in scans/tile.las:ground.

Peers: two-dimensional Delaunay triangulation (of terrain), advancing front and Poisson reconstruction of all points,
each brought to the same number of vertices by Lindstrom and Turk's edge collapse; and greedy insertion of as many
points (of terrain).

Columns: vertices; mean distance of the points to the mesh, its 99th percentile and the same mean where the mesh was
made of a random half of the points and is measured by the other, in 1e-4 of the diagonal; share of the area that is far
from all points; area that faces up and down, in units of the ground's (of terrain); share of vertical lines through
points that meet the mesh once (of terrain); share of the area that faces away from the scanner (where its place is
known); borders, pieces; edges that aren't manifold or oriented, vertices in several fans, pairs of triangles that
cross; processor time in seconds, of peers with the reconstruction; how many times as long the whole program takes, by
the clock and of all processors together, as for as many points of a closed model (CLOSED's mesh, sampled evenly): the
least of --rounds runs of either, in turn, with as many threads as there are processors.  Nothing else should run then.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import collections
import json
import pathlib
import random
import subprocess
import sys
import time

import numpy as np

import models
import scenes
from programs import Failed, Made, Programs, markdown, processor_ms, run, work_of

SCANS = models.SHARED / "scans"
METER = models.SHARED.parent / "tools" / "open_scan.cpp"
OURS = ("subset", "optimal")
PIXELS, NEARBY = 600, 0.3  # of a picture's longer side; of a scan's width and height
AWAY = (0.85, 0.45, 0.4)  # colour of back faces
PEERS = {"delaunay": "surface_cgal", "greedy": "surface_cgal", "front": "surface_cgal", "poisson": "open3d"}
OF_TERRAIN = ("delaunay", "greedy")
CLOSED = "horse"  # a model of models.py
HEADER = ("scan", "kept", "method", "vertices", "mean", "99 %", "half", "far %", "up", "down", "once %", "away %",
          "borders", "pieces", "bad edges", "pinched", "crossings", "s", "times closed", "times its work")

# scanner: where it stood, where that is known; whether the scan is of the ground, seen from above.
Scan = collections.namedtuple("Scan", "file scanner terrain", defaults=(None, False))
KNOWN = {"samp53g": Scan("samp53g.pcd", terrain=True), "autzen_trim": Scan("autzen_trim.las", terrain=True),
         "frag2": Scan("frag2.ply"), "lion": Scan("lion.ply"), "mosd10": Scan("mosd10.pcd", (0, 0, 0)),
         "range1": Scan("range1.ply", (0, 0, 0))}


def is_made(name):
    return name.partition(":")[0] in scenes.KINDS and name.partition(":")[2].isdigit()


def scan_of(name):
    """The scan that a name of --models tells of, or None."""
    path, _, sort = name.partition(":")
    if name in KNOWN:
        return KNOWN[name]._replace(file=SCANS / KNOWN[name].file)
    if sort in ("", "ground", "origin") and pathlib.Path(path).is_file():
        return Scan(pathlib.Path(path).resolve(), (0, 0, 0) if sort == "origin" else None, sort == "ground")
    return None


def stem_of(name):
    """What a scan is called in tables and in the names of files."""
    return name if name in KNOWN or is_made(name) else pathlib.Path(name.partition(":")[0]).stem


def sample(mesh, count, target):
    """Points on a mesh, one at random in each of as many equal stretches of its area."""
    rng = np.random.default_rng(7)
    columns, corners = models.read_ply(mesh)
    corner = np.column_stack([columns[axis] for axis in "xyz"])[np.array(corners).reshape(-1, 3)]
    side, other = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    reached = np.cumsum(np.linalg.norm(np.cross(side, other), axis=1))
    at = np.searchsorted(reached / reached[-1], (np.arange(count) + rng.random(count)) / count).clip(0, len(corner) - 1)
    along = rng.random((count, 2))
    along = np.where(along.sum(1, keepdims=True) > 1, 1 - along, along)
    models.write_ply(target, (corner[at, 0] + side[at] * along[:, :1] + other[at] * along[:, 1:]).ravel())


class Campaign:
    """One run: its programs, its meter, its options."""

    def __init__(self, options):
        self.options = options
        self.programs = Programs(options.build, f"out/{options.output.stem}")
        self.folder = self.programs.folder
        self.meter = options.build / "tests/peers/open_scan"
        if not self.meter.exists() or self.meter.stat().st_mtime < METER.stat().st_mtime:
            run(["g++", "-O2", "-std=c++17", METER, "-o", self.meter, "-lgmp", "-lmpfr"])
        self.scans = {stem_of(name): self.made(name) if is_made(name) else scan_of(name) for name in options.models}

    def made(self, name):
        kind, _, seed = name.partition(":")
        scene = scenes.make(kind, int(seed), self.options.points)
        target = self.folder / f"made-{kind}-{seed}.ply"
        scenes.write(target, scene.points)
        return Scan(target, scene.scanner, scene.ground)

    def points_of(self, name):
        """All points of a scan as the PLY that the peers read, and a random half and the other."""
        stem = f"{name}-{self.options.points}" if is_made(name) else name
        target = self.folder / f"{stem}.ply"
        halves = [self.folder / f"{stem}-{part}.ply" for part in ("half", "other")]
        if not all(path.exists() for path in [target, *halves]):
            folder, _ = self.programs.whittle(self.scans[name].file, "--ratio", 1, outputs="cloud,report", name="all")
            models.to_plain(folder / "cloud.ply", target)
            columns, _ = models.read_ply(target)
            points = list(zip(*(columns[axis] for axis in "xyz")))
            random.Random(1).shuffle(points)
            for path, part in zip(halves, (points[::2], points[1::2])):
                models.write_ply(path, [c for point in part for c in point])
        return target, *halves

    def ours(self, cloud, ratio, placement, name):
        folder, report = self.programs.whittle(cloud, "--ratio", ratio, "--placement", placement, "--surface",
                                               self.options.surface, "--threads", 1, outputs="mesh,report", name=name)
        plain = self.programs.plain(folder / "mesh.ply", name)
        return Made(plain, report["mesh"]["vertices"], *work_of(report))

    def reconstructed(self, cloud, peer):
        """A peer's mesh of all points, made once."""
        target = self.folder / f"{cloud.stem}-{peer}.ply"
        told = target.with_suffix(".json")
        if not told.exists():
            made = self.programs.peer(PEERS[peer], peer, Made(cloud, 0), 0, name=target.stem)
            told.write_text(json.dumps(made[1:]))
        return Made(target, *json.loads(told.read_text()))

    def theirs(self, cloud, ratio, peer, name):
        count = int(ratio * models.count_of(cloud))
        if peer == "greedy":
            return self.programs.peer(PEERS[peer], peer, Made(cloud, 0), count, name=name)
        return self.programs.peer("surface_cgal", "lindstrom-turk", self.reconstructed(cloud, peer), count, name=name)

    def mesh(self, cloud, ratio, method, name):
        return self.ours(cloud, ratio, method, name) if method in OURS else self.theirs(cloud, ratio, method, name)

    def closed(self, count):
        """So many points of the closed model, or None where it isn't at hand."""
        target = self.folder / f"closed-{count}.ply"
        known = [] if target.exists() else models.find((CLOSED,))
        if known:
            sample(known[0].mesh, count, target)
        return target if target.exists() else None

    def times_closed(self, cloud, count, ratio, placement):
        """How many times a closed model's (clock, processors) a mesh of a cloud takes."""
        pair, least = (cloud, self.closed(count)), [[], []]
        if not self.options.rounds or not pair[1]:
            return "-", "-"
        for _ in range(self.options.rounds):
            for which, taken in zip(pair, least):
                before, began = processor_ms(), time.monotonic()
                self.programs.whittle(which, "--ratio", ratio, "--placement", placement, "--surface",
                                      self.options.surface if which == cloud else "auto", outputs="mesh,report",
                                      name="timed")
                taken.append((time.monotonic() - began, processor_ms() - before))
        scan, closed = ([min(column) for column in zip(*taken)] for taken in least)
        return tuple(f"{of_scan / of_closed:.2f}" for of_scan, of_closed in zip(scan, closed))

    def measure(self, points, mesh, scanner=None):
        done = subprocess.run([str(w) for w in (self.meter, points, mesh, *(scanner or ()))], capture_output=True,
                              text=True, check=False)
        if done.returncode:
            raise Failed(f"open_scan: {done.stdout or done.stderr}")
        return json.loads(done.stdout)


def cells_of(campaign, name, ratio, method):
    """(columns after the method's name, path of the mesh)."""
    scan, (whole, half, other) = campaign.scans[name], campaign.points_of(name)
    source = scan.file if method in OURS else whole  # with the viewpoint that it may have
    made = campaign.mesh(source, ratio, method, f"{name}-{ratio:g}-{method}")
    told = campaign.measure(whole, made.path, scan.scanner)
    sound = json.loads(run([campaign.options.build / "tests/peers/soundness_cgal", made.path]))
    held_out = "-"
    if campaign.options.halves:
        of_half = campaign.mesh(half, ratio, method, f"{name}-{ratio:g}-{method}-half")
        held_out = f"{campaign.measure(other, of_half.path)['points_to_mesh_mean']:.2f}"
    ground = [f"{told['up']:.3f}", f"{told['down']:.3f}", f"{100 * told['layers_1']:.1f}"] if scan.terrain else ["-"] * 3
    times = campaign.times_closed(source, models.count_of(whole), ratio, method) if method in OURS else ("-", "-")
    away = "-" if told["away"] is None else f"{100 * told['away']:.1f}"
    return [made.points, f"{told['points_to_mesh_mean']:.3f}", f"{told['points_to_mesh_p99']:.1f}", held_out,
            f"{100 * told['phantom']:.1f}", *ground, away, told["boundary_loops"], told["components"],
            told["nonmanifold_edges"] + told["misoriented_edges"], sound["pinched"], sound["crossings"],
            f"{made.processor_ms / 1e3:.1f}", *times], made.path


def methods_for(scan, options):
    return [*OURS, *(peer for peer in options.peers if peer not in OF_TERRAIN or scan.terrain)]


def draw(campaign, name, ratio, made):
    """Each mesh as a whole and from nearby, flat shaded, so that each triangle is seen; back faces are red."""
    sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "paper"))
    import draw as pictures  # pylint: disable=import-outside-toplevel

    path = campaign.folder / f"{name}-{ratio:g}.png"
    points = np.column_stack([models.read_ply(campaign.points_of(name)[0])[0][axis] for axis in "xyz"])
    across = pictures.Camera(name, points, PIXELS).axes[:2].T
    drawn, titles = [], []
    for part, share in (("", 1.0), (", nearby", NEARBY)):
        low, high = np.percentile(points @ across, [50 - 50 * share, 50 + 50 * share], axis=0)
        camera = pictures.Camera(name, points[((points @ across >= low) & (points @ across <= high)).all(1)], PIXELS)
        for method, mesh in made.items():
            columns, corners = models.read_ply(mesh)
            xyz, faces = np.column_stack([columns[axis] for axis in "xyz"]), np.array(corners).reshape(-1, 3)
            seen = (xyz @ across)[faces]
            faces = faces[((seen.max(1) >= low) & (seen.min(1) <= high)).all(1)]
            away = pictures.face_normals(xyz, faces) @ camera.axes[2] < 0
            drawn.append(pictures.draw_mesh(camera, xyz, faces, face_colour=np.where(
                away[:, None], AWAY, pictures.CLAY)))
            titles.append(f"{name}, {100 * ratio:g} %, {method}{part}")
    pictures.panels(path, drawn, titles, rows=2)
    return path


def measure_scan(campaign, name, ratio):
    rows, made = [], {}
    for method in methods_for(campaign.scans[name], campaign.options):
        began = time.monotonic()
        head = [name, f"{100 * ratio:g} %", method]
        try:
            cells, made[method] = cells_of(campaign, name, ratio, method)
        except Failed as failure:
            cells = ["-"] * (len(HEADER) - len(head))
            print(f"{name}, {method}: {failure}", file=sys.stderr)
        rows.append(head + cells)
        print(*rows[-1], f"({time.monotonic() - began:.0f} s)", file=sys.stderr, flush=True)
    if campaign.options.pictures:
        print(draw(campaign, name, ratio, made), file=sys.stderr)
    return rows


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--build", default="build/release", type=pathlib.Path)
    parser.add_argument("--models", default=list(KNOWN), type=lambda text: text.split(","))
    parser.add_argument("--ratios", default=[0.2, 0.1, 0.05], type=lambda text: [float(w) for w in text.split(",")])
    parser.add_argument("--surface", default="auto")
    parser.add_argument("--points", default=100_000, type=int)
    parser.add_argument("--peers", default=list(PEERS), type=lambda text: [w for w in text.split(",") if w])
    parser.add_argument("--rounds", default=3, type=int)
    for what in ("halves", "pictures"):
        parser.add_argument(f"--no-{what}", dest=what, action="store_false")
    parser.add_argument("-o", "--output", default="out/real_scans.md", type=pathlib.Path)
    options = parser.parse_args()
    unknown = sorted(name for name in options.models if not is_made(name) and scan_of(name) is None)
    if unknown:
        parser.error(f"no scan {', '.join(unknown)}; there are {', '.join(KNOWN)}, "
                     f"{', '.join(scenes.KINDS)} with a seed, as in towers:3, and any file, as in tile.las:ground")
    unknown = set(options.peers) - set(PEERS)
    if unknown:
        parser.error(f"no peer {', '.join(sorted(unknown))}; there are {', '.join(PEERS)}")
    return options


def main():
    options = parse()
    missing = [path for path in (METER, *(SCANS / KNOWN[name].file for name in options.models if name in KNOWN))
               if not path.exists()]
    if missing:
        print(f"real_scans: skipped: there is no {missing[0]}")
        return
    campaign = Campaign(options)
    rows = [row for name in campaign.scans for ratio in options.ratios for row in measure_scan(campaign, name, ratio)]
    text = markdown(HEADER, rows) + "\n"
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
