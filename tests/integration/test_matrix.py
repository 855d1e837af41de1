# SPDX-License-Identifier: GPL-3.0-or-later
"""Every operation with every status that its description names, and every reply as described.

A case is a function named after the operation and the status; what several operations have in common comes from
`common`.  A description without a case, or a case without a description, is a failure.
"""
import hashlib
import json
import signal
import socket
import subprocess

import pytest

pytest.importorskip("jsonschema", reason="python3-jsonschema is not installed")

from conftest import SMALL, parse_reply, sphere, wait_until  # noqa: E402  pylint: disable=wrong-import-position
from described import OPERATIONS, check  # noqa: E402  pylint: disable=wrong-import-position

NOBODY = "01900000-0000-7000-8000-000000000000"
FLAT = "".join(f"{i % 5} {i // 5} 0\n" for i in range(25)).encode()
# What only a fault of the machine or of the service itself brings about.
NOT_PROVOKED = {
    ("simplify", "500"), ("deleteJob", "500"), ("createJob", "500"), ("createCloud", "500"),
    ("getReadiness", "503"), ("getReadiness", "507"), ("createUpload", "500"), ("continueUpload", "500"),
    ("continueUpload", "507"),  # what was free has to go while the upload runs
    ("getUpload", "412"),  # HEAD's; below
    ("getUpload", "415"), ("getUpload", "422"),  # of an upload whose last bytes came just before a crash
    ("createUpload", "409"),  # two requests have to meet in one upload that has just been made
}
CASES = {}


def case(function):
    """createJob_201 is the case of operation createJob and status 201."""
    operation, status = function.__name__.rsplit("_", 1)
    CASES[operation, status] = function
    return function


class World:
    """A daemon, and things in it that cases need."""

    def __init__(self, make_daemon, folder):
        self.make_daemon, self.folder = make_daemon, folder

    def daemon(self, *flags):
        return self.make_daemon(*flags)

    def guarded(self, *flags):
        tokens = self.folder / "tokens"
        tokens.write_text("".join(f"{name}:{name}:{hashlib.sha256(name.encode()).hexdigest()}\n"
                                  for name in ("submit", "read")))
        return self.daemon("--tokens-file", tokens, *flags)


@pytest.fixture(name="world")
def make_world(make_daemon, tmp_path):
    return World(make_daemon, tmp_path)


def job_of(daemon, query="?ratio=0.5", cloud=SMALL):
    job_id = daemon.submit(cloud, query)
    daemon.ended(job_id)
    return job_id


def cloud_of(daemon, cloud=SMALL):
    return daemon.post("/v1/clouds", cloud).json["id"]


def waiting_job(world):
    """A job that waits behind one that takes long."""
    daemon = world.daemon("--workers", "1")
    daemon.submit(sphere(400000))
    return daemon, daemon.submit(SMALL)


def send(daemon, operation, path, *arguments, data=None):
    arguments = ("-X", operation.method, *arguments)
    if data is not None:
        arguments += ("--data-binary", "@-", "-H", "Expect:")
    return daemon.curl(path, *arguments, data=data)


def parts_of(operation, daemon, **parts):
    """Values for the path's parameters: what is there, unless the case says otherwise."""
    if "{id}" in operation.path and "id" not in parts:
        parts["id"] = (cloud_of(daemon) if "/clouds/" in operation.path else
                       upload_of(daemon, 10).rsplit("/", 1)[1] if "/uploads/" in operation.path else job_of(daemon))
    return {"name": "cloud.ply", "slug": "no-such-job", **parts}


# ---------------------------------------------------------------------------------------------- common

def unknown_parameter(world, operation):
    daemon = world.daemon()
    return send(daemon, operation, operation.url(**parts_of(operation, daemon)) + "?no_such_parameter=1",
                data=SMALL if "requestBody" in operation.described else None)


def without_token(world, operation):
    return send(world.guarded(), operation, operation.url(id=NOBODY, name="cloud.ply"))


def without_scope(world, operation):
    token = "read" if operation.described["x-scope"] == "submit" else "submit"
    return send(world.guarded(), operation, operation.url(id=NOBODY, name="cloud.ply"), "-H",
                f"Authorization: Bearer {token}")


def nothing_there(world, operation):
    absent = hashlib.sha256(b"").hexdigest() if "/clouds/" in operation.path else NOBODY
    return send(world.daemon(), operation, operation.url(id=absent, name="cloud.ply", slug="no-such-slug"))


