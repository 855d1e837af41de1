#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""A cloud with colours as an octree that Potree's viewer opens (its form 1.7), as PotreeConverter makes it.

Usage: octree.py CLOUD.ply FOLDER

The cloud is a binary little-endian PLY of scalars, as whittle writes error.ply.  FOLDER gets cloud.js, and in data/r/ the
tree (r.hrc) and a file for each node: 16 bytes a point, its place from the node's corner in units of `scale`, its colour.
A node takes an even choice of its points; the others go to its eighths.
"""
import argparse
import json
import pathlib

import numpy

NODE_POINTS = 20000
STEPS = 1 << 24  # of the whole cube's edge: as many as a float tells apart
DEEPEST = 20
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8"}


def read_ply(file):
    head, body = file.read_bytes().split(b"end_header\n", 1)
    words = [line.split() for line in head.decode().splitlines()]
    if ["format", "binary_little_endian", "1.0"] not in words:
        raise SystemExit(f"{file}: no binary little-endian PLY")
    count = next(int(line[2]) for line in words if line[:2] == ["element", "vertex"])
    row = numpy.dtype([(line[2], "<" + TYPES[line[1]]) for line in words if line[0] == "property" and line[1] in TYPES])
    points = numpy.frombuffer(body, row, count)
    places = numpy.stack([points[name] for name in "xyz"], 1).astype(float)
    colours = numpy.stack([points[name] for name in ("red", "green", "blue")], 1)
    return places, colours


def write_octree(places, colours, folder):
    data = folder / "data" / "r"
    data.mkdir(parents=True)
    low, size = places.min(0), float(numpy.ptp(places, 0).max()) or 1.0
    at = numpy.minimum((places - low) / size * STEPS, STEPS - 1).astype(numpy.uint32)
    order = numpy.random.default_rng(1).permutation(len(at))
    tree, nodes = bytearray(), [("r", order, numpy.zeros(3, numpy.uint32))]
    for name, those, corner in nodes:  # grows while it is read: the tree is written level by level
        own, rest = those[:NODE_POINTS], those[NODE_POINTS:]
        if len(name) > DEEPEST:
            own, rest = those, those[:0]
        half = STEPS >> len(name)
        eighth = ((at[rest] - corner) // half) @ [4, 2, 1]
        children = numpy.unique(eighth)
        for child in children:
            steps = numpy.array([child >> 2 & 1, child >> 1 & 1, child & 1], numpy.uint32)
            nodes.append((f"{name}{child}", rest[eighth == child], corner + steps * numpy.uint32(half)))
        tree += bytes([sum(1 << int(child) for child in children)]) + len(own).to_bytes(4, "little")
        rows = numpy.zeros(len(own), [("at", "<u4", 3), ("colour", "u1", 4)])
        rows["at"], rows["colour"][:, :3] = at[own] - corner, colours[own]
        (data / f"{name}.bin").write_bytes(rows.tobytes())
    (data / "r.hrc").write_bytes(tree)
    box = {f"{end}{axis}": float(low[i] + (size if end == "u" else 0)) for end in "lu" for i, axis in enumerate("xyz")}
    tight = {f"{end}{axis}": float(side[i]) for end, side in (("l", low), ("u", places.max(0))) for i, axis in enumerate("xyz")}
    (folder / "cloud.js").write_text(json.dumps({
        "version": "1.7", "octreeDir": "data", "points": len(at), "boundingBox": box, "tightBoundingBox": tight,
        "pointAttributes": ["POSITION_CARTESIAN", "COLOR_PACKED"], "spacing": size / 128, "scale": size / STEPS,
        "hierarchyStepSize": DEEPEST + 1}))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloud", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    arguments = parser.parse_args()
    write_octree(*read_ply(arguments.cloud), arguments.folder)


if __name__ == "__main__":
    main()
