#!/usr/bin/env python3
"""Which readers that aren't ours have which attributes of what whittle writes: a table of what `make readers` ran, from
pytest's JUnit XML (tests/integration/test_attributes.py).

Usage: readers.py RESULTS.xml ... [-o out/readers.md]

A row is a reader and a format that it read, with the formats that the points or the mesh were converted from, and the
attributes that were the same by each of these ways; those in brackets by some, since a format between can't hold them.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import json
import pathlib
import re
import subprocess
import sys
import xml.etree.ElementTree

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGES = {"three": "three", "loaders.gl": "@loaders.gl/core", "gltf-validator": "gltf-validator"}  # of npm
DEBIAN = {"PCL": "pcl-tools", "CloudCompare": "cloudcompare", "Open3D": "python3-open3d", "assimp": "assimp-utils"}
TOGETHER = (("position", ("x", "y", "z")), ("normal", ("nx", "ny", "nz")), ("colour", ("red", "green", "blue")))
# Readers whose tests are of formats that the name of the test doesn't tell.
TESTS = {"PCL": "test_pcl_", "CloudCompare": "test_cloudcompare_", "Open3D": "test_open3d_", "trimesh": "test_trimesh_",
         "assimp": "test_assimp_", "gltf-validator": "test_the_validator_of_gltf_",
         "three": r"test_readers_of_browsers_.*\[three-", "loaders.gl": r"test_readers_of_browsers_.*\[loaders.gl-"}


def version(reader):
    if reader in PACKAGES:
        path = ROOT / "tests/node/node_modules" / PACKAGES[reader] / "package.json"
        return json.loads(path.read_text(encoding="utf-8"))["version"] if path.exists() else ""
    command = ["dpkg-query", "-W", "-f", "${Version}", DEBIAN.get(reader, reader)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.split("+")[0].split("-")[0] if done.returncode == 0 else ""


def in_words(names):
    names = list(names)
    for word, parts in TOGETHER:
        if set(parts) <= set(names):
            names = [word if name == parts[0] else name for name in names if name not in parts[1:]]
    return names


def seen_by(case):
    return [json.loads(each.get("value")) for each in case.iter("property") if each.get("name") == "seen"]


def rows(cases):
    for reader, pattern in TESTS.items():
        mine = [case for case in cases if re.match(pattern, case.get("name"))]
        seen = [each for case in mine for each in seen_by(case)]
        failed = sum(case.find("failure") is not None or case.find("error") is not None for case in mine)
        for kind in dict.fromkeys(each[1] for each in seen):
            ways = {each[2]: each[3] for each in seen if each[1] == kind}
            each_way = [set(names) for names in ways.values()]
            always, sometimes = set.intersection(*each_way), set.union(*each_way)
            order = max(ways.values(), key=len)
            words = in_words(name for name in order if name in always)
            words += [f"({word})" for word in in_words(name for name in order if name in sometimes - always)]
            yield [reader, version(reader), kind, ", ".join(ways), ", ".join(words), f"{failed} failed" if failed else ""]
        if not seen:
            why = {skipped.get("message") for case in mine for skipped in case.iter("skipped")}
            yield [reader, version(reader), "", "", "failed" if failed else "not run", "; ".join(sorted(why))]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("results", nargs="+")
    parser.add_argument("-o", "--output", type=pathlib.Path, default=ROOT / "out/readers.md")
    options = parser.parse_args()
    cases = [case for path in options.results for case in xml.etree.ElementTree.parse(path).iter("testcase")]
    table = [["reader", "version", "reads", "which came from", "and has", ""], ["---"] * 6, *rows(cases)]
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text("".join(f"| {' | '.join(line)} |\n" for line in table), encoding="utf-8")
    print(options.output.read_text(encoding="utf-8"), end="")
    sys.exit(any("failed" in " ".join(line) for line in table))


if __name__ == "__main__":
    main()
