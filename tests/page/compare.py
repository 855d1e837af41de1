#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""From "I have a file" to "I see what was lost": our page beside other ways, in steps by hand and in seconds.

Usage: compare.py BUILD_FOLDER OUT_FOLDER CLOUD

Prints a table in Markdown and leaves a picture of each way in OUT_FOLDER.  Seconds are those of the machine: each step
of a person comes on top.  What a way can't do is said.

    page          file chosen, Simplify pressed; until every point is seen in the colour of its deviation
    CloudCompare  whittle makes the mesh; both files opened, distances computed (C2M); until its window shows them
    glTF viewer   whittle makes the mesh as glTF; until <model-viewer> shows it
    Potree        whittle measures every point; an octree of those is written here, where PotreeConverter would be run,
                  which neither Debian nor npm have; until potree-core, the renderer of Potree's viewer, shows all points
"""
import argparse
import json
import os
import pathlib
import resource
import shutil
import struct
import subprocess
import tempfile
import time

from service import serving

HERE = pathlib.Path(__file__).resolve().parent
MODEL_VIEWER = HERE / "viewers/node_modules/@google/model-viewer/dist/model-viewer.min.js"
SCREEN = "1600x900x24"
MOST = 20000  # points of a node of an octree


def spent():
    """Processor seconds of all processes that were started here and have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def timed(*command, **options):
    began = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **options)
    return time.monotonic() - began


def browser(*arguments):
    done = subprocess.run(["node", HERE / "compare.js", shutil.which("chromium"), *arguments], check=True, text=True, stdout=subprocess.PIPE)
    return float(done.stdout)


def by_page(build, cloud, out):
    with serving(build) as address:
        return browser("page", f"http://{address}/", cloud, out / "page.png")


def by_gltf(build, cloud, out, folder):
    making = timed(build / "whittle", cloud, folder / "mesh.glb", "--ratio", "0.1", "-q")
    return making + browser("gltf", MODEL_VIEWER, folder / "mesh.glb", out / "gltf.png")


