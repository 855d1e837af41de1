# SPDX-License-Identifier: GPL-3.0-or-later
"""No one gets in where they don't belong: tokens, scopes, principals, signed links."""
import hashlib
import os
import re
import signal
import stat
import subprocess
import time

import pytest

from conftest import SMALL, Daemon, wait_until
from tables import CONTRACT, ROUTES

TOKENS = {"alice": "submit,read", "bob": "submit,read", "reader": "read", "submitter": "submit", "root": "admin"}


def line(name, scopes, token):
    return f"{name}:{scopes}:{hashlib.sha256(token.encode()).hexdigest()}\n"


def as_(name):
    return ("-H", f"Authorization: Bearer {name}-secret")


@pytest.fixture(name="daemon", scope="module")
def make_guarded_daemon(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guarded")
    tokens = folder / "tokens"
    tokens.write_text("# who may what\n\n" + "".join(line(n, s, f"{n}-secret") for n, s in TOKENS.items()))
    with Daemon(folder, "--tokens-file", tokens) as daemon:
        yield daemon
        assert daemon.stop() == 0
        assert "-secret" not in daemon.log_text()


@pytest.fixture(name="job_id", scope="module")
def make_job(daemon):
    """A job of alice's."""
    reply = daemon.post("/v1/jobs", SMALL, *as_("alice"))
    assert reply.status == 201 and reply.json["principal"] == "alice"
    job_id = reply.json["id"]

    def ended():
        return daemon.curl(f"/v1/jobs/{job_id}", *as_("alice")).json["status"] == "successful"
    wait_until(ended, "the job's end")
    return job_id


# ---------------------------------------------------------------------------------------------- tokens

def test_what_is_public_wants_no_token(daemon):
    for path in ("/healthz", "/readyz", "/openapi.json", "/problems/unauthorized", "/v1/parameters", "/v1/info", "/"):
        assert daemon.curl(path).status == 200, path


def operations():
    for path, item in CONTRACT["paths"].items():
        for method, operation in item.items():
            if method != "parameters":
                yield method.upper(), path, operation


def test_the_contract_says_which_scope_each_operation_wants():
    table = {(row["method"], row["path"]): row["scope"] for row in ROUTES}
    for method, path, operation in operations():
        assert table[method, path] == operation.get("x-scope", "public"), path
        assert (operation.get("security", []) == []) == (table[method, path] == "public")


@pytest.mark.parametrize("method, path", [(m, p) for m, p, o in operations() if o.get("x-scope")])
def test_every_other_operation_wants_one(daemon, method, path):
    path = path.replace("{id}", "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e").replace("{name}", "cloud.ply")
    reply = daemon.curl(path, "-X", method)
    assert (reply.status, reply.slug) == (401, "unauthorized")
    assert reply.headers["www-authenticate"] == 'Bearer realm="whittled"'


@pytest.mark.parametrize("header, code", [
    ("Bearer wrong", "invalid_token"), ("Bearer ", "invalid_request"), ("Bearer alice-secret2", "invalid_token"),
    ("Bearer alice-secre", "invalid_token"), ("Basic YWxpY2U6eA==", "invalid_request"), ("alice-secret", "invalid_request"),
    ("Bearer " + "x" * 4000, "invalid_token"), ("Bearer alice-secret, Bearer bob-secret", "invalid_token")])
def test_wrong_tokens(daemon, header, code):
    reply = daemon.curl("/v1/jobs", "-H", f"Authorization: {header}")
    assert reply.status == 401 and reply.slug == "unauthorized"
    if header != "Bearer ":  # whose blank gets lost on the way
        assert f'error="{code}"' in reply.headers["www-authenticate"]


def test_the_hash_is_no_token(daemon):
    digest = hashlib.sha256(b"alice-secret").hexdigest()
    assert daemon.curl("/v1/jobs", "-H", f"Authorization: Bearer {digest}").status == 401


def test_two_authorizations_are_malformed(daemon):
    assert daemon.curl("/v1/jobs", *as_("alice"), *as_("root")).slug == "malformed-request"


def test_the_scheme_is_told_in_any_case(daemon):
    assert daemon.curl("/v1/jobs", "-H", "Authorization: bearer alice-secret").status == 200


def test_scopes(daemon, job_id):
    for path in ("/v1/jobs", "/v1/simplify"):
        reply = daemon.post(path, SMALL, *as_("reader"))
        assert (reply.status, reply.slug, reply.json["scope"]) == (403, "forbidden", "submit")
        assert 'error="insufficient_scope", scope="submit"' in reply.headers["www-authenticate"]
    assert daemon.curl("/v1/jobs", *as_("submitter")).json["scope"] == "read"
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE", *as_("reader")).status == 403
    assert daemon.post("/v1/simplify", SMALL, *as_("submitter")).status == 200


def test_a_refused_upload_is_not_sent(daemon, tmp_path):
    body = tmp_path / "body"
    body.write_bytes(bytes(8 << 20))
    done = subprocess.run(daemon.curl_command("/v1/jobs", "-X", "POST", "-T", body, "-H", "Expect: 100-continue", "-w",
                                              "sent=%{size_upload}"), capture_output=True, check=False)
    assert b" 401 " in done.stdout and done.stdout.endswith(b"sent=0")


# ---------------------------------------------------------------------------------------------- principals

def test_another_principals_job_is_not_there(daemon, job_id):
    for tail in ("", "/outputs", "/outputs/cloud.ply", "/events", "/log"):
        reply = daemon.curl(f"/v1/jobs/{job_id}{tail}", *as_("bob"))
        assert (reply.status, reply.slug) == (404, "no-such-job"), tail
    for method, tail in (("DELETE", ""), ("POST", "/outputs/cloud.ply/link")):
        assert daemon.curl(f"/v1/jobs/{job_id}{tail}", "-X", method, *as_("bob")).slug == "no-such-job"
    assert daemon.curl("/v1/jobs", *as_("bob")).json["jobs"] == []


def test_admin_sees_all(daemon, job_id):
    assert daemon.curl(f"/v1/jobs/{job_id}", *as_("root")).json["principal"] == "alice"
    assert job_id in [job["id"] for job in daemon.curl("/v1/jobs", *as_("root")).json["jobs"]]
    assert daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply", *as_("root")).status == 200


def test_another_principals_deleted_job_was_never_there(daemon):
    job_id = daemon.post("/v1/jobs", SMALL, *as_("alice")).json["id"]
    wait_until(lambda: daemon.curl(f"/v1/jobs/{job_id}", *as_("alice")).json["finished"], "the job's end")
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE", *as_("alice")).status == 200
    assert daemon.curl(f"/v1/jobs/{job_id}", *as_("alice")).status == 410
    assert daemon.curl(f"/v1/jobs/{job_id}", *as_("root")).status == 410
    assert daemon.curl(f"/v1/jobs/{job_id}", *as_("bob")).status == 404


# ---------------------------------------------------------------------------------------------- links

def make_link(daemon, job_id, query="", name="cloud.ply"):
    return daemon.curl(f"/v1/jobs/{job_id}/outputs/{name}/link{query}", "-X", "POST", *as_("alice"))


def test_a_link_opens_its_output_alone(daemon, job_id):
    reply = make_link(daemon, job_id)
    assert reply.status == 200 and reply.headers["cache-control"] == "no-store"
    href = reply.json["href"]
    whole = daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply", *as_("alice")).body
    assert daemon.curl(href).body == whole
    assert daemon.curl(href, "-I", "-o", "/dev/null").status == 200
    assert daemon.curl(href, "-H", "Range: bytes=0-2").body == b"ply"
    assert daemon.curl(href + "&points=5").status == 200
    assert daemon.curl(href, *as_("bob")).status == 200  # the link is enough, whoever follows it
    for other in (href.replace("cloud.ply", "report.json"), href.replace("/outputs/cloud.ply", "/log")):
        assert daemon.curl(other).status in (401, 403)


@pytest.mark.parametrize("change", [
    lambda h: h[:-1] + ("0" if h[-1] != "0" else "1"), lambda h: h.split("&sig=")[0], lambda h: h.replace("exp=1", "exp=2"),
    lambda h: h.replace("exp=", "exp=x"), lambda h: h.replace("exp=", "exp=-"), lambda h: h + "00", lambda h: h.upper(),
    lambda h: re.sub("exp=[0-9]+&", "", h)], ids=range(8))
def test_a_changed_link_opens_nothing(daemon, job_id, change):
    reply = daemon.curl(change(make_link(daemon, job_id).json["href"]).replace("/V1/JOBS", "/v1/jobs"))
    assert reply.status in (403, 404)
    assert reply.slug in ("forbidden", "no-such-resource")


def test_a_link_ends(daemon, job_id):
    href = make_link(daemon, job_id, "?seconds=1").json["href"]

    def ended():
        reply = daemon.curl(href)
        assert reply.status in (200, 403)
        return reply.json["detail"] if reply.status == 403 else None
    assert "expired" in wait_until(ended, "the link's end")


@pytest.mark.parametrize("query, name, status", [("?seconds=0", "cloud.ply", 400), ("?seconds=x", "cloud.ply", 400),
                                                 ("?seconds=99999999", "cloud.ply", 400), ("?secnds=5", "cloud.ply", 400),
                                                 ("", "mesh.ply", 404)])
def test_links_that_cannot_be(daemon, job_id, query, name, status):
    assert make_link(daemon, job_id, query, name).status == status


def test_links_survive_a_restart_and_their_key_is_private(make_daemon):
    daemon = make_daemon()
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    href = daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply/link", "-X", "POST").json["href"]
    key = daemon.data / "signing.key"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600 and key.stat().st_size == 32
    daemon.stop()
    daemon.start()
    assert daemon.curl(href).status == 200
    daemon.stop()
    key.chmod(0o644)
    failed = subprocess.run([daemon.process.args[0], "--data", daemon.data, "--listen", "127.0.0.1:0"],
                            capture_output=True, text=True, check=False)
    assert failed.returncode == 1 and "0600" in failed.stderr
    key.unlink()
    daemon.start()
    assert daemon.curl(href).status == 403


# ---------------------------------------------------------------------------------------------- reload, start

def hang_up(daemon, word):
    before = daemon.log_text().count(word)
    daemon.process.send_signal(signal.SIGHUP)
    wait_until(lambda: daemon.log_text().count(word) > before, word)


def test_sighup_reads_tokens_and_settings_again(make_daemon, tmp_path):
    tokens, settings = tmp_path / "tokens", tmp_path / "settings"
    tokens.write_text(line("old", "read", "one"))
    settings.write_text("max-queue = 5\nworkers = 1\n")
    daemon = make_daemon("--tokens-file", tokens, "--config", settings)

    def status(token):
        return daemon.curl("/v1/jobs", "-H", f"Authorization: Bearer {token}").status
    assert (status("one"), status("two")) == (200, 401)
    tokens.write_text(line("new", "read", "two"))
    settings.write_text("max-queue = 6\nworkers = 2\n")
    hang_up(daemon, "reload: 1 tokens")
    assert (status("one"), status("two")) == (401, 200)
    assert daemon.curl("/v1/info").json["limits"]["max_queue"] == 6
    assert daemon.curl("/v1/info").json["limits"]["workers"] == 1
    assert "workers has changed, which takes a restart" in daemon.log_text()
    tokens.write_text("nonsense\n")
    settings.write_text("max-queue = none\n")
    hang_up(daemon, "the tokens stay as they were")
    assert "line 1" in daemon.log_text() and "the settings stay as they were" in daemon.log_text()
    assert (status("one"), status("two")) == (401, 200)
    assert daemon.curl("/v1/info").json["limits"]["max_queue"] == 6
    tokens.unlink()
    hang_up(daemon, "the tokens stay as they were")
    assert status("two") == 200
    assert daemon.stop() == 0


@pytest.mark.parametrize("text, word", [
    ("", "names no token"), ("# nobody\n", "names no token"), ("a:read\n", "line 1: a line is"),
    (line("a", "read", "x") + "a b:read:" + "0" * 64, "line 2: a name"), ("a:write:" + "0" * 64, "scopes"),
    ("a::" + "0" * 64, "scopes"), ("a:read:" + "0" * 63, "hash"), ("a:read:" + "g" * 64, "hash"), ("x" * 600, "too long"),
    (":read:" + "0" * 64, "a name")], ids=range(10))
def test_bad_files_of_tokens_end_the_start(daemon, tmp_path, text, word):
    file = tmp_path / "tokens"
    file.write_text(text)
    done = subprocess.run([daemon.process.args[0], "--data", tmp_path / "data", "--listen", "127.0.0.1:0",
                           "--tokens-file", file], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and word in done.stderr


def test_with_tokens_any_address_will_do(tmp_path, daemon):
    tokens = tmp_path / "tokens"
    tokens.write_text(line("a", "read", "x"))
    process = subprocess.Popen([daemon.process.args[0], "--data", tmp_path / "data", "--listen", "0.0.0.0:0",
                                "--tokens-file", tokens], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout.readline().startswith("listening on http://0.0.0.0:")
    finally:
        process.kill()
        process.wait()


# ---------------------------------------------------------------------------------------------- the log

@pytest.mark.parametrize("header, expected", [
    ("X-Request-Id: abc-1.2_3", "abc-1.2_3"), ("X-Request-Id: " + "x" * 65, None), ("X-Request-Id: a b", None),
    ("traceparent: 00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01", "4bf92f3577b34da6a3ce929d0e0e4736"),
    ("traceparent: 00-00000000000000000000000000000000-00f067aa0ba902b7-01", None), ("traceparent: junk", None)])
def test_each_request_is_one_line_with_its_id(daemon, header, expected):
    reply = daemon.curl("/v1/jobs", "-H", header, *as_("bob"))
    request = reply.headers["x-request-id"]
    assert request == expected if expected else re.fullmatch("[0-9a-f]{16}", request)
    wait_until(lambda: f"id={request} " in daemon.log_text(), "the line")
    assert re.search(rf"http id={request} peer=127.0.0.1 who=bob method=GET path=/v1/jobs status=200 ms=\d+ in=0 "
                     rf"out={len(reply.body)} end=whole\n", daemon.log_text())


def test_a_path_cannot_forge_the_log(daemon):
    daemon.curl("/x%20status=200%0a%22", "--path-as-is")
    wait_until(lambda: "path=/x%20status=200%0A" in daemon.log_text(), "the line")
