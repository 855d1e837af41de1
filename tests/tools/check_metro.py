#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares the distances that whittle measures with those of MeshLab, which has code of its own for them.

    tests/tools/check_metro.py WHITTLE A.ply B.ply

A and B are triangle meshes (PLY: text or little-endian, x y z first).  Three one-sided distances are measured by both:
from the points of B, which is exact on either side, and from samples of each surface, where chance is left.  Both are
given the same copies, scaled to a diagonal of 1e5, since MeshLab prints six decimals.  Exit status: 0 agreement,
1 disagreement, 77 MeshLab (meshlabserver) or Xvfb (xvfb-run), which it needs, isn't installed.
"""
import json
import math
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile

SAMPLES = 1000000
DIAGONAL = 1e5
CODES = {"char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H",
         "uint16": "H", "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f",
         "double": "d", "float64": "d"}
# Name, is it B that is sampled, are its vertices the samples, member of whittle's JSON, tolerances of mean, rms, max.
# MeshLab computes in single precision.  Its largest distance is of other samples than ours, so it is only shown.
CHECKS = [("points of B to A", True, True, "forward", (1e-4, 1e-4, 1e-4)),
          ("surface of B to A", True, False, "surface", (0.02, 0.03, None)),
          ("surface of A to B", False, False, "backward", (0.02, 0.03, None))]


def read_header(data):
    end = data.index(b"end_header")
    end = data.index(b"\n", end) + 1
    elements, encoding = [], None
    for line in data[:end].decode("latin-1").split("\n"):
        words = line.split()
        if words[:1] == ["format"]:
            encoding = words[1]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    return encoding, elements, end


def reader(data, offset, ascii_text):
    """A function that returns the next n numbers of a type."""
    if ascii_text:
        words = iter(data[offset:].split())
        return lambda code, n: [float(next(words)) if code in "fd" else int(next(words)) for _ in range(n)]
    place = [offset]

    def take(code, n):
        values = struct.unpack_from(f"<{n}{code}", data, place[0])
        place[0] += struct.calcsize(f"<{n}{code}")
        return values
    return take


def read_ply(path):
    with open(path, "rb") as file:
        data = file.read()
    encoding, elements, offset = read_header(data)
    if encoding not in ("ascii", "binary_little_endian"):
        sys.exit(f"{path}: {encoding} isn't read here")
    take = reader(data, offset, encoding == "ascii")
    rows = {"vertex": [], "face": []}
    for name, count, properties in elements:
        for _ in range(count):
            row = []
            for words in properties:
                row += take(CODES[words[2]], take(CODES[words[1]], 1)[0]) if words[0] == "list" else take(CODES[words[0]], 1)
            rows.setdefault(name, []).append(row)
    return [row[:3] for row in rows["vertex"]], [row[:3] for row in rows["face"]]


def write_ply(path, mesh, scale):
    points, faces = mesh
    header = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\n"
              f"property float y\nproperty float z\nelement face {len(faces)}\n"
              "property list uchar int vertex_indices\nend_header\n")
    with open(path, "wb") as file:
        file.write(header.encode())
        for point in points:
            file.write(struct.pack("<3f", *(scale * x for x in point)))
        for face in faces:
            file.write(struct.pack("<B3i", 3, *face))


def script(from_b, vertices):
    def row(kind, name, value):
        return f'<Param type="{kind}" name="{name}" value="{value}" min="0" max="{10 * DIAGONAL}"/>'
    yes_no = ["false", "true"]
    rows = [row("RichMesh", "SampledMesh", int(from_b)), row("RichMesh", "TargetMesh", int(not from_b)),
            row("RichBool", "SaveSample", "false"), row("RichBool", "SampleVert", yes_no[vertices]),
            row("RichBool", "SampleEdge", "false"), row("RichBool", "SampleFauxEdge", "false"),
            row("RichBool", "SampleFace", yes_no[not vertices]), row("RichInt", "SampleNum", SAMPLES),
            row("RichAbsPerc", "MaxDist", 10 * DIAGONAL)]
    return ("<!DOCTYPE FilterScript>\n<FilterScript>\n<filter name=\"Hausdorff Distance\">\n" + "\n".join(rows) +
            "\n</filter>\n</FilterScript>\n")


def meshlab(folder, from_b, vertices):
    path = os.path.join(folder, "hausdorff.mlx")
    with open(path, "w") as file:
        file.write(script(from_b, vertices))
    command = ["xvfb-run", "-a", "meshlabserver", "-i", os.path.join(folder, "a.ply"), os.path.join(folder, "b.ply"),
               "-s", path]
    run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    found = re.search(r"max\s+(\S+)\s+mean\s*:\s+(\S+)\s+RMS\s*:\s+(\S+)", run.stdout)
    if not found:
        sys.exit(f"MeshLab printed no distance:\n{run.stdout}")
    largest, mean, rms = map(float, found.groups())
    return mean, rms, largest


def whittle(program, folder):
    command = [program, "measure", os.path.join(folder, "a.ply"), os.path.join(folder, "b.ply"), "--json", "--samples",
               str(SAMPLES)]
    return json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)


def compare(name, ours, theirs, tolerances):
    agree = True
    for what, x, y, tolerance in zip(("mean", "rms", "max"), ours, theirs, tolerances):
        difference = abs(x - y) / max(abs(y), 1e-5)
        good = tolerance is None or difference <= tolerance
        print(f"{name if what == 'mean' else '':20}{what:6}{x / DIAGONAL:14.6e}{y / DIAGONAL:14.6e}{difference:10.2e}"
              f"  {'' if tolerance is None else 'ok' if good else 'DIFFERS'}")
        agree = agree and good
    return agree


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    for needed in ("meshlabserver", "xvfb-run"):
        if not shutil.which(needed):
            print(f"skipped: {needed} isn't installed")
            return 77
    meshes = [read_ply(path) for path in sys.argv[2:]]
    scale = DIAGONAL / math.dist(*([pick(axis) for axis in zip(*meshes[1][0])] for pick in (min, max)))
    with tempfile.TemporaryDirectory() as folder:
        for name, mesh in zip(("a.ply", "b.ply"), meshes):
            write_ply(os.path.join(folder, name), mesh, scale)
        figures = whittle(sys.argv[1], folder)
        print(f"{'of the diagonal':26}{'whittle':>14}{'MeshLab':>14}{'relative':>10}")
        agree = True
        for name, from_b, vertices, member, tolerances in CHECKS:
            ours = [figures[member][key] for key in ("mean", "rms", "max")]
            agree = compare(name, ours, meshlab(folder, from_b, vertices), tolerances) and agree
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
