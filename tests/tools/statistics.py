#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""How long functions are: for each folder how many there are in a thousand lines, their median length, the 90th
percentile, and how many of the static ones are used in one place.

Usage: statistics.py [FOLDER ...]        core, api and server where none is given

Lines are all lines of .c, .h and .cc files; a function's are those from its brace to its end.  No figure to steer by: a
function is a paragraph.  It shows where a folder went to crumbs, or to scrolls.
"""
import pathlib
import re
import sys

TOKEN = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'', re.S)
NOT_A_FUNCTION = re.compile(r"\b(struct|class|union|enum|namespace)\b[^()=;]*$|^extern\b[^(]*$")


def blank(match):
    token = match.group()
    return "\n" * token.count("\n") if token[0] == "/" else token[0] * 2


def code_of(path):
    """The text without comments, strings and lines of the preprocessor, on the same lines."""
    text = TOKEN.sub(blank, path.read_text(encoding="utf-8", errors="replace"))
    return re.sub(r"^[ \t]*#(?:\\\n|[^\n])*", lambda m: "\n" * m.group().count("\n"), text, flags=re.M)


def functions(code):
    """(name, whether static, lines) of each function."""
    open_braces, head, line = [], "", 1
    for char in code:
        line += char == "\n"
        if char == "{":
            signature = " ".join(head.split())
            inside = any(kind != "scope" for kind, *_ in open_braces)
            if not inside and NOT_A_FUNCTION.search(signature):
                kind = "scope"
            elif (not inside and re.search(r"\)(?: (?:const|noexcept|override))*$", signature)
                  and "=" not in signature.split("(")[0]):
                kind = "function"
            else:
                kind = "block"
            open_braces.append((kind, signature, line))
            head = ""
        elif char == "}":
            kind, signature, first = open_braces.pop() if open_braces else ("block", "", line)
            name = re.search(r"(\w+) ?\((?!\()(?!printf)", re.sub(r"__attribute__ ?\(\(.*?\)\) ?", "", signature))
            if kind == "function" and name:
                yield name.group(1), signature.startswith("static") or " static " in signature, line - first + 1
            head = ""
        elif char == ";":
            head = ""
        else:
            head += char


def row_of(folder):
    paths = [p for p in sorted(pathlib.Path(folder).rglob("*"))
             if p.suffix in (".c", ".h", ".cc", ".cpp") and "node_modules" not in p.parts]
    lines, lengths, statics, used_once = 0, [], 0, 0
    for path in paths:
        lines += path.read_text(encoding="utf-8", errors="replace").count("\n")
        code = code_of(path)
        found = list(functions(code))
        lengths += [length for *_, length in found]
        for name, static, _ in found:
            uses = len(re.findall(rf"\b{name}\b", code)) - 1
            if static and path.suffix != ".h":
                statics, used_once = statics + 1, used_once + (uses == 1)
    if not lengths:
        return None
    lengths.sort()
    return (folder, len(paths), lines, len(lengths), 1000 * len(lengths) / lines, lengths[len(lengths) // 2],
            lengths[int(0.9 * len(lengths))], lengths[-1], 100 * used_once / max(statics, 1))


def main():
    rooms = sys.argv[1:]
    if not rooms:
        for top in ("core", "api", "server"):
            rooms += [top, *sorted(str(p) for p in pathlib.Path(top).iterdir() if p.is_dir())]
    print(f"{'folder':24s} {'files':>5s} {'lines':>6s} {'functions':>9s} {'/1000':>6s} {'median':>6s} {'p90':>4s} "
          f"{'longest':>7s} {'statics used once':>18s}")
    for row in filter(None, map(row_of, rooms)):
        print(f"{row[0]:24s} {row[1]:5d} {row[2]:6d} {row[3]:9d} {row[4]:6.1f} {row[5]:6d} {row[6]:4d} {row[7]:7d} "
              f"{row[8]:16.0f} %")


if __name__ == "__main__":
    main()
