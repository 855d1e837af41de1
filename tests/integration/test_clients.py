# SPDX-License-Identifier: GPL-3.0-or-later
"""Every client that people have brings the same cloud and gets the same result; a real tus client, cut anywhere."""
import base64
import gzip
import hashlib
import http.client
import json
import os
import pathlib
import random
import re
import shutil
import socket
import subprocess
import threading

import pytest

from conftest import SMALL, sphere

NODE = pathlib.Path(__file__).parent.parent / "node"
NAME = hashlib.sha256(SMALL).hexdigest()
QUERY = "/v1/jobs?points=50&outputs=cloud"


@pytest.fixture(name="daemon", scope="module")
def make_shared_daemon(tmp_path_factory):
    from conftest import Daemon
    with Daemon(tmp_path_factory.mktemp("daemon"), "--result-cache=0") as daemon:
        yield daemon
        assert daemon.stop() == 0
        assert daemon.leftovers() == []


@pytest.fixture(name="files", scope="module")
def make_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    (folder / "plain").write_bytes(SMALL)
    (folder / "packed").write_bytes(gzip.compress(SMALL))
    return folder


def check(daemon, text):
    """The job in the answer has the same input and the same result as any other."""
    job = daemon.ended(json.loads(text)["id"])
    assert job["status"] == "successful" and job["input"]["sha256"] == NAME and job["input"]["bytes"] == len(SMALL)
    cloud = daemon.curl(f"/v1/jobs/{job['id']}/outputs/cloud.ply").headers["etag"]
    assert check.__dict__.setdefault("cloud", cloud) == cloud


def run(*command, **more):
    if not shutil.which(command[0]):
        pytest.skip(f"{command[0]} isn't installed")
    done = subprocess.run([str(part) for part in command], capture_output=True, check=False, timeout=60, **more)
    assert done.returncode == 0, (done.stdout, done.stderr)
    return done.stdout


def name_of(packed):
    return "packed" if packed else "plain"


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("framing", ["length", "chunked"])
@pytest.mark.parametrize("expect", ["", "100-continue"])
@pytest.mark.parametrize("how", ["-T", "--data-binary", "-F"])
def test_curl(daemon, files, how, expect, framing, packed):
    path = files / name_of(packed)
    what = {"-T": path, "--data-binary": f"@{path}", "-F": f"file=@{path}"}[how]
    more = ["-H", f"Expect: {expect}" if expect else "Expect:"]
    if framing == "chunked":
        more += ["-H", "Transfer-Encoding: chunked"]
    if packed and how == "-F":
        pytest.skip("curl doesn't compress a form")
    if packed:
        more += ["-H", "Content-Encoding: gzip"]
    check(daemon, run("curl", "-fsS", "-X", "POST", *more, how, what, daemon.url + QUERY))


def test_curl_from_a_pipe(daemon):
    check(daemon, run("curl", "-fsS", "-X", "POST", "-T", "-", daemon.url + QUERY, input=SMALL))


@pytest.mark.parametrize("packed", [False, True])
def test_wget(daemon, files, packed):
    more = ["--header=Content-Encoding: gzip"] if packed else []
    check(daemon, run("wget", "-q", "-O", "-", *more, f"--post-file={files / name_of(packed)}", daemon.url + QUERY))


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("framing", ["length", "chunked"])
def test_python(daemon, files, framing, packed):
    body = (files / name_of(packed)).read_bytes()
    pieces = (body[i:i + 777] for i in range(0, len(body), 777)) if framing == "chunked" else body
    connection = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=60)
    connection.request("POST", QUERY, body=pieces, headers={"Content-Encoding": "gzip"} if packed else {},
                       encode_chunked=framing == "chunked")
    reply = connection.getresponse()
    assert reply.status == 201
    check(daemon, reply.read())
    connection.close()


FETCH = """
const [url, path, coding, how] = process.argv.slice(1);
const fs = require("fs"), headers = coding ? {"Content-Encoding": coding} : {};
const body = how === "stream" ? require("stream").Readable.toWeb(fs.createReadStream(path))
  : how === "form" ? (() => { const f = new FormData(); f.append("file", new Blob([fs.readFileSync(path)])); return f; })()
  : fs.readFileSync(path);
fetch(url, {method: "POST", body, headers, duplex: "half"}).then(r => r.text()).then(t => process.stdout.write(t));
"""


@pytest.mark.parametrize("how, packed", [("buffer", False), ("buffer", True), ("stream", False), ("stream", True),
                                         ("form", False)])
def test_nodes_fetch(daemon, files, how, packed):
    check(daemon, run("node", "-e", FETCH, daemon.url + QUERY, files / name_of(packed), "gzip" if packed else "", how))


# ---------------------------------------------------------------------------------------------- as described

