# SPDX-License-Identifier: GPL-3.0-or-later
"""A job that runs is held by a lease: who has lost it ends the process and writes nothing more of the job; what nobody
holds is queued again.  Another host is played by changes of the database."""

import pytest

from conftest import BUILD, SMALL, process_lives, wait_until

FAR = 2**53


@pytest.fixture(name="gated")
def make_gated(make_daemon, tmp_path):
    """A service whose jobs begin their work when the gate, a file, is removed."""
    gate, worker = tmp_path / "gate", tmp_path / "worker"
    gate.touch()
    worker.write_text(f'#!/bin/sh\nwhile [ -e "{gate}" ]; do sleep 0.02; done\nexec "{BUILD / "whittle"}" "$@"\n')
    worker.chmod(0o755)
    yield lambda *flags: (make_daemon("--worker", worker, "--worker-sandbox=off", "--workers", "1", *flags), gate)
    gate.unlink(missing_ok=True)


def row(daemon, job_id, *columns):
    return daemon.ask(f"SELECT {', '.join(columns)} FROM jobs WHERE id = '{job_id}'")[0]


def test_leases_are_renewed(gated):
    daemon, gate = gated("--lease", "300ms")
    job = daemon.submit(SMALL)
    daemon.wait_for(job, "running")
    first, = row(daemon, job, "lease")
    wait_until(lambda: row(daemon, job, "lease")[0] > first + 600, "a lease that was renewed")
    gate.unlink()
    assert daemon.ended(job)["attempt"] == 1


def test_what_another_host_has_taken_ends_here_and_leaves_nothing(gated):
    daemon, gate = gated("--lease", "300ms")
    job = daemon.submit(SMALL)
    daemon.wait_for(job, "running")
    own, = row(daemon, job, "owner")
    pid = daemon.worker_pid(job)
    daemon.ask(f"UPDATE jobs SET owner = 'another', attempt = 2, lease = {FAR} WHERE id = '{job}'")
    wait_until(lambda: f"job={job} attempt=1 is lost" in daemon.log_text(), "the end of the lost run")
    wait_until(lambda: not process_lives(pid), "the end of its process")
    assert row(daemon, job, "state", "owner", "attempt") == (1, "another", 2)
    assert daemon.leftovers() == [] and not list((daemon.data / "jobs" / job).glob("outputs*"))

    daemon.ask(f"UPDATE jobs SET lease = 1 WHERE id = '{job}'")  # the other host is gone
    gate.unlink()
    ended = daemon.ended(job)
    assert ended["status"] == "successful" and ended["attempt"] == 3
    assert row(daemon, job, "owner", "lease", "interruptions") == ("", 0, 1) and own not in ("", "another")
    assert daemon.curl(f"/v1/jobs/{job}/outputs/cloud.ply").status == 200
    assert daemon.stop() == 0 and daemon.check() == (0, ["checked 1 jobs, 1 clouds, 2 outputs: 0 damaged, 0 unfinished"])


def test_the_start_leaves_what_another_host_holds(gated):
    daemon, gate = gated("--lease", "300ms")
    job = daemon.submit(SMALL)
    daemon.wait_for(job, "running")
    daemon.kill()
    daemon.ask(f"UPDATE jobs SET owner = 'another', lease = {FAR} WHERE id = '{job}'")
    gate.unlink()
    daemon.start()
    assert daemon.job(job)["status"] == "running"
    daemon.ask(f"UPDATE jobs SET lease = 1 WHERE id = '{job}'")
    assert daemon.ended(job)["attempt"] == 2


def test_a_cancelled_job_is_not_run_again_after_a_kill(gated):
    """DELETE was sent; the host dies before the job has ended."""
    daemon, gate = gated()
    job = daemon.submit(SMALL)
    daemon.wait_for(job, "running")
    daemon.kill()
    daemon.ask(f"UPDATE jobs SET cancelled = 1 WHERE id = '{job}'")
    gate.unlink()
    daemon.start()
    assert daemon.ended(job)["status"] == "dismissed"
