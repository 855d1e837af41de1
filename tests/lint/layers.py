#!/usr/bin/env python3
"""Checks who includes whom, which functions are banned, and that the library shows no symbol of the layers above.

Usage: layers.py [libwhittle.a]      (from the root of the tree)
SPDX-License-Identifier: GPL-3.0-or-later
"""
import functools
import pathlib
import re
import subprocess
import sys

# Folder -> which project folders its files may include.
MAY_INCLUDE = {"core": {"core"}, "api": {"api", "core"}, "server": {"server", "api", "core"}}
# The rooms of core/, from the bottom up: a file may include its own room, what stands above core/'s rooms (params.h,
# report.h), and the rooms that its row names.
ROOMS = {
    "core": {"core/base", "core/text", "core/surface"},  # params.c takes the names of reconstructions from their table
    "core/base": set(),
    "core/text": set(),
    "core/math": {"core/base"},
    "core/cloud": {"core/base", "core/text", "core/math"},
    "core/mesh": {"core/base", "core/math", "core/cloud"},
    "core/io/codec": {"core/base"},
    "core/io/laz": {"core/base"},
    "core/io": {"core/base", "core/text", "core/cloud", "core/io/codec", "core/io/formats", "core/io/out"},
    "core/io/formats": {"core/base", "core/text", "core/cloud", "core/io", "core/io/codec", "core/io/laz"},
    "core/io/out": {"core/base", "core/text", "core/cloud", "core/mesh", "core/io", "core/io/formats", "core/io/laz"},
    "core/spatial": {"core/base", "core/math", "core/cloud", "core/mesh"},
    "core/clean": {"core/base", "core/math", "core/cloud", "core/spatial"},
    "core/simplify": {"core/base", "core/math", "core/cloud", "core/spatial"},
    "core/simplify/reference": {"core/base", "core/math", "core/spatial", "core/simplify"},
    "core/surface": {"core/base", "core/math", "core/cloud", "core/mesh", "core/surface/cocone", "core/surface/sheet"},
    "core/surface/cocone": {"core/base", "core/math", "core/cloud", "core/mesh", "core/spatial", "core/surface"},
    "core/surface/sheet": {"core/base", "core/math", "core/cloud", "core/mesh", "core/spatial", "core/surface",
                           "core/surface/cocone"},
    "core/surface/given": {"core/base", "core/math", "core/cloud", "core/mesh", "core/surface"},
    "core/refine": {"core/base", "core/math", "core/cloud", "core/mesh", "core/spatial", "core/refine/kernels"},
    "core/refine/kernels": {"core/base", "core/math", "core/cloud", "core/refine"},
    "core/measure": {"core/base", "core/math", "core/cloud", "core/mesh", "core/spatial"},
    "core/pipeline": {"core/base", "core/math", "core/cloud", "core/mesh", "core/io", "core/io/formats", "core/io/laz",
                      "core/spatial", "core/clean", "core/simplify", "core/surface", "core/surface/cocone",
                      "core/surface/given", "core/surface/sheet", "core/refine", "core/measure", "core/picture", "core/text"},
    "core/tiles": {"core/base", "core/math", "core/cloud", "core/io", "core/io/formats", "core/io/out", "core/spatial",
                   "core/clean", "core/simplify", "core/measure", "core/pipeline"},
    "core/tileset": {"core/base", "core/math", "core/cloud", "core/mesh", "core/io/codec", "core/io/formats", "core/io/out",
                     "core/spatial"},
    "core/picture": {"core/base", "core/math", "core/cloud", "core/mesh", "core/io/out", "core/spatial"},
    "core/library": {"core/base", "core/cloud", "core/mesh", "core/io", "core/pipeline"},
}
# The rooms of server/ likewise.
SERVER_ROOMS = {
    "server/shared": set(),
    "server/cli": {"server/shared"},
    "server/base": set(),
    "server/catalog": {"server/base"},
    "server/catalog/sqlite": {"server/catalog", "server/base"},
    "server/catalog/postgres": {"server/catalog", "server/base"},
    "server/blobs": {"server/base"},
    "server/blobs/file": {"server/blobs", "server/base"},
    "server/blobs/s3": {"server/blobs", "server/base"},
    "server/storage": {"server/catalog", "server/blobs", "server/base"},
    "server/jobs": {"server/shared", "server/catalog", "server/blobs", "server/storage", "server/base"},
    "server/auth": {"server/catalog", "server/base"},
    "server/http": {"server/catalog", "server/storage", "server/jobs", "server/auth", "server/base"},
    "server/runner": {"server/catalog", "server/storage", "server/jobs", "server/shared", "server/base"},
    "server/webhooks": {"server/catalog", "server/storage", "server/jobs", "server/base"},
    "server/handlers": {"server/catalog", "server/storage", "server/jobs", "server/auth", "server/http", "server/runner",
                        "server/webhooks", "server/base"},
    "server/daemon": {"server/shared", "server/catalog", "server/blobs", "server/storage", "server/jobs", "server/auth",
                      "server/http", "server/runner", "server/webhooks", "server/handlers", "server/base"},
}
# What is left to undo: (file, what it includes all the same).
SERVER_EXCEPTIONS = set()
# What api/ may know of core/.
API_SEES = {"core/base/status.h", "core/params.h", "core/report.h", "core/base/version.h", "core/io/sniff.h"}
# core/pipeline/pipeline.h and the stages belong to the command, server/cli/.
DAEMON_SEES = API_SEES | {"core/base/alloc.h", "core/base/clock.h", "core/base/fault.h",
                          "core/base/process_memory.h", "core/cloud/select.h", "core/io/codec/inflate.h", "core/io/formats/las_fields.h", "core/io/formats/ply_header.h",
                          "core/io/prefix.h", "core/pipeline/memory.h", "core/tiles/fit.h", "core/tileset/archive_find.h"}
