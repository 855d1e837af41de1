# SPDX-License-Identifier: GPL-3.0-or-later
"""openapi.json says what is there: no more, no less."""
import html
import json
import pathlib
import re
import shutil
import subprocess
import sys

import pytest

from conftest import BUILD, SMALL
from tables import CONTRACT_FILE, PROBLEMS, ROUTES

ROOT = pathlib.Path(__file__).parent.parent.parent
PARTS = ROOT / "api/openapi"
sys.path.insert(0, str(PARTS))
import parts  # noqa: E402


@pytest.fixture(name="contract")
def make_contract(daemon):
    return daemon.curl("/openapi.json").json


def test_the_contract_is_the_file(daemon):
    assert daemon.curl("/openapi.json").body == CONTRACT_FILE.read_bytes()


def parts_in(folder):
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*.json")}


def test_bringing_it_up_to_date_changes_nothing(tmp_path):
    types = pathlib.Path("api/javascript/parameters.d.ts")
    shutil.copytree(PARTS, tmp_path / "api/openapi")
    (tmp_path / types).parent.mkdir()
    subprocess.run([sys.executable, ROOT / "tests/tools/update_contract.py", BUILD.resolve()], cwd=tmp_path, check=True)
    assert parts_in(tmp_path / "api/openapi") == parts_in(PARTS)
    assert (tmp_path / types).read_text() == (ROOT / types).read_text()


def test_parts_are_laid_out_as_they_are_written(tmp_path):
    for path in PARTS.rglob("*.json"):
        parts.write(tmp_path / "part.json", parts.read(path))
        assert (tmp_path / "part.json").read_text() == path.read_text(), path


@pytest.fixture(name="copied")
def make_copied(tmp_path):
    shutil.copytree(PARTS, tmp_path / "parts")
    return tmp_path / "parts"


def join(folder):
    return subprocess.run([sys.executable, PARTS / "parts.py", folder, folder / "joined.json"], capture_output=True,
                          text=True, check=False)


def test_the_parts_make_the_contract(copied):
    assert join(copied).returncode == 0
    assert (copied / "joined.json").read_bytes() == CONTRACT_FILE.read_bytes()


@pytest.mark.parametrize("part, text, wrong", [
    ("paths/others.json", "{}", "one file for each tag of head.json, others is not"),
    ("paths/service.json", '{"/v1/jobs": {}}', "/v1/jobs is in another part too"),
    ("paths/service.json", '{"/new": {"get": {"tags": ["jobs"]}}}', "an operation of /new has another tag"),
    ("components/headers.json", '{"a": {}, "b": {}, "a": {}}', "a stands there twice"),
    ("head.json", '{"tags": [', "Expecting value")])
def test_parts_that_do_not_fit_are_refused(copied, part, text, wrong):
    (copied / part).write_text(text)
    done = join(copied)
    assert done.returncode == 1 and wrong in done.stderr and "Traceback" not in done.stderr
    assert not (copied / "joined.json").exists()


def test_operations_are_the_route_table(contract):
    routes = {(row["method"], row["path"], row["operation"]) for row in ROUTES}
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
        if "deprecated" in parameter:
            described[name]["deprecated"] = parameter["deprecated"]
    assert described == table["properties"]
    create = [p.get("$ref", "").rsplit("/", 1)[-1] or p["name"] for p in
              contract["paths"]["/v1/jobs"]["post"]["parameters"] if p.get("in") != "header"]
    assert set(create) == set(table["properties"]) | {"label", "priority", "webhook"}


def nodes(node):
    """The node and everything in it."""
    yield node
    for child in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from nodes(child)


def target_of(contract, reference):
    target = contract
    for name in reference.removeprefix("#/").split("/"):
        target = target[name]
    return target


def references(contract):
    return {node["$ref"] for node in nodes(contract) if isinstance(node, dict) and "$ref" in node}


def operations_of(contract):
    return [operation for item in contract["paths"].values() for method, operation in item.items()
            if method != "parameters"]


def test_every_reference_leads_somewhere(contract):
    assert references(contract)
    for reference in references(contract):
        target_of(contract, reference)


def test_every_component_is_used(contract):
    schemes = {name for operation in operations_of(contract) for each in operation["security"] for name in each}
    used = references(contract) | {f"#/components/securitySchemes/{name}" for name in schemes}
    assert used == {f"#/components/{kind}/{name}" for kind, named in contract["components"].items() for name in named}


def test_every_operation_is_described(contract):
    for operation in operations_of(contract):
        assert operation["summary"].endswith(".") and operation["description"].endswith("."), operation["operationId"]
        assert operation["responses"]


def test_problem_responses_show_each_problem_that_they_name(contract):
    responses = [response for operation in operations_of(contract) for response in operation["responses"].values()]
    shown = 0
    for response in responses + list(contract["components"]["responses"].values()):
        content = response.get("content", {}).get("application/problem+json")
        if content:
            named = response["description"].removeprefix("A problem document: ").removesuffix(".").split(", ")
            assert content["examples"] == {slug: {"$ref": f"#/components/examples/{slug}"} for slug in named}
            shown += 1
    assert shown


def resolved(contract, node):
    while "$ref" in node:
        node = target_of(contract, node["$ref"])
    return node


def values_of(contract, node):
    """The examples of a parameter or of a body."""
    if "example" in node:
        return [node["example"]]
    return [resolved(contract, example)["value"] for example in node.get("examples", {}).values()]


PLAIN = ("text/html", "text/css", "text/javascript")  # pages, which people look at