def deleted_job(world, operation):
    daemon = world.daemon()
    job_id = job_of(daemon)
    daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE")
    return send(daemon, operation, operation.url(id=job_id, name="cloud.ply"))


def not_ended(world, operation):
    daemon, job_id = waiting_job(world)
    return send(daemon, operation, operation.url(id=job_id, name="cloud.ply"))


def plain(world, operation):
    daemon = world.daemon()
    return send(daemon, operation, operation.url(**parts_of(operation, daemon)))


def part(world, operation):
    daemon = world.daemon()
    return send(daemon, operation, operation.url(**parts_of(operation, daemon)), "-H", "Range: bytes=1-3")


def part_outside(world, operation):
    daemon = world.daemon()
    return send(daemon, operation, operation.url(**parts_of(operation, daemon)), "-H", "Range: bytes=99999999-")


def unchanged(world, operation):
    daemon = world.daemon()
    path = operation.url(**parts_of(operation, daemon))
    return send(daemon, operation, path, "-H", f"If-None-Match: {daemon.curl(path).headers['etag']}")


COMMON = {"400": unknown_parameter, "401": without_token, "403": without_scope, "404": nothing_there,
          "410": deleted_job, "409": not_ended, "200": plain, "206": part, "416": part_outside, "304": unchanged}


def case_of(operation, status):
    if (operation.id, status) in CASES:
        return CASES[operation.id, status]
    takes_body = "requestBody" in operation.described
    if takes_body and status not in ("400", "401", "403"):
        return None
    return COMMON.get(status)


# ---------------------------------------------------------------------------------------------- clouds come in

def intake_201(world, operation):
    return send(world.daemon(), operation, operation.path, data=SMALL)


def refused(reply):
    return reply if reply.status >= 400 else None


def intake_409(world, operation):
    """Another request with the same key has been admitted, and its body isn't there yet."""
    daemon = world.daemon()
    with socket.create_connection(("127.0.0.1", daemon.port)) as first:
        first.sendall(f"POST {operation.path} HTTP/1.1\r\nHost: here\r\nContent-Length: {len(SMALL)}\r\n"
                      "Idempotency-Key: k\r\nExpect: 100-continue\r\n\r\n".encode())
        assert b"100 Continue" in first.recv(100)
        return send(daemon, operation, operation.path, "-H", "Idempotency-Key: k", data=SMALL)


def intake_413(world, operation):
    return send(world.daemon("--max-body-bytes", "100"), operation, operation.path, data=SMALL)


def intake_415(world, operation):
    return send(world.daemon(), operation, operation.path, data=b"\x89PNG\r\n\x1a\n" + bytes(100))


def intake_422(world, operation):
    return send(world.daemon(), operation, operation.path, data=b"ply\nformat ascii 1.0\nelement vertex x\n")


def intake_507(world, operation):
    return send(world.daemon("--min-free", "1000T"), operation, operation.path, data=SMALL)


def queue_is_full(world, operation):
    daemon = world.daemon("--workers", "1", "--max-queue", "1")
    daemon.wait_for(daemon.submit(sphere(400000)), "running")
    daemon.submit(SMALL)
    return send(daemon, operation, operation.path, data=SMALL)


def draining(world, operation):
    daemon = world.daemon("--workers", "1")
    daemon.wait_for(daemon.submit(sphere(400000)), "running")
    daemon.process.send_signal(signal.SIGTERM)
    return wait_until(lambda: refused(send(daemon, operation, operation.path, data=SMALL)))


def over_quota(world, operation):
    """More bytes than a principal may have here."""
    length = () if operation.path != "/v1/uploads" else (*TUS, "-H", f"Upload-Length: {len(SMALL)}", *PIECE)
    return send(world.guarded("--principal-bytes", "1K"), operation, operation.path, "-H", "Authorization: Bearer submit",
                *length, data=SMALL)


def by_name_404(world, operation):
    body = json.dumps({"input": "/v1/clouds/" + hashlib.sha256(b"").hexdigest(), "params": {}}).encode()
    return send(world.daemon(), operation, operation.path, "-H", "Content-Type: application/json", data=body)


for _operation in ("createJob", "createCloud", "simplify"):
    for _status, _function in (("409", intake_409), ("413", intake_413), ("415", intake_415), ("422", intake_422),
                               ("507", intake_507), ("503", queue_is_full)):
        CASES[_operation, _status] = _function
