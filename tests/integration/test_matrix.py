# SPDX-License-Identifier: GPL-3.0-or-later
"""Every operation with every status that its description names, and every reply as described.

A case is a function named after the operation and the status; what several operations have in common comes from
`common`.  A description without a case, or a case without a description, is a failure.
"""
import contextlib
import hashlib
import json
import re
import signal
import socket
import sqlite3
import subprocess

import pytest

pytest.importorskip("jsonschema", reason="python3-jsonschema is not installed")

from conftest import SMALL, parse_reply, sphere, wait_until  # noqa: E402  pylint: disable=wrong-import-position
from described import OPERATIONS, check  # noqa: E402  pylint: disable=wrong-import-position

NOBODY = "01900000-0000-7000-8000-000000000000"
FLAT = "".join(f"{i % 5} {i // 5} 0\n" for i in range(25)).encode()
CASES = {}
OF_HEAD = {("getUpload", status) for status in ("412", "415", "422")}  # GET wants no version, and ends no upload


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


def batch_of(daemon):
    """A batch that has ended."""
    document = json.dumps({"clouds": [f"/v1/clouds/{cloud_of(daemon)}"]}).encode()
    batch = daemon.post("/v1/batches", document, *JSON).json["id"]
    wait_until(lambda: daemon.curl(f"/v1/batches/{batch}").json["finished"], "the end of the batch")
    return batch


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
                       batch_of(daemon) if "/batches/" in operation.path else
                       upload_of(daemon, 10).rsplit("/", 1)[1] if "/uploads/" in operation.path else
                       job_of(daemon, "?ratio=0.5&outputs=tileset") if "/tileset" in operation.path else job_of(daemon))
    name = "cloud.ply" if "/tileset" not in operation.path else "0.glb" if "/tiles/" in operation.path else "tileset.json"
    return {"name": name, "slug": "no-such-job", **parts}


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


def not_matching(world, operation):
    daemon = world.daemon()
    path = operation.url(**parts_of(operation, daemon))
    return send(daemon, operation, path, "-H", 'If-Match: "another"')


