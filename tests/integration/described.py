# SPDX-License-Identifier: GPL-3.0-or-later
"""Holds replies against the contract: status, media type, headers, body, problem."""
import re

import jsonschema

from tables import CONTRACT as DOCUMENT

METHODS = ("get", "post", "put", "patch", "delete", "options", "head")


def resolved(node):
    while "$ref" in node:
        target = DOCUMENT
        for part in node["$ref"].removeprefix("#/").split("/"):
            target = target[part.replace("~1", "/").replace("~0", "~")]
        node = target
    return node


class Operation:
    """One method on one path, as the document has it."""

    def __init__(self, path, method, described):
        self.path, self.method, self.described = path, method.upper(), described
        self.id = described["operationId"]
        self.pattern = re.compile(re.sub(r"\{\w+\}", "[^/]+", path) + r"(\?.*)?")
        self.public = not described.get("security", DOCUMENT.get("security"))

    @property
    def statuses(self):
        return sorted(self.described["responses"])

    def slugs(self, status):
        """The problems that a status may come with."""
        said = resolved(self.described["responses"][str(status)])["description"]
        found = re.search(r"A problem document: ([^.]+)\.", said)
        return [slug.strip() for slug in found.group(1).split(",")] if found else []

    def url(self, **parts):
        return re.sub(r"\{(\w+)\}", lambda m: str(parts[m.group(1)]), self.path)


def operations():
    return {op["operationId"]: Operation(path, method, op) for path, item in DOCUMENT["paths"].items()
            for method, op in item.items() if method in METHODS}


OPERATIONS = operations()


def check_schema(instance, schema):
    """Against a schema of the document, whose references stay valid."""
    whole = {"$schema": "https://json-schema.org/draft/2020-12/schema", "components": DOCUMENT["components"],
             "allOf": [schema]}
    jsonschema.Draft202012Validator(whole, format_checker=jsonschema.FormatChecker()).validate(instance)


def check(operation, reply, head=False):
    """Whether the document allows this reply to this operation; returns it."""
    what = f"{operation.method} {operation.path} -> {reply.status}"
    assert str(reply.status) in operation.described["responses"], f"{what} is not described: {reply.body[:300]}"
    response = resolved(operation.described["responses"][str(reply.status)])
    for name, header in response.get("headers", {}).items():
        header = resolved(header)
        if header.get("required"):
            assert name.lower() in reply.headers, f"{what} has no header {name}"
        if name.lower() in reply.headers and header["schema"].get("type") == "integer":
            assert reply.headers[name.lower()].isdigit(), f"{what}: {name}"
    content = response.get("content", {})
    if not content:
        assert not reply.body, f"{what} has a body that isn't described"
        return reply
    media = reply.headers["content-type"].split(";")[0]
    assert media in content, f"{what} is of type {media}"
    if head:
        return reply
    if media.endswith("json") and reply.status != 206:
        check_schema(reply.json, content[media]["schema"])
    if media == "application/problem+json":
        assert reply.slug in operation.slugs(reply.status), f"{what}: {reply.slug} is not named"
    return reply
