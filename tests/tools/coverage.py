#!/usr/bin/env python3
"""Sums gcovr's table up by rooms: lines, lines that ran, and how many in a hundred.

Usage: coverage.py coverage.txt
       coverage.py --clean FOLDER      (from the root of the tree) removes the counts of earlier runs, and all that was
                                       compiled of sources that are there no more, which gcovr complains of
SPDX-License-Identifier: GPL-3.0-or-later
"""
import collections
import pathlib
import re
import sys


def clean(folder):
    for count in folder.rglob("*.gcda"):
        count.unlink()
    for note in folder.rglob("*.gcno"):
        source = pathlib.Path(str(note.relative_to(folder)).split(".")[0])
        if not any(source.with_suffix(ending).is_file() for ending in (".c", ".cc")):
            for path in note.parent.glob(f"{note.stem}.*"):
                path.unlink()


def main():
    if sys.argv[1] == "--clean":
        clean(pathlib.Path(sys.argv[2]))
        return
    rooms = collections.defaultdict(lambda: [0, 0])
    for line in pathlib.Path(sys.argv[1]).read_text().splitlines():
        row = re.match(r"((?:core|api|server)/\S+)\s+(\d+)\s+(\d+)\s+\d+%", line)
        if row:
            for name in (str(pathlib.PurePath(row[1]).parent), "all"):
                rooms[name][0] += int(row[2])
                rooms[name][1] += int(row[3])
    if not rooms:
        sys.exit("coverage: the table has no rows")
    print(f"{'room':28}{'lines':>8}{'ran':>8}{'%':>7}")
    for name, (lines, ran) in sorted(rooms.items(), key=lambda item: (item[0] == "all", item[0])):
        print(f"{name:28}{lines:8}{ran:8}{100 * ran / max(lines, 1):7.1f}")


main()
