# SPDX-License-Identifier: GPL-3.0-or-later
"""Resumable uploads: tus 1.0 and the IETF's draft by the letter, through cut connections, kills and restarts."""
import base64
import concurrent.futures
import hashlib
import http.client
import json
import os
import signal
import socket
import threading

import pytest

from conftest import SMALL, sphere, wait_until

NAME = hashlib.sha256(SMALL).hexdigest()
TUS = ("-H", "Tus-Resumable: 1.0.0")
PIECE = ("-H", "Content-Type: application/offset+octet-stream")


def headers(**named):
    return [part for name, value in named.items() for part in ("-H", f"{name.replace('_', '-')}: {value}")]


def create(daemon, length=None, *more):
    size = headers(Upload_Length=length) if length is not None else headers(Upload_Defer_Length=1)
    reply = daemon.curl("/v1/uploads", "-X", "POST", *TUS, *size, *more)
    assert reply.status == 201 and reply.headers["tus-resumable"] == "1.0.0", reply.body
    return reply.headers["location"]


def patch(daemon, path, offset, data, *more):
    return daemon.post(path, data, *TUS, *PIECE, *headers(Upload_Offset=offset), *more, "-X", "PATCH")


def head(daemon, path):
    return daemon.curl(path, "-I", "-o", os.devnull, *TUS)


def offset_of(daemon, path):
    reply = head(daemon, path)
    assert reply.status == 200 and reply.headers["cache-control"] == "no-store", reply.body
    return int(reply.headers["upload-offset"])


def parts(daemon):
    return sorted(p.name for p in (daemon.data / "uploads").iterdir())


def test_options(daemon):
    reply = daemon.curl("/v1/uploads", "-X", "OPTIONS")
    assert reply.status == 204 and not reply.body
    assert reply.headers["tus-resumable"] == reply.headers["tus-version"] == "1.0.0"
    assert int(reply.headers["tus-max-size"]) == 2 << 30
    assert set(reply.headers["tus-extension"].split(",")) == {
        "creation", "creation-with-upload", "creation-defer-length", "expiration", "checksum", "termination",
        "concatenation"}
    assert set(reply.headers["tus-checksum-algorithm"].split(",")) == {"sha1", "sha256"}


def test_a_piece_after_the_last_one_is_refused(daemon):
    path = create(daemon, len(SMALL))
    assert patch(daemon, path, 0, SMALL).status == 204
    for offset, data in ((0, SMALL), (len(SMALL), b"x"), (len(SMALL), b"")):
        late = patch(daemon, path, offset, data)
        assert (late.status, late.slug) == (409, "offset-mismatch"), late.body
    assert daemon.curl(f"/v1/clouds/{NAME}").status == 200


@pytest.mark.parametrize("last", ["GET", "DELETE"])
def test_an_upload_that_becomes_a_cloud_is_asked_for_meanwhile(daemon, last):
    """Whoever comes first makes the cloud; the others find it, or, after a DELETE, nothing."""
    data = SMALL * 1000
    path = create(daemon, len(data))
    assert patch(daemon, path, 0, data[:-100]).status == 204
    ended, seen = threading.Event(), []

    def ask():
        while not ended.is_set():
            seen.append(daemon.curl(path).status)
    askers = [threading.Thread(target=ask) for _ in range(3)]
    for asker in askers:
        asker.start()
    sender = threading.Thread(target=lambda: seen.append(patch(daemon, path, len(data) - 100, data[-100:]).status))
    sender.start()
    wait_until(lambda: daemon.curl(path).json.get("offset") == len(data) or not sender.is_alive(), "the last byte")
    seen.append(daemon.curl(path, "-X", last, *TUS).status)
    sender.join()
    ended.set()
    for asker in askers:
        asker.join()
    assert set(seen) <= ({200, 204} if last == "GET" else {200, 204, 404}), seen
    assert parts(daemon) == []


def test_piece_by_piece_to_a_job(daemon):
    path = create(daemon, len(SMALL), *headers(Upload_Metadata="filename YS54eXo=,empty"))
    for start in range(0, len(SMALL), 1000):
        assert offset_of(daemon, path) == start
        reply = patch(daemon, path, start, SMALL[start:start + 1000])
        assert reply.status == 204 and reply.headers["tus-resumable"] == "1.0.0" and reply.headers["upload-expires"]
        assert int(reply.headers["upload-offset"]) == min(start + 1000, len(SMALL))
    assert reply.headers["whittle-cloud"] == f"/v1/clouds/{NAME}"
    seen = head(daemon, path)
    assert seen.headers["whittle-cloud"] == f"/v1/clouds/{NAME}" and int(seen.headers["upload-length"]) == len(SMALL)
    assert seen.headers["upload-metadata"] == "filename YS54eXo=,empty"
    document = daemon.curl(path).json
    assert document["cloud"] == f"/v1/clouds/{NAME}" and document["offset"] == document["length"] == len(SMALL)
    assert daemon.curl(f"/v1/clouds/{NAME}/data").body == SMALL and parts(daemon) == []
    job = daemon.post("/v1/jobs", json.dumps({"input": document["cloud"], "params": {"points": 50}}).encode(),
                      "-H", "Content-Type: application/json")
    assert daemon.ended(job.json["id"])["status"] == "successful"


