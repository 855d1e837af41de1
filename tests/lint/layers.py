#!/usr/bin/env python3
"""Checks who includes whom, which functions are banned, and that the library shows no symbol of the layers above.

Usage: layers.py [libwhittle.a]      (from the root of the tree)
SPDX-License-Identifier: GPL-3.0-or-later
"""
import pathlib
import re
import subprocess
import sys

# Folder -> which project folders its files may include.
MAY_INCLUDE = {"core": {"core"}, "api": {"api", "core"}, "server": {"server", "api", "core"}}
# What api/ may know of core/.
API_SEES = {"core/status.h", "core/params.h", "core/report.h", "core/version.h", "core/cloud_sniff.h"}
# core/pipeline.h and the stages belong to the worker.
DAEMON_SEES = API_SEES | {"core/alloc.h", "core/cloud_ply.h", "core/cloud_prefix.h", "core/fault.h", "core/inflate.h",
                          "core/memory.h", "core/ply_header.h"}
# Third-party header -> the only files that include it (a pattern).
OWNER = {
    r"flann/.*": r"core/knn_flann\.cc",
    r"CGAL/.*": r"core/\w+_cgal\.cc",
    r"zlib\.h": r"core/inflate_gzip\.c",
    r"zstd(_errors)?\.h": r"core/inflate_zstd\.c",
    r"curl/.*": r"server/post\.c",
    r"sqlite3\.h": r"server/sql(_faults)?\.c",
    r"microhttpd\.h": r"server/http\.c",
    r"gnutls/.*": r"server/tls\.c",
    r"seccomp\.h": r"server/daemon_seccomp\.c",
    r"jansson\.h": r"api/\w+\.[ch]",
}
BANNED = re.compile(r"(?<![\w.>])(sprintf|vsprintf|strcpy|strcat|gets|strtok|atoi|atol|atof|system)\s*\(")
CORE_NEVER = re.compile(r"(?<![\w.>])(printf|fprintf|puts|perror|exit|abort|getenv)\s*\(")
FOREIGN_SYMBOL = re.compile(r" U (MHD_|json_|sqlite3_)\w+")
COMMENT = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"', re.S)


def blank(match):
    text = match.group()
    return text if text.startswith('"') and "/" in text and text.endswith('.h"') else "\n" * text.count("\n")


def problems_of(path):
    name, text = str(path), path.read_text(encoding="utf-8")
    if "SPDX-License-Identifier: GPL-3.0-or-later" not in text:
        yield "no SPDX line"
    for line in text.splitlines():
        if len(line) > 120:
            yield f"over 120 columns: {line[:60]}..."
    folder = path.parts[0]
    for header in re.findall(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', text, re.M):
        top = header.split("/")[0]
        if folder in MAY_INCLUDE and top in MAY_INCLUDE and top not in MAY_INCLUDE[folder]:
            yield f"{folder}/ may not include {header}"
        if folder == "api" and top == "core" and header not in API_SEES:
            yield f"api/ may not include {header}"
        if folder == "server" and not path.name.startswith("worker_") and top == "core" and header not in DAEMON_SEES:
            yield f"only worker_* may include {header}"
        if header.endswith(".c"):
            yield f"includes the source {header}"
        for pattern, owner in OWNER.items():
            if folder in MAY_INCLUDE and re.fullmatch(pattern, header) and not re.fullmatch(owner, name):
                yield f"{header} belongs to {owner}"
    code = COMMENT.sub(blank, text)
    for match in BANNED.finditer(code):
        yield f"banned function {match.group(1)}"
    if folder == "core":
        for match in CORE_NEVER.finditer(code):
            yield f"core/ never calls {match.group(1)}"


def main():
    found = 0
    files = [p for top in ("core", "api", "server", "tests") for p in sorted(pathlib.Path(top).rglob("*.[ch]*"))
             if p.suffix in (".c", ".h", ".cc") and "node_modules" not in p.parts]
    for path in files:
        for problem in problems_of(path):
            print(f"{path}: {problem}")
            found += 1
    for archive in sys.argv[1:]:
        symbols = subprocess.run(["nm", "-u", archive], capture_output=True, text=True, check=True).stdout
        for match in FOREIGN_SYMBOL.finditer(symbols):
            print(f"{archive}:{match.group()}")
            found += 1
    print(f"lint: {len(files)} files, {found} problems")
    sys.exit(found > 0 or not files)


main()