def octree(points, folder):
    """Writes points (x, y, z, value) as Potree 2.0 has them, in place of PotreeConverter: nodes of at most MOST points."""
    least, most_value = [min(p[k] for p in points) for k in range(3)], max(p[3] for p in points) or 1
    side = max(max(p[k] for p in points) - least[k] for k in range(3)) or 1
    scale, nodes, data = side / (1 << 30), [], bytearray()
    waiting = [(points, tuple(least), side)]
    for these, corner, wide in waiting:  # by breadth, as hierarchy.bin has them
        step = max(1, -(-len(these) // MOST))
        parts = [[] for _ in range(8)]
        for i, p in enumerate(these):
            if i % step:
                parts[sum((p[k] >= corner[k] + wide / 2) << (2 - k) for k in range(3))].append(p)
        own, begin = these[::step], len(data)
        for p in own:
            data += struct.pack("<3iH", *(round((p[k] - least[k]) / scale) for k in range(3)), round(65535 * p[3] / most_value))
        nodes.append(struct.pack("<BBIqq", not any(parts), sum(bool(part) << c for c, part in enumerate(parts)), len(own), begin, len(data) - begin))
        waiting += [(part, tuple(corner[k] + (c >> (2 - k) & 1) * wide / 2 for k in range(3)), wide / 2) for c, part in enumerate(parts) if part]
    (folder / "octree.bin").write_bytes(data)
    (folder / "hierarchy.bin").write_bytes(b"".join(nodes))
    attributes = [("position", 3, 4, "int32", least, [c + side for c in least]), ("intensity", 1, 2, "uint16", [0], [65535])]
    (folder / "metadata.json").write_text(json.dumps({
        "version": "2.0", "name": "cloud", "points": len(points), "projection": "", "encoding": "DEFAULT", "offset": least, "scale": [scale] * 3, "spacing": side / 128,
        "hierarchy": {"firstChunkSize": 22 * len(nodes), "stepSize": 4, "depth": 8}, "boundingBox": {"min": least, "max": [c + side for c in least]},
        "attributes": [{"name": name, "description": "", "size": n * size, "numElements": n, "elementSize": size, "type": kind, "min": low, "max": high}
                       for name, n, size, kind, low, high in attributes]}), encoding="utf-8")


def by_potree(build, cloud, out, folder):
    making = timed(build / "whittle", cloud, "-o", folder / "measured", "--ratio", "0.1", "--outputs", "mesh,error", "--encoding", "ascii", "-q")
    lines = (folder / "measured/error.ply").read_text(encoding="ascii").partition("end_header\n")[2].splitlines()
    octree([tuple(map(float, line.split()[:4])) for line in lines], folder)
    return making + browser("potree", HERE / "viewers/node_modules", folder, out / "potree.png")


def brightness(picture):
    """From 0 to 1: a window is bright, an empty screen and what is shown before it aren't."""
    return float(subprocess.run(["convert", picture, "-colorspace", "Gray", "-format", "%[fx:mean]", "info:"], check=True, capture_output=True, text=True).stdout)


def window_of(file, picture):
    """Seconds until CloudCompare shows a file, on a screen of its own: until the picture is bright and stands still."""
    read, write = os.pipe()
    with subprocess.Popen(["Xvfb", "-displayfd", str(write), "-screen", "0", SCREEN], pass_fds=[write], stderr=subprocess.DEVNULL) as screen:
        os.close(write)
        display = os.environ | {"DISPLAY": f":{os.read(read, 16).decode().strip()}"}
        began = time.monotonic()
        with subprocess.Popen(["CloudCompare", file], env=display, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as window:
            try:
                before, seconds = None, 0.0
                while time.monotonic() - began < 300:
                    subprocess.run(["import", "-window", "root", picture], env=display, check=True)
                    now = picture.read_bytes()
                    if now == before and brightness(picture) > 0.2:
                        break
                    before, seconds = now, time.monotonic() - began
            finally:
                window.terminate()
                screen.terminate()
    return seconds


def by_cloudcompare(build, cloud, out, folder):
    making = timed(build / "whittle", cloud, folder / "mesh.ply", "--ratio", "0.1", "--outputs", "mesh", "-q")
    measuring = timed("xvfb-run", "-a", "CloudCompare", "-SILENT", "-AUTO_SAVE", "OFF", "-O", cloud, "-O", folder / "mesh.ply", "-C2M_DIST",
                      "-SAVE_CLOUDS", "FILE", folder / "distances.bin")
    return making + measuring + window_of(folder / "distances.bin", out / "cloudcompare.png")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("cloud", type=pathlib.Path)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    build, cloud, out = arguments.build, arguments.cloud, arguments.out
    print("| way | steps by hand | seconds | of processor | what is seen |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory(prefix="compare-") as name:
        folder = pathlib.Path(name)
        for way, steps, measure, seen in (
                ("the page", "2: choose the file, Simplify", lambda: by_page(build, cloud, out),
                 "before and after, every point in the colour of its deviation, histogram, figures"),
                ("whittle and CloudCompare", "9: a command; open, twice, each with a dialog; select both; Cloud/Mesh Dist.; roles; Compute; OK",
                 lambda: by_cloudcompare(build, cloud, out, folder), "the points in the colours of their distances"),
                ("whittle and a glTF viewer", "2: a command, open the file", lambda: by_gltf(build, cloud, out, folder), "the result alone; nothing of what was lost"),
                ("whittle and Potree", "6: a command; to LAZ; PotreeConverter; a page of one's own; a server for it; open it", lambda: by_potree(build, cloud, out, folder),
                 "the points in the colours of their distances; no mesh, scale of colours or figures")):
            before = spent()
            seconds = measure()
            print(f"| {way} | {steps} | {seconds:.0f} | {spent() - before:.1f} | {seen} |", flush=True)
    print(f"\n{cloud.name}; load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    main()
