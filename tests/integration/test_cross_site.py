# SPDX-License-Identifier: GPL-3.0-or-later
"""Web pages of other people: they can't use a service on the reader's machine unless its operator lets them."""
import hashlib
import socket
import subprocess

import pytest

from conftest import BUILD, SMALL

PAGE = "https://page.example"
PREFLIGHT = ("-X", "OPTIONS", "-H", "Access-Control-Request-Method: POST", "-H",
             "Access-Control-Request-Headers: authorization,content-type")
JOBS = {"/v1/jobs": 201, "/v1/simplify": 200, "/v1/clouds": 201}


def headers(**named):
    return [part for name, value in named.items() for part in ("-H", f"{name.replace('_', '-')}: {value}")]


# ---------------------------------------------------------------------------------------------- origins

FOREIGN = [{"Origin": PAGE}, {"Origin": "null"}, {"Origin": PAGE, "Sec_Fetch_Site": "cross-site"},
           {"Origin": "http://localhost:3000", "Sec_Fetch_Site": "same-site"}, {"Sec_Fetch_Site": "cross-site"},
           {"Origin": "http://localhost"}, {"Origin": "http://localhost:1"}]


@pytest.mark.parametrize("sent", FOREIGN, ids=range(len(FOREIGN)))
@pytest.mark.parametrize("path", JOBS)
def test_a_foreign_page_changes_nothing(daemon, path, sent):
    reply = daemon.post(path, SMALL, "-H", "Content-Type: text/plain", *headers(**sent))
    assert (reply.status, reply.slug) == (403, "cross-site")
    assert not [name for name in reply.headers if name.startswith("access-control")]
    assert daemon.curl("/v1/jobs").json["jobs"] == [] and daemon.curl("/v1/clouds").json["clouds"] == []


def test_a_foreign_page_deletes_nothing(daemon):
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE", *headers(Origin=PAGE)).slug == "cross-site"
    assert daemon.curl("/v1/uploads", "-X", "POST", *headers(Origin=PAGE, Tus_Resumable="1.0.0", Upload_Length="9")
                       ).slug == "cross-site"
    assert daemon.job(job_id)["status"] == "successful"


def test_two_origins_are_malformed(daemon):
    reply = daemon.post("/v1/jobs", SMALL, "-H", f"Origin: {daemon.url}", "-H", f"Origin: {PAGE}")
    assert (reply.status, reply.slug) == (400, "malformed-request")


@pytest.mark.parametrize("path, status", JOBS.items())
def test_programs_and_own_pages_go_on(daemon, path, status):
    https = daemon.url.replace("http:", "https:")  # a proxy in front ended TLS
    own = [{}, {"Origin": daemon.url}, {"Origin": https}, {"Origin": daemon.url, "Sec_Fetch_Site": "same-origin"},
           {"Sec_Fetch_Site": "none"}, {"Origin": "https://by.proxy.example", "Sec_Fetch_Site": "same-origin"}]
    seen = [daemon.post(path, SMALL, *headers(**sent)).status for sent in own]
    assert seen == [status] + [status if status != 201 or path == "/v1/jobs" else 200] * (len(own) - 1)


def test_reading_is_left_to_the_browser(daemon):
    reply = daemon.curl("/v1/jobs", *headers(Origin=PAGE, Sec_Fetch_Site="cross-site"))
    assert reply.status == 200 and "access-control-allow-origin" not in reply.headers  # a script can't read it


# ---------------------------------------------------------------------------------------------- hosts

@pytest.mark.parametrize("path", ["/", "/v1/info", "/v1/jobs", "/docs", "/no/such/path", "/metrics"])
@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "localhost.evil.example", "127.0.0.1.evil.example",
                                  "evil", "xlocalhost", "127.1", ""])
def test_hosts_that_are_not_ours(daemon, host, path):
    reply = daemon.curl(path, "-H", f"Host: {host}" if host else "Host;")
    assert (reply.status, reply.slug) == (421, "unknown-host")


@pytest.mark.parametrize("host", ["[::1", "[::1.evil", "[::1]evil", "[[::1]]", "a:b", "localhost:1:2", "localhost:65536",
                                  "localhost:000000", "localhost]", "a b"])
def test_what_is_no_host_is_malformed(daemon, host):
    reply = daemon.curl("/v1/info", "-H", f"Host: {host}")
    assert (reply.status, reply.slug) == (400, "malformed-request")


@pytest.mark.parametrize("target, status", [("http://evil.example", 400), ("http://localhost:{port}", 200),
                                            ("HTTP://LOCALHOST:{port}", 200), ("http://localhost:{port}.evil.example", 400),
                                            ("http://", 400), ("https://evil.example", 400)])
