# SPDX-License-Identifier: GPL-3.0-or-later
"""whittle.Client, of the standard library, against a real service: uploads that break, waits, outputs, problems."""
import collections
import hashlib
import http.client
import pathlib
import subprocess
import sys

import pytest

from conftest import SMALL, sphere

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "api/python"))
import whittle  # noqa: E402  pylint: disable=wrong-import-position
import whittle.client as module  # noqa: E402  pylint: disable=wrong-import-position

NAME = hashlib.sha256(SMALL).hexdigest()


@pytest.fixture(name="client")
def make_client(daemon):
    return whittle.Client(daemon.url)


def test_a_cloud_comes_and_its_outputs_go(client, tmp_path):
    (tmp_path / "ball.xyz").write_bytes(SMALL)
    told = []
    cloud = client.upload(tmp_path / "ball.xyz", progress=lambda sent, total: told.append((sent, total)))
    assert cloud == NAME and told[0] == (0, len(SMALL)) and told[-1] == (len(SMALL), len(SMALL))
    job = client.simplify(cloud, ratio=0.5, outputs=["cloud", "mesh"], label="ball")
    seen = []
    job = client.wait(job, progress=lambda document: seen.append(document["status"]))
    assert job["status"] == seen[-1] == "successful" and job["label"] == "ball" and job["params"]["ratio"] == 0.5
    client.save(job, "mesh.ply", tmp_path / "mesh.ply")
    assert (tmp_path / "mesh.ply").read_bytes() == client.output(job, "mesh.ply")
    assert not list(tmp_path.glob("*.part"))
    assert client.clouds()[0]["id"] == NAME
    client.delete(job)
    with pytest.raises(whittle.Problem) as refused:
        client.job(job)
    assert refused.value.status == 410


def test_outputs_are_arrays(client):
    numpy = pytest.importorskip("numpy", reason="python3-numpy isn't installed: make deps")
    job = client.wait(client.simplify(SMALL, ratio=0.5))
    points = client.array(job)
    assert len(points) == 150 and points.dtype.names == ("x", "y", "z")
    assert numpy.allclose(points["x"] ** 2 + points["y"] ** 2 + points["z"] ** 2, 1, atol=1e-5)
    assert (client.array(job, points=7) == points[:7]).all()


def test_problems_carry_their_document(client):
    for call, status, slug in ((lambda: client.simplify(SMALL, ratio=7), 400, "invalid-parameter"),
                               (lambda: client.simplify("0" * 64, ratio=0.5), 404, "no-such-cloud"),
                               (lambda: client.upload(b"\x89PNG\r\n\x1a\n" + bytes(100)), 415, "unsupported-format"),
                               (lambda: client.output("01900000-0000-7000-8000-000000000000", "a"), 404, "no-such-job")):
        with pytest.raises(whittle.Problem) as refused:
            call()
        assert refused.value.status == status and refused.value.document["type"].endswith(slug)
    assert refused.value.document["detail"] in str(refused.value)


def test_lists_may_be_texts_as_on_the_command_line(client):
    job = client.wait(client.simplify(SMALL, levels="0.5,0.25", outputs="cloud,report", where="z>0,x>0", surface="open",
                                      viewpoint="0,0,5"))
    assert job["status"] == "successful"
    assert job["params"]["levels"] == [0.5, 0.25] and job["params"]["outputs"] == ["cloud", "report"]
    assert job["params"]["where"] == ["z>0", "x>0"] and job["params"]["viewpoint"] == [0, 0, 5]
    batch = client.batch([NAME], levels="0.5,0.25", where="z > 0")
    assert client.wait_batch(batch)["counts"]["successful"] == 1
    with pytest.raises(whittle.Problem, match=r'params\.levels: "half" is not allowed; in JSON it takes an array of numbers'):
        client.simplify(NAME, levels="half")