def test_creation_with_upload(daemon):
    whole = daemon.post("/v1/uploads", SMALL, *TUS, *PIECE, *headers(Upload_Length=len(SMALL)))
    assert whole.status == 201 and int(whole.headers["upload-offset"]) == len(SMALL)
    assert whole.headers["whittle-cloud"] == f"/v1/clouds/{NAME}" and whole.json["cloud"]
    part = daemon.post("/v1/uploads", SMALL[:100], *TUS, *PIECE, *headers(Upload_Length=len(SMALL)))
    assert part.status == 201 and int(part.headers["upload-offset"]) == 100 and part.json["cloud"] is None
    assert patch(daemon, part.headers["location"], 100, SMALL[100:]).headers["whittle-cloud"]


def test_length_may_come_later(daemon):
    path = create(daemon)
    seen = head(daemon, path)
    assert seen.headers["upload-defer-length"] == "1" and "upload-length" not in seen.headers
    assert patch(daemon, path, 0, SMALL[:500]).status == 204
    assert "whittle-cloud" not in head(daemon, path).headers
    assert patch(daemon, path, 500, b"", *headers(Upload_Length=400)).slug == "malformed-request"
    reply = patch(daemon, path, 500, SMALL[500:], *headers(Upload_Length=len(SMALL)))
    assert reply.status == 204 and reply.headers["whittle-cloud"] == f"/v1/clouds/{NAME}"


def test_a_limit_that_fell_below_what_has_come(make_daemon, tmp_path):
    settings = tmp_path / "settings"
    settings.write_text("max-body-bytes = 1M\n")
    daemon = make_daemon("--config", settings)
    path = create(daemon)
    assert patch(daemon, path, 0, SMALL).status == 204
    settings.write_text(f"max-body-bytes = {len(SMALL) // 2}\n")
    daemon.process.send_signal(signal.SIGHUP)
    wait_until(lambda: "max-body-bytes has changed" in daemon.log_text())
    assert patch(daemon, path, len(SMALL), b"more").slug == "body-too-large"


def test_length_alone_may_end_an_upload(daemon):
    path = create(daemon)
    assert patch(daemon, path, 0, SMALL).status == 204
    reply = patch(daemon, path, len(SMALL), b"", *headers(Upload_Length=len(SMALL)))
    assert reply.headers["whittle-cloud"] == f"/v1/clouds/{NAME}"


@pytest.mark.parametrize("method, more", [("PATCH", PIECE), ("HEAD", ("-I", "-o", os.devnull)), ("DELETE", ()),
                                          ("POST", ())])
@pytest.mark.parametrize("spoken", [(), ("-H", "Tus-Resumable: 0.2.2")])
def test_other_versions(daemon, method, more, spoken):
    path = "/v1/uploads" if method == "POST" else create(daemon, 10)
    verb = () if method == "HEAD" else ("-X", method)
    reply = daemon.curl(path, *verb, *more, *spoken, *headers(Upload_Length=5, Upload_Offset=0))
    assert reply.status == 412 and reply.headers["tus-version"] == "1.0.0"
    assert reply.headers["tus-resumable"] == "1.0.0"


@pytest.mark.parametrize("more, status, slug", [
    (headers(), 400, "malformed-request"),
    (headers(Upload_Length="x"), 400, "malformed-request"),
    (headers(Upload_Length=-1), 400, "malformed-request"),
    (headers(Upload_Length=5, Upload_Defer_Length=1), 400, "malformed-request"),
    (headers(Upload_Defer_Length=2), 400, "malformed-request"),
    (headers(Upload_Length=3 << 30), 413, "body-too-large"),
    (headers(Upload_Length=5, Upload_Concat="partially"), 400, "malformed-request"),
    (headers(Upload_Length=5, Upload_Metadata="x" * 700), 400, "malformed-request"),
    (headers(Upload_Length=5, Upload_Checksum="md5 x"), 400, "malformed-request"),
])
def test_refused_creations(daemon, more, status, slug):
    reply = daemon.curl("/v1/uploads", "-X", "POST", *TUS, *more)
    assert (reply.status, reply.slug) == (status, slug) and parts(daemon) == []
    assert reply.headers["tus-resumable"] == "1.0.0"


def test_refused_pieces(daemon):
    path = create(daemon, 100)
    assert patch(daemon, path, 0, b"0 0 0\n").status == 204
    wrong = patch(daemon, path, 5, b"1 1 1\n")
    assert (wrong.status, wrong.slug, wrong.json["offset"]) == (409, "offset-mismatch", 6)
    assert wrong.headers["upload-offset"] == "6"
    assert daemon.post(path, b"x", *TUS, *headers(Upload_Offset=6, Content_Type="text/plain"), "-X", "PATCH").status == 415
    assert daemon.post(path, b"x", *TUS, *PIECE, "-X", "PATCH").slug == "malformed-request"
    assert patch(daemon, path, 6, b"x", *headers(Content_Encoding="gzip")).json["supported"] == ["identity"]
    for more in ((), headers(Transfer_Encoding="chunked")):
        longer = patch(daemon, path, 6, b"x" * 95, *more)
        assert (longer.slug, longer.json["limit"]) == ("body-too-large", 94)
        assert "piece" in longer.json["detail"] and "HEAD" in longer.json["hint"]
    assert patch(daemon, path, 6, b"", *headers(Upload_Length=101)).slug == "malformed-request"
    assert patch(daemon, "/v1/uploads/none", 0, b"x").slug == "no-such-upload"
    assert daemon.curl("/v1/uploads/none").slug == "no-such-upload"