# What those bring along: nothing else of core/ reaches api/ or the daemon by way of another header.
BROUGHT = {"core/text/column_list.h", "core/text/condition_list.h", "core/text/weight_list.h", "core/text/name_list.h", "core/base/left_out.h", "core/cloud/cloud.h", "core/io/formats.h", "core/math/vec3.h"}
# A third-party header, or what stands behind a seam -> the only files that include it (a pattern).
OWNER = {
    r"flann/.*": r"core/spatial/knn_flann\.cc",
    r"CGAL/.*": r"core/surface/\w+_cgal\.cc",
    r"expat\.h": r"core/io/formats/e57_xml\.c",
    r"zlib\.h": r"core/io/codec/inflate_gzip\.c",
    r"zstd(_errors)?\.h": r"core/io/codec/inflate_zstd\.c",
    r"png\.h": r"core/picture/png_write\.c",
    r"curl/.*": r"server/(webhooks/http_client|blobs/s3/s3_client)\.c",
    r"sqlite3\.h": r"server/catalog/sqlite/sql(_faults)?\.c",
    r"postgresql/.*": r"server/catalog/postgres/pq\.c",
    r"server/catalog/postgres/.*": r"server/catalog/postgres/\w+\.[ch]",
    r"server/catalog/sqlite/.*": r"server/catalog/sqlite/\w+\.[ch]",
    r"server/blobs/s3/.*": r"server/blobs/s3/\w+\.[ch]",
    r"server/blobs/file/.*": r"server/blobs/file/\w+\.[ch]",
    r"server/blobs/blobs_backend\.h": r"server/blobs/(\w+/)?\w+\.[ch]",
    r"server/catalog/catalog_backend\.h": r"server/catalog/(\w+/)?\w+\.[ch]",
    r"microhttpd\.h": r"server/http/http\.c",
    r"gnutls/.*": r"server/http/tls\.c",
    r"seccomp\.h": r"server/runner/seccomp\.c",
    r"jansson\.h": r"api/(\w+/)?\w+\.[ch]|core/io/formats/glb_read\.c",
}
ALLOCATES = "malloc|calloc|realloc|reallocarray|aligned_alloc|posix_memalign|memalign|valloc|strdup|strndup|v?asprintf"
TALKS = "(?:v|f|vf|d|vd)?printf|f?puts|f?putc|putchar|fwrite|perror|psignal|v?syslog|v?warnx?|v?errx?"
LEAVES = "exit|_exit|_Exit|quick_exit|abort"
LOOKS = "getenv|secure_getenv|setenv|putenv|unsetenv"
DIFFERS = "hypot[fl]?"  # in the last bit, between processors: core/math/exact.h
LISTENS = "strto(?:d|f|ld)|setlocale"  # to the program's locale: core/text/number.h


def calls(names):
    return re.compile(rf"(?<![\w.>])({names})\s*\(")