def test_the_host_of_an_absolute_target_counts(daemon, target, status):
    """By RFC 9112 it is the one that counts; what a reader before this one goes by isn't known, so both are to agree."""
    target = target.format(port=daemon.port)
    reply = daemon.curl("/v1/info", "--request-target", f"{target}/v1/info", "-H", f"Host: localhost:{daemon.port}")
    assert reply.status == status, reply.body
    assert status == 200 or reply.slug == "malformed-request"


def test_a_foreign_host_makes_no_job(daemon):
    evil = f"http://evil.example:{daemon.port}"  # to the browser the page is of this very origin
    reply = daemon.post("/v1/jobs", SMALL, *headers(Host=evil[7:], Origin=evil, Sec_Fetch_Site="same-origin"))
    assert (reply.status, reply.slug) == (421, "unknown-host")
    assert daemon.curl("/v1/jobs").json["jobs"] == []


@pytest.mark.parametrize("host", ["localhost", "LocalHost:1", "localhost.", "a.localhost:8080", "127.0.0.1", "127.3.2.1:80",
                                  "[::1]", "[::1]:8080", "192.0.2.7:8080", "[2001:db8::7]"])
def test_hosts_that_are(daemon, host):
    assert daemon.curl("/v1/info", "-H", f"Host: {host}").status == 200


def test_the_machine_s_own_name(daemon):
    assert daemon.curl("/v1/info", "-H", f"Host: {socket.gethostname()}:{daemon.port}").status == 200


def test_health_is_told_to_every_host(daemon):
    for path in ("/healthz", "/readyz"):
        assert daemon.curl(path, "-H", "Host: balancer.example").status == 200


def test_hosts_of_the_operator(make_daemon):
    daemon = make_daemon("--allowed-hosts", "whittle.example.org, *.inside.example,[2001:db8::1]")
    for host, status in {"whittle.example.org": 200, "WHITTLE.example.org:443": 200, "a.inside.example": 200,
                         "b.a.inside.example.": 200, "inside.example": 421, "xinside.example": 421,
                         "x.whittle.example.org": 421, "evil.example": 421, "localhost": 200}.items():
        assert daemon.curl("/v1/info", "-H", f"Host: {host}").status == status, host
    own = headers(Host="whittle.example.org", Origin="https://whittle.example.org")
    assert daemon.post("/v1/jobs", SMALL, *own).status == 201


def test_all_hosts(make_daemon):
    assert make_daemon("--allowed-hosts", "*").curl("/v1/info", "-H", "Host: any.example").status == 200


def test_open_to_a_network_short_names_are_taken(make_daemon):
    daemon = make_daemon("--insecure-open")
    assert daemon.curl("/v1/info", "-H", "Host: whittled:8080").status == 200
    assert daemon.curl("/v1/info", "-H", "Host: evil.example").slug == "unknown-host"


def test_with_tokens_a_page_has_none_and_hosts_are_free(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"a:submit,read:{hashlib.sha256(b'a').hexdigest()}\n")
    free = make_daemon("--tokens-file", tokens)
    assert free.curl("/v1/info", "-H", "Host: whittle.example.org").status == 200
    assert free.post("/v1/jobs", SMALL, *headers(Host="whittle.example.org", Authorization="Bearer a")).status == 201
    listed = make_daemon("--tokens-file", tokens, "--allowed-hosts", "whittle.example.org")
    assert listed.curl("/v1/info", "-H", "Host: whittle.example.org").status == 200
    assert listed.curl("/v1/info", "-H", "Host: evil.example").slug == "unknown-host"


# ---------------------------------------------------------------------------------------------- CORS

def names(header):
    return {name.strip().lower() for name in header.split(",")}


def test_pages_of_the_operator(make_daemon):
    daemon = make_daemon("--cors-origins", f"https://other.example,{PAGE}")
    asked = daemon.curl("/v1/jobs", *PREFLIGHT, *headers(Origin=PAGE, Sec_Fetch_Site="cross-site"))
    assert (asked.status, asked.body) == (204, b"")
    assert asked.headers["access-control-allow-origin"] == PAGE and asked.headers["vary"] == "Origin"
    assert names(asked.headers["access-control-allow-methods"]) == {"get", "head", "post"}
    assert {"authorization", "content-type", "idempotency-key", "prefer", "tus-resumable", "upload-offset", "range",
            "upload-metadata", "upload-length"} <= names(asked.headers["access-control-allow-headers"])
    assert int(asked.headers["access-control-max-age"]) > 0
    made = daemon.post("/v1/jobs", SMALL, *headers(Origin=PAGE, Sec_Fetch_Site="cross-site"))
    assert made.status == 201 and made.headers["access-control-allow-origin"] == PAGE
    assert {"location", "etag", "upload-offset", "tus-resumable", "retry-after", "job-stats", "link",
            "content-range"} <= names(made.headers["access-control-expose-headers"])
    assert "access-control-allow-credentials" not in made.headers
    refused = daemon.post("/v1/jobs?ratio=9", SMALL, *headers(Origin=PAGE))
    assert refused.status == 400 and refused.headers["access-control-allow-origin"] == PAGE  # a script may read why


