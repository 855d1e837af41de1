#!/usr/bin/env python3
"""Checks that what comments name exists: a word with an underscore is that of something in the sources.

Usage: comments.py      (from the root of the tree)
SPDX-License-Identifier: GPL-3.0-or-later
"""
import pathlib
import re
import sys

TOPS, NAMING = ("core", "api", "server", "tests", "deploy"), (".c", ".cc", ".h", ".def")
READABLE = (*NAMING, ".py", ".js", ".mjs", ".json", ".sql", ".html", ".css", ".sh", ".toml")
COMMENT_OR_TEXT = re.compile(r'"(?:\\.|[^"\\\n])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)
NAME = re.compile(r"(?<![\w*/.-])[a-z][a-z0-9]*(?:_[a-z0-9]+)+(?![\w*])")
# Of systems and libraries that the sources only speak of; columns of files; examples.
OTHERS = {"no_new_privs", "sd_notify", "sd_watchdog_enabled", "sd_listen_fds", "x_coord", "point_x", "extra_0", "extra_1",
          "x_new", "x_free", "x_rel", "name_base", "name_avx2", "name_scalar", "name_given", "share_ahead", "fetch_triangle",
          "fetch_samples"}


def is_mathematics(name):
    """n_p, kappa_n, h_pq: a symbol with an index."""
    first, *rest = name.split("_")
    return len(rest) == 1 and (len(rest[0]) == 1 or len(first) == 1 and len(rest[0]) <= 2)


def readable():
    return [path for top in TOPS for path in sorted(pathlib.Path(top).rglob("*"))
            if path.is_file() and "node_modules" not in path.parts]


def words(files):
    """All words of the sources outside of comments, and the names of their files."""
    found = set(re.findall(r"\w+", pathlib.Path("Makefile").read_text(encoding="utf-8")))
    for path in files:
        found.add(path.stem)
        if path.suffix in READABLE:
            text = path.read_text(encoding="utf-8", errors="replace")
            if path.suffix in NAMING:
                text = COMMENT_OR_TEXT.sub(lambda match: match.group() if match.group()[0] == '"' else " ", text)
            found.update(re.findall(r"\w+", text))
    return found


def main():
    files = readable()
    known, problems = words(files) | OTHERS, []
    for path in files:
        if path.suffix not in NAMING or path.parts[0] == "tests":
            continue
        text = path.read_text(encoding="utf-8", errors="replace")
        for comment in COMMENT_OR_TEXT.finditer(text):
            if comment.group()[0] == '"':
                continue
            for name in NAME.finditer(comment.group()):
                if name.group() not in known and not is_mathematics(name.group()):
                    line = text.count("\n", 0, comment.start() + name.start()) + 1
                    problems.append(f"{path}:{line}: nothing is called {name.group()}, which this comment names")
    print("".join(f"{problem}\n" for problem in problems), end="")
    print(f"lint: comments of {len(files)} files, {len(problems)} problems")
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
