#!/usr/bin/env python3
"""Prints the bill of materials of programs as SPDX 2.3 JSON: the programs, and the Debian packages that they are linked
with (from the dynamic linker and dpkg) or compiled from headers of (CGAL, FLANN).

Usage: sbom.py PROGRAM...       the same bytes for the same programs and packages
SPDX-License-Identifier: GPL-3.0-or-later
"""
import datetime
import hashlib
import json
import pathlib
import re
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
COMPILED_IN = ["libcgal-dev", "libflann-dev"]


def run(*command):
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def libraries_of(program):
    """Paths of the shared libraries that the dynamic linker loads."""
    return re.findall(r"(?:=> |^\s+)(/\S+) \(0x", run("ldd", program), re.M)


def names_of(path):
    """What dpkg may know a library as: with or without /usr."""
    real = str(pathlib.Path(path).resolve())
    return path, "/usr" + path, real, real.removeprefix("/usr")


def owners_of(paths):
    """The packages that libraries belong to.  dpkg is asked once, since it reads all its lists each time."""
    names = [name for path in paths for name in names_of(path)]
    told = subprocess.run(["dpkg-query", "-S", *names], capture_output=True, text=True, check=False).stdout
    package_of = {}
    for line in told.splitlines():
        packages, _, name = line.rpartition(": ")
        package_of[name] = packages.split(":")[0].split(",")[0]
    owners = set()
    for path in paths:
        owner = next((package_of[name] for name in names_of(path) if name in package_of), None)
        if not owner:
            raise SystemExit(f"sbom: no package owns {path}")
        owners.add(owner)
    return sorted(owners)


def facts_of(package):
    text = run("dpkg-query", "-W", "-f", "${Package}\t${Version}\t${Architecture}\t${source:Package}\t${Homepage}\n",
               package)
    name, version, architecture, source, homepage = text.splitlines()[0].split("\t")
    return {"name": name, "SPDXID": "SPDXRef-deb-" + re.sub(r"[^A-Za-z0-9.-]", "-", name), "versionInfo": version,
            "supplier": "Organization: Debian", "downloadLocation": "NOASSERTION", "homepage": homepage or "NOASSERTION",
            "sourceInfo": f"built from the Debian source package {source}", "filesAnalyzed": False,
            "licenseConcluded": "NOASSERTION", "licenseDeclared": "NOASSERTION", "copyrightText": "NOASSERTION",
            "externalRefs": [{"referenceCategory": "PACKAGE-MANAGER", "referenceType": "purl",
                              "referenceLocator": f"pkg:deb/debian/{name}@{version}?arch={architecture}"}]}


def relation(one, kind, other):
    return {"spdxElementId": one, "relationshipType": kind, "relatedSpdxElement": other}


def document(programs):
    version = run(HERE / "version.sh").strip()
    made = datetime.datetime.fromtimestamp(int(run(HERE / "version.sh", "--epoch")), datetime.timezone.utc)
    linked = owners_of({path for program in programs for path in libraries_of(program)})
    packages = [{"name": "whittle", "SPDXID": "SPDXRef-whittle", "versionInfo": version,
                 "downloadLocation": "NOASSERTION", "filesAnalyzed": False, "licenseConcluded": "GPL-3.0-or-later",
                 "licenseDeclared": "GPL-3.0-or-later", "copyrightText": "NOASSERTION"}]
    relations = [relation("SPDXRef-DOCUMENT", "DESCRIBES", "SPDXRef-whittle")]
    for package in linked + COMPILED_IN:
        packages.append(facts_of(package))
        kind = "STATIC_LINK" if package in COMPILED_IN else "DYNAMIC_LINK"
        relations.append(relation("SPDXRef-whittle", kind, packages[-1]["SPDXID"]))
    files = []
    for program in map(pathlib.Path, programs):
        files.append({"fileName": "./" + program.name, "SPDXID": f"SPDXRef-file-{program.name}",
                      "checksums": [{"algorithm": a.upper(), "checksumValue": hashlib.new(a, program.read_bytes())
                                     .hexdigest()} for a in ("sha1", "sha256")],
                      "licenseConcluded": "GPL-3.0-or-later", "copyrightText": "NOASSERTION"})
        relations.append(relation("SPDXRef-whittle", "CONTAINS", files[-1]["SPDXID"]))
    digest = hashlib.sha256(json.dumps([packages, files], sort_keys=True).encode()).hexdigest()
    return {"spdxVersion": "SPDX-2.3", "dataLicense": "CC0-1.0", "SPDXID": "SPDXRef-DOCUMENT",
            "name": f"whittle-{version}", "documentNamespace": f"https://whittle.invalid/spdx/{version}-{digest}",
            "creationInfo": {"created": made.strftime("%Y-%m-%dT%H:%M:%SZ"), "creators": ["Tool: whittle-sbom"]},
            "packages": packages, "files": files, "relationships": relations}


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    json.dump(document(sys.argv[1:]), sys.stdout, indent=2, sort_keys=True)
    print()
