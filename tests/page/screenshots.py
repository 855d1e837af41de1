#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the page, to be looked at: each part dark and light, 360, 800 and 1600 pixels wide.

Usage: screenshots.py BUILD_FOLDER OUT_FOLDER CLOUD [CLOUD]

Runs a daemon with the page (make page) and goes through it with the first cloud in Debian's chromium; while the second
one, which should be larger, is at work, that is looked at.
"""
import argparse
import pathlib
import shutil
import subprocess

from service import serving


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("clouds", type=pathlib.Path, nargs="+")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    with serving(arguments.build) as address:
        subprocess.run(["node", pathlib.Path(__file__).with_name("screenshots.js"), shutil.which("chromium"),
                        f"http://{address}/", arguments.out, *arguments.clouds[:2]], check=True)
    print(f"{len(list(arguments.out.glob('*.png')))} pictures in {arguments.out}")


if __name__ == "__main__":
    main()
