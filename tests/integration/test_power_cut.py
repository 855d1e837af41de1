# SPDX-License-Identifier: GPL-3.0-or-later
"""Power cuts: at each moment the disk has nothing but what was flushed, and that is whole, and holds what was answered."""
import hashlib
import os
import pathlib
import subprocess

import pytest

from conftest import SANITIZED, SMALL, Daemon, wait_until

pytestmark = pytest.mark.skipif(SANITIZED, reason="sanitizers come first among what is preloaded")
TUS = ("-H", "Tus-Resumable: 1.0.0")
PIECE = ("-X", "PATCH", *TUS, "-H", "Content-Type: application/offset+octet-stream")
OTHER = SMALL + b"0 0 1\n"
VOLATILE = ("whittled.db-shm", "lock", ".", "..")


@pytest.fixture(name="library", scope="module")
def make_library(tmp_path_factory):
    library = tmp_path_factory.mktemp("power_cut") / "power_cut.so"
    source = pathlib.Path(__file__).with_name("power_cut.c")
    subprocess.run(["cc", "-std=c11", "-D_GNU_SOURCE", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-pthread", "-o",
                    library, source], check=True)
    return library


class Disk:
    """The records of a daemon, and the folders that a power cut would leave."""

    def __init__(self, daemon, records):
        self.daemon, self.records = daemon, records

    def now(self):
        """How many flushes are done."""
        return sum(name != "part" for name in os.listdir(self.records))

    def cut(self, moment, folder):
        """What the first `moment` flushes leave, as a daemon's folder that doesn't run."""
        files, folders = {}, {}
        for i in range(moment):
            head, _, rest = (self.records / f"{i:06}").read_bytes().partition(b"\n")
            kind, inode = head.split()
            (folders if kind == b"folder" else files)[inode] = rest

        def build(inode, path):
            path.mkdir(parents=True)
            for line in folders.get(inode, b"").splitlines():
                kind, entry, name = line.split(b" ", 2)
                if name.decode() in VOLATILE:
                    continue
                if kind == b"d":
                    build(entry, path / name.decode())
                else:
                    (path / name.decode()).write_bytes(files.get(entry, b""))
                    (path / name.decode()).chmod(0o600)
        left = Daemon(folder)
        build(str(self.daemon.data.stat().st_ino).encode(), left.data)
        return left


@pytest.fixture(name="disk")
def make_disk(tmp_path, library):
    (tmp_path / "records").mkdir()
    daemon = Daemon(tmp_path, "--workers", "1")
    daemon.prefix = ("env", f"LD_PRELOAD={library}", f"POWER_CUT={tmp_path / 'records'}")
    yield Disk(daemon.start(), tmp_path / "records")
    if daemon.process.poll() is None:
        daemon.kill()
    print(daemon.log_text()[-20000:])


def test_what_was_answered_is_there_after_a_power_cut(disk, tmp_path):
    daemon, answered, first = disk.daemon, [], disk.now()

    def note(look):
        answered.append((disk.now(), look))
    cloud = daemon.post("/v1/clouds", SMALL + b"0 0 0\n").headers["location"]
    note(lambda after: after.curl(f"{cloud}/data").body == SMALL + b"0 0 0\n")
    upload = daemon.curl("/v1/uploads", "-X", "POST", *TUS, "-H", f"Upload-Length: {len(OTHER)}").headers["location"]
    assert daemon.post(upload, OTHER[:4000], *PIECE, "-H", "Upload-Offset: 0").status == 204
    note(lambda after: after.curl(upload, *TUS, "-I").headers["upload-offset"] == "4000")
    job_id = daemon.submit(SMALL, "?ratio=0.5")
    note(lambda after: after.ended(job_id)["status"] == "successful")
    daemon.ended(job_id)
    result = daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply").body
    note(lambda after: after.job(job_id)["attempt"] == 1
         and after.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply").body == result)
    again = daemon.submit(SMALL, "?ratio=0.5")  # the earlier result serves
    note(lambda after: after.curl(f"/v1/jobs/{again}/outputs/cloud.ply").body == result)
    assert daemon.post(upload, OTHER[4000:], *PIECE, "-H", "Upload-Offset: 4000").status == 204
    note(lambda after: after.curl(f"/v1/clouds/{hashlib.sha256(OTHER).hexdigest()}/data").body == OTHER)
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").status == 200
    note(lambda after: after.curl(f"/v1/jobs/{job_id}").status == 410)
    wait_until(lambda: daemon.curl("/v1/jobs?status=running").json["jobs"] == [], "rest")
    daemon.kill()
    last = disk.now()
    assert last - first > 15
    for moment in range(first, last + 1):  # between any two flushes
        status, lines = disk.cut(moment, tmp_path / f"cut{moment}").check()
        assert status == 0, (moment, lines)
    for i, (moment, look) in enumerate(answered):
        (tmp_path / f"answered{i}").mkdir()
        after = disk.cut(moment, tmp_path / f"answered{i}").start()
        try:
            assert look(after), (i, moment)
        finally:
            after.kill()