for _operation in ("createJob", "createCloud", "simplify", "createUpload"):
    CASES[_operation, "429"] = over_quota
for _operation in ("createJob", "simplify"):
    CASES[_operation, "404"] = by_name_404
for _operation in ("createJob", "createCloud"):
    CASES[_operation, "201"] = intake_201
CASES["createCloud", "503"] = draining


@case
def createCloud_200(world, operation):
    daemon = world.daemon()
    cloud_of(daemon)
    return send(daemon, operation, operation.path, data=SMALL)


@case
def simplify_200(world, operation):
    return send(world.daemon(), operation, operation.path, data=SMALL)


@case
def simplify_202(world, operation):
    return send(world.daemon(), operation, operation.path, "-H", "Prefer: respond-async", data=SMALL)


@case
def simplify_504(world, operation):
    return send(world.daemon(), operation, operation.path, "-H", "Prefer: wait=0", data=sphere(400000))


# ---------------------------------------------------------------------------------------------- uploads

TUS = ("-H", "Tus-Resumable: 1.0.0")
PIECE = ("-H", "Content-Type: application/offset+octet-stream")
PNG = b"\x89PNG\r\n\x1a\n" + bytes(100)
MALFORMED = b"ply\nformat ascii 1.0\nelement vertex x\n"
CHECKSUM = ("-H", "Upload-Checksum: sha1 " + "A" * 27 + "=")


def upload_of(daemon, length=None):
    size = "Upload-Defer-Length: 1" if length is None else f"Upload-Length: {length}"
    return daemon.curl("/v1/uploads", "-X", "POST", *TUS, "-H", size).headers["location"]


def create_upload(*arguments, length=10, data=None, flags=(), path="/v1/uploads"):
    def function(world, operation):
        sent = (*PIECE, "-H", "Expect:", "--data-binary", "@-") if data else ()
        return world.daemon(*flags).curl(path, "-X", operation.method, "-H", f"Upload-Length: {len(data or b'') or length}",
                                         *arguments, *sent, data=data)
    return function


def on_upload(*arguments, offset=0, data=None, flags=(), query=""):
    """Something done with an upload that is there."""
    def function(world, operation):
        daemon = world.daemon(*flags)
        path = upload_of(daemon)
        sent = (*PIECE, "-H", "Expect:", "--data-binary", "@-") if data is not None else ()
        return daemon.curl(path + query, "-X", operation.method, "-H", f"Upload-Offset: {offset}", *arguments, *sent,
                           data=data)
    return function


def draining_upload(world, operation):
    daemon = world.daemon("--workers", "1")
    daemon.wait_for(daemon.submit(sphere(400000)), "running")
    path = upload_of(daemon)
    daemon.process.send_signal(signal.SIGTERM)
    return wait_until(lambda: refused(daemon.post(path, b"1 2 3\n", *TUS, *PIECE, "-H", "Upload-Offset: 0", "-X",
                                                  operation.method)))


def too_many_uploads(world, _operation):
    daemon = world.daemon("--max-uploads", "1")
    upload_of(daemon)
    return daemon.curl("/v1/uploads", "-X", "POST", *TUS, "-H", "Upload-Length: 10")


