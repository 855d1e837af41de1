# SPDX-License-Identifier: GPL-3.0-or-later
"""Who stands between a host and its S3 store, and cuts, delays, refuses and changes what goes by: nothing is lost, nothing
else is served than what was put, and what can't be done is told as such (5xx), not as done or as not there."""
import collections
import concurrent.futures
import contextlib
import http.client
import http.server
import os
import random
import re
import socket
import sqlite3
import subprocess
import threading
import time
import urllib.parse

import pytest

from conftest import BUILD, PATIENCE_S, SMALL, sphere, wait_until
from test_hosts import PROGRAMS, content, make_in_s3, make_server, objects_in  # pylint: disable=unused-import
from test_rules import ask
from test_storage import inside, on_a_disk_of

SLOW_DOWN = (b'<?xml version="1.0"?><Error><Code>SlowDown</Code><Message>Reduce your request rate.</Message></Error>')
FAILED = b'<?xml version="1.0"?><Error><Code>InternalError</Code><Message>We encountered an error.</Message></Error>'
PAGE = b"<html><head><title>Not Found</title></head></html>"
HOP = {"connection", "keep-alive", "transfer-encoding", "content-length"}
LONG = sphere(250000)  # more than 5 MiB: it is put in parts


def half(body):
    return body[:len(body) // 2]


def flip(body):
    return body[:len(body) // 2] + bytes([body[len(body) // 2] ^ 1]) + body[len(body) // 2 + 1:] if body else body


class Meddler(http.server.ThreadingHTTPServer):
    """Passes requests on to the gateway, each in a way that `choose` says: the name of one of WAYS, or None."""
    daemon_threads = True

    def __init__(self, endpoint, choose):
        self.to, self.choose = endpoint.removeprefix("http://"), choose
        self.done = collections.Counter()  # in which way, and of which method
        super().__init__(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server_address[1]}"
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def handle_error(self, request, client_address):
        pass  # connections end here in the middle


class Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def handle_one(self):
        body = self.rfile.read(int(self.headers.get("content-length", 0)))
        way = self.server.choose(self.command, self.path)
        if way not in OF_METHOD.get(self.command, OF_ALL):
            way = None
        self.server.done[way, self.command] += 1
        getattr(self, "do_" + way if way else "pass_on")(body)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = handle_one

    def ask(self, body):
        """The store's own answer: status, headers, body."""
        connection = http.client.HTTPConnection(self.server.to, timeout=60)
        try:
            connection.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
            for name, value in self.headers.items():
                connection.putheader(name, value)
            connection.endheaders(body)
            reply = connection.getresponse()
            headers = [(n, v) for n, v in reply.getheaders() if n.lower() not in HOP]
            return reply.status, headers, reply.read(), reply.getheader("content-length", "0")
        finally:
            connection.close()

    def answer(self, status, headers, body, length=None):
        """length: what is told of it, where that isn't what comes."""
        self.send_response_only(status)
        for name, value in headers:
            self.send_header(name, value)
        self.send_header("Content-Length", length or str(len(body)))
        self.end_headers()
        self.wfile.write(body)
        if self.command != "HEAD" and length and int(length) != len(body):
            self.drop()

    def drop(self):
        self.wfile.flush()
        self.close_connection = True

    def pass_on(self, body):
        status, headers, reply, length = self.ask(body)
        self.answer(status, headers, reply, length if self.command == "HEAD" else None)

    def change(self, body, change):
        """Another body for an answer that is well, of another length."""
        status, headers, reply, length = self.ask(body)
        reply = change(reply) if status < 300 else reply
        self.answer(status, headers, reply, length if self.command == "HEAD" else None)

    # -- the ways
    def do_error(self, _):
        self.answer(500, [], b"<html>500</html>")

    def do_slow_down(self, _):
        self.answer(503, [("Content-Type", "application/xml")], SLOW_DOWN)

    def do_too_many(self, _):
        self.answer(429, [], b"")

    def do_page(self, _):
        self.answer(404, [("Content-Type", "text/html")], PAGE)

    def do_forbid(self, _):
        self.answer(403, [("Content-Type", "text/html")], PAGE)

    def do_welcome(self, _):
        self.answer(200, [("Content-Type", "text/html")], PAGE)

    def do_elsewhere(self, _):
        self.answer(307, [("Location", "http://127.0.0.1:9/")], b"")

    def do_refuse(self, _):
        self.drop()

    def do_lose(self, body):
        self.ask(body)
        self.drop()

    def do_cut(self, body):
        status, headers, reply, _ = self.ask(body)
        self.answer(status, headers, half(reply), str(len(reply)))

    def do_short(self, body):
        self.change(body, half)

    def do_longer(self, body):
        self.change(body, lambda reply: reply + b"more")

    def do_flip(self, body):
        self.change(body, flip)

    def do_trickle(self, body):
        """In many small pieces."""
        status, headers, reply, _ = self.ask(body)
        self.answer(status, headers, reply[:1], str(len(reply) or 1) if reply else None)
        for at in range(1, len(reply), 1 + len(reply) // 50):
            self.wfile.write(reply[at:at + 1 + len(reply) // 50])
            self.wfile.flush()
        self.close_connection = True

    def do_tag(self, body):
        status, headers, reply, length = self.ask(body)
        headers = [(n, v if n.lower() != "etag" else '"0123456789abcdef0123456789abcdef"') for n, v in headers]
        self.answer(status, headers, reply, length if self.command == "HEAD" else None)

    def do_shift(self, body):
        """Another part than was asked for."""
        wanted = self.headers["range"]
        if wanted:
            first, last = map(int, re.findall(r"\d+", wanted))
            self.headers.replace_header("range", f"bytes={max(0, first - 1)}-{max(0, last - 1)}")
        self.pass_on(body)

    def do_all(self, body):
        """All of it, where a part was asked for."""
        del self.headers["range"]
        self.pass_on(body)

    def do_halve(self, body):
        """Half of what is put reaches the store."""
        connection = http.client.HTTPConnection(self.server.to, timeout=60)
        with contextlib.suppress(OSError, http.client.HTTPException):
            connection.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
            for name, value in self.headers.items():
                connection.putheader(name, value)
            connection.endheaders(half(body))
        connection.close()
        self.drop()

    def do_spoil(self, body):
        """Something else than was to be put reaches the store."""
        status, headers, reply, _ = self.ask(flip(body))
        self.answer(status, headers, reply)

    def do_fail_well(self, _):
        """200, and in its text that it failed, as S3 itself says it of copies and of what is completed."""
        self.answer(200, [("Content-Type", "application/xml")], FAILED)

    def log_message(self, *_):
        pass


OF_ALL = {"error", "slow_down", "too_many", "page", "forbid", "elsewhere", "refuse", "lose"}
CHANGED = {"cut", "short", "longer", "flip", "trickle"}  # of an answer
OF_METHOD = {"GET": {*OF_ALL, *CHANGED, "welcome", "shift", "all"}, "HEAD": OF_ALL - {"page", "forbid", "elsewhere"},
             "PUT": {*OF_ALL, "tag", "halve", "spoil", "welcome"}, "POST": {*OF_ALL, "fail_well", "cut", "short", "welcome"},
             "DELETE": OF_ALL - {"elsewhere"}}
WAYS = sorted(set().union(*OF_METHOD.values()))
HARMLESS = {"trickle", "tag"}  # where nothing is put in parts


def through(flags, endpoint, meddler):
    return [flag.replace(endpoint, meddler.url) for flag in flags]


def own_check(flags, folder):
    """What `whittled check` says where nobody meddles."""
    done = subprocess.run([BUILD / "whittled", "check", "--data", folder, *flags[:4]], capture_output=True, text=True,
                          check=False)
    return done.returncode, [line for line in (done.stdout + done.stderr).splitlines() if line.startswith("damaged")]


def persist(ask):
    """Until it is done; each answer before is that it can't be now."""
    def done():
        reply = ask()
        assert reply.status < 300 or reply.status in (409, 500, 503), (reply.status, reply.body)
        return reply if reply.status < 300 else None
    return wait_until(done, "an answer that it is done")


@pytest.mark.parametrize("way", WAYS)
def test_what_happens_to_the_first_try_of_a_request_is_made_good(make_daemon, in_s3, tmp_path, way):
    seen = set()

    def first(method, path):
        request = method, re.sub("uploadId=[^&]*", "", path)
        is_first = request not in seen
        seen.add(request)
        return way if is_first else None

    flags, endpoint = in_s3
    meddler = Meddler(endpoint, lambda *_: None)
    host = make_daemon(*through(flags, endpoint, meddler), "--lease", "60s")
    meddler.choose = first
    job = host.submit(SMALL, "?ratio=0.5")
    cloud = persist(lambda: host.post("/v1/clouds", LONG)) if way == "tag" else host.post("/v1/clouds", LONG)
    assert cloud.status == 201, cloud.body
    assert host.ended(job)["status"] == "successful", host.job(job)
    again = host.submit(SMALL, "?ratio=0.5")  # the same result, copied
    assert host.ended(again)["status"] == "successful"
    same = content(host, job)
    part = host.curl(f"/v1/jobs/{again}/outputs/cloud.ply", "-H", "Range: bytes=100-199")
    assert part.status == 206 and (part.body == same[100:200] or way == "flip")  # a part's hash isn't known
    meddler.choose = lambda *_: None
    assert content(host, job) == content(host, again) == same
    assert host.curl(f"/v1/clouds/{cloud.json['id']}/data").body == LONG
    assert any(done == way for done, _ in meddler.done), meddler.done
    assert host.stop() == 0 and own_check(flags, tmp_path / "check") == (0, [])


@pytest.mark.parametrize("way", sorted(set(WAYS) - HARMLESS))
def test_what_happens_to_every_request_is_told_and_ends_with_it(make_daemon, in_s3, tmp_path, way):
    flags, endpoint = in_s3
    meddler = Meddler(endpoint, lambda *_: None)
    host = make_daemon(*through(flags, endpoint, meddler), "--lease", "60s", "--result-cache=0")
    job = host.submit(SMALL, "?ratio=0.5")
    host.ended(job)
    path = f"/v1/jobs/{job}/outputs/cloud.ply"
    before = content(host, job)
    meddler.choose = lambda *_: way
    whole, part = host.curl(path), host.curl(path, "-H", "Range: bytes=100-199")
    made, kept = host.post("/v1/jobs?ratio=0.4", SMALL), host.post("/v1/clouds", SMALL + b"# another\n")
    begun = host.post("/v1/clouds", LONG)
    meddler.choose = lambda *_: None
    for reply, good, right in ((whole, 200, before), (part, 206, before[100:200])):
        if way == "flip" and good == 206:
            continue  # a part's hash isn't known
        assert (reply.status, reply.body) == (good, right) or reply.status in (500, 503), (reply.status, reply.body)
        assert reply.status != 500 or way in ("short", "longer", "flip", "all", "shift", "welcome"), (way, reply.body)
    for reply in (made, kept, begun):
        assert reply.status in (200, 201, 503), (reply.status, reply.body)
        assert reply.status != 503 or int(reply.headers["retry-after"]) > 0
    assert content(host, job) == before
    for reply, data in ((kept, SMALL + b"# another\n"), (begun, LONG)):
        if reply.status != 503:
            assert host.curl(f"/v1/clouds/{reply.json['id']}/data").body == data
    if made.status == 201:
        assert host.ended(made.json["id"])["status"] == "successful"
    assert host.ended(host.submit(SMALL, "?ratio=0.4"))["status"] == "successful"
    assert host.stop() == 0 and own_check(flags, tmp_path / "check") == (0, [])


def test_a_store_that_is_hostile_at_random_loses_nothing_and_changes_nothing(make_daemon, in_s3, tmp_path):
    """Two hosts, each through a meddler of its own; every third request meets something, drawn by a seed."""
    flags, endpoint = in_s3
    seed = int(os.environ.get("HOSTILE_SEED") or random.SystemRandom().randrange(10**6))
    print(f"HOSTILE_SEED={seed}")
    meddlers, hosts = [], []
    for i in range(2):
        chance, lock = random.Random(f"{seed}/{i}"), threading.Lock()

        def choose(*_, chance=chance, lock=lock):
            with lock:
                return chance.choice(WAYS) if chance.random() < 0.33 else None
        meddlers.append(Meddler(endpoint, lambda *_: None))
        hosts.append(make_daemon(*through(flags, endpoint, meddlers[-1]), "--lease", "5s", "--result-cache=0"))
        meddlers[-1].choose = choose
    jobs = {}
    for i in range(12):
        cloud = sphere(200 + i)
        reply = persist(lambda: hosts[i % 2].post(  # pylint: disable=cell-var-from-loop
            "/v1/jobs?ratio=0.5", cloud, "-H", f"Idempotency-Key: hostile-{i}"))
        jobs[reply.json["id"]] = cloud
    for job, cloud in jobs.items():
        ended = wait_until(lambda: hosts[0].job(job) if hosts[0].job(job)["status"] in (  # pylint: disable=cell-var-from-loop
            "successful", "failed", "dismissed") else None, f"the end of {job}")
        assert ended["status"] == "successful", ended
        (tmp_path / "in.xyz").write_bytes(cloud)
        subprocess.run([BUILD / "whittle", tmp_path / "in.xyz", tmp_path / "out.ply", "--ratio", "0.5", "-q", "--force"],
                       check=True)
        for host in hosts:
            found = persist(lambda: host.curl(f"/v1/jobs/{job}/outputs/cloud.ply"))  # pylint: disable=cell-var-from-loop
            assert found.body == (tmp_path / "out.ply").read_bytes()
    assert len(hosts[0].curl("/v1/jobs").json["jobs"]) == len(jobs)
    assert [host.stop() for host in hosts] == [0, 0] and own_check(flags, tmp_path / "check") == (0, [])


def test_outputs_are_put_side_by_side(make_daemon, in_s3):
    """The first put of an output waits for the second one."""
    flags, endpoint = in_s3
    both, waiting = threading.Condition(), set()

    def choose(method, path):
        if method == "PUT" and "/outputs/" in path:
            with both:
                waiting.add(path)
                both.notify_all()
                both.wait_for(lambda: len(waiting) >= 2, PATIENCE_S)
    host = make_daemon(*through(flags, endpoint, Meddler(endpoint, choose)), "--lease", "600s")
    job = host.submit(SMALL, "?outputs=cloud,xyz,report")
    assert host.ended(job)["status"] == "successful" and len(waiting) == 3
    assert content(host, job) and content(host, job, "cloud.xyz")


def test_a_job_whose_cloud_the_store_changes_fails_and_is_not_computed(make_daemon, in_s3):
    flags, endpoint = in_s3
    meddler = Meddler(endpoint, lambda method, path: "flip" if "/clouds/" in path else None)
    host = make_daemon(*through(flags, endpoint, meddler), "--lease", "60s")
    ended = host.ended(host.submit(SMALL))
    assert ended["status"] == "failed" and "input" in ended["problem"]["detail"], ended


def test_a_piece_of_an_upload_that_the_store_changes_makes_no_cloud(make_daemon, in_s3):
    flags, endpoint = in_s3
    meddler = Meddler(endpoint, lambda *_: None)
    host = make_daemon(*through(flags, endpoint, meddler), "--roles", "http")
    tus = ("-H", "Tus-Resumable: 1.0.0")
    begun = host.curl("/v1/uploads", "-X", "POST", *tus, "-H", f"Upload-Length: {len(SMALL)}")
    assert begun.status == 201, begun.body
    upload = begun.headers["location"].removeprefix(host.url)

    def send(offset, data):
        return host.curl(upload, "-X", "PATCH", *tus, "-H", f"Upload-Offset: {offset}", "-H",
                         "Content-Type: application/offset+octet-stream", "--data-binary", "@-", data=data)
    assert send(0, SMALL[:5000]).status == 204
    meddler.choose = lambda method, path: "flip" if "/uploads/" in path else None
    refused = send(5000, SMALL[5000:])
    assert refused.status >= 500, refused.body
    assert host.curl("/v1/clouds").json["clouds"] == []
    meddler.choose = lambda *_: None
    assert host.curl(upload, "-I", *tus).headers["upload-offset"] == str(len(SMALL))  # which makes it one
    (cloud,) = host.curl("/v1/clouds").json["clouds"]
    assert host.curl(f"/v1/clouds/{cloud['id']}/data").body == SMALL


def test_what_is_told_of_an_upload_stays_while_a_piece_of_it_is_put(make_daemon, in_s3):
    """The sweep makes a piece of what comes, and the store takes its time; who asks for the offset then ends the upload's
    request, and not the piece."""
    flags, endpoint = in_s3
    holder = Holder(endpoint, "hold", ("PUT", "/uploads/"))
    host = make_daemon(*through(flags, endpoint, holder), "--roles", "http")
    tus, cloud = ("-H", "Tus-Resumable: 1.0.0"), sphere(6000)
    begun = host.curl("/v1/uploads", "-X", "POST", *tus, "-H", f"Upload-Length: {len(cloud)}")
    upload = begun.headers["location"].removeprefix(host.url)
    with socket.create_connection(("127.0.0.1", host.port)) as client, concurrent.futures.ThreadPoolExecutor() as pool:
        client.sendall(f"PATCH {upload} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
                       f"Content-Type: application/offset+octet-stream\r\nContent-Length: {len(cloud)}\r\n\r\n".encode())
        client.sendall(cloud[:100000])
        assert holder.has_come.wait(PATIENCE_S)
        told = host.curl(upload).json["offset"]
        assert 0 < told <= 100000
        asked = pool.submit(host.curl, upload, "-I", *tus)
        concurrent.futures.wait([asked], timeout=1)
        holder.goes_on.set()
        at = int(asked.result(PATIENCE_S).headers["upload-offset"])
    assert at >= told
    ended = host.curl(upload, "-X", "PATCH", *tus, "-H", f"Upload-Offset: {at}", "-H",
                      "Content-Type: application/offset+octet-stream", "--data-binary", "@-", data=cloud[at:])
    assert ended.status == 204, ended.body
    assert host.curl(host.curl(upload).json["cloud"] + "/data").body == cloud


@pytest.fixture(name="cramped")
def make_cramped(in_s3, tmp_path):
    folder = tmp_path / "cramped"
    folder.mkdir()
    yield from on_a_disk_of("40M", folder, *in_s3[0], "--roles", "http")


def test_a_host_whose_disk_is_full_says_so_to_readers(in_s3, cramped, make_daemon):
    """What it can't take out of the store others can; when there is room it can, too."""
    host, other = cramped, make_daemon(*in_s3[0])
    cloud = other.post("/v1/clouds", LONG).json["id"]
    job = other.submit(SMALL)
    other.ended(job)
    ballast = inside(host) / "ballast"
    with open(ballast, "wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
    for path in (f"/v1/clouds/{cloud}/data", f"/v1/jobs/{job}/outputs/cloud.ply", f"/v1/jobs/{job}/log"):
        reply = host.curl(path)
        assert reply.status == 503 and int(reply.headers["retry-after"]) > 0, (path, reply.status, reply.body)
        assert other.curl(path).status == 200
    level = host.curl(f"/v1/jobs/{job}/outputs/cloud.ply?points=20")
    assert level.status == 503, level.body
    assert host.job(job)["status"] == "successful"
    ballast.unlink()
    assert host.curl(f"/v1/clouds/{cloud}/data").body == LONG and content(host, job) == content(other, job)


# ---------------------------------------------------------------------------------------------- removals that come late

class Keeper(Meddler):
    """Keeps what is to remove a cloud, without an answer, until it is let go."""

    def __init__(self, endpoint):
        self.kept, self.keeps = [], True
        super().__init__(endpoint, lambda method, path: "keep" if self.keeps and method == "DELETE" and
                         "/clouds/" in path else None)

    def let_go(self):
        for handler, body in self.kept:
            assert handler.ask(body)[0] == 204
        self.kept.clear()


def keep(handler, body):
    handler.server.kept.append((handler, body))
    handler.drop()


Handler.do_keep = keep
OF_METHOD["DELETE"].add("keep")


def pass_grace(flags):
    """As if a quarter of an hour had gone by since."""
    ask(flags, "UPDATE expected SET removal = removal - 3600000 WHERE removed = 0 AND removal > 0")


@pytest.mark.parametrize("is_killed", [False, True])
def test_a_removal_that_comes_late_removes_nothing_that_was_put_since(make_daemon, in_s3, tmp_path, is_killed):
    """The store's answer to the removal of a cloud is lost, or the host that asks for it dies; another host is given the
    same cloud, and then what was asked for comes to the store."""
    flags, endpoint = in_s3
    keeper = Keeper(endpoint)
    host, other = make_daemon(*through(flags, endpoint, keeper)), make_daemon(*flags)
    cloud = other.post("/v1/clouds", SMALL).json["id"]
    forget(flags)
    if is_killed:
        client = subprocess.Popen(["curl", "-s", "-X", "DELETE", f"{host.url}/v1/clouds/{cloud}"],  # pylint: disable=consider-using-with
                                  stdout=subprocess.DEVNULL)
        wait_until(lambda: keeper.kept, "the removal")
        host.kill()
        client.wait(PATIENCE_S)
    else:
        assert host.curl(f"/v1/clouds/{cloud}", "-X", "DELETE").status == 200
    assert keeper.kept and other.curl(f"/v1/clouds/{cloud}").status == 404
    early = other.post("/v1/clouds", SMALL)  # refused, or else kept from what comes late
    assert early.status == 201 or int(early.headers["retry-after"]) > 0, early.body
    keeper.keeps = False
    keeper.let_go()
    assert early.status != 201 or other.curl(f"/v1/clouds/{cloud}/data").body == SMALL
    pass_grace(flags)
    again = persist(lambda: other.post("/v1/clouds", SMALL))
    assert again.json["id"] == cloud and other.curl(f"/v1/clouds/{cloud}/data").body == SMALL
    job = other.submit(SMALL, "?ratio=0.5")
    assert other.ended(job)["status"] == "successful"
    assert own_check(flags, tmp_path / "check") == (0, [])


@pytest.mark.parametrize("is_killed", [False, True])
def test_a_removal_that_comes_late_is_waited_for_by_one_machine_too(make_daemon, in_s3, tmp_path, is_killed):
    """Whose catalog is a file, and whose bytes are in a store."""
    flags, endpoint = in_s3
    keeper = Keeper(endpoint)
    flags = ["--catalog", f"sqlite:{tmp_path}/catalog.db", *flags[2:4]]
    host = make_daemon(*through(flags, endpoint, keeper))
    cloud = host.post("/v1/clouds", SMALL).json["id"]
    if is_killed:
        client = subprocess.Popen(["curl", "-s", "-X", "DELETE", f"{host.url}/v1/clouds/{cloud}"],  # pylint: disable=consider-using-with
                                  stdout=subprocess.DEVNULL)
        wait_until(lambda: keeper.kept, "the removal")
        host.kill()
        client.wait(PATIENCE_S)
        host.start()
    else:
        assert host.curl(f"/v1/clouds/{cloud}", "-X", "DELETE").status == 200
    assert keeper.kept and host.curl(f"/v1/clouds/{cloud}").status == 404
    for path in ("/v1/clouds", "/v1/jobs"):
        early = host.post(path, SMALL)
        assert early.status == 503 and int(early.headers["retry-after"]) > 0, early.body
    keeper.keeps = False
    keeper.let_go()
    host.stop()
    with contextlib.closing(sqlite3.connect(tmp_path / "catalog.db")) as database, database:
        database.execute("UPDATE removals SET begun = begun - 3600000")  # as if a quarter of an hour had gone by
    host.start()
    again = persist(lambda: host.post("/v1/clouds", SMALL))
    assert again.json["id"] == cloud and host.curl(f"/v1/clouds/{cloud}/data").body == SMALL
    assert host.ended(host.submit(SMALL, "?ratio=0.5"))["status"] == "successful"
    host.stop()
    assert own_check(flags, tmp_path / "check") == (0, [])


def forget(flags):
    """As if those who were about to refer to a cloud had gone long ago."""
    ask(flags, "UPDATE expected SET until = 1")


def test_a_cloud_that_is_certainly_gone_is_put_again_at_once(make_daemon, in_s3):
    flags, _ = in_s3
    hosts = [make_daemon(*flags) for _ in range(2)]
    for i in range(6):
        cloud = hosts[i % 2].post("/v1/clouds", SMALL)
        assert cloud.status == 201, cloud.body
        forget(flags)
        path = f"/v1/clouds/{cloud.json['id']}"
        assert hosts[(i // 2) % 2].curl(path, "-X", "DELETE").status == 200
        assert hosts[i % 2].curl(path + "/data").status == 404
    assert ask(flags, "SELECT removed FROM expected") == "1"


def test_an_upload_that_the_store_does_not_take_leaves_no_copy_at_its_host(make_daemon, in_s3):
    """Its pieces are in the store, and what was made of them for that would be there until the next start: the host
    that ends it may be another one."""
    flags, endpoint = in_s3
    host, other = make_daemon(*flags), make_daemon(*flags)
    path = host.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H",
                     f"Upload-Length: {len(SMALL)}").headers["location"]
    host.stop()
    refusing = Meddler(endpoint, lambda method, path: "refuse" if method == "PUT" and "/clouds/" in path else None)
    host.flags = through(host.flags, endpoint, refusing)
    host.start()
    reply = host.curl(path, "-X", "PATCH", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Offset: 0", "-H",
                      "Content-Type: application/offset+octet-stream", "--data-binary", "@-", data=SMALL)
    assert reply.status == 503, reply.body
    assert not list((host.data / "uploads").iterdir())
    whole = other.curl(path, "-I", "-H", "Tus-Resumable: 1.0.0")
    assert whole.status == 200 and other.curl(whole.headers["whittle-cloud"] + "/data").body == SMALL


def test_what_one_machine_can_not_remove_from_the_store_goes_later(make_daemon, in_s3, tmp_path):
    """A job's outputs, which no row names any more when the store is away; a store that is shared has them marked."""
    flags, endpoint = in_s3
    refusing = Meddler(endpoint, lambda method, path: "refuse" if refusing.refuses and method == "DELETE" else None)
    refusing.refuses = True
    flags = ["--catalog", f"sqlite:{tmp_path}/catalog.db", *flags[2:]]
    host = make_daemon(*through(flags, endpoint, refusing))
    job = host.submit(SMALL)
    assert host.ended(job)["status"] == "successful"
    assert host.curl(f"/v1/jobs/{job}", "-X", "DELETE").status == 200
    assert host.curl(f"/v1/jobs/{job}").status == 410 and [key for key in objects_in(flags) if job in key]
    host.stop()
    refusing.refuses = False
    with contextlib.closing(sqlite3.connect(tmp_path / "catalog.db")) as database, database:
        database.execute("UPDATE marks SET until = 1")
        database.execute("DELETE FROM tombstones")  # or the start would remove them by that
    host.start()
    wait_until(lambda: not [key for key in objects_in(flags) if job in key], "the removal")


@pytest.mark.parametrize("is_alone", [False, True])
def test_what_is_removed_late_of_a_copy_that_failed_is_not_what_the_job_has_made_since(make_daemon, in_s3, tmp_path, is_alone):
    """A result that is there already can't be copied, and what was of the copy goes; then the job computes it."""
    flags, endpoint = in_s3
    keeper, ways = Keeper(endpoint), []  # the ways of the puts of outputs that come next

    def choose(method, path):
        is_output = "/outputs/" in urllib.parse.unquote(path)
        if method == "PUT" and is_output and ways:
            return ways.pop(0)
        return "keep" if method == "DELETE" and is_output and keeper.keeps else None
    keeper.choose = choose
    if is_alone:
        flags = ["--catalog", f"sqlite:{tmp_path}/catalog.db", *flags[2:]]
    host = make_daemon(*through(flags, endpoint, keeper))
    first = host.submit(SMALL, "?ratio=0.5")
    assert host.ended(first)["status"] == "successful"
    ways += [None, "error", "error", "error"]
    second = host.submit(SMALL, "?ratio=0.5")
    assert host.ended(second)["status"] == "successful" and host.job(second)["attempt"] == 1
    assert keeper.kept
    keeper.keeps = False
    keeper.let_go()
    assert content(host, second) == content(host, first)
    assert host.stop() == 0 and own_check(flags, tmp_path / "check") == (0, [])


@pytest.mark.parametrize("way", ["error", "refuse", "lose"])
def test_outputs_of_one_machine_wait_for_the_store_too(make_daemon, in_s3, tmp_path, way):
    """What is computed isn't failed for a store that is away for a while."""
    flags, endpoint = in_s3
    tries = collections.Counter()

    def choose(method, path):
        is_output = method == "PUT" and "report.json" in urllib.parse.unquote(path)
        tries[is_output] += 1
        return way if is_output and tries[True] <= 8 else None
    flags = ["--catalog", f"sqlite:{tmp_path}/catalog.db", *flags[2:]]
    host = make_daemon(*through(flags, endpoint, Meddler(endpoint, choose)))
    job = host.submit(SMALL)
    ended = host.ended(job)
    assert ended["status"] == "successful" and tries[True] > 8, ended
    assert host.curl(f"/v1/jobs/{job}/outputs/report.json").json
    assert host.stop() == 0 and own_check(flags, tmp_path / "check") == (0, [])


class Holder(Meddler):
    """Requests of a kind wait: `hold` before they are passed on, `hold_answer` before they are answered."""

    def __init__(self, endpoint, way, *kinds):
        self.has_come, self.goes_on = threading.Event(), threading.Event()
        super().__init__(endpoint, lambda method, path: way if any(
            method == of and part in urllib.parse.unquote(path) for of, part in kinds) else None)

    def wait(self):
        self.has_come.set()
        assert self.goes_on.wait(PATIENCE_S)


def hold(handler, body):
    handler.server.wait()
    handler.pass_on(body)


def hold_answer(handler, body):
    status, headers, reply, _ = handler.ask(body)
    handler.server.wait()
    handler.answer(status, headers, reply)


Handler.do_hold, Handler.do_hold_answer = hold, hold_answer
for ways in OF_METHOD.values():
    ways.update(("hold", "hold_answer"))


@pytest.mark.parametrize("way", ["hold", "hold_answer"])
@pytest.mark.parametrize("path", ["/v1/clouds", "/v1/jobs"])
def test_who_stores_a_cloud_for_longer_than_it_is_waited_for_refers_to_what_is_there(make_daemon, in_s3, tmp_path, path, way):
    """Another host removes what nobody waits for any more: before the cloud has come to the store, which harms nobody, or
    after that."""
    flags, endpoint = in_s3
    holder = Holder(endpoint, way, ("PUT", "/clouds/"))
    host, other = make_daemon(*through(flags, endpoint, holder)), make_daemon(*flags)
    with concurrent.futures.ThreadPoolExecutor() as pool:
        begun = pool.submit(host.post, path, SMALL)
        assert holder.has_come.wait(PATIENCE_S)
        since = time.monotonic()
        forget(flags)
        wait_until(lambda: ask(flags, "SELECT removed FROM expected") == "1", "the sweep of the other host")
        wait_until(lambda: time.monotonic() - since > 1.2, "more than a while")
        holder.goes_on.set()
        reply = begun.result(PATIENCE_S)
    if way == "hold":
        assert reply.status == 201, reply.body
    else:
        assert reply.status == 503 and int(reply.headers["retry-after"]) > 0, reply.body
        assert other.curl("/v1/clouds").json["clouds"] == other.curl("/v1/jobs").json["jobs"] == []
    again = persist(lambda: host.post("/v1/clouds", SMALL))
    assert other.curl(f"/v1/clouds/{again.json['id']}/data").body == SMALL
    assert other.ended(host.submit(SMALL))["status"] == "successful"
    assert own_check(flags, tmp_path / "check") == (0, [])


def test_a_result_that_is_deleted_meanwhile_serves_no_other_job(make_daemon, in_s3, tmp_path):
    """One host has deleted half of the files when another one looks which there are, to take them over."""
    flags, endpoint = in_s3
    other = make_daemon(*flags)
    first = other.submit(SMALL, "?ratio=0.5")
    assert other.ended(first)["status"] == "successful"
    lister = Holder(endpoint, "hold", ("GET", f"jobs/{first}/outputs"))
    deleter = Holder(endpoint, "hold", ("DELETE", f"jobs/{first}/outputs/report.json"))
    host, late = make_daemon(*through(flags, endpoint, lister)), make_daemon(*through(flags, endpoint, deleter))
    with concurrent.futures.ThreadPoolExecutor() as pool:
        begun = pool.submit(host.submit, SMALL, "?ratio=0.5")
        assert lister.has_come.wait(PATIENCE_S)
        deleted = pool.submit(late.curl, f"/v1/jobs/{first}", "-X", "DELETE")
        assert deleter.has_come.wait(PATIENCE_S)
        lister.goes_on.set()
        job = begun.result(PATIENCE_S)
        ended = other.ended(job)
        deleter.goes_on.set()
        assert deleted.result(PATIENCE_S).status == 200
    assert ended["status"] == "successful" and content(other, job)
    assert content(other, job, "report.json") and content(host, job, "report.json")
    assert own_check(flags, tmp_path / "check") == (0, [])
