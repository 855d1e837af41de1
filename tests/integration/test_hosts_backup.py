# SPDX-License-Identifier: GPL-3.0-or-later
"""deploy/hosts: backup and restore of what hosts share, with real PostgreSQL and a real S3 store."""
import importlib.util
import os
import pathlib
import socket
import subprocess

import pytest

from conftest import BUILD, SMALL
from test_hosts import PROGRAMS, by_host, content, make_server  # noqa: F401, a fixture

FOLDER = pathlib.Path(__file__).parents[2] / "deploy/hosts"
spec = importlib.util.spec_from_file_location("bucket", FOLDER / "bucket.py")
bucket = importlib.util.module_from_spec(spec)
spec.loader.exec_module(bucket)


def run(*command):
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False,
                          env=dict(os.environ, WHITTLED=str(BUILD.resolve() / "whittled"),
                                   PATH=f"{PROGRAMS}:{os.environ['PATH']}"))
    assert done.returncode == 0, (command, done.stdout, done.stderr)
    return done.stdout.splitlines()


@pytest.fixture(name="blobs")
def make_bucket():
    """The URL of a bucket of this test's own, which keeps what is removed."""
    if "WHITTLE_BLOBS" not in os.environ:
        pytest.skip("WHITTLE_BLOBS names no S3 store")
    url = f"s3://backup-{os.getpid()}/a-place?{os.environ['WHITTLE_BLOBS'].partition('?')[2]}"
    bucket.Bucket(url).ask("PUT")
    run(FOLDER / "bucket.py", "keep", url)
    return url


def test_the_bucket_may_be_named_by_the_host(blobs, monkeypatch):
    """BUCKET.localhost is this machine, as curl has it."""
    found = socket.getaddrinfo
    monkeypatch.setattr(socket, "getaddrinfo", lambda host, *rest, **named: found(
        "127.0.0.1" if host.endswith(".localhost") else host, *rest, **named))
    named = bucket.Bucket(by_host(blobs))
    assert b"<ListBucketResult" in named.ask("GET") and list(named.removed()) == []


def database(server, name):
    run(PROGRAMS / "createdb", "-h", server, "-U", "whittle", name)
    return f"postgresql://whittle@/{name}?host={server}"


def test_a_backup_is_put_back(server, blobs, make_daemon, tmp_path):  # noqa: F811
    before, after = database(server, "before"), database(server, "after")
    run(BUILD / "whittled", "migrate", "--catalog", before)
    flags = ("--blobs", blobs, "--result-cache=0", "--lease", "500ms")
    host = make_daemon("--catalog", before, *flags)
    jobs = [host.submit(SMALL + b"# %d\n" % i, "?ratio=0.5&outputs=cloud,mesh") for i in range(3)]
    for job in jobs:
        assert host.ended(job)["status"] == "successful"
    contents = {(job, name): content(host, job, name) for job in jobs for name in ("cloud.ply", "mesh.ply")}
    run(FOLDER / "backup.sh", before, tmp_path / "backup.dump")
    assert (tmp_path / "backup.dump").stat().st_mode & 0o777 == 0o600

    assert host.curl(f"/v1/jobs/{jobs[0]}", "-X", "DELETE").status == 200  # and its bytes go
    later = host.submit(SMALL + b"# later\n")
    assert host.ended(later)["status"] == "successful" and host.stop() == 0
    said = run(FOLDER / "restore.sh", tmp_path / "backup.dump", after, blobs)
    assert "objects that were removed are back" in said[0] and not said[0].startswith("bucket: 0 ")
    assert said[-1].startswith("checked 3 jobs, 3 clouds, 9 outputs: 0 damaged, ")
    assert all(line.endswith(" belongs to nothing") for line in said[1:-1])

    again = make_daemon("--catalog", after, *flags)
    assert {key: content(again, *key) for key in contents} == contents
    assert again.curl(f"/v1/jobs/{later}").status == 404
    assert again.ended(again.submit(SMALL))["status"] == "successful"


def test_a_database_that_is_not_empty_stays_as_it_is(server, tmp_path):  # noqa: F811
    there = database(server, "there")
    run(BUILD / "whittled", "migrate", "--catalog", there)
    run(FOLDER / "backup.sh", there, tmp_path / "backup.dump")
    done = subprocess.run([FOLDER / "restore.sh", tmp_path / "backup.dump", there, "s3://none/?endpoint=http://127.0.0.1:1"],
                          capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "already exists" in done.stderr