@pytest.mark.parametrize("algorithm", ["sha1", "sha256"])
def test_checksums(daemon, algorithm):
    def checksum(data):
        return headers(Upload_Checksum=f"{algorithm} {base64.b64encode(hashlib.new(algorithm, data).digest()).decode()}")
    path = create(daemon, len(SMALL))
    assert patch(daemon, path, 0, SMALL[:1000], *checksum(SMALL[:1000])).status == 204
    wrong = patch(daemon, path, 1000, SMALL[1000:2000], *checksum(b"x"))
    assert (wrong.status, wrong.slug) == (460, "checksum-mismatch") and offset_of(daemon, path) == 1000
    digest = base64.b64encode(hashlib.sha256(b"x").digest()).decode()
    wrong = patch(daemon, path, 1000, SMALL[1000:2000], *headers(Content_Digest=f"sha-256=:{digest}:"))
    assert wrong.slug == "digest-mismatch" and offset_of(daemon, path) == 1000
    assert patch(daemon, path, 1000, SMALL[1000:], *checksum(SMALL[1000:])).headers["whittle-cloud"].endswith(NAME)
    refused = daemon.post("/v1/uploads", SMALL, *TUS, *PIECE, *headers(Upload_Length=len(SMALL)), *checksum(b"x"))
    assert refused.status == 460 and parts(daemon) == [] and daemon.leftovers() == []


def test_termination(daemon):
    path = create(daemon, 100)
    assert patch(daemon, path, 0, b"0 0 0\n").status == 204
    assert daemon.curl(path, "-X", "DELETE", *TUS).status == 204 and parts(daemon) == []
    assert head(daemon, path).status == 404 and daemon.curl(path, "-X", "DELETE", *TUS).slug == "no-such-upload"
    assert patch(daemon, path, 6, b"x").slug == "no-such-upload"
    path = create(daemon, 100)
    assert daemon.curl(path, "-X", "POST", *TUS, *headers(X_HTTP_Method_Override="DELETE")).status == 204


def test_what_is_no_cloud_ends_the_upload(daemon):
    data = b"\x89PNG\r\n\x1a\n" + bytes(100)
    path = create(daemon, len(data))
    assert patch(daemon, path, 0, data).slug == "unsupported-format"
    assert head(daemon, path).status == 404 and parts(daemon) == []


def test_expiration(make_daemon):
    daemon = make_daemon("--retention", "200ms", "--upload-expiry", "300ms")
    path = create(daemon, 100)
    wait_until(lambda: daemon.curl(path).status == 404, "the upload's end")
    wait_until(lambda: parts(daemon) == [], "the file's end")


# ---------------------------------------------------------------------------------------------- concatenation

def partial(daemon, data, *more):
    """A part that is whole."""
    path = create(daemon, len(data), *headers(Upload_Concat="partial"), *more)
    assert patch(daemon, path, 0, data, *more).status == 204
    return path


def join(daemon, paths, *more):
    return daemon.curl("/v1/uploads", "-X", "POST", *TUS, *headers(Upload_Concat="final;" + " ".join(paths)), *more)


def thirds(data):
    third = len(data) // 3
    return [data[:third], data[third:2 * third], data[2 * third:]]


def test_parts_that_came_side_by_side_become_one_cloud(daemon):
    pieces = thirds(SMALL)
    paths = [create(daemon, len(piece), *headers(Upload_Concat="partial")) for piece in pieces]
    for at in (0, 1):  # each grows by itself
        for path, piece in reversed(list(zip(paths, pieces))):
            half = (piece[:100], piece[100:])[at]
            assert patch(daemon, path, 100 * at, half).status == 204
    whole = head(daemon, paths[0])
    assert whole.headers["upload-concat"] == "partial" and "whittle-cloud" not in whole.headers
    assert daemon.curl("/v1/clouds").json["clouds"] == []
    reply = join(daemon, [daemon.url + paths[0], *paths[1:]], *headers(Upload_Metadata="a Yg=="))
    assert reply.status == 201 and reply.json["length"] == reply.json["offset"] == len(SMALL)
    assert reply.headers["whittle-cloud"].endswith(NAME) and daemon.curl(f"/v1/clouds/{NAME}/data").body == SMALL
    final = head(daemon, reply.headers["location"])
    assert final.headers["upload-concat"] == "final;" + " ".join(paths) and final.headers["upload-metadata"] == "a Yg=="
    assert int(final.headers["upload-length"]) == int(final.headers["upload-offset"]) == len(SMALL)
    refused = patch(daemon, reply.headers["location"], len(SMALL), b"1 2 3\n")
    assert (refused.status, refused.slug) == (403, "forbidden")
    assert [head(daemon, path).status for path in paths] == [404] * 3 and parts(daemon) == []


