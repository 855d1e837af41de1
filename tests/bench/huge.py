#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds larger than memory: time, memory, disk, seams, and up to 20 million points the error against memory's.

Usage: huge.py BUILD_FOLDER POINTS [--memory BYTES] [--ratio R] [--real CLOUD] [--folder FOLDER]

The cloud is synthetic (make_scan), or --real, repeated side by side with a noise of a tenth of its spacing, until there
are as many points.  Each step is a process of its own, as a batch system runs them."""
import argparse
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import time

IN_CORE = 20_000_000


def run(*command):
    """Seconds by the clock, seconds of processor, peak of memory in bytes, and what it printed."""
    start = time.monotonic()
    # A process counts what the one that started it had as its own peak: that is a shell, not this program.
    program = subprocess.Popen(["sh", "-c", '"$@"; exit $?', "sh", *map(str, command)], stdout=subprocess.PIPE, text=True)
    told = program.stdout.read()
    _, status, usage = os.wait4(program.pid, 0)
    if status:
        sys.exit(f"{command[0]} ended with {os.waitstatus_to_exitcode(status)}")
    return time.monotonic() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss << 10, told


def repeat(build, cloud, points, path):
    import numpy
    plain = path.with_suffix(".xyz")
    subprocess.run([build / "whittle", "convert", cloud, plain, "-q"], check=True)
    with open(plain, encoding="ascii") as lines:
        one = numpy.array([[float(x) for x in line.split(" ", 3)[:3]] for line in lines])
    plain.unlink()
    times, size = -(-points // len(one)), one.max(0) - one.min(0)
    side = math.ceil(math.sqrt(times))
    noise = 0.1 * math.sqrt(size[0] * size[1] / len(one))
    draw = numpy.random.default_rng(1)
    with open(path, "wb") as out:
        out.write((f"ply\nformat binary_little_endian 1.0\nelement vertex {points}\nproperty double x\n"
                   "property double y\nproperty double z\nend_header\n").encode())
        for i in range(times):
            n = min(len(one), points - i * len(one))
            moved = one[:n] + size * [i % side, i // side, 0] + draw.normal(0, noise, (n, 3))
            out.write(moved.astype("<f8").tobytes())


def used(folder):
    return sum(p.stat().st_blocks * 512 for p in folder.iterdir())


def seams(build, work, kept):
    subprocess.run([build / "tests/bench/tile_seams", work, kept], check=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("points", type=int)
    parser.add_argument("--memory", default="4G")
    parser.add_argument("--ratio", default="0.01")
    parser.add_argument("--real", type=pathlib.Path)
    parser.add_argument("--folder")
    options = parser.parse_args()
    build, whittle = options.build, options.build / "whittle"
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = pathlib.Path(name)
        cloud, work, out = folder / "cloud.ply", folder / "work", folder / "kept.ply"
        if options.real:
            repeat(build, options.real, options.points, cloud)
        else:
            with open(cloud, "wb") as written:
                subprocess.run([build / "tests/bench/make_scan", str(options.points)], stdout=written, check=True)
        clock, processor, peak, _ = run(whittle, "tiles", "plan", cloud, "--scratch", work, "--memory", options.memory,
                                        "--ratio", options.ratio)
        print(f"plan             {clock:.0f} s, {processor:.0f} s of processor, {peak / 2**20:.0f} MiB", flush=True)
        tiles = subprocess.run([whittle, "tiles", "list", "--scratch", work], capture_output=True, text=True,
                               check=True).stdout.split()
        whole = [clock, processor, peak]
        for tile in tiles:
            of_tile = run(whittle, "tiles", "run", tile, "--scratch", work)
            whole = [whole[0] + of_tile[0], whole[1] + of_tile[1], max(whole[2], of_tile[2])]
        print(f"tiles            {len(tiles)}: {whole[0] - clock:.0f} s, {whole[1] - processor:.0f} s of processor, "
              f"{whole[2] / 2**20:.0f} MiB at most", flush=True)
        disk = used(work)
        of_merge = run(whittle, "tiles", "merge", out, "--scratch", work)
        print(f"merge            {of_merge[0]:.0f} s, {of_merge[1]:.0f} s of processor, {of_merge[2] / 2**20:.0f} MiB")
        whole = [whole[0] + of_merge[0], whole[1] + of_merge[1], max(whole[2], of_merge[2])]
        print(f"all              {whole[0]:.0f} s, {options.points / whole[0] / 1e6:.2f} million points a second; "
              f"{whole[1] / options.points * 1e6:.2f} us of processor a point; {whole[2] / 2**20:.0f} MiB at most; "
              f"disk {disk / cloud.stat().st_size:.2f} times the input", flush=True)
        seams(build, work, out)
        if options.points <= IN_CORE:
            inside = folder / "inside.ply"
            clock, processor, peak, _ = run(whittle, cloud, inside, "--ratio", options.ratio, "-q")
            print(f"in memory        {clock:.0f} s, {processor:.0f} s of processor, {peak / 2**20:.0f} MiB")
            seams(build, work, inside)
            mean = [json.loads(run(whittle, "measure", kept, cloud, "--json")[3])["forward"]["mean"]
                    for kept in (inside, out)]
            print(f"mean distance    {mean[1]:.6g} in tiles, {mean[0]:.6g} in memory: {mean[1] / mean[0]:.5f}")


if __name__ == "__main__":
    main()