def test_whatever_is_sent_or_comes_back_has_an_example_that_fits(contract):
    described = pytest.importorskip("described", reason="python3-jsonschema is not installed")
    looked = 0
    for operation in operations_of(contract):
        nodes_of = [(each["name"], each) for each in
                    (resolved(contract, each) for each in operation.get("parameters", []))]
        bodies = [operation["requestBody"]] if "requestBody" in operation else []
        for body in bodies + [resolved(contract, each) for each in operation["responses"].values()]:
            nodes_of += [(kind, content) for kind, content in resolved(contract, body).get("content", {}).items()
                         if content["schema"].get("format") != "binary" and kind not in PLAIN]
        for name, node in nodes_of:
            values = values_of(contract, node)
            assert values, (operation["operationId"], name)
            for value in values:
                described.check_schema(value, node["schema"])
                looked += 1
    assert looked > 300


# Keywords of languages that clients are generated for, as far as those can't be names of methods and classes there.
RESERVED = set("""abstract and as assert async await boolean break byte case catch char class const continue debugger def
default del delete do double elif else enum except export extends false final finally float for from func function global
go goto if implements import in instanceof int interface is lambda let long map native new nil none nonlocal not null or
package pass private protected public raise range return select self short static struct super switch synchronized this
throw throws transient true try type typeof var void volatile while with yield""".split())


def test_no_names_differ_by_case_alone_and_none_is_reserved(contract):
    schemas = contract["components"]["schemas"]
    groups = {"operations": [operation["operationId"] for operation in operations_of(contract)],
              "schemas": list(schemas), "tags": [tag["name"] for tag in contract["tags"]],
              **{f"components/{kind}": list(named) for kind, named in contract["components"].items()},
              **{f"members of {name}": list(schema.get("properties", {})) for name, schema in schemas.items()}}
    for operation in operations_of(contract):
        found = [resolved(contract, each) for each in operation.get("parameters", [])]
        groups[f"parameters of {operation['operationId']}"] = [f"{each['in']} {each['name']}" for each in found]
    for group, names in groups.items():
        plain = [re.sub("[^a-z0-9 ]", "", name.lower()) for name in names]
        assert len(set(plain)) == len(plain), (group, sorted(names))
        words = {name.split(" ")[-1] for name in names if not name.startswith("header ")}  # those have names of HTTP
        if not group.startswith(("members", "components/")):
            assert not {word.lower() for word in words} & RESERVED, group


def test_what_operations_share_is_written_once(contract):
    responses = [(status, response) for operation in operations_of(contract)
                 for status, response in operation["responses"].items() if "$ref" not in response]
    responses += [(None, response) for response in contract["components"]["responses"].values()]
    written = [json.dumps(response, sort_keys=True) for _, response in responses]
    written += [name + json.dumps(header, sort_keys=True) for _, response in responses
                for name, header in response.get("headers", {}).items() if "$ref" not in header]
    assert sorted(written) == sorted(set(written))


def test_job_documents_have_the_members_described(daemon, contract):
    job = daemon.ended(daemon.submit(SMALL))
    schema = contract["components"]["schemas"]["Job"]
    assert set(job) == set(schema["properties"]) == set(schema["required"])
    assert job["input"]["points"] == job["report"]["points_in"] == 300  # no header told them
    assert set(job["params"]) <= set(contract["components"]["schemas"]["Params"]["properties"])


def test_problem_pages_explain_every_problem_named(daemon, contract):
    text = CONTRACT_FILE.read_text()
    slugs = {slug.strip() for found in re.findall(r"A problem document: ([^.]+)\.", text) for slug in found.split(",")}
    assert "no-such-job" in slugs and slugs <= {row["slug"] for row in PROBLEMS}
    for row in PROBLEMS:
        page = daemon.curl(f"/problems/{row['slug']}")
        assert page.status == 200 and page.headers["content-type"].startswith("text/html")
        text = html.unescape(page.body.decode())
        assert f"<h1>{row['title']}</h1>" in text and f"<code>{row['slug']}</code>, HTTP status {row['status']}<" in text
    assert contract["openapi"].startswith("3.1")


def test_examples_of_problems_are_as_the_table_has_them(contract):
    examples = contract["components"]["examples"]
    shown = {row["slug"] for row in PROBLEMS if row["slug"] in examples}
    assert "no-such-job" in shown
    for row in PROBLEMS:
        if row["slug"] in shown:
            value = examples[row["slug"]]["value"]
            assert (value["type"], value["status"], value["title"]) == \
                (f"/problems/{row['slug']}", row["status"], row["title"])


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
    page = re.sub(r'<script type="module" src="page/docs-[0-9a-f]{16}\.js"></script>', "", page)  # where the page is built
    assert not re.search(r"<script|<link|<img|@import|url\(|https?://", page)
    for path, item in contract["paths"].items():
        for method, operation in item.items():
            if method != "parameters":
                assert f'<h3 id="{operation["operationId"]}"><code>{method.upper()} {path}</code></h3>' in page
    for name in contract["components"]["schemas"]:
        assert f'<h3 id="{name}">' in page
    rows = re.findall(r"<tr><td>(\d{3})<td>(.+?) *<td>", page)
    assert [status for status, _ in rows].count("401") > 1
    assert len(rows) == sum(len(operation["responses"]) for operation in operations_of(contract))
    linked = set(re.findall(r'href="problems/([a-z-]+)"', page))
    assert linked == {slug for slug in contract["components"]["examples"] if slug in {row["slug"] for row in PROBLEMS}}
    targets = set(re.findall(r'href="#(\w+)"', page))
    assert targets and targets <= set(re.findall(r'id="(\w+)"', page))
