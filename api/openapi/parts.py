#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads, writes and joins the parts of the contract.

Usage: parts.py FOLDER OUTPUT     (joins the parts in FOLDER into the document OUTPUT)

head.json is the document without paths and components; paths/TAG.json has the paths of each of its tags, and
components/KIND.json the components of each kind.  Paths stand in the order of the tags.
"""
import json
import os
import pathlib
import sys

COLUMNS = 120


def unique(pairs):
    members = dict(pairs)
    if len(members) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{next(name for name in names if names.count(name) > 1)} stands there twice")
    return members


def read(path):
    try:
        return json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=unique)
    except ValueError as error:
        sys.exit(f"{path}: {error}")


def layout(value, indent="", room=COLUMNS):
    """JSON text; whatever fits stands on one line."""
    short = json.dumps(value)
    if len(indent) + len(short) <= room or not value or not isinstance(value, (dict, list)):
        return short
    deeper = indent + " "
    if isinstance(value, list):
        return "[\n" + ",\n".join(deeper + layout(each, deeper, COLUMNS - 1) for each in value) + f"\n{indent}]"
    # A member's name takes of the room of its value.
    members = (f"{deeper}{json.dumps(name)}: " + layout(each, deeper, COLUMNS - len(json.dumps(name)) - 3)
               for name, each in value.items())
    return "{\n" + ",\n".join(members) + f"\n{indent}}}"


def write(path, value):
    path.write_text(layout(value) + "\n", encoding="utf-8")


def joined(folder):
    document = read(folder / "head.json") | {"paths": {}, "components": {}}
    tags = [tag["name"] for tag in document["tags"]]
    files = {path.stem for path in (folder / "paths").glob("*.json")}
    if files != set(tags):
        sys.exit(f"{folder}/paths: one file for each tag of head.json, {', '.join(sorted(files ^ set(tags)))} is not")
    for tag in tags:
        path = folder / "paths" / f"{tag}.json"
        for url, item in read(path).items():
            if url in document["paths"]:
                sys.exit(f"{path}: {url} is in another part too")
            if any(operation["tags"] != [tag] for method, operation in item.items() if method != "parameters"):
                sys.exit(f"{path}: an operation of {url} has another tag")
            document["paths"][url] = item
    for path in sorted((folder / "components").glob("*.json")):
        document["components"][path.stem] = read(path)
    return document


def main():
    folder, output = map(pathlib.Path, sys.argv[1:])
    whole = output.with_suffix(".tmp")
    whole.write_text(json.dumps(joined(folder), indent=1) + "\n", encoding="utf-8")
    os.replace(whole, output)


if __name__ == "__main__":
    main()