def test_pages_that_the_operator_does_not_name(make_daemon):
    daemon = make_daemon("--cors-origins", PAGE)
    for origin in ("https://page.example.org", "http://page.example", "https://page.example:8443", "null"):
        asked = daemon.curl("/v1/jobs", *PREFLIGHT, *headers(Origin=origin))
        assert asked.status == 405 and "access-control-allow-origin" not in asked.headers
        assert daemon.post("/v1/jobs", SMALL, *headers(Origin=origin)).slug == "cross-site"
    assert daemon.curl("/v1/info").headers["vary"] == "Origin"  # a cache must not give one page's reply to another


def test_a_preflight_needs_no_token_and_a_path(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"a:submit,read:{hashlib.sha256(b'a').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens, "--cors-origins", PAGE)
    assert daemon.curl("/v1/jobs", *PREFLIGHT, *headers(Origin=PAGE)).status == 204
    assert daemon.curl("/v1/no-such", *PREFLIGHT, *headers(Origin=PAGE)).status == 404
    unknown = daemon.post("/v1/jobs", SMALL, *headers(Origin=PAGE))
    assert unknown.status == 401 and unknown.headers["access-control-allow-origin"] == PAGE


def test_a_resumable_upload_of_a_page(make_daemon):
    daemon = make_daemon("--cors-origins", PAGE)
    tus = headers(Origin=PAGE, Tus_Resumable="1.0.0")
    asked = daemon.curl("/v1/uploads", *PREFLIGHT, *headers(Origin=PAGE))
    assert asked.status == 204 and names(asked.headers["access-control-allow-methods"]) == {"options", "post"}
    made = daemon.curl("/v1/uploads", "-X", "POST", *tus, *headers(Upload_Length=len(SMALL)))
    assert made.status == 201 and made.headers["access-control-allow-origin"] == PAGE
    path = made.headers["location"]
    assert "patch" in names(daemon.curl(path, *PREFLIGHT, *headers(Origin=PAGE)).headers["access-control-allow-methods"])
    piece = daemon.post(path, SMALL, "-X", "PATCH", *tus, *headers(Upload_Offset=0),
                        "-H", "Content-Type: application/offset+octet-stream")
    assert piece.status == 204 and {"upload-offset", "whittle-cloud"} <= names(piece.headers["access-control-expose-headers"])


def test_all_pages(make_daemon):
    daemon = make_daemon("--cors-origins", "*")
    made = daemon.post("/v1/jobs", SMALL, *headers(Origin=PAGE, Sec_Fetch_Site="cross-site"))
    assert made.status == 201 and made.headers["access-control-allow-origin"] == "*" and "vary" not in made.headers
    assert daemon.curl("/v1/jobs", *PREFLIGHT, *headers(Origin="null")).status == 204


def test_every_header_that_is_sent_may_be_read(make_daemon):
    """Of the headers in replies to a job's whole life, those that scripts can't read anyway are exposed."""
    daemon = make_daemon("--cors-origins", PAGE)
    safe = {"cache-control", "content-language", "content-length", "content-type", "expires", "last-modified", "pragma",
            "date", "connection", "vary", "x-content-type-options", "accept-ranges"}
    origin = headers(Origin=PAGE)
    made = daemon.post("/v1/jobs", SMALL, *origin)
    path = made.headers["location"]
    daemon.ended(made.json["id"])
    replies = [made, daemon.curl(path, *origin), daemon.curl("/v1/jobs?limit=1", *origin),
               daemon.curl(path + "/outputs/cloud.ply", *origin, "-H", "Range: bytes=0-1"),
               daemon.post("/v1/simplify", SMALL, *origin), daemon.curl("/v1/uploads", "-X", "OPTIONS", *origin)]
    for reply in replies:
        sent = {name for name in reply.headers if not name.startswith("access-control")}
        assert sent - safe <= names(reply.headers["access-control-expose-headers"]), sent


# ---------------------------------------------------------------------------------------------- settings

@pytest.mark.parametrize("flag, value", [
    ("--allowed-hosts", "a/b"), ("--allowed-hosts", "https://a.example"), ("--allowed-hosts", "a.*.example"),
    ("--allowed-hosts", "a.example:80"), ("--cors-origins", "page.example"), ("--cors-origins", "https://page.example/"),
    ("--cors-origins", "https://*.example"), ("--cors-origins", "https://a.example https://b.example")])
def test_lists_that_are_none_end_the_start(tmp_path, flag, value):
    done = subprocess.run([BUILD / "whittled", "--check-config", "--data", tmp_path, flag, value], capture_output=True,
                          text=True, check=False)
    assert done.returncode == 2 and flag[2:] in done.stderr