COMMON = {"412": not_matching, "400": unknown_parameter, "401": without_token, "403": without_scope, "404": nothing_there,
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
        first.sendall(f"POST {operation.path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(SMALL)}\r\n"
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
    return send(daemon, operation, operation.path, data=SMALL if operation.method == "POST" else None)


def draining(world, operation):
    daemon = world.daemon("--workers", "1")
    daemon.wait_for(daemon.submit(sphere(400000)), "running")
    daemon.process.send_signal(signal.SIGTERM)
    return wait_until(lambda: refused(send(daemon, operation, operation.path, data=SMALL)))


def over_quota(world, operation):
    """More bytes than a principal may have here beside those that it has."""
    daemon, token, more = full_share(world), ("-H", "Authorization: Bearer submit"), sphere(50)
    length = () if operation.path != "/v1/uploads" else (*TUS, "-H", f"Upload-Length: {len(more)}", *PIECE)
    return send(daemon, operation, operation.path, *token, *length, data=more)


def full_share(world):
    daemon = world.guarded("--principal-bytes", str(len(SMALL) + 100))
    assert daemon.post("/v1/clouds", SMALL, "-H", "Authorization: Bearer submit").status == 201
    return daemon


def continueUpload_429(world, operation):
    daemon, token = full_share(world), ("-H", "Authorization: Bearer submit")
    path = daemon.curl("/v1/uploads", "-X", "POST", *TUS, "-H", "Upload-Defer-Length: 1", *token).headers["location"]
    return daemon.curl(path, "-X", operation.method, *TUS, *PIECE, *token, "-H", "Upload-Offset: 0", "-H",
                       "Upload-Length: 1025", "-H", "Expect:", "--data-binary", "@-", data=b"1 2 3\n")


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


JSON = ("-H", "Content-Type: application/json")


def of_cloud(daemon, operation, *arguments, document=b"{}"):
    return send(daemon, operation, operation.url(id=cloud_of(daemon)), *JSON, *arguments, data=document)


@case
def createCloudJob_201(world, operation):
    return of_cloud(world.daemon(), operation, document=b'{"params":{"ratio":0.5,"outputs":["cloud","mesh"]}}')


@case
def createCloudJob_404(world, operation):
    return send(world.daemon(), operation, operation.url(id=hashlib.sha256(b"").hexdigest()), *JSON, data=b"{}")


@case
def createCloudJob_409(world, operation):
    daemon = world.daemon()
    path = operation.url(id=cloud_of(daemon))
    with socket.create_connection(("127.0.0.1", daemon.port)) as first:
        first.sendall(f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2\r\nIdempotency-Key: k\r\n"
                      "Content-Type: application/json\r\nExpect: 100-continue\r\n\r\n".encode())
        assert b"100 Continue" in first.recv(100)
        return send(daemon, operation, path, *JSON, "-H", "Idempotency-Key: k", data=b"{}")


@case
def createCloudJob_413(world, operation):
    return of_cloud(world.daemon(), operation, document=b'{"label":"' + 200000 * b"x" + b'"}')


@case
def createCloudJob_415(world, operation):
    daemon = world.daemon()
    return send(daemon, operation, operation.url(id=cloud_of(daemon)), data=SMALL)


@case
def createCloudJob_422(world, operation):
    daemon = world.daemon()
    assert of_cloud(daemon, operation, "-H", "Idempotency-Key: k").status == 201
    return of_cloud(daemon, operation, "-H", "Idempotency-Key: k", document=b'{"params":{"ratio":0.3}}')


@case
def createCloudJob_429(world, operation):
    daemon = world.guarded("--principal-jobs", "1", "--workers", "1")
    token = ("-H", "Authorization: Bearer submit")
    cloud = daemon.curl("/v1/clouds", *token, "--data-binary", "@-", data=sphere(400000)).json["id"]
    path = operation.url(id=cloud)
    assert send(daemon, operation, path, *JSON, *token, data=b"{}").status == 201
    return send(daemon, operation, path, *JSON, *token, data=b'{"params":{"ratio":0.3}}')


def started_again(world, operation, *flags):
    """The cloud is there since before the service was started with these."""
    daemon = world.daemon()
    path = operation.url(id=cloud_of(daemon))
    daemon.stop()
    daemon.start(*flags)
    return send(daemon, operation, path, *JSON, data=b"{}")


@case
def createCloudJob_500(world, operation):
    return started_again(world, operation, "--fault", "commit=eio:2-99")


@case
def createCloudJob_507(world, operation):
    return started_again(world, operation, "--min-free", "1000T")


@case
def createCloudJob_503(world, operation):
    daemon = world.daemon("--workers", "1", "--max-queue", "1")
    cloud = cloud_of(daemon)
    daemon.wait_for(daemon.submit(sphere(400000)), "running")
    daemon.submit(SMALL)
    return send(daemon, operation, operation.url(id=cloud), *JSON, data=b"{}")


# Of a batch: the same, by a document that names the cloud.

def of_clouds(daemon, operation, *arguments, cloud=None, **more):
    document = {"clouds": [f"/v1/clouds/{cloud or cloud_of(daemon)}"], **more}
    return send(daemon, operation, operation.path, *JSON, *arguments, data=json.dumps(document).encode())


@case
def createBatch_201(world, operation):
    return of_clouds(world.daemon(), operation, params={"ratio": 0.5, "outputs": ["cloud", "mesh"]})


@case
def createBatch_404(world, operation):
    return of_clouds(world.daemon(), operation, cloud=hashlib.sha256(b"").hexdigest())


@case
def createBatch_409(world, operation):
    daemon = world.daemon()
    with socket.create_connection(("127.0.0.1", daemon.port)) as first:
        first.sendall(b"POST /v1/batches HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2\r\nIdempotency-Key: k\r\n"
                      b"Content-Type: application/json\r\nExpect: 100-continue\r\n\r\n")
        assert b"100 Continue" in first.recv(100)
        return of_clouds(daemon, operation, "-H", "Idempotency-Key: k")


@case
def createBatch_413(world, operation):
    return of_clouds(world.daemon(), operation, label=200000 * "x")


@case
def createBatch_415(world, operation):
    return send(world.daemon(), operation, operation.path, data=SMALL)


@case
def createBatch_422(world, operation):
    daemon = world.daemon()
    assert of_clouds(daemon, operation, "-H", "Idempotency-Key: k").status == 201
    return of_clouds(daemon, operation, "-H", "Idempotency-Key: k", params={"ratio": 0.3})


@case
def createBatch_429(world, operation):
    daemon = world.guarded("--principal-jobs", "1")
    token = ("-H", "Authorization: Bearer submit")
    cloud = daemon.curl("/v1/clouds", *token, "--data-binary", "@-", data=SMALL).json["id"]
    document = json.dumps({"clouds": 2 * [f"/v1/clouds/{cloud}"]}).encode()
    return send(daemon, operation, operation.path, *JSON, *token, data=document)


def batch_again(world, operation, *flags):
    """The cloud is there since before the service was started with these."""
    daemon = world.daemon()
    cloud = cloud_of(daemon)
    daemon.stop()
    daemon.start(*flags)
    return of_clouds(daemon, operation, cloud=cloud)


@case
def createBatch_500(world, operation):
    return batch_again(world, operation, "--fault", "commit=eio:2-99")


@case
def createBatch_507(world, operation):
    return batch_again(world, operation, "--min-free", "1000T")


@case
def createBatch_503(world, operation):
    daemon = world.daemon("--max-queue", "1")
    document = json.dumps({"clouds": 2 * [f"/v1/clouds/{cloud_of(daemon)}"]}).encode()
    return send(daemon, operation, operation.path, *JSON, data=document)


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
def simplify_406(world, operation):
    return send(world.daemon(), operation, operation.path + "?output=cloud", "-H", "Accept: image/png, model/ply;q=0",
                data=SMALL)


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


def parts_are_gone(world, operation):
    return send(world.daemon(), operation, operation.path, *TUS, "-H", f"Upload-Concat: final;/v1/uploads/{NOBODY}")


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
    ("continueUpload", "200"): on_upload("-H", "Upload-Complete: ?1", data=SMALL),
    ("continueUpload", "204"): on_upload(*TUS, data=b"1 2 3\n"),
    ("continueUpload", "400"): on_upload(*TUS, data=b"1 2 3\n", query="?no_such_parameter=1"),
    ("continueUpload", "404"): lambda world, operation: world.daemon().post(
        f"/v1/uploads/{NOBODY}", b"1", *TUS, *PIECE, "-H", "Upload-Offset: 0", "-X", "PATCH"),
    ("continueUpload", "409"): on_upload(*TUS, data=b"1 2 3\n", offset=5),
    ("continueUpload", "412"): on_upload(data=b"1 2 3\n"),
    ("continueUpload", "413"): on_upload(*TUS, data=SMALL, flags=("--max-body-bytes", "100")),
    ("continueUpload", "415"): on_upload(*TUS, "-H", "Content-Type: text/plain", "--data-binary", "x"),
    ("continueUpload", "422"): on_upload(*TUS, "-H", f"Upload-Length: {len(MALFORMED)}", data=MALFORMED),
    ("continueUpload", "429"): continueUpload_429,
    ("continueUpload", "460"): on_upload(*TUS, *CHECKSUM, data=b"1 2 3\n"),
    ("continueUpload", "503"): draining_upload,
    ("deleteUpload", "204"): on_upload(*TUS),
    ("deleteUpload", "400"): on_upload(*TUS, query="?no_such_parameter=1"),
    ("deleteUpload", "404"): lambda world, operation: send(world.daemon(), operation, f"/v1/uploads/{NOBODY}", *TUS),
    ("deleteUpload", "412"): on_upload(),
}


def head_of_upload(daemon, path, *more):
    done = subprocess.run(["curl", "-sS", "-I", *more, daemon.url + path], capture_output=True, check=True)
    return parse_reply(done.stdout)


def head_without_version(world, _operation):
    daemon = world.daemon()
    return head_of_upload(daemon, upload_of(daemon, 10))


def part_of(daemon):
    """The file of the one upload that there is."""
    return wait_until(lambda: next((daemon.data / "uploads").iterdir(), None), "the upload's file")


def send_head(daemon, method, path, *headers):
    """A request whose body is still to come; chunked, unless its length is among the headers."""
    connection = socket.create_connection(("127.0.0.1", daemon.port), timeout=60)
    coding = () if any(h.startswith("Content-Length") for h in headers) else ("Transfer-Encoding: chunked",)
    head = "\r\n".join((f"{method} {path} HTTP/1.1", "Host: localhost", "Connection: close", *headers, *coding))
    connection.sendall(head.encode() + b"\r\n\r\n")
    return connection


def rest_of(connection):
    with connection:
        return parse_reply(b"".join(iter(lambda: connection.recv(65536), b"")))


def whole_before_a_crash(content):
    """All bytes of the upload are there, and the service ended before it could look at them."""
    def function(world, _operation):
        daemon = world.daemon("--upload-grace", "1s")  # a piece that stops coming is written then
        path = upload_of(daemon, len(content))
        with send_head(daemon, "PATCH", path, TUS[1], PIECE[1], "Upload-Offset: 0") as connection:
            connection.sendall(f"{len(content):x}\r\n".encode() + content + b"\r\n")
            wait_until(lambda: part_of(daemon).stat().st_size == len(content), "the bytes")
            daemon.kill()
        daemon.start()
        return head_of_upload(daemon, path, *TUS)
    return function


def taken_over(world, operation):
    """Somebody asks with HEAD where the upload is while its first bytes come."""
    daemon = world.daemon()
    with send_head(daemon, "POST", operation.path, TUS[1], PIECE[1], "Upload-Length: 10", "Content-Length: 10") as first:
        first.sendall(b"1 2 3")
        taken = f"/v1/uploads/{part_of(daemon).name}"
        subprocess.run(["curl", "-sSI", *TUS, daemon.url + taken], capture_output=True, check=True)
        first.sendall(b" 4 5\n")
        return rest_of(first)


def nowhere_to_create(world, operation):
    daemon = world.daemon()
    (daemon.data / "uploads").rmdir()
    return send(daemon, operation, operation.path, *TUS, "-H", "Upload-Length: 10")


def part_is_lost(world, operation):
    daemon = world.daemon()
    path = upload_of(daemon, 10)
    part_of(daemon).unlink()
    return send(daemon, operation, path, *TUS, *PIECE, "-H", "Upload-Offset: 0", data=b"1 2 3\n")


def room_goes(world, operation):
    """Less is free than is to be kept free, from some time in the upload on."""
    settings = world.folder / "settings"
    settings.write_text("min-free = 0\n")
    daemon = world.daemon("--config", settings)
    path = upload_of(daemon, 10)
    settings.write_text("min-free = 1000T\n")
    daemon.process.send_signal(signal.SIGHUP)
    wait_until(lambda: "min-free" in daemon.log_text(), "the new settings")
    return send(daemon, operation, path, *TUS, *PIECE, "-H", "Upload-Offset: 0", data=b"1 2 3\n")


CASES |= {
    ("createUpload", "404"): parts_are_gone,
    ("createUpload", "409"): taken_over,
    ("createUpload", "500"): nowhere_to_create,
    ("getUpload", "412"): head_without_version,
    ("getUpload", "415"): whole_before_a_crash(PNG),
    ("getUpload", "422"): whole_before_a_crash(MALFORMED),
    ("continueUpload", "500"): part_is_lost,
    ("continueUpload", "507"): room_goes,
}


# ---------------------------------------------------------------------------------------------- the others

def disk_breaks(world, operation):
    """What was written doesn't reach the disk."""
    return send(world.daemon("--fault", "upload-sync=eio"), operation, operation.path, data=SMALL)


for _operation in ("createJob", "createCloud"):
    CASES[_operation, "500"] = disk_breaks


def page_file(daemon):
    """The path of a file of the page, where that is built."""
    named = re.search(r"/page/[\w.-]+", daemon.curl("/").body.decode())
    return named[0] if named else pytest.skip("the page isn't built: make page")


@case
def getPageFile_200(world, operation):
    daemon = world.daemon()
    return send(daemon, operation, page_file(daemon))


@case
def getPageFile_304(world, operation):
    daemon = world.daemon()
    path = page_file(daemon)
    return send(daemon, operation, path, "-H", f"If-None-Match: {daemon.curl(path).headers['etag']}")


@case
def getJobPage_404(world, operation):
    return send(world.daemon(), operation, "/jobs/none")


@case
def simplify_500(world, operation):
    """The job's process ends by itself."""
    worker = world.folder / "worker"
    worker.write_text("#!/bin/sh\nkill -SEGV $$\n")
    worker.chmod(0o755)
    return send(world.daemon("--worker", worker, "--worker-sandbox=off"), operation, operation.path, data=SMALL)


@case
def deleteJob_500(world, operation):
    """Somebody else holds the database, longer than one waits for it."""
    daemon = world.daemon()
    job_id = job_of(daemon)
    with contextlib.closing(sqlite3.connect(daemon.data / "whittled.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        return send(daemon, operation, operation.url(id=job_id))


@case
def deleteBatch_500(world, operation):
    daemon = world.daemon()
    batch = batch_of(daemon)
    with contextlib.closing(sqlite3.connect(daemon.data / "whittled.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        return send(daemon, operation, operation.url(id=batch))


@case
def getBatchEvents_204(world, operation):
    daemon = world.daemon()
    path = operation.url(id=batch_of(daemon))
    number = re.findall(rb"^id: (\d+)", daemon.curl(path).body, re.M)[-1].decode()
    return send(daemon, operation, path, "-H", f"Last-Event-ID: {number}")


@case
def getReadiness_503(world, operation):
    return queue_is_full(world, operation)


@case
def getReadiness_507(world, operation):
    return send(world.daemon("--min-free", "1000T"), operation, operation.path)


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

# What only shared state answers: a database or a store that is away (test_rule_7_... in test_rules.py), and sending
# programs to the store (test_rule_9_... in test_hosts.py).  Those tests take PostgreSQL and S3.
OF_HOSTS = {*((name, "503") for name in ("listJobs", "getJob", "deleteJob", "getEvents", "getLog", "listOutputs",
                                         "getOutput", "getTileset", "getTile", "createLink", "listClouds", "getCloud", "deleteCloud",
                                         "getCloudData", "getUpload", "deleteUpload", "listBatches", "getBatch", "deleteBatch", "getBatchEvents")),
            ("getOutput", "302"), ("getCloudData", "302")}
MATRIX = [(operation.id, status) for operation in OPERATIONS.values() for status in operation.statuses
          if (operation.id, status) not in OF_HOSTS]


@pytest.mark.parametrize("operation_id, status", MATRIX)
def test_the_matrix(world, operation_id, status):
    operation = OPERATIONS[operation_id]
    function = case_of(operation, status)
    assert function, f"no case brings about {operation_id} -> {status}"
    reply = check(operation, function(world, operation), head=(operation_id, status) in OF_HEAD)
    assert str(reply.status) == status, (reply.status, reply.body[:400])


def test_every_case_is_of_something_described():
    assert set(CASES) <= set(MATRIX), set(CASES) - set(MATRIX)
    described = {(operation.id, status) for operation in OPERATIONS.values() for status in operation.statuses}
    assert OF_HOSTS <= described, OF_HOSTS - described


@pytest.mark.parametrize("method, path, status", [("GET", "/no/such/path", 404), ("PATCH", "/v1/jobs", 405),
                                                  ("DELETE", "/v1/info", 405), ("GET", "/v1/jobs/", 404)])
def test_what_no_operation_is_of_is_a_problem_too(daemon, method, path, status):
    reply = daemon.curl(path, "-X", method)
    assert reply.status == status
    assert reply.slug == ("no-such-resource" if status == 404 else "method-not-allowed")
    assert status == 404 or reply.headers["allow"]


@pytest.mark.parametrize("output", ["cloud", "xyz", "cloud.pcd", "mesh", "mesh.obj", "mesh.stl", "mesh.glb", "report",
                                    "dso", "error", "preview.png", "cloud.las", "cloud.laz", "cloud.copc.laz", "tileset"])
def test_every_output_of_a_one_shot_is_described(daemon, output):
    check(OPERATIONS["simplify"], daemon.post(f"/v1/simplify?ratio=0.5&output={output}", SMALL))


def test_a_one_shot_whose_job_is_dismissed_says_so(world):
    daemon = world.daemon("--workers", "1")
    daemon.submit(sphere(400000))
    command = daemon.curl_command("/v1/simplify?label=mine", "-X", "POST", "--data-binary", "@-", "-H", "Expect:")
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as waiting:
        waiting.stdin.write(SMALL)
        waiting.stdin.close()
        job = wait_until(lambda: daemon.curl("/v1/jobs?label=mine").json["jobs"], "the one-shot's job")[0]
        assert daemon.curl(f"/v1/jobs/{job['id']}", "-X", "DELETE").json["status"] == "dismissed"
        reply = check(OPERATIONS["simplify"], parse_reply(waiting.stdout.read()))
    assert (reply.status, reply.slug) == (409, "job-dismissed") and job["id"] in reply.headers["link"]


def test_what_the_engine_cannot_do_is_said(world):
    worker = world.folder / "worker"
    worker.write_text("#!/bin/sh\necho 'failed engine 0 - contract this can not be' >&3\nexit 70\n")
    worker.chmod(0o755)
    reply = world.daemon("--worker", worker, "--worker-sandbox=off").post("/v1/simplify", SMALL)
    check(OPERATIONS["simplify"], reply)
    assert (reply.status, reply.slug) == (500, "engine-error")
    assert reply.json["detail"] == "this can not be" and reply.json["where"] == "contract"


def test_every_output_of_a_job_is_described(daemon):
    outputs = ("cloud,xyz,cloud.pcd,mesh,mesh.obj,mesh.stl,mesh.glb,report,dso,error,preview.png,cloud.las,cloud.laz,"
               "cloud.copc.laz,tileset")
    job_id = job_of(daemon, f"?ratio=0.5&outputs={outputs}")
    names = [o["name"] for o in daemon.curl(f"/v1/jobs/{job_id}/outputs").json["outputs"]]
    assert len(names) == 15
    operation = OPERATIONS["getOutput"]
    for name in names:
        for more in ((), ("-H", "Range: bytes=0-5")):
            check(operation, daemon.curl(operation.url(id=job_id, name=name), *more))


@pytest.mark.parametrize("operation_id", [o.id for o in OPERATIONS.values() if o.method == "GET"])
def test_head_is_described_as_get_is(daemon, operation_id):
    operation = OPERATIONS[operation_id]
    path = operation.url(**parts_of(operation, daemon))
    done = subprocess.run(["curl", "-sS", "-I", daemon.url + path], capture_output=True, check=True)
    reply = parse_reply(done.stdout)
    if operation.path.startswith("/v1/uploads"):
        assert reply.status == 412  # the protocol's HEAD names its version
    check(operation, reply, head=True)
