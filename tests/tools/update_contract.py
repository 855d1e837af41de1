#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings api/openapi.json up to date with the parameter table, and with the scopes of the route table.

Usage: update_contract.py WHITTLED     (from the root of the tree)

The table is core/params.c, as a daemon started for the purpose tells it at /v1/parameters.  Everything else in the
contract is written by hand.  A new parameter may be used by every operation that had all of them before.
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile
import urllib.request

CONTRACT = pathlib.Path("api/openapi.json")


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


def parameter(name, row):
    schema = {key: value for key, value in row.items() if key != "description"}
    described = {"name": name, "in": "query", "description": row["description"] + ".", "required": False,
                 "schema": schema}
    if schema["type"] == "array":
        described |= {"style": "form", "explode": False}
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


def scopes():
    """(method, path) -> scope, of the route table."""
    rows = re.findall(r'\{"([A-Z]+)", "([^"]+)",\s+"\w+",\s+OPERATION_\w+,\s+ROUTES_(\w+)\}',
                      pathlib.Path("api/routes.c").read_text(encoding="utf-8"))
    return {(method.lower(), path): scope.lower() for method, path, scope in rows}


def problem(slug):
    return {"description": f"A problem document: {slug}.",
            "content": {"application/problem+json": {
                "schema": {"$ref": "#/components/schemas/Problem"},
                "examples": {slug: {"$ref": f"#/components/examples/{slug}"}}}}}


def update_security(operation, scope):
    """Which token an operation wants, and what it answers to others, where that isn't described yet."""
    if scope == "public":
        operation["security"] = []
        return
    operation["security"] = [{"token": []}] + ([{"link": []}] if operation["operationId"] == "getOutput" else [])
    operation["x-scope"] = scope
    header = {"schema": {"type": "string"}, "description": "Bearer, and what is wrong with the token.",
              "required": True}
    responses = operation["responses"]
    responses.setdefault("401", problem("unauthorized") | {"headers": {"WWW-Authenticate": header}})
    responses.setdefault("403", problem("forbidden"))
    operation["responses"] = dict(sorted(responses.items()))


def main():
    table = table_of(sys.argv[1])
    contract = json.loads(CONTRACT.read_text(encoding="utf-8"))
    components = contract["components"]
    old = set(components["parameters"])
    components["parameters"] = {name: parameter(name, row) for name, row in table.items()}
    components["schemas"]["Params"]["properties"] = {
        name: {key: value for key, value in row.items() if not key.startswith("x-")} for name, row in table.items()}
    scope_of = scopes()
    for path, item in contract["paths"].items():
        for method, operation in item.items():
            if method != "parameters":
                update_operation(operation, old, table)
                update_security(operation, scope_of[method, path])
    CONTRACT.write_text(json.dumps(contract, indent=1) + "\n", encoding="utf-8")


main()