CASES |= {
    ("getUploadOptions", "204"): plain,
    ("createUpload", "201"): create_upload(*TUS),
    ("createUpload", "400"): create_upload(*TUS, path="/v1/uploads?no_such_parameter=1"),
    ("createUpload", "412"): create_upload(),
    ("createUpload", "413"): create_upload(*TUS, length=3 << 40),
    ("createUpload", "415"): create_upload(*TUS, data=PNG),
    ("createUpload", "422"): create_upload(*TUS, data=MALFORMED),
    ("createUpload", "460"): create_upload(*TUS, *CHECKSUM, data=SMALL),
    ("createUpload", "503"): too_many_uploads,
    ("createUpload", "507"): create_upload(*TUS, flags=("--min-free", "1000T")),
    ("getUpload", "200"): on_upload(*TUS),
    ("getUpload", "400"): on_upload(*TUS, query="?no_such_parameter=1"),
    ("continueUpload", "204"): on_upload(*TUS, data=b"1 2 3\n"),
    ("continueUpload", "400"): on_upload(*TUS, data=b"1 2 3\n", query="?no_such_parameter=1"),
    ("continueUpload", "404"): lambda world, operation: world.daemon().post(
        f"/v1/uploads/{NOBODY}", b"1", *TUS, *PIECE, "-H", "Upload-Offset: 0", "-X", "PATCH"),
    ("continueUpload", "409"): on_upload(*TUS, data=b"1 2 3\n", offset=5),
    ("continueUpload", "412"): on_upload(data=b"1 2 3\n"),
    ("continueUpload", "413"): on_upload(*TUS, data=SMALL, flags=("--max-body-bytes", "100")),
    ("continueUpload", "415"): on_upload(*TUS, "-H", "Content-Type: text/plain", "--data-binary", "x"),
    ("continueUpload", "422"): on_upload(*TUS, "-H", f"Upload-Length: {len(MALFORMED)}", data=MALFORMED),
    ("continueUpload", "429"): on_upload(*TUS, "-H", "Upload-Length: 1025", data=b"1 2 3\n",
                                         flags=("--principal-bytes", "1K")),
    ("continueUpload", "460"): on_upload(*TUS, *CHECKSUM, data=b"1 2 3\n"),
    ("continueUpload", "503"): draining_upload,
    ("deleteUpload", "204"): on_upload(*TUS),
    ("deleteUpload", "400"): on_upload(*TUS, query="?no_such_parameter=1"),
    ("deleteUpload", "404"): lambda world, operation: send(world.daemon(), operation, f"/v1/uploads/{NOBODY}", *TUS),
    ("deleteUpload", "412"): on_upload(),
}


# ---------------------------------------------------------------------------------------------- the others

@case
def deleteCloud_409(world, operation):
    daemon, _ = waiting_job(world)
    return send(daemon, operation, operation.url(id=cloud_of(daemon)))


@case
def deleteCloud_200(world, operation):
    daemon = world.daemon()
    return send(daemon, operation, operation.url(id=cloud_of(daemon)))


@case
def getEvents_204(world, operation):
    daemon = world.daemon()
    job_id = job_of(daemon)
    sequence = daemon.curl(f"/v1/jobs/{job_id}").headers["etag"].strip('"')
    return send(daemon, operation, operation.url(id=job_id), "-H", f"Last-Event-ID: {sequence}")


# ---------------------------------------------------------------------------------------------- the tests

MATRIX = [(operation.id, status) for operation in OPERATIONS.values() for status in operation.statuses]


@pytest.mark.parametrize("operation_id, status", MATRIX)
def test_the_matrix(world, operation_id, status):
    operation = OPERATIONS[operation_id]
    if (operation_id, status) in NOT_PROVOKED:
        pytest.skip("comes of a fault that this test can't bring about")
    function = case_of(operation, status)
    assert function, f"no case brings about {operation_id} -> {status}"
    reply = check(operation, function(world, operation))
    assert str(reply.status) == status, (reply.status, reply.body[:400])


def test_every_case_is_of_something_described():
    assert set(CASES) | NOT_PROVOKED <= set(MATRIX), (set(CASES) | NOT_PROVOKED) - set(MATRIX)


@pytest.mark.parametrize("method, path, status", [("GET", "/no/such/path", 404), ("PATCH", "/v1/jobs", 405),
                                                  ("DELETE", "/v1/info", 405), ("GET", "/v1/jobs/", 404)])
def test_what_no_operation_is_of_is_a_problem_too(daemon, method, path, status):
    reply = daemon.curl(path, "-X", method)
    assert reply.status == status
    assert reply.slug == ("no-such-resource" if status == 404 else "method-not-allowed")
    assert status == 404 or reply.headers["allow"]


@pytest.mark.parametrize("output", ["cloud", "xyz", "mesh", "report", "dso", "error"])
def test_every_output_of_a_one_shot_is_described(daemon, output):
    check(OPERATIONS["simplify"], daemon.post(f"/v1/simplify?ratio=0.5&output={output}", SMALL))


@pytest.mark.parametrize("operation_id", [o.id for o in OPERATIONS.values() if o.method == "GET"])
def test_head_is_described_as_get_is(daemon, operation_id):
    operation = OPERATIONS[operation_id]
    path = operation.url(**parts_of(operation, daemon))
    done = subprocess.run(["curl", "-sS", "-I", daemon.url + path], capture_output=True, check=True)
    reply = parse_reply(done.stdout)
    if operation.path.startswith("/v1/uploads"):
        assert reply.status == 412  # the protocol's HEAD names its version
    check(operation, reply, head=True)