@pytest.mark.parametrize("given, more, status, slug", [
    ("partially", (), 400, "malformed-request"), ("final;", (), 400, "malformed-request"),
    ("final;/v1/clouds/x", (), 400, "malformed-request"), ("final;" + 17 * "{whole} ", (), 400, "malformed-request"),
    ("final;{whole}", ("-H", "Upload-Length: 3"), 400, "malformed-request"),
    ("final;{begun},{whole}", (), 400, "malformed-request"), ("final;{begun}\t{whole}", (), 400, "malformed-request"),
    ("final;{whole} {alone}", (), 400, "malformed-request"), ("final;{whole} {begun}", (), 409, "offset-mismatch"),
    ("final;{whole} /v1/uploads/01900000-0000-7000-8000-000000000000", (), 404, "no-such-upload")])
def test_what_can_not_be_joined(daemon, given, more, status, slug):
    paths = {"whole": partial(daemon, SMALL), "alone": create(daemon, 10),
             "begun": create(daemon, 10, *headers(Upload_Concat="partial"))}
    reply = daemon.curl("/v1/uploads", "-X", "POST", *TUS, *headers(Upload_Concat=given.format(**paths)), *more)
    assert (reply.status, reply.slug) == (status, slug)
    assert [head(daemon, path).status for path in paths.values()] == [200] * 3


def test_parts_stay_where_they_make_no_cloud(daemon):
    paths = [partial(daemon, b"\x89PNG\r\n\x1a\n" + bytes(100)), partial(daemon, SMALL)]
    assert join(daemon, paths).slug == "unsupported-format"
    assert [head(daemon, path).status for path in paths] == [200] * 2
    assert join(daemon, paths[1:]).headers["whittle-cloud"].endswith(NAME)


