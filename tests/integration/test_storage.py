# SPDX-License-Identifier: GPL-3.0-or-later
"""Disks that fill, and files that grow too long: in uploads, in jobs, in the database."""
import os
import pathlib
import subprocess

import pytest

from conftest import HOSTS, SMALL, Daemon, sphere, wait_until

SMALL_DISK = "mount -t tmpfs -o size=$SIZE whittled \"$DATA\" && exec \"$@\""


def on_a_disk_of(size, tmp_path, *flags):
    """A daemon whose data folder is a file system that it alone sees."""
    data = tmp_path / "data"
    data.mkdir()
    prefix = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"]),
              "env", f"DATA={data}", f"SIZE={size}", "sh", "-c", SMALL_DISK, "sh"]
    if subprocess.run([*prefix, "true"], capture_output=True, check=False).returncode:
        pytest.skip("mounting a file system of one's own isn't allowed here")
    daemon = Daemon(tmp_path, *flags)
    daemon.prefix = prefix
    try:
        yield daemon.start()
    finally:
        daemon.stop()
        print(daemon.log_text())


@pytest.fixture(name="cramped")
def make_cramped(tmp_path):
    yield from on_a_disk_of("1500k", tmp_path, "--min-free", "0")


@pytest.fixture(name="reserved")
def make_reserved(tmp_path):
    yield from on_a_disk_of("8M", tmp_path, "--min-free", "4M", "--principal-bytes", "0")


def inside(daemon):
    """The data folder as the daemon sees it."""
    return pathlib.Path(f"/proc/{daemon.process.pid}/root{daemon.data}")


def free_bytes(daemon):
    figures = os.statvfs(inside(daemon))
    return figures.f_bavail * figures.f_frsize


def test_a_disk_that_fills_during_the_upload(cramped):
    cloud = sphere(80000)  # longer than the disk
    for query in ("-H", "Transfer-Encoding: chunked"), ():
        reply = cramped.post("/v1/jobs", cloud, *query)
        assert reply.status == 507 and reply.slug == "storage-full"
    assert cramped.post("/v1/simplify?ratio=0.5", SMALL).status == 200


def test_a_disk_that_fills_during_the_job(cramped):
    cloud = sphere(25000)  # in and out together are longer than the disk
    job_id = cramped.submit(cloud, "?ratio=1&outputs=cloud,xyz,mesh")
    job = cramped.ended(job_id)
    assert job["status"] == "failed" and job["attempt"] == (3 if HOSTS else 1)  # another host might have more room
    problem = job["problem"]
    assert problem["type"] == "/problems/storage-full" and problem["status"] == 507
    assert "No space left on device" in problem["detail"]
    assert cramped.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").status == 200
    assert cramped.post("/v1/simplify?ratio=0.5", SMALL).status == 200


def test_a_full_disk_is_not_ready(cramped):
    assert cramped.curl("/readyz").status == 200
    filler = inside(cramped) / "filler"
    with pytest.raises(OSError), open(filler, "wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    wait_until(lambda: cramped.curl("/readyz").status != 200, "the end of readiness")
    assert cramped.curl("/readyz").slug == "storage-full"
    assert cramped.post("/v1/jobs", SMALL).slug == "storage-full"
    assert cramped.curl("/healthz").status == 200
    filler.unlink()
    wait_until(lambda: cramped.curl("/readyz").status == 200, "readiness")
    assert cramped.ended(cramped.submit(SMALL))["status"] == "successful"


TUS = ("-H", "Tus-Resumable: 1.0.0")


def test_what_is_to_stay_free_stays_free_while_bodies_of_no_known_length_come(reserved):
    cloud = sphere(250000)  # 7 MB
    chunked = ("-H", "Transfer-Encoding: chunked")
    for path in ("/v1/jobs", "/v1/clouds"):
        reply = reserved.post(path, cloud, *chunked)
        assert (reply.status, reply.slug) == (507, "storage-full")
        wait_until(lambda: free_bytes(reserved) > 7 << 20, "the room of what came, which goes after the answer")
    upload = reserved.curl("/v1/uploads", "-X", "POST", *TUS, "-H", "Upload-Defer-Length: 1").headers["location"]
    piece = ("-H", "Content-Type: application/offset+octet-stream", "-H", "Upload-Offset: 0", "-X", "PATCH")
    reply = reserved.post(upload, cloud, *TUS, *piece, *chunked)
    assert (reply.status, reply.slug) == (507, "storage-full")
    assert 2 << 20 < free_bytes(reserved) < 5 << 20  # what came is kept, and the rest is free
    assert reserved.post(upload, cloud, *TUS, *piece).slug == "storage-full"  # refused by its length
    assert reserved.curl(upload, "-X", "DELETE", *TUS).status == 204
    assert reserved.ended(reserved.submit(SMALL))["status"] == "successful"


def test_a_file_longer_than_a_job_may_write(make_daemon):
    daemon = make_daemon("--job-file-bytes", "100K")
    job = daemon.ended(daemon.submit(sphere(20000), "?ratio=0.9&outputs=xyz"))
    assert job["status"] == "failed"
    assert job["problem"]["type"] == "/problems/storage-full" and "File too large" in job["problem"]["detail"]
    reply = daemon.post("/v1/simplify?ratio=0.9&output=xyz", sphere(20000))
    assert reply.status == 507 and reply.slug == "storage-full"
    assert daemon.ended(daemon.submit(SMALL))["status"] == "successful" and daemon.leftovers() == []