BANNED = calls("sprintf|vsprintf|strcpy|stpcpy|strncpy|strcat|gets|strtok|atoi|atol|atoll|atof|system|popen")
SCANS = calls("[fv]?scanf|vfscanf|v?sscanf")
# Who scans lines that the operator or the kernel writes, never a client.
MAY_SCAN = {"server/daemon/fault_point.c", "server/jobs/metrics.c"}
CORE_NEVER = calls("|".join((ALLOCATES, TALKS, LEAVES, LOOKS, DIFFERS, LISTENS)))
# The same as symbols, so that no macro or pointer hides it.
CORE_NEVER_LINKS = re.compile(rf"(?:__)?({ALLOCATES}|{TALKS}|{LEAVES}|{LOOKS}|stdout|stderr|environ)(?:_chk)?")
# File -> what it may call all the same: the one seam of allocation; FLANN's pools, and what its headers bring along; what
# CGAL's headers bring along.
CORE_MAY = {"core/base/alloc.c": {"malloc", "calloc", "realloc", "aligned_alloc"},
            "core/spatial/knn_flann.cc": {"malloc", "fwrite", "stderr"},
            "core/surface/delaunay_cgal.cc": {"abort", "exit"}}
# Static data that a program may change, as objdump lists it.  Bindings other than local and global are those of templates
# in the headers of libraries.
STATE = re.compile(r"^\w+ [lg][ \w]{6} (?:\.t?data|\.t?bss|\.t?data\.(?!rel\.ro)\S*|\.t?bss\.\S+|\*COM\*)\t(\w+) +(\S+)$")
# What is allowed: what tests make calls fail with; what the C library is told of freed memory, and doesn't tell again;
# the team that a thread leads; what <iostream> brings along.
KNOWN_STATE = {("alloc.o", "alloc_fail"), ("alloc.o", "alloc_fail_ctx"), ("alloc.o", "keeps"),
               ("fault.o", "fault_point"), ("par.o", "current"),
               ("knn_flann.o", "_ZStL8__ioinit"), ("delaunay_cgal.o", "_ZStL8__ioinit")}
FOREIGN_SYMBOL = re.compile(r"(MHD_|json_|sqlite3_)\w+")
# Whose formats hold JSON: (member, what its names of the library begin with).
MAY_LINK_FOREIGN = {("glb_read.o", "json_")}
STATIC_FUNCTION = re.compile(
    r"^(?:[A-Z_]+ )?static\b(?: *__attribute__\(\([^;{}]*?\)\))?[^;={}()]*?\b(\w+)\([^;{}]*\) *\{", re.M)
COMMENT = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"', re.S)


def blank(match):
    text = match.group()
    return text if text.startswith('"') and "/" in text and text.endswith('.h"') else "\n" * text.count("\n")