def test_parts_count_for_their_principal_and_what_they_make_only_once(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"ann:submit,read:{hashlib.sha256(b'ann').hexdigest()}\n"
                      f"bob:submit,read:{hashlib.sha256(b'bob').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens, "--principal-bytes", str(len(SMALL) + 100), "--principal-uploads", "3")
    ann, bob = headers(Authorization="Bearer ann"), headers(Authorization="Bearer bob")
    paths = [partial(daemon, piece, *ann) for piece in thirds(SMALL)]
    more = daemon.curl("/v1/uploads", "-X", "POST", *TUS, *headers(Upload_Length=200, Upload_Concat="partial"), *ann)
    assert (more.status, more.slug) == (429, "rate-limited")
    assert join(daemon, paths, *bob).slug == "no-such-upload"
    assert join(daemon, paths, *ann).headers["whittle-cloud"].endswith(NAME)
    more = daemon.curl("/v1/uploads", "-X", "POST", *TUS, *headers(Upload_Length=200, Upload_Concat="partial"), *ann)
    assert (more.status, more.slug) == (429, "rate-limited")  # the cloud counts now
    create(daemon, 50, *headers(Upload_Concat="partial"), *ann)


def test_a_part_that_is_named_again_counts_again(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"ann:submit,read:{hashlib.sha256(b'ann').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens, "--principal-bytes", str(2 * len(SMALL)))
    ann = headers(Authorization="Bearer ann")
    path = partial(daemon, SMALL, *ann)
    more = join(daemon, 3 * [path], *ann)
    assert (more.status, more.slug) == (429, "rate-limited")
    twice = join(daemon, 2 * [path], *ann)
    assert twice.status == 201 and twice.json["length"] == 2 * len(SMALL)
    assert daemon.curl(path, *ann).status == 404 and parts(daemon) == []


def test_a_final_upload_is_the_same_when_it_is_asked_for_again(make_daemon, tmp_path):
    """The answer may have been lost, and the parts are gone by then."""
    tokens = tmp_path / "tokens"
    tokens.write_text(f"ann:submit,read:{hashlib.sha256(b'ann').hexdigest()}\n"
                      f"bob:submit,read:{hashlib.sha256(b'bob').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens, "--principal-uploads", "3")
    ann, bob = headers(Authorization="Bearer ann"), headers(Authorization="Bearer bob")
    paths = [partial(daemon, piece, *ann) for piece in thirds(SMALL)]
    first = join(daemon, paths, *ann)
    assert first.status == 201
    daemon.kill()
    daemon.start()
    for _ in range(2):
        again = join(daemon, paths, *ann)
        assert again.status == 201 and again.headers["location"] == first.headers["location"], again.body
        assert again.json == first.json and again.headers["whittle-cloud"].endswith(NAME)
    assert join(daemon, paths[::-1], *ann).slug == join(daemon, paths[:2], *ann).slug == "no-such-upload"
    assert join(daemon, paths, *bob).slug == "no-such-upload"
    assert daemon.curl(first.headers["location"], "-X", "DELETE", *TUS, *ann).status == 204
    assert join(daemon, paths, *ann).slug == "no-such-upload"


def test_a_final_upload_that_is_asked_for_side_by_side_is_one_cloud(daemon):
    paths = [partial(daemon, piece) for piece in thirds(SMALL)]
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        replies = list(pool.map(lambda _: join(daemon, paths), range(8)))
    assert [(reply.status, reply.headers.get("whittle-cloud", "")[-64:]) for reply in replies] == 8 * [
        (201, NAME)], [reply.body for reply in replies]
    assert [head(daemon, path).status for path in paths] == [404] * 3 and parts(daemon) == []


def test_what_is_joined_is_within_the_limit_of_a_body(make_daemon):
    daemon = make_daemon("--max-body-bytes", str(len(SMALL) - 1))
    paths = [partial(daemon, piece) for piece in thirds(SMALL)]
    reply = join(daemon, paths)
    assert (reply.status, reply.slug) == (413, "body-too-large")
    assert [head(daemon, path).status for path in paths] == [200] * 3


def test_parts_outlive_kills_and_expire(make_daemon):
    daemon = make_daemon()
    paths = [partial(daemon, piece) for piece in thirds(SMALL)]
    daemon.kill()
    daemon.start()
    assert head(daemon, paths[1]).headers["upload-concat"] == "partial"
    final = join(daemon, paths).headers["location"]
    daemon.kill()
    daemon.start()
    assert head(daemon, final).headers["upload-concat"].startswith("final;")
    partial(daemon, SMALL)
    assert daemon.stop() == 0
    daemon.start("--upload-expiry", "200ms")
    short = create(daemon, len(SMALL), *headers(Upload_Concat="partial"))
    wait_until(lambda: head(daemon, short).status == 404, "the part's end")


def test_a_number_of_uploads(make_daemon):
    daemon = make_daemon("--max-uploads", "2")
    paths = [create(daemon, 10), create(daemon, 10)]
    full = daemon.curl("/v1/uploads", "-X", "POST", *TUS, *headers(Upload_Length=10))
    assert (full.status, full.slug) == (503, "too-many-uploads") and full.headers["retry-after"]
    assert daemon.curl(paths[0], "-X", "DELETE", *TUS).status == 204
    create(daemon, 10)


def test_a_refused_upload_makes_room_before_it_is_told(make_daemon):
    daemon = make_daemon("--max-uploads", "1")
    both = [http.client.HTTPConnection("127.0.0.1", daemon.port) for _ in range(2)]
    wrong = {"Tus-Resumable": "1.0.0", "Content-Type": "application/offset+octet-stream",
             "Upload-Length": str(len(SMALL)), "Upload-Checksum": f"sha1 {'A' * 27}="}
    for one in both * 100:
        assert daemon.request("POST", "/v1/uploads", SMALL, wrong, one)[0] == 460
        assert parts(daemon) == [] and daemon.leftovers() == []


class Half:
    """A request whose body is only begun."""

    def __init__(self, daemon, path, offset, length, data, more=""):
        self.socket = socket.create_connection(("127.0.0.1", daemon.port))
        self.socket.sendall(f"PATCH {path} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: {offset}\r\n"
                            f"Content-Type: application/offset+octet-stream\r\n{more}"
                            f"Content-Length: {length}\r\n\r\n".encode() + data)

    def more(self, data):
        self.socket.sendall(data)

    def end(self):
        self.socket.close()


def begun(daemon, path, start):
    """Waits, without going between, until more is there than before: the end of what was sent may wait in memory.  How
    much there is."""
    def offset():
        return daemon.curl(path).json["offset"]
    wait_until(lambda: offset() > start, f"more than {start} bytes")
    return offset()


# So large that pieces of it are written at once.
CLOUD = sphere(6000)
CLOUD_NAME = hashlib.sha256(CLOUD).hexdigest()


def test_what_came_before_the_connection_broke_is_kept(daemon):
    path = create(daemon, len(CLOUD))
    half = Half(daemon, path, 0, len(CLOUD), CLOUD[:30000])
    least = begun(daemon, path, 0)
    half.end()
    start = offset_of(daemon, path)
    assert least <= start <= 30000
    assert patch(daemon, path, start, CLOUD[start:]).headers["whittle-cloud"].endswith(CLOUD_NAME)


def test_half_a_piece_with_a_checksum_is_not_kept(daemon):
    path = create(daemon, len(SMALL))
    digest = base64.b64encode(hashlib.sha1(SMALL).digest()).decode()
    half = Half(daemon, path, 0, len(SMALL), SMALL[:6000], f"Upload-Checksum: sha1 {digest}\r\n")
    wait_until(lambda: sum(p.stat().st_size for p in (daemon.data / "tmp").iterdir()) == 6000, "the piece")
    half.end()
    wait_until(lambda: daemon.leftovers() == [], "its end")
    assert offset_of(daemon, path) == 0
    assert patch(daemon, path, 0, SMALL).headers["whittle-cloud"].endswith(NAME)


def test_who_comes_back_does_not_wait_for_the_dead(daemon):
    path = create(daemon, len(CLOUD))
    half = Half(daemon, path, 0, len(CLOUD), CLOUD[:30000])
    least = begun(daemon, path, 0)
    start = offset_of(daemon, path)
    assert least <= start <= 30000
    half.more(CLOUD[30000:40000])  # comes too late
    assert patch(daemon, path, start, CLOUD[start:]).headers["whittle-cloud"].endswith(CLOUD_NAME)
    assert daemon.curl(f"/v1/clouds/{CLOUD_NAME}/data").body == CLOUD
    half.end()


def test_many_at_once_on_one_upload_keep_it_whole(daemon):
    cloud = sphere(20000)
    path = create(daemon, len(cloud))

    def push():
        while True:
            seen = head(daemon, path)
            start = int(seen.headers["upload-offset"])
            if start == len(cloud):
                return
            patch(daemon, path, start, cloud[start:start + 50000])
    threads = [threading.Thread(target=push) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert head(daemon, path).headers["whittle-cloud"].endswith(hashlib.sha256(cloud).hexdigest())


def test_an_upload_survives_kills(make_daemon):
    daemon = make_daemon()
    path, start = create(daemon, len(CLOUD), *headers(Upload_Metadata="a Yg==")), 0
    while start + 40000 < len(CLOUD):
        half = Half(daemon, path, start, len(CLOUD) - start, CLOUD[start:start + 30000])
        least = begun(daemon, path, start)
        daemon.kill()
        half.end()
        daemon.start()
        offset = offset_of(daemon, path)
        assert least <= offset <= start + 30000  # all that was written
        start = offset + 500
        assert patch(daemon, path, offset, CLOUD[offset:start]).status == 204
    assert head(daemon, path).headers["upload-metadata"] == "a Yg=="
    assert patch(daemon, path, start, CLOUD[start:]).headers["whittle-cloud"].endswith(CLOUD_NAME)
    daemon.kill()
    daemon.start()
    assert head(daemon, path).headers["whittle-cloud"].endswith(CLOUD_NAME) and parts(daemon) == []


def test_after_another_boot_only_what_was_flushed_counts(make_daemon):
    import sqlite3
    daemon = make_daemon()
    path = create(daemon, len(CLOUD))
    assert patch(daemon, path, 0, CLOUD[:10000]).status == 204
    half = Half(daemon, path, 10000, len(CLOUD) - 10000, CLOUD[10000:40000])
    begun(daemon, path, 10000)
    daemon.kill()
    half.end()
    with sqlite3.connect(daemon.data / "whittled.db") as database:
        database.execute("UPDATE uploads SET boot = 'another'")
    database.close()
    daemon.start()
    assert offset_of(daemon, path) == 10000
    assert patch(daemon, path, 10000, CLOUD[10000:]).headers["whittle-cloud"].endswith(CLOUD_NAME)


def test_whole_but_for_the_last_word(make_daemon):
    """Killed between the last byte and its answer: asking for the offset makes it a cloud."""
    daemon = make_daemon()
    path = create(daemon, len(SMALL))
    half = Half(daemon, path, 0, len(SMALL) + 1, SMALL)
    half.end()
    path = create(daemon, len(SMALL))
    daemon.kill()
    (daemon.data / "uploads" / path.rsplit("/", 1)[1]).write_bytes(SMALL)
    daemon.start()
    assert head(daemon, path).headers["whittle-cloud"] == f"/v1/clouds/{NAME}"


def test_lost_files_and_leftover_files(make_daemon):
    daemon = make_daemon()
    lost, kept = create(daemon, 10), create(daemon, 10)
    assert patch(daemon, lost, 0, b"0 0").status == 204
    daemon.kill()
    (daemon.data / "uploads" / lost.rsplit("/", 1)[1]).unlink()
    (daemon.data / "uploads" / "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e").write_bytes(b"x")
    daemon.start()
    assert head(daemon, lost).status == 404 and offset_of(daemon, kept) == 0
    assert parts(daemon) == [kept.rsplit("/", 1)[1]]


# ---------------------------------------------------------------------------------------------- the IETF's draft

VERSION = ("-H", "Upload-Draft-Interop-Version: 8")
MORE, LAST = ("-H", "Upload-Complete: ?0"), ("-H", "Upload-Complete: ?1")
PARTIAL = ("-H", "Content-Type: application/partial-upload")


def begin(daemon, data, *more):
    reply = daemon.post("/v1/uploads", data, *VERSION, *more)
    assert reply.status == 201 and "tus-resumable" not in reply.headers, reply.body
    assert reply.headers["upload-draft-interop-version"] == "8"
    return reply


def append(daemon, path, offset, data, *more):
    return daemon.post(path, data, *VERSION, *PARTIAL, *headers(Upload_Offset=offset), "-X", "PATCH", *more)


def state_of(daemon, path):
    """(offset, whether it is complete, length if it is known)"""
    reply = daemon.curl(path, "-I", "-o", os.devnull, *VERSION)
    assert reply.status == 200 and reply.headers["cache-control"] == "no-store" and not reply.body
    assert "tus-resumable" not in reply.headers and "upload-defer-length" not in reply.headers
    limits = dict(part.split("=") for part in reply.headers["upload-limit"].split(", "))
    assert int(limits["max-size"]) == 2 << 30 and 0 < int(limits["max-age"]) <= 86400
    length = reply.headers.get("upload-length")
    return int(reply.headers["upload-offset"]), reply.headers["upload-complete"], length and int(length)


def test_draft_in_one_piece(daemon):
    reply = begin(daemon, SMALL, *LAST, "-H", "Content-Type: text/plain")
    assert reply.headers["upload-complete"] == "?1" and reply.headers["whittle-cloud"] == f"/v1/clouds/{NAME}"
    assert state_of(daemon, reply.headers["location"]) == (len(SMALL), "?1", len(SMALL))
    assert daemon.curl(f"/v1/clouds/{NAME}/data").body == SMALL


@pytest.mark.parametrize("told", ["length", "by the last piece", "in chunks"])
def test_draft_in_pieces(daemon, told):
    """Whether the length is told at first, by the last piece's own, or by its end."""
    size = headers(Upload_Length=len(SMALL)) if told == "length" else ()
    path = begin(daemon, b"", *MORE, *size).headers["location"]
    for start in range(0, 3000, 1000):
        assert state_of(daemon, path) == (start, "?0", len(SMALL) if size else None)
        reply = append(daemon, path, start, SMALL[start:start + 1000], *MORE)
        assert (reply.status, reply.headers["upload-complete"]) == (204, "?0"), reply.body
        assert int(reply.headers["upload-offset"]) == start + 1000
    chunked = ("-H", "Transfer-Encoding: chunked") if told == "in chunks" else ()
    reply = append(daemon, path, 3000, SMALL[3000:], *LAST, *chunked)
    assert (reply.status, reply.headers["upload-complete"]) == (200, "?1"), reply.body
    assert reply.json["cloud"] == reply.headers["whittle-cloud"] == f"/v1/clouds/{NAME}"
    assert state_of(daemon, path) == (len(SMALL), "?1", len(SMALL))
    for data, refused in ((b"", (409, "offset-mismatch")), (b"x", (400, "malformed-request"))):
        late = append(daemon, path, len(SMALL), data, *LAST)
        assert (late.status, late.slug) == refused and "upload-complete" not in late.headers
    assert daemon.curl(f"/v1/clouds/{NAME}/data").body == SMALL


def test_draft_is_complete_when_its_client_says_so(daemon):
    """Not where the length is there already; then an empty piece ends it."""
    path = begin(daemon, SMALL, *MORE, *headers(Upload_Length=len(SMALL))).headers["location"]
    assert state_of(daemon, path) == (len(SMALL), "?0", len(SMALL))
    assert daemon.curl(f"/v1/clouds/{NAME}").status == 404
    daemon.kill()
    daemon.start()
    assert state_of(daemon, path) == (len(SMALL), "?0", len(SMALL))
    reply = append(daemon, path, len(SMALL), b"", *LAST)
    assert (reply.status, reply.headers["upload-complete"]) == (200, "?1"), reply.body
    assert daemon.curl(f"/v1/clouds/{NAME}").status == 200


def test_draft_refuses_what_does_not_fit(daemon):
    assert daemon.post("/v1/uploads", SMALL, *VERSION).slug == "malformed-request"
    for value in ("1", "?2", "true", "?", "?10"):
        assert daemon.post("/v1/uploads", SMALL, *VERSION, *headers(Upload_Complete=value)).slug == "malformed-request"
    assert daemon.post("/v1/uploads", SMALL, *LAST, *headers(Upload_Length=5)).slug == "malformed-request"
    path = begin(daemon, SMALL[:1000], *MORE, *headers(Upload_Length=len(SMALL))).headers["location"]
    wrong = append(daemon, path, 0, SMALL[1000:], *LAST)
    assert (wrong.status, wrong.slug) == (409, "offset-mismatch") and wrong.headers["upload-offset"] == "1000"
    for data in (SMALL[1000:-1], SMALL[1000:] + b"x"):
        assert append(daemon, path, 1000, data, *LAST).slug == "malformed-request"
    short = append(daemon, path, 1000, SMALL[1000:-10], *LAST, "-H", "Transfer-Encoding: chunked")
    assert short.slug == "malformed-request" and "upload-complete" not in short.headers
    assert daemon.post(path, b"1", *MORE, *headers(Upload_Offset=len(SMALL) - 10, Content_Type="text/html"), "-X",
                       "PATCH").status == 415
    assert append(daemon, path, len(SMALL) - 10, SMALL[-10:], *LAST).status == 200
    assert daemon.post("/v1/uploads", b"", *VERSION, *MORE, *headers(Upload_Length=3 << 40)).status == 413


def test_draft_says_where_the_whole_is_what_is_wrong(daemon):
    path = begin(daemon, b"ply\nformat ascii 1.0\n", *MORE).headers["location"]
    reply = append(daemon, path, 21, b"element vertex x\n", *LAST)
    assert (reply.status, reply.headers["upload-complete"]) == (422, "?1"), reply.body
    assert daemon.curl(path, "-I", *VERSION).status == 404


def test_draft_is_deleted_and_begun_where_it_belongs(daemon):
    path = begin(daemon, SMALL[:10], *MORE).headers["location"]
    assert daemon.curl(path, "-X", "DELETE", *VERSION).status == 204
    assert daemon.curl(path, "-I", *VERSION).status == 404 and parts(daemon) == []
    for target in ("/v1/clouds", "/v1/jobs", "/v1/simplify"):
        assert daemon.post(target, SMALL, *VERSION, *MORE).slug == "malformed-request"
        assert daemon.post(target, SMALL, *VERSION, *LAST).status < 300
    options = daemon.curl("/v1/uploads", "-X", "OPTIONS").headers
    assert "application/partial-upload" in options["accept-patch"] and options["upload-limit"] == f"max-size={2 << 30}"


@pytest.mark.parametrize("content", [SMALL, b"ply\nformat ascii 1.0\nelement vertex x\n"])
def test_a_look_ends_no_upload(daemon, content):
    """Neither makes GET a cloud of what its client hasn't ended, nor removes what would be none."""
    path = begin(daemon, content, *MORE, *headers(Upload_Length=len(content))).headers["location"]
    for spoken in ((), VERSION):
        look = daemon.curl(path, *spoken)
        assert (look.status, look.json["offset"], look.json["cloud"]) == (200, len(content), None), look.body
    assert state_of(daemon, path) == (len(content), "?0", len(content))
    assert daemon.curl(f"/v1/clouds/{NAME}").status == 404
    assert append(daemon, path, len(content), b"", *LAST).status == (200 if content == SMALL else 422)


@pytest.mark.parametrize("version", ["1", "4", "9", "eight", "6.5"])
def test_other_versions_of_the_draft(daemon, version):
    spoken = headers(Upload_Draft_Interop_Version=version)
    path = begin(daemon, SMALL[:10], *MORE).headers["location"]
    for reply in (daemon.post("/v1/uploads", SMALL, *LAST, *spoken), daemon.curl(path, "-I", *spoken),
                  daemon.post(path, b"x", *PARTIAL, *LAST, *headers(Upload_Offset=10), *spoken, "-X", "PATCH"),
                  daemon.curl(path, "-X", "DELETE", *spoken)):
        assert reply.status == 412 and reply.headers["upload-draft-interop-version"] == "8"
        assert "tus-version" not in reply.headers
    assert state_of(daemon, path)[0] == 10


def test_headers_of_uploads_are_there_once_and_may_have_parameters(daemon):
    for twice in ((*LAST, *MORE, *VERSION), (*LAST, *VERSION, *headers(Upload_Draft_Interop_Version=7)),
                  (*TUS, *headers(Upload_Length=5), *headers(Upload_Length=6))):
        assert daemon.post("/v1/uploads", SMALL, *twice).slug == "malformed-request" and parts(daemon) == []
    reply = daemon.post("/v1/uploads", SMALL, "-H", "Upload-Complete: ?1; a=?0",
                        *headers(Upload_Draft_Interop_Version="8;a"))
    assert (reply.status, reply.headers["upload-complete"]) == (201, "?1"), reply.body


def test_the_draft_knows_no_parts(daemon):
    for value in ("partial", "final;/v1/uploads/0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e"):
        assert daemon.post("/v1/uploads", SMALL, *VERSION, *LAST, *headers(Upload_Concat=value)).slug == "malformed-request"
    assert parts(daemon) == []


def test_the_draft_tells_the_limit_where_a_piece_is_beyond_it(make_daemon):
    daemon = make_daemon("--max-body-bytes", "5000")
    path = begin(daemon, SMALL[:1000], *MORE).headers["location"]
    for reply in (daemon.post("/v1/uploads", b"0" * 5001, *VERSION, *LAST), append(daemon, path, 1000, b"0" * 4001, *MORE),
                  append(daemon, path, 1000, b"0" * 4001, *LAST)):
        assert (reply.status, reply.slug, reply.headers["upload-limit"]) == (413, "body-too-large", "max-size=5000")
    piece = append(daemon, path, 1000, b"0" * 4001, *MORE).json
    assert piece["limit"] == 4000 and "piece" in piece["detail"] and "HEAD" in piece["hint"]


@pytest.mark.parametrize("spoken", ["Tus-Resumable: 1.0.0\r\nUpload-Length: {}", "Upload-Complete: ?1", "Upload-Complete: ?0"])
def test_a_creation_that_was_cut_short_leaves_nothing(daemon, spoken):
    """Its client has heard of no name to go on with."""
    told = spoken.format(len(CLOUD)) + "\r\nContent-Type: application/offset+octet-stream"
    with socket.create_connection(("127.0.0.1", daemon.port)) as link:
        link.sendall(f"POST /v1/uploads HTTP/1.1\r\nHost: localhost\r\n{told}\r\n"
                     f"Content-Length: {len(CLOUD)}\r\n\r\n".encode() + CLOUD[:30000])
        wait_until(lambda: parts(daemon) != [] and any(p.stat().st_size for p in (daemon.data / "uploads").iterdir()),
                   "its first bytes")
    wait_until(lambda: parts(daemon) == [], "its end")
    assert daemon.leftovers() == []


def test_a_creation_that_is_refused_leaves_nothing(make_daemon, tmp_path):
    """Its answer has no Location: a last piece that is too short, a whole that is no cloud, or more than the share."""
    chunked = ("-H", "Transfer-Encoding: chunked")
    (tmp_path / "tokens").write_text("ann:submit,read:" + hashlib.sha256(32 * b"a").hexdigest())
    daemon = make_daemon("--tokens-file", tmp_path / "tokens", "--principal-bytes", "5000")
    ann = ("-H", "Authorization: Bearer " + 32 * "a")
    for data, status, more in (
            (SMALL[:100], 400, (*VERSION, *LAST, *chunked, *headers(Upload_Length=200))),
            (b"ply\nelement vertex x\n", 422, (*VERSION, *LAST)),
            (b"ply\nelement vertex x\n", 422, (*TUS, *PIECE, *headers(Upload_Length=21))),
            (b"0 0 0\n" * 900, 429, (*VERSION, *MORE, *chunked)),
            (b"0 0 0\n" * 900, 429, (*TUS, *PIECE, *chunked, *headers(Upload_Defer_Length=1)))):
        reply = daemon.post("/v1/uploads", data, *more, *ann)
        assert reply.status == status and "location" not in reply.headers, reply.body
        assert parts(daemon) == []
    # What the refused one had reserved is given back behind its answer.
    wait_until(lambda: daemon.post("/v1/uploads", SMALL[:3000], *VERSION, *MORE, *ann).status == 201, "room in the share")
