# SPDX-License-Identifier: GPL-3.0-or-later
"""What the service believes of what a job's process says and leaves: scripts in place of whittle."""
import signal

import pytest

from conftest import SMALL, process_lives, wait_until

BOTH = "echo x > $out/cloud.ply; echo {} > $out/report.json"


@pytest.fixture(name="scripted")
def make_scripted(make_daemon, tmp_path):
    """scripted(lines): a daemon whose jobs run these lines of a shell; $out is their folder."""
    def make(lines, *flags):
        script = tmp_path / "script"
        script.write_text(f"#!/bin/sh\nwhile [ \"$1\" != -o ]; do shift; done\nout=$2\n{lines}\n")
        script.chmod(0o755)
        return make_daemon("--worker", script, "--worker-sandbox=off", "--workers", "1", *flags)
    return make


def ended(daemon):
    return daemon.ended(daemon.submit(SMALL))


@pytest.mark.parametrize("lines, said", [
    (":", "cloud.ply isn't there"),
    ("echo x > $out/cloud.ply", "report.json isn't there"),
    ("ln -s /etc/passwd $out/cloud.ply; echo {} > $out/report.json", "cloud.ply is no file"),
    ("echo {} > $out/report.json; ln $out/report.json $out/cloud.ply", "cloud.ply has another name"),
    ("mkdir $out/cloud.ply; echo {} > $out/report.json", "cloud.ply is no file"),
    ("mkfifo $out/cloud.ply; echo {} > $out/report.json", "cloud.ply is no file"),
    (f"{BOTH}; : > $out/report.json", "report.json is empty"),
    (f"{BOTH}; echo x > $out/mesh.ply", "mesh.ply was not asked for"),
    (f"{BOTH}; echo x > $out/.hidden", ".hidden was not asked for"),
    (f"{BOTH}; echo x > \"$out/a b\"", "a?b was not asked for"),
    (f"{BOTH}; mkdir $out/more", "more was not asked for"),
    ("d=$PWD; cd /; rmdir $d && ln -s /etc $d", "can't list the outputs"),
])
def test_outputs_are_not_believed(scripted, lines, said):
    daemon = scripted(f"{lines}\necho done >&3")
    job = ended(daemon)
    assert job["status"] == "failed" and job["attempt"] == 1 and said in job["problem"]["detail"], job
    assert job["problem"]["type"] in ("/problems/engine-error", "/problems/internal-error")
    assert job.get("outputs", []) == [] and daemon.leftovers() == []
    assert not (daemon.data / "jobs" / job["id"] / "outputs").exists()


def test_outputs_that_were_asked_for_are_kept(scripted):
    daemon = scripted(f"{BOTH}\necho done >&3")
    job = ended(daemon)
    assert job["status"] == "successful", job
    assert daemon.curl(f"/v1/jobs/{job['id']}/outputs/cloud.ply").body == b"x\n"


@pytest.mark.parametrize("lines, state", [
    ("echo done >&3; echo 'failed malformed 0 - x y' >&3", "successful"),  # nothing counts after the end
    ("echo done >&3; echo 'progress late 0.5 y' >&3", "successful"),
    ("echo 'failed malformed 0 - x y' >&3; echo done >&3", "failed"),
    ("echo done >&3; exit 1", "failed"),  # its word alone is not enough
    ("exit 0", "failed"),
    ("echo Done >&3; echo ' done' >&3; echo 'done ' >&3", "failed"),
])
def test_the_first_word_of_the_end_counts_and_goes_with_the_exit_status(scripted, lines, state):
    job = ended(scripted(f"{BOTH}\n{lines}"))
    assert job["status"] == state, job
    assert job.get("stage") != "late"


def test_what_a_process_leaves_running_is_ended_with_it(scripted, tmp_path):
    """Its whole group is: a child that it started goes on for ever."""
    told = tmp_path / "child"
    daemon = scripted(f"{BOTH}\nsleep 100000 3>&- & echo $! > {told}\necho done >&3")
    assert ended(daemon)["status"] == "successful"
    wait_until(lambda: not process_lives(int(told.read_text())), "the child's end")


def test_a_dismissed_job_takes_its_children_with_it(scripted, tmp_path):
    told = tmp_path / "child"
    daemon = scripted(f"trap '' TERM\nsleep 100000 3>&- & echo $! > {told}\necho 'progress on 0.5 y' >&3\nwait\nwait")
    job_id = daemon.submit(SMALL)
    wait_until(lambda: daemon.job(job_id)["stage"] == "on", "the script's word")
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"
    wait_until(lambda: not process_lives(int(told.read_text())), "the child's end")


def test_a_process_that_can_t_be_watched_is_not_told_as_started(scripted):
    """A program that isn't there: each attempt says so, and no output appears."""
    daemon = scripted("echo done >&3", "--worker", "/nonexistent/whittle")
    job = ended(daemon)
    assert job["status"] == "failed" and job["problem"]["exit_status"] == 127


def test_processor_time_is_that_of_the_process_and_what_it_waited_for(scripted):
    daemon = scripted(f"{BOTH}\n( i=0; while [ $i -lt 200000 ]; do i=$((i+1)); done )\nkill -ABRT $$")
    job = ended(daemon)
    assert job["problem"]["signal"] == signal.SIGABRT
    assert 10 < job["problem"]["cpu_ms"] < 60000, job
