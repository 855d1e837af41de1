# SPDX-License-Identifier: GPL-3.0-or-later
"""The service under valgrind, through a job, a cancelled one, a resumable upload, a drain and a restart: no invalid
access, nothing lost.  The jobs themselves run without it.     (make valgrind)
"""
import pathlib
import shutil
import subprocess

import pytest

from conftest import SANITIZED, SMALL

VALGRIND = ("valgrind", "-q", "--error-exitcode=9", "--leak-check=full", "--show-leak-kinds=definite",
            "--errors-for-leak-kinds=definite", "--child-silent-after-fork=yes")
# A job's process is still under valgrind when it is confined, which needs what confinement forbids.
UNCONFINED = ("--job-memory", "1024T", "--worker-sandbox=off")

pytestmark = pytest.mark.skipif(SANITIZED or not shutil.which("valgrind"), reason="needs valgrind and a plain build")


@pytest.fixture(name="pidfd", scope="module")
def make_pidfd(tmp_path_factory):
    library = tmp_path_factory.mktemp("pidfd") / "pidfd.so"
    source = pathlib.Path(__file__).with_name("pidfd.c")
    subprocess.run(["cc", "-D_GNU_SOURCE", "-shared", "-fPIC", "-pthread", "-o", library, source], check=True)
    return library


@pytest.fixture(name="watched")
def make_watched(make_daemon, pidfd):
    daemon = make_daemon(*UNCONFINED, "--drain-timeout", "0", "--workers", "2")
    assert daemon.stop() == 0
    daemon.prefix = ("env", f"LD_PRELOAD={pidfd}", *VALGRIND)
    return daemon.start()


def end(daemon):
    """A drain, and what valgrind says of it."""
    status = daemon.stop()
    assert status == 0 and "==" not in daemon.log_text(), daemon.log_text()[-8000:]


def test_a_job_and_what_it_leaves(watched):
    job_id = watched.submit(SMALL, "?outputs=cloud,mesh,report")
    assert watched.ended(job_id)["status"] == "successful"
    outputs = watched.curl(f"/v1/jobs/{job_id}/outputs").json["outputs"]
    for output in outputs:
        path = f"/v1/jobs/{job_id}/outputs/{output['name']}"
        whole = watched.curl(path)
        assert whole.status == 200 and len(whole.body) == output["bytes"]
        assert watched.curl(path, "-H", "Range: bytes=3-9").body == whole.body[3:10]
    assert watched.curl(f"/v1/jobs/{job_id}/events").status == 200
    assert watched.post("/v1/simplify?ratio=0.3", SMALL).status == 200
    assert watched.post("/v1/jobs", b"\x89PNG\r\n\x1a\n").status == 415
    for path in ("/", "/docs", "/openapi.json", "/v1/parameters", "/v1/info", "/v1/jobs", "/v1/clouds", "/metrics", "/readyz"):
        assert watched.curl(path).status == 200
    assert watched.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").status == 200
    end(watched)


def test_a_cancelled_job_a_drain_and_a_restart(watched, large):
    cancelled = watched.submit(large, "?outputs=mesh")
    watched.wait_for(cancelled, "running")
    assert watched.curl(f"/v1/jobs/{cancelled}", "-X", "DELETE").status in (200, 202)
    assert watched.ended(cancelled)["status"] == "dismissed"
    requeued = watched.submit(large, "?outputs=mesh")
    watched.wait_for(requeued, "running")
    end(watched)
    watched.start()
    watched.wait_for(requeued, "running")
    assert watched.curl(f"/v1/jobs/{requeued}", "-X", "DELETE").status in (200, 202)
    assert watched.ended(requeued)["status"] == "dismissed"
    end(watched)


def test_a_resumable_upload(watched):
    tus = ("-H", "Tus-Resumable: 1.0.0")
    path = watched.curl("/v1/uploads", "-X", "POST", *tus, "-H", f"Upload-Length: {len(SMALL)}").headers["location"]
    for first, last in ((0, 1000), (1000, len(SMALL))):
        reply = watched.post(path, SMALL[first:last], *tus, "-X", "PATCH", "-H", f"Upload-Offset: {first}", "-H",
                             "Content-Type: application/offset+octet-stream")
        assert reply.status == 204, reply.body
    assert watched.curl(reply.headers["whittle-cloud"]).json["bytes"] == len(SMALL)
    end(watched)
