# SPDX-License-Identifier: GPL-3.0-or-later
"""Disks that fill, and files that grow too long: in uploads, in jobs, in the database."""
import os
import subprocess

import pytest

from conftest import SMALL, Daemon, sphere

SMALL_DISK = "mount -t tmpfs -o size=1500k whittled \"$DATA\" && exec \"$@\""


@pytest.fixture(name="cramped")
def make_cramped(tmp_path):
    """A daemon whose data folder is a file system of 1.5 MB that it alone sees."""
    data = tmp_path / "data"
    data.mkdir()
    prefix = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"]),
              "env", f"DATA={data}", "sh", "-c", SMALL_DISK, "sh"]
    if subprocess.run([*prefix, "true"], capture_output=True, check=False).returncode:
        pytest.skip("mounting a file system of one's own isn't allowed here")
    daemon = Daemon(tmp_path, "--min-free", "0")
    daemon.prefix = prefix
    yield daemon.start()
    daemon.stop()
    print(daemon.log_text())


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
    assert job["status"] == "failed" and job["attempt"] == 1
    problem = job["problem"]
    assert problem["type"] == "/problems/storage-full" and problem["status"] == 507
    assert "No space left on device" in problem["detail"]
    assert cramped.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").status == 200
    assert cramped.post("/v1/simplify?ratio=0.5", SMALL).status == 200


def test_a_file_longer_than_a_job_may_write(make_daemon):
    daemon = make_daemon("--job-file-bytes", "100K")
    job = daemon.ended(daemon.submit(sphere(20000), "?ratio=0.9&outputs=xyz"))
    assert job["status"] == "failed"
    assert job["problem"]["type"] == "/problems/storage-full" and "File too large" in job["problem"]["detail"]
    reply = daemon.post("/v1/simplify?ratio=0.9&output=xyz", sphere(20000))
    assert reply.status == 507 and reply.slug == "storage-full"
    assert daemon.ended(daemon.submit(SMALL))["status"] == "successful" and daemon.leftovers() == []
