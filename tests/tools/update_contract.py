#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings api/openapi/ up to date with the parameter table, and with the scopes of the route table.

Usage: update_contract.py BUILD     (from the root of the tree; runs whittled and tests/tools/tables of BUILD)

The table is core/params.c, as a daemon started for the purpose tells it at /v1/parameters.  Everything else in the
contract is written by hand.  A new parameter may be used by every operation that had all of them before.
"""
import json
import pathlib
import subprocess
import sys
import tempfile
import textwrap
import urllib.request

FOLDER = pathlib.Path("api/openapi")
COMPONENTS = FOLDER / "components"
sys.path.insert(0, str(pathlib.Path(__file__).parent.parent.parent / FOLDER))
import parts  # noqa: E402


def table_of(whittled):
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen([whittled, "--listen", "127.0.0.1:0", "--data", folder], stdout=subprocess.PIPE,
                                   stderr=subprocess.DEVNULL, text=True)
        try:
            url = process.stdout.readline().split()[-1]
            with urllib.request.urlopen(f"{url}/v1/parameters") as reply:
                return json.load(reply)["properties"]
        finally:
            process.terminate()
            process.wait()


# Of parameters without a default.
EXAMPLES = {"ratio": 0.1, "points": 5000, "max_deviation": 0.5, "max_deviation_rel": 0.001, "spacing": 0.05,
            "max_error": 0.001, "levels": [0.4, 0.2, 0.1], "crop": [0, 0, 0, 10, 10, 5], "viewpoint": [0, 0, 1.7],
            "where": ["class==2|6", "intensity>100"], "weights": ["rgb:0.2"], "close_holes": 2.5,
            "preview_azimuth": 60,
            "columns": ["-", "x", "y", "z"], "outputs": ["cloud", "mesh", "report"], "cocone": "tight",
            "preview_up": "z", "properties": ["rgb", "intensity"]}


def parameter(name, row):
    schema = {key: value for key, value in row.items() if key != "description"}
    described = {"name": name, "in": "query", "description": row["description"] + ".", "required": False,
                 "schema": schema}
    if schema.pop("deprecated", False):
        described["deprecated"] = True
    described["example"] = EXAMPLES[name] if name in EXAMPLES else row["default"]
    if schema["type"] == "array":
        described |= {"style": "form", "explode": True}
    return described


def update_operation(operation, old, new):
    """Replaces the references to parameters of the table by those of the new one, less what was left out before."""
    names = [p.get("$ref", "").rsplit("/", 1)[-1] for p in operation.get("parameters", [])]
    if not set(names) & old:
        return
    left_out = old - set(names)
    others = [p for p, name in zip(operation["parameters"], names) if name not in old]
    kept = [{"$ref": f"#/components/parameters/{name}"} for name in new if name not in left_out]
    operation["parameters"] = kept + others


def scopes(tables):
    """(method, path) -> scope, of the route table."""
    printed = subprocess.run([tables], capture_output=True, check=True).stdout
    return {(row["method"].lower(), row["path"]): row["scope"] for row in json.loads(printed)["routes"]}


def update_security(operation, scope):
    """Which token an operation wants, and what it answers to others, where that isn't described yet."""
    if scope == "public":
        operation["security"] = []
        return
    link = [{"link": []}] if operation["operationId"] == "getOutput" else []
    operation["security"] = [{"token": []}, *link, {}]  # {}: a service without tokens
    operation["x-scope"] = scope
    responses = operation["responses"]
    responses.setdefault("401", {"$ref": "#/components/responses/Unauthorized"})
    responses.setdefault("403", {"$ref": "#/components/responses/Forbidden"})
    operation["responses"] = dict(sorted(responses.items()))


def type_of(row):
    """A parameter's type in TypeScript."""
    if row["type"] == "array":
        return f"readonly ({type_of(row['items'])})[]"
    if "enum" in row:
        return " | ".join(json.dumps(value) for value in row["enum"])
    return "string" if row["type"] == "string" else "number"


def types(table):
    """api/javascript/parameters.d.ts."""
    lines = ["// The parameters of a job.  `make contract` writes this file from core/params.c.", "//",
             "// SPDX-License-Identifier: GPL-3.0-or-later", "", "export interface Parameters {"]
    for name, row in table.items():
        notes = ["@deprecated"] if row.get("deprecated") else []
        notes += [f"Default {row['default']}."] if "default" in row and not isinstance(row["default"], list) else []
        text = " ".join([row["description"].rstrip(".") + ".", *notes])
        lines += textwrap.wrap(text, 114, initial_indent="  /** ", subsequent_indent="   *  ")
        lines[-1] += " */"
        one = f"  {name}?: {type_of(row)};"
        lines += [one] if len(one) <= 120 else [f"  {name}?:", *textwrap.wrap(
            type_of(row) + ";", 114, initial_indent="    ", subsequent_indent="    ", break_long_words=False)]
    return "\n".join([*lines, "}", ""])


def main():
    build = pathlib.Path(sys.argv[1])
    table = table_of(build / "whittled")
    old = set(parts.read(COMPONENTS / "parameters.json"))
    parts.write(COMPONENTS / "parameters.json", {name: parameter(name, row) for name, row in table.items()})
    pathlib.Path("api/javascript/parameters.d.ts").write_text(types(table), encoding="utf-8")
    schemas = parts.read(COMPONENTS / "schemas.json")
    schemas["Params"]["properties"] = {
        name: {key: value for key, value in row.items() if not key.startswith("x-")} for name, row in table.items()}
    parts.write(COMPONENTS / "schemas.json", schemas)
    scope_of = scopes(build / "tests/tools/tables")
    for path in (FOLDER / "paths").glob("*.json"):
        items = parts.read(path)
        for url, item in items.items():
            for method, operation in item.items():
                if method != "parameters":
                    update_operation(operation, old, table)
                    update_security(operation, scope_of[method, url])
        parts.write(path, items)


main()