def includes_of(text):
    return re.findall(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', text, re.M)


@functools.lru_cache(maxsize=None)
def reached_from(header):
    """The project's headers that an include of this one brings along, itself among them."""
    found, rest = set(), [header]
    while rest:
        name = rest.pop()
        if name not in found and pathlib.Path(name).is_file():
            found.add(name)
            rest += includes_of(pathlib.Path(name).read_text(encoding="utf-8"))
    return found


def problems_of(path):
    name, text = str(path), path.read_text(encoding="utf-8")
    if "SPDX-License-Identifier: GPL-3.0-or-later" not in text:
        yield "no SPDX line"
    for line in text.splitlines():
        if len(line) > 120:
            yield f"over 120 columns: {line[:60]}..."
    folder = path.parts[0]
    if folder in MAY_INCLUDE and re.search(r'^\s*#\s*include\s*[^<"\s]', text, re.M):
        yield "includes what a macro names"
    for header in re.findall(r'^\s*#\s*include\s*"([^"]+)"', text, re.M):
        if folder in MAY_INCLUDE and (header.split("/")[0] not in MAY_INCLUDE or ".." in header):
            yield f"{folder}/ may not include {header}"
    for header in includes_of(text):
        top = header.split("/")[0]
        sees = API_SEES if folder == "api" else DAEMON_SEES if folder == "server" and path.parts[1] != "cli" else None
        for brought in sorted(reached_from(header) if sees and header in sees else ()):
            if brought.startswith("core/") and brought not in sees | BROUGHT:
                yield f"{header} brings {brought} along, which {folder}/ may not include"
        if folder in MAY_INCLUDE and top in MAY_INCLUDE and top not in MAY_INCLUDE[folder]:
            yield f"{folder}/ may not include {header}"
        if folder == "api" and top == "core" and header not in API_SEES:
            yield f"api/ may not include {header}"
        if folder == "server" and path.parts[1] != "cli" and top == "core" and header not in DAEMON_SEES:
            yield f"only server/cli/ may include {header}"
        room, of = str(path.parent), str(pathlib.PurePath(header).parent)
        if folder == "core" and room not in ROOMS:
            yield f"{room}/ is no room of the table"
        elif folder == "core" and top == "core" and of not in ROOMS[room] | {room, "core"}:
            yield f"{room}/ may not include {header}"
        if folder == "server" and room not in SERVER_ROOMS:
            yield f"{room}/ is no room of the table"
        elif folder == "server" and top == "server" and of not in SERVER_ROOMS[room] | {room}:
            if (name, header) not in SERVER_EXCEPTIONS:
                yield f"{room}/ may not include {header}"
        if header.endswith(".c"):
            yield f"includes the source {header}"
        for pattern, owner in OWNER.items():
            if folder in MAY_INCLUDE and re.fullmatch(pattern, header) and not re.fullmatch(owner, name):
                yield f"{header} belongs to {owner}"
    code = COMMENT.sub(blank, text)
    for match in BANNED.finditer(code):
        yield f"banned function {match.group(1)}"
    for match in SCANS.finditer(code if folder in MAY_INCLUDE and name not in MAY_SCAN else ""):
        yield f"banned function {match.group(1)}"
    for match in CORE_NEVER.finditer(code if folder == "core" else ""):
        if match.group(1) not in CORE_MAY.get(name, ()):
            yield f"core/ never calls {match.group(1)}"


def state_of(archive):
    """What two calls at a time would share."""
    listing = subprocess.run(["objdump", "-t", archive], capture_output=True, text=True, check=True).stdout
    member = ""
    for line in listing.splitlines():
        member = line.split(":")[0] if ":     file format" in line else member
        match = STATE.match(line)
        if match and int(match[1], 16) and (member, match[2]) not in KNOWN_STATE:
            yield f"{member} keeps state in {match[2]}"


def links_of(archive):
    """What a file of core/ calls, however it is written."""
    may = {pathlib.Path(name).stem + ".o": allowed for name, allowed in CORE_MAY.items()}
    for line in subprocess.run(["nm", "-A", "-u", archive], capture_output=True, text=True, check=True).stdout.splitlines():
        member, symbol = line.split(":")[-2], line.split()[-1].split("@")[0]
        match = CORE_NEVER_LINKS.fullmatch(symbol)
        if match and match.group(1) not in may.get(member, ()):
            yield f"{member} links {match.group(1)}, which core/ never calls"
        match = FOREIGN_SYMBOL.fullmatch(symbol)
        if match and (member, match.group(1)) not in MAY_LINK_FOREIGN:
            yield f"{member} links {symbol}, which belongs to the layers above"


def names_twice(files):
    """Static functions of one name in two files of a folder: a reader who looks for one finds the other."""
    first = {}
    for path in files:
        if path.parts[0] in MAY_INCLUDE:
            for match in STATIC_FUNCTION.finditer(COMMENT.sub(blank, path.read_text(encoding="utf-8"))):
                other = first.setdefault((path.parent, match.group(1)), path)
                if other != path:
                    yield f"{path}: {match.group(1)}() is also in {other.name}"


def stale_exceptions():
    """Those of the table that nobody needs any more."""
    for name, header in sorted(SERVER_EXCEPTIONS):
        path = pathlib.Path(name)
        if not path.is_file() or header not in includes_of(path.read_text(encoding="utf-8")):
            yield f"{name}: includes {header} no more, and is an exception in tests/lint/layers.py still"


def main():
    found = 0
    for problem in stale_exceptions():
        print(problem)
        found += 1
    files = [p for top in ("core", "api", "server", "tests") for p in sorted(pathlib.Path(top).rglob("*.[chd]*"))
             if p.suffix in (".c", ".h", ".cc", ".def") and "node_modules" not in p.parts]
    for path in files:
        for problem in problems_of(path):
            print(f"{path}: {problem}")
            found += 1
    for problem in names_twice(files):
        print(problem)
        found += 1
    for archive in sys.argv[1:]:
        for problem in [*state_of(archive), *links_of(archive)]:
            print(f"{archive}: {problem}")
            found += 1
    print(f"lint: {len(files)} files, {found} problems")
    sys.exit(found > 0 or not files)


if __name__ == "__main__":
    main()
