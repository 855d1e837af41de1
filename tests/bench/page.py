#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a person waits for who opens a large result in a browser.

Usage: page.py BUILD_FOLDER [--points 1000000] [--picture FILE]

Runs a daemon with the page (make page) and a job on a synthetic scan, opens that in Debian's chromium without a graphics
processor (SwiftShader, so figures are far above those of other machines), and prints as JSON: bytes and milliseconds
of the page alone, to the first view, to the result's first 50 000 points, and until all is there; the page's longest task by the clock and by the processor time that it took
(on a busy machine the first one says more of the machine); frames while it turns, by the clock and by the processor time
of what draws and of pages; the memory of the page and of the processes that show it.
"""
import argparse
import pathlib
import shutil
import subprocess
import sys
import tempfile

TESTS = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(TESTS / "page"))
from service import job_of, serving  # noqa: E402  pylint: disable=wrong-import-position


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--points", type=int, default=1000000)
    parser.add_argument("--picture", type=pathlib.Path, help="a screenshot is written there")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench-page-") as folder:
        cloud = pathlib.Path(folder, "scan.ply")
        with open(cloud, "wb") as out:
            subprocess.run([arguments.build / "tests/bench/make_scan", str(arguments.points)], stdout=out, check=True)
        with serving(arguments.build) as address:
            url = f"http://{address}/jobs/{job_of(address, cloud, 'ratio=0.1&outputs=cloud,error')}"
            picture = [arguments.picture] if arguments.picture else []
            subprocess.run(["node", TESTS / "page/measure.js", shutil.which("chromium"), url, *picture], check=True)


if __name__ == "__main__":
    main()