def test_an_upload_goes_on_where_the_connection_broke(client, monkeypatch):
    """Every second reply is lost, after the service has taken the piece or before."""
    cloud = sphere(2000)
    monkeypatch.setattr(module, "PIECE_BYTES", 10000)
    count, real = [0], client._open

    def breaking(method, path, body=None, headers=None):
        if method != "PATCH":
            return real(method, path, body, headers)
        count[0] += 1
        if count[0] % 4 == 1:
            raise ConnectionResetError("before the piece")
        connection, reply = real(method, path, body, headers)
        if count[0] % 4 == 3:
            connection.close()
            raise http.client.RemoteDisconnected("after the piece")
        return connection, reply

    monkeypatch.setattr(client, "_open", breaking)
    assert client.upload(cloud) == hashlib.sha256(cloud).hexdigest()
    assert count[0] > len(cloud) // 10000


class Reply:
    """What a proxy says, or somebody else."""

    def __init__(self, status, headers=None):
        self.status, self.headers = status, headers or {}

    def read(self):
        return b"<html>Bad Gateway</html>"

    def close(self):
        pass


def test_what_a_proxy_says_in_between_holds_up_neither_upload_nor_reading(client, monkeypatch):
    cloud = sphere(2000)
    monkeypatch.setattr(module, "PIECE_BYTES", 10000)
    monkeypatch.setattr(module.time, "sleep", lambda seconds: None)
    count, real = collections.Counter(), client._open

    def absent(method, path, body=None, headers=None):
        count[method] += 1
        status = (503, 502, 504, 409, 423)[count[method] % 5] if method == "PATCH" else 503
        every_second = count[method] % 2 and method != "POST"
        return (Reply(status), Reply(status)) if every_second else real(method, path, body, headers)

    monkeypatch.setattr(client, "_open", absent)
    assert client.upload(cloud) == hashlib.sha256(cloud).hexdigest()
    assert client.clouds()[0]["id"] and count["PATCH"] > len(cloud) // 5000
    monkeypatch.setattr(client, "_open", lambda *_: (Reply(503), Reply(503)))
    with pytest.raises(whittle.Problem) as refused:
        client.clouds()
    assert refused.value.status == 503


@pytest.mark.parametrize("offset, raised", [("0", OSError), (None, ValueError), ("-1", ValueError), ("much", ValueError)])
def test_an_upload_of_which_nothing_is_kept_ends(client, monkeypatch, offset, raised):
    monkeypatch.setattr(module.time, "sleep", lambda seconds: None)
    pieces = []

    def hostile(method, path, body=None, headers=None):
        if method == "PATCH":
            pieces.append(body)
        assert len(pieces) < 50, "endless"
        reply = Reply(204, {"Location": "/v1/uploads/1", "Upload-Offset": "0" if method == "HEAD" else offset})
        return reply, reply

    monkeypatch.setattr(client, "_open", hostile)
    with pytest.raises(raised):
        client.upload(SMALL)
    assert len(pieces) == (1 if raised is ValueError else client.retries + 1)


def test_an_upload_is_resumed_by_another_client(daemon, client, monkeypatch):
    cloud, places = sphere(2000), []
    monkeypatch.setattr(module, "PIECE_BYTES", 10000)

    def stop(sent, total):
        if sent > total // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        client.upload(cloud, progress=stop, started=places.append)
    told = []
    other = whittle.Client(daemon.url)
    assert other.upload(cloud, resume=places[0], progress=lambda sent, total: told.append(sent)) == \
        hashlib.sha256(cloud).hexdigest()
    assert told[0] > len(cloud) // 2


def test_a_client_that_can_not_reach_the_service_says_so(daemon):
    with pytest.raises(ValueError):
        whittle.Client("localhost:8080")
    client = whittle.Client(daemon.url, retries=1)
    daemon.stop()
    with pytest.raises(OSError):
        client.upload(SMALL)


