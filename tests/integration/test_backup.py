# SPDX-License-Identifier: GPL-3.0-or-later
"""A backup that is made while jobs come, run and go, put back elsewhere: complete, and served as before."""
import os
import pathlib
import shutil
import subprocess
import threading

import pytest

import conftest

DEPLOY = pathlib.Path(__file__).resolve().parents[2] / "deploy"
pytestmark = pytest.mark.skipif(not shutil.which("sqlite3"), reason="sqlite3 is not installed")


def back_up(daemon, path):
    subprocess.run([DEPLOY / "backup.sh", daemon.data, path], check=True)
    return path


def put_back(path, folder):
    """Another daemon's folder with the backup in it, checked by restore.sh."""
    daemon = conftest.Daemon(folder)
    folder.mkdir(exist_ok=True)
    done = subprocess.run([DEPLOY / "restore.sh", path, daemon.data], capture_output=True, text=True, check=False,
                          env=dict(os.environ, WHITTLED=str((conftest.BUILD / "whittled").resolve())))
    assert done.returncode == 0, done.stdout + done.stderr
    return daemon


def test_a_backup_under_load_is_complete(daemon, tmp_path):
    kept = [daemon.submit(conftest.SMALL, f"?points={40 + i}&label=kept") for i in range(3)]
    before = {job: daemon.ended(job) for job in kept}
    outputs = {job: daemon.curl(f"/v1/jobs/{job}/outputs/mesh.ply").body for job in kept}
    stop = threading.Event()

    def traffic():
        i = 0
        while not stop.is_set():
            i += 1
            job = daemon.submit(conftest.SMALL + f"0 0 {i}\n".encode(), "?points=30")
            if i % 2:
                daemon.curl(f"/v1/jobs/{job}", "-X", "DELETE")
    thread = threading.Thread(target=traffic)
    thread.start()
    try:
        backups = [back_up(daemon, tmp_path / f"{i}.tar") for i in range(3)]
    finally:
        stop.set()
        thread.join()
    assert backups[0].stat().st_mode & 0o077 == 0
    for i, path in enumerate(backups):
        restored = put_back(path, tmp_path / f"restored{i}").start()
        try:
            for job in kept:
                after = restored.job(job)
                assert after["status"] == "successful" and after["report"] == before[job]["report"]
                assert restored.curl(f"/v1/jobs/{job}/outputs/mesh.ply").body == outputs[job]
            # Everything else that the backup knows of comes to its end.
            for job in restored.curl("/v1/jobs?limit=500").json["jobs"]:
                assert restored.ended(job["id"])["status"] in ("successful", "dismissed"), job
        finally:
            restored.stop()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_what_is_put_back_belongs_to_the_folders_owner(daemon, tmp_path):
    daemon.ended(daemon.submit(conftest.SMALL, "?points=40"))
    path = back_up(daemon, tmp_path / "backup.tar")
    folder = tmp_path / "restored" / "data"
    folder.mkdir(parents=True)
    os.chown(folder, 12345, 12345)
    put_back(path, folder.parent)
    entries = [folder, *folder.rglob("*")]
    assert len(entries) > 5 and {p.lstat().st_uid for p in entries} == {12345}


def test_nothing_is_put_back_over_data(daemon, tmp_path):
    path = back_up(daemon, tmp_path / "backup.tar")
    done = subprocess.run([DEPLOY / "restore.sh", path, daemon.data], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "not empty" in done.stderr


def test_a_damaged_database_is_not_backed_up(daemon, tmp_path):
    daemon.submit(conftest.SMALL)
    daemon.stop()
    database = daemon.data / "whittled.db"
    database.write_bytes(database.read_bytes()[:4096] + os.urandom(database.stat().st_size - 4096))
    done = subprocess.run([DEPLOY / "backup.sh", daemon.data, tmp_path / "b.tar"], capture_output=True, check=False)
    assert done.returncode != 0 and not list(tmp_path.glob("b.tar*"))
