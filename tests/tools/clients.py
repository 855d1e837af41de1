#!/usr/bin/env python3
"""Which clients call the service as it is: a table of what `make test-contract` ran, from pytest's JUnit XML.

Usage: clients.py RESULTS.xml ... [-o out/clients.md]

A generated client's calls are those that its test prints; of everything else the tests count.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import json
import pathlib
import re
import xml.etree.ElementTree

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGES = ROOT / "tests/node/node_modules"
GENERATED = "test_a_generated_client_calls_the_service"
GENERATORS = {"hey-api": "@hey-api/openapi-ts", "openapi-fetch": "openapi-fetch"}  # packages of another name
# Client, its package of npm, and the tests that call by it: a pattern of file.test[parameters].
OTHERS = (
    ("prism, between", "@stoplight/prism-cli", r"test_description\.test_the_main_traffic"),
    ("tus-js-client", "tus-js-client", r"test_clients\.test_tus_js_client"),
    ("curl, wget, Python's and Node's own", None, r"test_clients\.(?!test_tus_js_client)"),
    ("whittle.js in Node", None, r"test_javascript_client\."),
    ("whittle.js in Chromium", None, r"test_browser\.test_the_javascript_client"),
    ("whittle.Client of Python", None, r"test_python_client\."),
)


def version(package):
    path = PACKAGES / (package or "") / "package.json"
    return json.loads(path.read_text(encoding="utf-8"))["version"] if package and path.exists() else ""


def outcome(case):
    if case.find("skipped") is not None:
        return "skipped"
    return "failed" if case.find("failure") is not None or case.find("error") is not None else "passed"


def row(name, package, outcomes):
    ran = [each for each in outcomes if each != "skipped"]
    passed = sum(each == "passed" for each in ran)
    return [name, version(package), f"{passed} of {len(ran)}" if ran else "not run", str(len(outcomes) - len(ran) or "")]


def rows(cases):
    for case in cases:
        match = re.fullmatch(GENERATED + r"\[(.*)\]", case.get("name"))
        if match:
            said = re.findall(rf"^{re.escape(match[1])} +(.+?)  +(\S.*)$", case.findtext("system-out") or "", re.M)
            outcomes = ["passed" if result == "ok" else "failed" for _, result in said] or [outcome(case)]
            yield row(match[1], GENERATORS.get(match[1], match[1]), outcomes)
    for name, package, pattern in OTHERS:
        named = [(f"{case.get('classname').split('.')[-1]}.{case.get('name')}", case) for case in cases]
        yield row(name, package, [outcome(case) for full, case in named if re.match(pattern, full)])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("results", nargs="+")
    parser.add_argument("-o", "--output", type=pathlib.Path, default=ROOT / "out/clients.md")
    options = parser.parse_args()
    cases = [case for path in options.results for case in xml.etree.ElementTree.parse(path).iter("testcase")]
    table = [["client", "version", "calls that passed", "skipped"], ["---"] * 4, *rows(cases)]
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text("".join(f"| {' | '.join(line)} |\n" for line in table), encoding="utf-8")
    print(options.output.read_text(encoding="utf-8"), end="")


if __name__ == "__main__":
    main()
