#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""A tileset of more points than memory holds: time, memory, and each geometricError against scipy's.

Usage: tileset.py BUILD_FOLDER POINTS [--memory BYTES] [--folder FOLDER] [--show FOLDER]

The cloud is synthetic (make_scan), and all of its points are kept.  Errors are looked up from outside: of every tile
that has others below it, the largest distance of a point below to the nearest of what is shown with it.  --show has it
opened by 3d-tiles-renderer in Chromium, which puts a picture into the folder."""
import argparse
import json
import pathlib
import shutil
import struct
import subprocess
import sys
import tempfile

import numpy
from huge import run
from scipy.spatial import cKDTree


def positions(path):
    """Of a tile's points, in the tileset's axes."""
    data = path.read_bytes()
    json_bytes = struct.unpack("<I", data[12:16])[0]
    scene, binary = json.loads(data[20:20 + json_bytes]), data[28 + json_bytes:]
    accessor = scene["accessors"][scene["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    view = scene["bufferViews"][accessor["bufferView"]]
    found = numpy.ndarray((accessor["count"], 3), "<f4", binary, view["byteOffset"], (view.get("byteStride", 12), 4))
    x, y, z = (found.astype("f8") + scene["nodes"][0]["translation"]).T
    return numpy.stack([x, -z, y], 1)


class Errors:
    """A walk through the tree: what is shown above a tile is known on the way down, what is below it on the way up."""

    def __init__(self, folder):
        self.folder, self.tiles, self.points, self.worst, self.checked = folder, 0, 0, 0.0, 0

    def walk(self, tile, above):
        """The points of a tile and those below it, each with its distance to what is shown with every tile above."""
        own = positions(self.folder / tile["content"]["uri"])
        self.tiles, self.points = self.tiles + 1, self.points + len(own)
        distances, nearest = [], numpy.full(len(own), numpy.inf)
        for tree in above:
            nearest = numpy.minimum(nearest, tree.query(own, workers=-1)[0])
            distances.append(nearest.max())
        children = tile.get("children", [])
        below = [0.0] * (len(above) + 1)
        shown = [*above, cKDTree(own)] if children else above
        for child in children:
            below = numpy.maximum(below, self.walk(child, shown))
        if children:
            self.checked += 1
            self.worst = max(self.worst, abs(tile["geometricError"] / below[-1] - 1))
        elif tile["geometricError"] != 0:
            sys.exit("a tile with none below has an error")
        return [max(pair) for pair in zip(below, distances)]


def show(out, pictures):
    """What the viewer held from far off, and from nearby with errors of a pixel and a half."""
    script = pathlib.Path(__file__).parent.parent / "node/show_tileset.mjs"
    pathlib.Path(pictures).mkdir(parents=True, exist_ok=True)
    done = subprocess.run(["node", script, shutil.which("chromium"), out, pictures, "1.5"], capture_output=True,
                          text=True, check=False)
    if done.returncode != 0:
        sys.exit(done.stderr)
    seen = json.loads(done.stdout)
    for where, name in (("far", "from far off"), ("all", "nearby")):
        view = seen[where]
        print(f"3d-tiles-renderer {name}: {view['tiles']} tiles, {view['points']} points, {view['pixels']} pixels")
    if seen["errors"] or seen["failed"]:
        sys.exit(f"{seen['errors']} {seen['failed']}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("points", type=int)
    parser.add_argument("--memory", default="1G")
    parser.add_argument("--folder")
    parser.add_argument("--show")
    options = parser.parse_args()
    build = options.build
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = pathlib.Path(name)
        cloud, out = folder / "cloud.ply", folder / "cloud.3dtiles"
        with open(cloud, "wb") as written:
            subprocess.run([build / "tests/bench/make_scan", str(options.points)], stdout=written, check=True)
        clock, processor, peak, _ = run(build / "whittle", cloud, out, "--ratio", "1", "--memory", options.memory, "-q")
        print(f"tileset          {clock:.0f} s, {processor:.0f} s of processor, {peak / 2**20:.0f} MiB at most", flush=True)
        errors = Errors(out)
        errors.walk(json.loads((out / "tileset.json").read_text())["root"], [])
        print(f"points           {errors.points} in {errors.tiles} tiles")
        print(f"geometricError   of {errors.checked} tiles: at most {100 * errors.worst:.4f} % from scipy's")
        validate = pathlib.Path(__file__).parent.parent / "node/validate_glb.js"
        if (validate.parent / "node_modules/gltf-validator").exists():
            tiles = sorted((out / "tiles").iterdir())
            for first in range(0, len(tiles), 100):
                subprocess.run(["node", validate, *tiles[first:first + 100]], check=True)
            print(f"gltf-validator   {len(tiles)} tiles, nothing to say")
        if options.show:
            show(out, options.show)
        if errors.points != options.points or errors.worst > 0.05:
            sys.exit("the tileset isn't what it should be")


if __name__ == "__main__":
    main()