def test_tokens_and_a_base_path(make_daemon, tmp_path):
    (tmp_path / "tokens").write_text(f"me:submit,read:{hashlib.sha256(b'secret').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tmp_path / "tokens", "--base-path", "/points")
    client = whittle.Client(daemon.url + "/points", token="secret")
    assert client.wait(client.simplify(SMALL, ratio=0.5))["status"] == "successful"
    with pytest.raises(whittle.Problem) as refused:
        whittle.Client(daemon.url + "/points").simplify(SMALL)
    assert refused.value.status == 401


def test_a_job_that_fails_or_takes_too_long_is_raised(client, make_daemon):
    flat = "".join(f"{i} 0 0\n" for i in range(50)).encode()
    with pytest.raises(whittle.Problem) as failed:
        client.wait(client.simplify(flat, outputs=["mesh"], surface="closed"))
    assert "line" in str(failed.value)
    busy = make_daemon("--workers", "1")
    other = whittle.Client(busy.url)
    other.simplify(sphere(400000), outputs=["mesh"])
    with pytest.raises(TimeoutError):
        other.wait(other.simplify(SMALL), timeout=0)


def test_several_clouds_are_one(client):
    lines = SMALL.decode().splitlines(keepends=True)
    parts = ["".join(lines[:100]).encode(), "".join(lines[100:]).encode()]
    whole = client.wait(client.simplify(SMALL, ratio=0.5, outputs=["cloud", "mesh"]))
    job = client.wait(client.simplify(parts, ratio=0.5, outputs=["cloud", "mesh"]))
    assert job["report"]["points_in"] == 300 and job["input"]["format"] == "tar"
    for name in ("cloud.ply", "mesh.ply"):
        assert client.output(job, name) == client.output(whole, name)
    again = client.simplify(parts, ratio=0.5, outputs=["cloud", "mesh"])
    assert again["status"] == "successful" and again["input"]["cloud"] == job["input"]["cloud"]


def test_what_needs_numpy_says_how_to_get_it():
    code = "import sys; sys.modules['numpy'] = None\nimport whittle; whittle.Client\nwhittle.simplify"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=pathlib.Path(whittle.__file__).parents[1])
    last = done.stderr.strip().splitlines()[-1]
    assert last == "ModuleNotFoundError: whittle.simplify needs numpy: apt install python3-numpy, or pip install numpy"


def test_a_batch_is_a_job_for_each_cloud(client):
    lines = SMALL.decode().splitlines(keepends=True)
    parts = ["".join(lines[:150]).encode(), "".join(lines[150:]).encode()]
    seen = []
    batch = client.batch(parts, label="halves", ratio=0.5)
    ended = client.wait_batch(batch, progress=lambda document: seen.append(document["progress"]))
    assert ended["status"] == "successful" and ended["label"] == "halves" and seen[-1] == 100
    for job, part in zip(ended["jobs"], parts):
        assert job["cloud"].endswith(client.upload(part)) and len(client.array(job)) == 75
    assert client.delete_batch(ended)["counts"]["successful"] == 2
    with pytest.raises(whittle.Problem) as refused:
        client.wait_batch(batch)
    assert refused.value.status == 404
    with pytest.raises(whittle.Problem):
        client.batch([])


def test_what_is_wrong_in_a_list_of_clouds_is_told(client):
    cloud = client.upload(SMALL)
    for join, status, part in ((["nowhere"], 400, "join[0]"), ("x", 400, "join: a list"), ([7], 400, "join[0]"),
                               (["/v1/clouds/" + "0" * 64], 404, "there is no cloud 000"),
                               ([f"/v1/clouds/{cloud}"] * 256, 400, "up to 255")):
        with pytest.raises(whittle.Problem) as refused:
            client._document("POST", f"/v1/clouds/{cloud}/jobs", {"join": join})
        assert refused.value.status == status and part in refused.value.document["detail"]
    las = pathlib.Path(__file__).parent.parent / "fixtures/valid/las-2/input.las"
    job = client.simplify([las, SMALL], ratio=0.5)
    told = client.wait(job)["report"]["left_out"]
    assert any("cloud-2 has no intensity" in loss["what"] for loss in told), told


def test_a_list_of_clouds_that_can_not_be_one_fails_with_the_reason(client):
    bad = client.upload(SMALL + b"1 2\n")
    with pytest.raises(whittle.Problem) as failed:
        client.wait(client.simplify([SMALL, bad], ratio=0.5))
    assert failed.value.document["type"].endswith("malformed-cloud") and "cloud-2: " in str(failed.value)
