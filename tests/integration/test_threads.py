# SPDX-License-Identifier: GPL-3.0-or-later
"""Which threads of the service do what: none that serves connections waits, and one alone signals a job's process."""
import pathlib
import subprocess

import pytest

from conftest import SANITIZED, SMALL, Daemon, wait_until

pytestmark = pytest.mark.skipif(SANITIZED, reason="sanitizers come first among what is preloaded")
TUS = ("-H", "Tus-Resumable: 1.0.0")
PIECE = ("-X", "PATCH", *TUS, "-H", "Content-Type: application/offset+octet-stream", "-H", "Upload-Offset: 0")


@pytest.fixture(name="watched")
def make_watched(tmp_path):
    library = tmp_path / "watched_calls.so"
    source = pathlib.Path(__file__).with_name("watched_calls.c")
    subprocess.run(["cc", "-std=c11", "-D_GNU_SOURCE", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-pthread", "-o",
                    library, source], check=True)
    daemon = Daemon(tmp_path, "--workers", "2")
    daemon.prefix = ("env", f"LD_PRELOAD={library}", f"WATCHED_CALLS={tmp_path / 'calls'}")
    with daemon:
        yield daemon


def calls_of(daemon):
    """(call, thread, process that it is about), in their order."""
    lines = (daemon.folder / "calls").read_text(encoding="ascii").split()
    return list(zip(lines[::3], lines[1::3], lines[2::3]))


def test_no_thread_that_serves_connections_waits(watched, large):
    cloud = watched.post("/v1/clouds", SMALL).headers["location"]
    assert watched.curl(f"{cloud}/data").body == SMALL
    upload = watched.curl("/v1/uploads", "-X", "POST", *TUS, "-H", f"Upload-Length: {len(SMALL)}").headers["location"]
    assert watched.post(upload, SMALL, *PIECE).status == 204
    job = watched.submit(SMALL, "?ratio=0.5")
    assert watched.ended(job)["status"] == "successful"
    assert watched.curl(f"/v1/jobs/{job}/outputs/cloud.ply").status == 200
    assert watched.post("/v1/simplify?ratio=0.25", SMALL, "-H", "Idempotency-Key: k").status == 200
    assert watched.curl(f"/v1/jobs/{job}/events", "-H", "Accept: text/event-stream").status == 200
    running = watched.submit(large)
    watched.wait_for(running, "running")
    for path in ("/v1/jobs", "/v1/clouds", "/v1/info", "/metrics", "/healthz", "/readyz", f"/v1/jobs/{job}/log"):
        watched.curl(path)
    assert watched.curl(f"/v1/jobs/{running}", "-X", "DELETE").status == 200
    assert watched.curl(f"/v1/jobs/{job}", "-X", "DELETE").status == 200
    assert watched.curl("/v1/nowhere").status == 404
    calls = calls_of(watched)
    serving = {thread for call, thread, _ in calls if call == "recv"}
    waiting = {(call, thread) for call, thread, _ in calls if call != "recv"}
    assert serving and {"fsync", "sqlite3_step", "renameat"} <= {call for call, _ in waiting}
    assert {call for call, thread in waiting if thread in serving} == set()


def test_one_thread_alone_signals_a_job_s_process_and_never_after_its_end(watched, large):
    dismissed = watched.submit(large)
    watched.wait_for(dismissed, "running")
    assert watched.curl(f"/v1/jobs/{dismissed}", "-X", "DELETE").status == 200
    for ratio in (0.3, 0.4, 0.5):  # no earlier result serves
        assert watched.ended(watched.submit(SMALL, f"?ratio={ratio}"))["status"] == "successful"
    drained = watched.submit(large)
    watched.wait_for(drained, "running")
    watched.stop()
    calls = calls_of(watched)
    ends = {about: i for i, (call, _, about) in enumerate(calls) if call == "wait4"}
    assert len(ends) == 5
    signals = [(i, thread, about) for i, (call, thread, about) in enumerate(calls) if call == "kill"]
    assert len(signals) > len(ends)
    for i, thread, about in signals:
        assert i < ends[about] and thread == calls[ends[about]][1]
