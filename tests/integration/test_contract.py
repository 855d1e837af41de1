# SPDX-License-Identifier: GPL-3.0-or-later
"""openapi.json says what is there: no more, no less."""
import json
import pathlib
import re
import shutil
import subprocess
import sys

import pytest

from conftest import BUILD, SMALL

ROOT = pathlib.Path(__file__).parent.parent.parent


@pytest.fixture(name="contract")
def make_contract(daemon):
    return daemon.curl("/openapi.json").json


def test_the_contract_is_the_file(daemon):
    assert daemon.curl("/openapi.json").body == (ROOT / "api/openapi.json").read_bytes()


def test_bringing_it_up_to_date_changes_nothing(tmp_path):
    (tmp_path / "api").mkdir()
    for name in ("openapi.json", "routes.c"):
        shutil.copy(ROOT / "api" / name, tmp_path / "api")
    subprocess.run([sys.executable, ROOT / "tests/tools/update_contract.py", (BUILD / "whittled").resolve()],
                   cwd=tmp_path, check=True)
    assert json.loads((tmp_path / "api/openapi.json").read_text()) == json.loads((ROOT / "api/openapi.json").read_text())


def test_operations_are_the_route_table(contract):
    source = (ROOT / "api/routes.c").read_text()
    routes = set(re.findall(r'\{"([A-Z]+)", "([^"]+)", "(\w+)", OPERATION_', source))
    described = {(method.upper(), path, operation["operationId"])
                 for path, item in contract["paths"].items()
                 for method, operation in item.items() if method != "parameters"}
    assert routes and routes == described


def test_parameters_are_the_parameter_table(daemon, contract):
    table = daemon.curl("/v1/parameters").json
    assert table["$schema"].endswith("2020-12/schema")
    described = {}
    for name, parameter in contract["components"]["parameters"].items():
        assert parameter["name"] == name
        described[name] = {**parameter["schema"], "description": parameter["description"].removesuffix(".")}
    assert described == table["properties"]
    create = [p.get("$ref", "").rsplit("/", 1)[-1] or p["name"] for p in
              contract["paths"]["/v1/jobs"]["post"]["parameters"] if p.get("in") != "header"]
    assert set(create) == set(table["properties"]) | {"label", "priority", "webhook"}


def test_every_reference_leads_somewhere(contract):
    def walk(node):
        if isinstance(node, dict):
            if "$ref" in node:
                target = contract
                for part in node["$ref"].removeprefix("#/").split("/"):
                    target = target[part]
            for child in node.values():
                walk(child)
        elif isinstance(node, list):
            for child in node:
                walk(child)
    walk(contract)


def test_job_documents_have_the_members_described(daemon, contract):
    job = daemon.ended(daemon.submit(SMALL))
    schema = contract["components"]["schemas"]["Job"]
    assert set(job) == set(schema["properties"]) == set(schema["required"])
    assert job["input"]["points"] == job["report"]["points_in"] == 300  # no header told them
    assert set(job["params"]) <= set(contract["components"]["schemas"]["Params"]["properties"])


def test_problem_pages_explain_every_problem_named(daemon, contract):
    text = (ROOT / "api/openapi.json").read_text()
    slugs = {slug.strip() for found in re.findall(r"A problem document: ([^.]+)\.", text) for slug in found.split(",")}
    table = set(re.findall(r'\{\s*"([a-z-]+)",\s*[45]\d\d,', (ROOT / "api/problem.c").read_text()))
    assert slugs <= table
    for slug in table:
        page = daemon.curl(f"/problems/{slug}")
        assert page.status == 200 and page.headers["content-type"].startswith("text/html") and slug.encode() in page.body
    assert "no-such-job" in text and contract["openapi"].startswith("3.1")


@pytest.mark.parametrize("path", ["/", "/v1/info", "/v1/parameters", "/openapi.json", "/healthz", "/readyz", "/v1/jobs"])
def test_head_is_get_without_a_body(daemon, path):
    get, head = daemon.curl(path), daemon.curl(path, "-I", "-o", "/dev/null")
    assert get.status == head.status == 200 and get.body
    assert head.headers["content-type"] == get.headers["content-type"]
    assert head.headers["content-length"] == get.headers["content-length"]


def test_head_of_events_does_not_wait(daemon):
    job_id = daemon.submit(SMALL)
    head = daemon.curl(f"/v1/jobs/{job_id}/events", "-I", "-o", "/dev/null")
    assert head.status == 200 and head.headers["content-type"] == "text/event-stream"


def test_info_tells_the_limits(daemon):
    info = daemon.curl("/v1/info").json
    assert info["version"] and "xyz" in info["input_formats"] and "mesh.ply" in info["outputs"]
    for name in ("max_body_bytes", "max_queue", "job_memory_bytes", "job_wall_ms", "retention_ms", "sync_max_ms"):
        assert info["limits"][name] > 0


def test_the_reference_page_has_everything_and_loads_nothing(daemon, contract):
    reply = daemon.curl("/docs")
    page = reply.body.decode()
    assert reply.headers["content-type"].startswith("text/html")
    assert reply.headers["content-security-policy"].startswith("default-src 'none'")
    assert not re.search(r"<script|<link|<img|@import|url\(|https?://", page)
    for path, item in contract["paths"].items():
        for method, operation in item.items():
            if method != "parameters":
                assert f'<h3 id="{operation["operationId"]}"><code>{method.upper()} {path}</code></h3>' in page
    for name in contract["components"]["schemas"]:
        assert f'<h3 id="{name}">' in page
    targets = set(re.findall(r'href="#(\w+)"', page))
    assert targets and targets <= set(re.findall(r'id="(\w+)"', page))