def test_the_four_commands_and_the_one_shot(daemon, tmp_path):
    """The commands of the description, as they are written but for host, id and file."""
    shell = {"cwd": tmp_path, "env": {**os.environ, "AT": daemon.url.removeprefix("http://")}}
    (tmp_path / "horse.ply").write_bytes(daemon.post("/v1/simplify?ratio=1", SMALL).body)
    (tmp_path / "in.ply").write_bytes((tmp_path / "horse.ply").read_bytes())

    def sh(command):
        return run("sh", "-ec", command, **shell).decode()
    created = sh("curl -sS -X POST -T horse.ply -D- \"$AT/v1/jobs?ratio=0.1&outputs=cloud,mesh\"")
    assert re.search(r"^HTTP/1.1 201 Created\r$", created, re.M)
    shell["env"]["JOB"] = re.search(r"^Location: (/v1/jobs/[0-9a-f-]{36})\r$", created, re.M)[1]
    events = sh("curl -sSN \"$AT$JOB/events\"")
    assert "event: status" in events and events.rstrip().split("\n\n")[-1].startswith("event: end")
    report = json.loads(sh("curl -sS \"$AT$JOB\" | jq .report"))
    assert report["points_in"] == 300 and report["points_out"] == 30 and report["mesh"]["watertight"]
    sh("curl -sSOJ \"$AT$JOB/outputs/mesh.ply\"")
    assert (tmp_path / "mesh.ply").read_bytes().startswith(b"ply\n")
    sh("curl -fsS -X POST -T in.ply \"$AT/v1/simplify?ratio=0.1\" -o out.ply")
    assert b"element vertex 30\n" in (tmp_path / "out.ply").read_bytes()


# ---------------------------------------------------------------------------------------------- tus-js-client

class Relay:
    """Stands at one address before a daemon that may come back at another, and cuts connections after some bytes."""

    def __init__(self, daemon, budgets, each_cut):
        self.daemon, self.budgets, self.each_cut, self.cuts = daemon, budgets, each_cut, 0
        self.lock = threading.Lock()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}"
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            threading.Thread(target=self.relay, args=(client,), daemon=True).start()

    def relay(self, client):
        with self.lock:
            budget = self.budgets.pop(0) if self.budgets else 1 << 60
            try:
                server = socket.create_connection(("127.0.0.1", self.daemon.port))
            except OSError:
                client.close()
                return
        threading.Thread(target=self.back, args=(server, client), daemon=True).start()
        try:
            while budget > 0:
                data = client.recv(min(budget, 16384))
                if not data:
                    break
                server.sendall(data)
                budget -= len(data)
        except OSError:
            pass
        if budget <= 0:
            with self.lock:
                self.cuts += 1
                self.each_cut(self.cuts)
        for end in (server, client):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def back(self, server, client):
        try:
            while data := server.recv(65536):
                client.sendall(data)
            client.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass


has_tus_js_client = pytest.mark.skipif(
    not shutil.which("node") or not (NODE / "node_modules" / "tus-js-client").exists(),
    reason="tus-js-client isn't installed: npm ci in tests/node")


@has_tus_js_client
@pytest.mark.parametrize("parts", [2, 5])
def test_tus_js_client_in_parts_side_by_side(make_daemon, tmp_path, parts):
    daemon, cloud = make_daemon(), sphere(60000)
    (tmp_path / "cloud").write_bytes(cloud)
    url = run("node", NODE / "upload_tus.js", daemon.url + "/v1/uploads", tmp_path / "cloud", "200000", parts).decode()
    upload = daemon.curl(url.strip().removeprefix(daemon.url), "-I", "-H", "Tus-Resumable: 1.0.0", "-o", "/dev/null")
    assert upload.headers["upload-concat"].count("/v1/uploads/") == parts
    assert daemon.curl(upload.headers["whittle-cloud"] + "/data").body == cloud
    assert sum("partial" in line for line in daemon.ask("SELECT concat FROM uploads")[0]) == 0


@has_tus_js_client
@pytest.mark.parametrize("protocol, chunk", [("tus-v1", ""), ("tus-v1", "200000"), ("ietf-draft-03", "200000"),
                                             ("ietf-draft-05", ""), ("ietf-draft-05", "200000")])
def test_tus_js_client_cut_at_random_places(make_daemon, tmp_path, protocol, chunk):
    daemon, chance = make_daemon(), random.Random(f"cut {chunk}")
    cloud = sphere(60000)
    (tmp_path / "cloud").write_bytes(cloud)

    def each_cut(number):
        if number % 3 == 0:
            daemon.kill()
            daemon.start()
    relay = Relay(daemon, [chance.randint(1, 300000) for _ in range(10)], each_cut)
    url = run("node", NODE / "upload_tus.js", relay.url + "/v1/uploads", tmp_path / "cloud", chunk, "",
              protocol).decode().strip()
    assert url.startswith(relay.url + "/v1/uploads/") and relay.cuts >= 3
    path = url.removeprefix(relay.url)
    upload = daemon.curl(path).json
    if protocol != "tus-v1" and upload["cloud"] is None:  # it calls no piece of a file the last one but the whole
        daemon.curl(path, "-X", "PATCH", "-H", "Upload-Complete: ?1", "-H", f"Upload-Offset: {len(cloud)}",
                    "-H", "Content-Type: application/partial-upload", "--data-binary", "")
        upload = daemon.curl(path).json
    assert upload["cloud"] == f"/v1/clouds/{hashlib.sha256(cloud).hexdigest()}"
    assert base64.b64encode(b"a cloud.xyz").decode() in upload["metadata"]
    assert daemon.curl(upload["cloud"] + "/data").body == cloud
    job = daemon.post("/v1/jobs", json.dumps({"input": upload["cloud"], "params": {"points": 100}}).encode(),
                      "-H", "Content-Type: application/json")
    assert job.status == 201
    relay.listener.close()
