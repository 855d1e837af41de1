#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""From "I have a file" to "I see what was lost": our page beside other ways, in steps by hand and in seconds.

Usage: compare.py BUILD_FOLDER OUT_FOLDER CLOUD

Prints a table in Markdown and leaves a picture of each way in OUT_FOLDER.  Seconds are those of the machine: each step
of a person comes on top.  What a way can't do is said.

    page          file chosen, Simplify pressed; until every point is seen in the colour of its deviation
    CloudCompare  whittle makes the mesh; both files opened, distances computed (C2M); until its window shows them
    glTF viewer   whittle makes the mesh as glTF; until <model-viewer> shows it
    Potree        whittle writes each point with its deviation as a colour; octree.py makes Potree's octree of it, as
                  PotreeConverter would, which neither Debian nor npm have; until Potree's viewer shows every point
"""
import argparse
import json
import os
import pathlib
import resource
import shutil
import subprocess
import tempfile
import time

from service import serving

HERE = pathlib.Path(__file__).resolve().parent
MODEL_VIEWER = HERE / "viewers/node_modules/@google/model-viewer/dist/model-viewer.min.js"
POTREE = HERE / "viewers/node_modules/potree"
SCREEN = "1600x900x24"


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


def by_potree(build, cloud, out, folder):
    making = timed(build / "whittle", cloud, folder / "error.ply", "--ratio", "0.1", "--outputs", "error", "-q")
    converting = timed(HERE / "octree.py", folder / "error.ply", folder / "octree")
    points = json.loads((folder / "octree/cloud.js").read_text())["points"]
    return making + converting + browser("potree", POTREE, folder / "octree", str(points), out / "potree.png")


def shows_distances(picture):
    """Whether there are points in the picture that are coloured by small distances, which are green; a window without a
    cloud is grey and blue, with some spots of other colours on its buttons."""
    green = subprocess.run(["convert", picture, "-resize", "10%", "-fx", "max(0,g-b-.2)", "-format", "%[fx:mean]", "info:"],
                           check=True, capture_output=True, text=True).stdout
    return float(green) > 0.004


def window_of(file, picture):
    """Seconds until CloudCompare shows a file, on a screen of its own: until there are points in the picture and it stands
    still."""
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
                    if now == before and shows_distances(picture):
                        break
                    before, seconds = now, time.monotonic() - began
                else:
                    raise SystemExit(f"CloudCompare shows no distances: {picture}")
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
                ("whittle and Potree's viewer", "4: a command, PotreeConverter, a page that names the octree, a web server",
                 lambda: by_potree(build, cloud, out, folder), "every point in the colour of its deviation; no scale, no result"),
                ("whittle and a glTF viewer", "2: a command, open the file", lambda: by_gltf(build, cloud, out, folder), "the result alone; nothing of what was lost")):
            before = spent()
            seconds = measure()
            print(f"| {way} | {steps} | {seconds:.0f} | {spent() - before:.1f} | {seen} |", flush=True)
    print(f"\n{cloud.name}; load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    main()
