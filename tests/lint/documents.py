#!/usr/bin/env python3
"""Checks that every file that a document names exists, every function that a README names, and that the tables of
layers are the code's.

Usage: documents.py             (from the root of the tree)
       documents.py --update    writes the tables of layers into core/README.md and server/README.md

A name is what stands in backticks and has the form of a path below core/, server/, api/, tests/ or deploy/, or of a
source file; or the target of a link.  Braces and wildcards are expanded.  A name is looked for in the folder of its
document, then in the root; one without a slash may be anywhere in the tree.  Folders that commands make (out/) need
not exist.  A function, or any other name of the source, is what stands in backticks in the READMEs of core/, api/ and
server/ as small words with underscores between them.
SPDX-License-Identifier: GPL-3.0-or-later
"""
import itertools
import pathlib
import re
import sys

import layers

TOPS = ("core", "server", "api", "tests", "deploy")
SOURCE = r"[\w.*{},/-]+\.(?:c|cc|h|py|sh|js|mk|map|sql|html|def)"
PATH = rf"(?:{'|'.join(TOPS)})/[\w.*{{}},/-]*"
NAME = re.compile(rf"`({PATH}|{SOURCE})`")
IDENTIFIER = re.compile(r"`([a-z][a-z0-9]*(?:_[a-z0-9]+)+)(?:\(\))?`")
NAMED_IN, READABLE = ("core", "api", "server"), (".c", ".cc", ".h", ".def", ".py", ".js", ".json", ".sql", ".html")
LINK = re.compile(r"\]\((?!\w+:|#)([^)#\s]+)[^)]*\)")
BEGIN, END = "<!-- layers: make lint compares this table with tests/lint/layers.py -->\n", "<!-- end of layers -->\n"


def expanded(name):
    """The names that a name with braces stands for."""
    parts = [part[1:-1].split(",") if part[:1] == "{" else [part] for part in re.split(r"(\{[^}]*\})", name)]
    return ("".join(choice) for choice in itertools.product(*parts))


def exists(name, folder):
    if any(next(place.glob(name), None) for place in (folder, pathlib.Path())):
        return True
    return "/" not in name and any(next(pathlib.Path(top).rglob(name), None) for top in TOPS)


def missing_names(document):
    folder, text = document.parent, document.read_text(encoding="utf-8")
    for found in NAME.findall(text):
        yield from (name for name in expanded(found.rstrip("/"))
                    if not name.startswith("out/") and not exists(name, folder))
    for target in LINK.findall(text):
        if not (folder / target).exists():
            yield target


def words_of_the_source():
    """What a README may name: all words of the sources, and the names of their files."""
    words = set(re.findall(r"\w+", pathlib.Path("Makefile").read_text(encoding="utf-8")))
    for path in (p for top in TOPS for p in pathlib.Path(top).rglob("*")):
        if path.suffix in READABLE and "node_modules" not in path.parts and path.is_file():
            words.add(path.stem)
            words.update(re.findall(r"\w+", path.read_text(encoding="utf-8", errors="replace")))
    return words


def room_names(rooms, top="core"):
    return ", ".join(sorted(room.removeprefix(f"{top}/") for room in rooms)) or "none"


def layer_table():
    """The table of layers as Markdown, from layers.py."""
    lines = ["| files in | may include |", "|---|---|"]
    for top, below in layers.MAY_INCLUDE.items():
        lines.append(f"| `{top}/` | {', '.join(f'`{b}/`' for b in sorted(below))} |")
    lines += ["", "| room of `core/` | may include, besides itself and `core/*.h` |", "|---|---|"]
    for room, below in layers.ROOMS.items():
        if room != "core":
            lines.append(f"| `{room}/` | {room_names(below)} |")
    return "\n".join(lines) + "\n"


def server_table():
    """The rooms of server/ as Markdown, from layers.py."""
    lines = ["| room of `server/` | may include, besides itself |", "|---|---|"]
    lines += [f"| `{room}/` | {room_names(below, 'server')} |" for room, below in layers.SERVER_ROOMS.items()]
    lines += ["", "Left to undo:", ""] * bool(layers.SERVER_EXCEPTIONS)
    lines += [f"- `{name.removeprefix('server/')}` includes `{header.removeprefix('server/')}`"
              for name, header in sorted(layers.SERVER_EXCEPTIONS)]
    return "\n".join(lines) + "\n"


TABLES = {"core/README.md": layer_table, "server/README.md": server_table}


def with_table(text, table):
    before, rest = text.split(BEGIN)
    return before + BEGIN + table() + END + rest.split(END)[1]


def main():
    readmes = {pathlib.Path(name): table for name, table in TABLES.items()}
    if sys.argv[1:] == ["--update"]:
        for readme, table in readmes.items():
            readme.write_text(with_table(readme.read_text(encoding="utf-8"), table), encoding="utf-8")
        return
    documents = [pathlib.Path("README.md")] + [p for top in (*TOPS, ".github") for p in sorted(pathlib.Path(top).rglob("*.md"))
                            if "node_modules" not in p.parts]
    problems = [f"{document}: there is no {name}" for document in documents for name in missing_names(document)]
    words = words_of_the_source()
    for document in documents:
        if document.name == "README.md" and document.parts[0] in NAMED_IN:
            names = IDENTIFIER.findall(document.read_text(encoding="utf-8"))
            problems += [f"{document}: nothing is called {name}" for name in names if name not in words]
    for readme, table in readmes.items():
        text = readme.read_text(encoding="utf-8")
        if BEGIN not in text or with_table(text, table) != text:
            problems.append(f"{readme}: the table of layers differs from tests/lint/layers.py; "
                            "tests/lint/documents.py --update writes it")
    print("".join(f"{problem}\n" for problem in problems), end="")
    print(f"lint: {len(documents)} documents, {len(problems)} problems")
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
