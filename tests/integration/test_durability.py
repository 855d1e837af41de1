# SPDX-License-Identifier: GPL-3.0-or-later
"""What was accepted is never lost: kills, restarts, drains."""
import contextlib
import datetime
import hashlib
import http.client
import json
import os
import pathlib
import re
import resource
import shutil
import signal
import sqlite3
import subprocess

import pytest

from conftest import BUILD, PATIENCE_S, SMALL, process_lives, wait_until
from test_tls import make_certificate

STRAY = "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e"  # an id that no job has


def test_kill_of_the_daemon_in_mid_job(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    running, waiting = daemon.submit(large, "?ratio=0.1"), daemon.submit(SMALL, "?ratio=0.5")
    pid = daemon.worker_pid(running)
    os.kill(pid, signal.SIGSTOP)  # it won't end by itself
    daemon.kill()
    wait_until(lambda: not process_lives(pid), "the worker's end with its parent")
    daemon.start()
    job = daemon.ended(running)
    assert job["status"] == "successful" and job["attempt"] == 2
    assert daemon.ended(waiting)["status"] == "successful"
    assert daemon.leftovers() == []
    assert daemon.curl(f"/v1/jobs/{running}/outputs/cloud.ply").body == \
        daemon.post("/v1/simplify?ratio=0.1", large).body


def kill_in_mid_job(daemon, job_id, attempt):
    wait_until(lambda: f"job={job_id} accepted -> running attempt={attempt} " in daemon.log_text(), "the start")
    daemon.kill()


def test_ends_of_the_service_fail_no_job(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    job_id = daemon.submit(large)
    for attempt in range(1, 7):
        kill_in_mid_job(daemon, job_id, attempt)
        daemon.start()
    pid = wait_until(lambda: re.search(rf"job={job_id} .* attempt=7 pid=(\d+)", daemon.log_text()), "the start")[1]
    os.kill(int(pid), signal.SIGKILL)  # the first end of its own
    job = daemon.ended(job_id)
    assert job["status"] == "successful" and job["attempt"] == 8


def interruptions(daemon, *job_ids, number=None):
    """How often the service ended while each ran, as the database has it; or sets that."""
    for job_id in job_ids if number is not None else ():
        daemon.ask(f"UPDATE jobs SET interruptions = {number} WHERE id = '{job_id}'")
    return [daemon.ask(f"SELECT interruptions FROM jobs WHERE id = '{job_id}'")[0][0] for job_id in job_ids]


def test_a_job_that_ends_the_service_again_and_again_fails(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    job_id = daemon.submit(large)
    kill_in_mid_job(daemon, job_id, 1)
    interruptions(daemon, job_id, number=18)
    daemon.start()
    kill_in_mid_job(daemon, job_id, 2)  # the 20th
    daemon.start()
    job = daemon.ended(job_id)
    assert job["status"] == "failed" and job["attempt"] == 2
    assert job["problem"]["type"] == "/problems/worker-crashed" and "20 times" in job["problem"]["detail"]
    assert daemon.post("/v1/simplify", SMALL).status == 200


def test_jobs_that_were_interrupted_often_run_alone(make_daemon, large):
    daemon = make_daemon("--workers", "3")
    jobs = [daemon.submit(large + b"0 0 %d\n" % i) for i in range(3)]
    for attempt in (1, 2):
        for job_id in jobs:
            wait_until(lambda i=job_id, a=attempt: f"job={i} accepted -> running attempt={a} " in daemon.log_text(), "it")
        daemon.kill()
        if attempt == 1:
            daemon.start()
    daemon.start()
    assert interruptions(daemon, *jobs) == [2, 2, 2]
    kill_in_mid_job(daemon, jobs[0], 3)
    daemon.start()
    assert interruptions(daemon, *jobs) == [3, 2, 2]  # the others weren't there
    seen = 0

    def all_ended():
        nonlocal seen
        states = [job["status"] for job in daemon.curl("/v1/jobs").json["jobs"]]
        seen = max(seen, states.count("running"))
        return states == ["successful"] * 3
    wait_until(all_ended, "the end of all")
    assert seen == 1
    both = [daemon.submit(large + b"0 1 %d\n" % i) for i in range(2)]  # others run side by side as ever
    for job_id in both:
        daemon.worker_pid(job_id)
    assert [daemon.job(job_id)["status"] for job_id in both] == ["running"] * 2


def test_a_job_is_dismissed_while_its_outputs_are_hashed(make_daemon, tmp_path):
    worker = tmp_path / "worker"
    worker.write_text("#!/usr/bin/python3\nimport os, sys\n"
                      "path = sys.argv[sys.argv.index('-o') + 1] + '/cloud.ply'\n"
                      "os.truncate(os.open(path, os.O_CREAT | os.O_RDWR), 1 << 40)\n"
                      "open(os.path.dirname(path) + '/report.json', 'w').write('{}')\nos.write(3, b'done\\n')\n")
    worker.chmod(0o755)
    daemon = make_daemon("--worker", worker, "--worker-sandbox=off", "--job-file-bytes", "2T")
    job_id = daemon.submit(SMALL, "?outputs=cloud")  # a tebibyte: its hash would take far longer than DELETE waits
    pid = daemon.worker_pid(job_id)
    wait_until(lambda: not process_lives(pid), "the process's end")
    status, _, body = daemon.request("DELETE", f"/v1/jobs/{job_id}")
    assert status == 200 and json.loads(body)["status"] == "dismissed"
    assert daemon.job(job_id)["status"] == "dismissed"
    assert not (daemon.data / "jobs" / job_id / "outputs").exists() and daemon.leftovers() == []


def test_kill_of_the_worker_is_tried_again(daemon, large):
    job_id = daemon.submit(large)
    os.kill(daemon.worker_pid(job_id), signal.SIGKILL)
    job = daemon.ended(job_id)
    assert job["status"] == "successful" and job["attempt"] == 2
    assert b"signal 9" in daemon.curl(f"/v1/jobs/{job_id}/log").body


@pytest.mark.parametrize("how", ["kill", "twice"])
def test_the_log_tells_of_an_attempt_that_the_service_ended_during(make_daemon, large, how):
    daemon = make_daemon("--drain-timeout", "600s")
    job_id = daemon.submit(large)
    daemon.worker_pid(job_id)
    if how == "kill":
        daemon.kill()
    else:
        daemon.process.send_signal(signal.SIGTERM)
        wait_until(lambda: "draining" in daemon.log_text(), "the first signal")
        daemon.may_end(128 + signal.SIGTERM)
        daemon.process.send_signal(signal.SIGTERM)
        daemon.process.wait(PATIENCE_S)
    daemon.start()
    assert daemon.ended(job_id)["status"] == "successful"
    told = [line for line in daemon.curl(f"/v1/jobs/{job_id}/log").body.decode().splitlines() if line.startswith("attempt")]
    assert told == ["attempt 1 begins", "attempt 1: queued again: the service ended during it", "attempt 2 begins",
                    "attempt 2: successful"]


def test_a_job_waits_for_what_its_start_lacks(daemon, large):
    job_id = daemon.submit(large)
    pid, service = daemon.worker_pid(job_id), daemon.process.pid
    limits = resource.prlimit(service, resource.RLIMIT_NOFILE)
    resource.prlimit(service, resource.RLIMIT_NOFILE, (3, limits[1]))
    os.kill(pid, signal.SIGKILL)
    wait_until(lambda: daemon.log_text().count(f"job={job_id} can't be started yet") > 3, "more tries than attempts")
    resource.prlimit(service, resource.RLIMIT_NOFILE, limits)
    job = daemon.ended(job_id)
    assert job["status"] == "successful" and job["attempt"] == 2  # the one that was killed, and the one that came to run
    assert daemon.leftovers() == []


def test_a_job_that_waits_for_its_start_can_be_dismissed(daemon, large):
    job_id = daemon.submit(large)
    pid, service = daemon.worker_pid(job_id), daemon.process.pid
    limits = resource.prlimit(service, resource.RLIMIT_NOFILE)
    connection = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=PATIENCE_S)
    connection.connect()
    assert daemon.request("GET", f"/v1/jobs/{job_id}", connection=connection)[0] == 200
    resource.prlimit(service, resource.RLIMIT_NOFILE, (3, limits[1]))
    os.kill(pid, signal.SIGKILL)
    wait_until(lambda: f"job={job_id} can't be started yet" in daemon.log_text(), "the wait")
    assert daemon.request("DELETE", f"/v1/jobs/{job_id}", connection=connection)[0] in (200, 202)
    resource.prlimit(service, resource.RLIMIT_NOFILE, limits)
    assert daemon.ended(job_id)["status"] == "dismissed"
    connection.close()


def test_a_bell_that_rang_for_the_job_before_wakes_the_next_one_only_once(make_daemon, large):
    daemon = make_daemon("--workers", "1", "--wait-max", "1s")
    first, second = daemon.submit(large), daemon.submit(SMALL)
    daemon.worker_pid(first)
    connection = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=PATIENCE_S)
    database = sqlite3.connect(daemon.data / "whittled.db", isolation_level=None)
    database.execute("BEGIN IMMEDIATE")  # the end of the first can't be recorded
    for word in ("running -> dismissed", ""):  # what the second DELETE rings, no process is there to hear
        assert daemon.request("DELETE", f"/v1/jobs/{first}", connection=connection)[0] == 500
        wait_until(lambda end=f"job={first} {word}": end in daemon.log_text(), "the process's end")
    limits = resource.prlimit(daemon.process.pid, resource.RLIMIT_NOFILE)
    resource.prlimit(daemon.process.pid, resource.RLIMIT_NOFILE, (3, limits[1]))
    database.execute("ROLLBACK")
    database.close()

    def tries():
        return re.findall(rf"^(\S+)Z warn  job={second} can't be started yet", daemon.log_text(), re.MULTILINE)
    wait_until(lambda: len(tries()) > 4, "some tries")
    times = [datetime.datetime.fromisoformat(time) for time in tries()]
    pauses = [(later - before).total_seconds() for before, later in zip(times, times[1:])]
    assert pauses[0] < min(pauses[1:]) and min(pauses[1:]) >= 0.99, pauses
    resource.prlimit(daemon.process.pid, resource.RLIMIT_NOFILE, limits)
    assert daemon.ended(second)["status"] == "successful" and daemon.ended(first)["status"] == "dismissed"
    connection.close()


def test_kill_of_the_worker_each_time_ends_with_an_obituary(daemon, large):
    job_id = daemon.submit(large)
    seen = set()
    for _ in range(3):
        pid = wait_until(lambda: daemon.worker_pid(job_id) not in seen and daemon.worker_pid(job_id), "the next attempt")
        seen.add(pid)
        os.kill(pid, signal.SIGKILL)
    job = daemon.ended(job_id)
    problem = job["problem"]
    assert job["status"] == "failed" and job["attempt"] == 3
    assert problem["type"] == "/problems/worker-crashed" and problem["signal"] == 9 and problem["attempt"] == 3
    assert problem["log"] == f"/v1/jobs/{job_id}/log"


def test_a_crash_of_the_worker_is_not_tried_again(daemon, large):
    job_id = daemon.submit(large)
    os.kill(daemon.worker_pid(job_id), signal.SIGSEGV)
    job = daemon.ended(job_id)
    assert job["status"] == "failed" and job["attempt"] == 1
    assert daemon.post("/v1/simplify", SMALL).status == 200


def test_a_worker_that_cannot_be_started(make_daemon, tmp_path):
    daemon = make_daemon("--worker", tmp_path / "none")
    job = daemon.ended(daemon.submit(SMALL))
    assert job["status"] == "failed" and job["problem"]["exit_status"] == 127


def test_a_worker_that_says_nothing_and_dies(make_daemon, tmp_path):
    liar = tmp_path / "liar"
    liar.write_text("#!/bin/sh\necho last words >&2\nexit 9\n")
    liar.chmod(0o755)
    daemon = make_daemon("--worker", liar, "--worker-sandbox=off")
    problem = daemon.ended(daemon.submit(SMALL))["problem"]
    assert problem["exit_status"] == 9 and "last words" in problem["last_words"]


def test_a_worker_that_ignores_everything_is_killed(make_daemon, tmp_path):
    deaf = tmp_path / "deaf"
    deaf.write_text("#!/bin/sh\ntrap '' TERM\necho 'progress deaf 0.5 x' >&3\nwhile :; do sleep 1000; done\n")
    deaf.chmod(0o755)
    daemon = make_daemon("--worker", deaf, "--worker-sandbox=off")
    job_id = daemon.submit(SMALL)
    wait_until(lambda: daemon.job(job_id)["stage"] == "deaf", "its word")
    pid = daemon.worker_pid(job_id)
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"
    assert not process_lives(pid)
    group = subprocess.run(["pgrep", "-g", str(pid)], capture_output=True, text=True, check=False).stdout.split()
    wait_until(lambda: not any(process_lives(member) for member in group), "the end of all of its group")


# ---------------------------------------------------------------------------------------------- drain

def test_drain_lets_running_jobs_end(make_daemon, large):
    daemon = make_daemon("--workers", "1", "--drain-timeout", "1h")
    job_id = daemon.submit(large)
    waiting = daemon.submit(SMALL)
    daemon.worker_pid(job_id)
    daemon.process.send_signal(signal.SIGTERM)
    wait_until(lambda: daemon.curl("/readyz").status == 503, "the end of readiness")
    assert daemon.curl("/readyz").slug == "draining"
    assert daemon.post("/v1/jobs", SMALL).slug == "draining"
    assert daemon.curl("/healthz").status == 200
    assert daemon.job(waiting)["status"] == "accepted"
    assert daemon.process.wait(PATIENCE_S) == 0
    daemon.start()
    assert daemon.job(job_id)["status"] == "successful" and daemon.job(job_id)["attempt"] == 1
    assert daemon.ended(waiting)["status"] == "successful"


def test_drain_queues_again_what_takes_too_long(make_daemon, large):
    daemon = make_daemon("--drain-timeout", "0")
    job_id = daemon.submit(large)
    pid = daemon.worker_pid(job_id)
    assert daemon.stop() == 0
    assert not process_lives(pid)
    daemon.start()
    job = daemon.ended(job_id)
    assert job["status"] == "successful" and job["attempt"] == 2


def test_drain_answers_those_who_wait(make_daemon, large):
    daemon = make_daemon("--drain-timeout", "0", "--workers", "1")
    running = daemon.submit(large)
    daemon.worker_pid(running)
    waiting = daemon.submit(SMALL)
    poll = subprocess.Popen(daemon.curl_command(f"/v1/jobs/{waiting}", "-H", "Prefer: wait=50"), stdout=subprocess.PIPE)
    events = subprocess.Popen(daemon.curl_command(f"/v1/jobs/{waiting}/events", "-N"), stdout=subprocess.PIPE)
    wait_until(lambda: events.stdout.readline().startswith(b"event:"), "the stream's beginning")
    fds = f"/proc/{daemon.process.pid}/fd"
    wait_until(lambda: subprocess.run(["ls", "-l", fds], capture_output=True, text=True,
                                      check=False).stdout.count("socket:") > 2, "both connections")
    assert daemon.stop() == 0
    assert b"200 OK" in poll.communicate(timeout=PATIENCE_S)[0]
    events.communicate(timeout=PATIENCE_S)
    assert events.returncode == 0


def test_a_second_signal_ends_at_once(make_daemon, large):
    daemon = make_daemon("--drain-timeout", "10m")
    job_id = daemon.submit(large)
    pid = daemon.worker_pid(job_id)
    daemon.process.send_signal(signal.SIGTERM)
    wait_until(lambda: "draining" in daemon.log_text(), "the drain")
    daemon.process.send_signal(signal.SIGTERM)
    daemon.may_end(128 + signal.SIGTERM)
    assert daemon.process.wait(PATIENCE_S) == 128 + signal.SIGTERM
    wait_until(lambda: not process_lives(pid), "the worker's end")
    daemon.start()
    assert daemon.ended(job_id)["status"] == "successful"


def test_sighup_lets_jobs_uploads_and_streams_go_on(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    running, waiting = daemon.submit(large), daemon.submit(SMALL)
    pid = daemon.worker_pid(running)
    events = subprocess.Popen(daemon.curl_command(f"/v1/jobs/{running}/events", "-N"), stdout=subprocess.PIPE)
    for i in range(1, 4):
        daemon.process.send_signal(signal.SIGHUP)
        wait_until(lambda n=i: daemon.log_text().count("reading settings, tokens and certificate again") == n, "the reload")
    assert daemon.worker_pid(running) == pid
    job = daemon.ended(running)
    assert job["status"] == "successful" and job["attempt"] == 1
    assert b"event: end" in events.communicate(timeout=PATIENCE_S)[0]
    assert daemon.ended(waiting)["status"] == "successful"


# ---------------------------------------------------------------------------------------------- mending

def lost(daemon):
    """What lies in lost+found, as paths below the folder of its start."""
    return sorted(str(path.relative_to(start)) for start in (daemon.data / "lost+found").glob("*")
                  for path in start.rglob("*") if path.is_file())


def lost_count(daemon):
    return int(re.search(rb"^whittled_lost_found_files (\d+)$", daemon.curl("/metrics").body, re.MULTILINE)[1])


def test_the_start_sets_aside_what_nobody_knows(make_daemon):
    daemon = make_daemon()
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    daemon.kill()
    (daemon.data / "tmp" / "upload-half").write_bytes(b"x")
    (daemon.data / "tmp" / "half").mkdir()
    (daemon.data / "tmp" / "half" / "cloud.ply").write_bytes(b"x")
    (daemon.data / "clouds" / ("0" * 64)).write_bytes(b"x")
    (daemon.data / "uploads" / STRAY).write_bytes(b"x")
    stray = daemon.data / "jobs" / STRAY / "outputs"
    stray.mkdir(parents=True)
    (stray / "cloud.ply").write_bytes(b"x")
    daemon.start()
    assert daemon.leftovers() == []
    assert len(list((daemon.data / "clouds").iterdir())) == 1
    assert [p.name for p in (daemon.data / "jobs").iterdir()] == [job_id]
    assert daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply").status == 200
    assert "clouds_lost=0 files_removed=2 files_set_aside=3" in daemon.log_text()
    assert lost(daemon) == [f"clouds/{'0' * 64}", f"jobs/{STRAY}/outputs/cloud.ply", f"uploads/{STRAY}"]
    assert lost_count(daemon) == 3
    assert daemon.stop() == 0
    status, lines = daemon.check()
    assert status == 0 and lines[0].startswith("set aside: lost+found has 3 ") and len(lines) == 2
    shutil.rmtree(daemon.data / "lost+found")
    assert len(daemon.check()[1]) == 1


def test_what_was_deleted_is_not_kept_by_a_crash(make_daemon):
    daemon = make_daemon("--fault", "delete-committed=kill:1")
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    with contextlib.suppress(AssertionError):
        daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE")
    assert daemon.process.wait(PATIENCE_S) == -signal.SIGKILL
    assert (daemon.data / "jobs" / job_id).exists()
    daemon.flags = ()
    daemon.start()
    assert not (daemon.data / "jobs" / job_id).exists()
    assert lost(daemon) == [f"clouds/{hashlib.sha256(SMALL).hexdigest()}"]  # another job may have named it since


# ---------------------------------------------------------------------------------------------- identity

def refused(daemon):
    """What the service says when it doesn't start, and leaves everything as it was."""
    before = {path: path.read_bytes() for path in daemon.data.rglob("*") if path.is_file() and "whittled.db" not in path.name}
    with subprocess.Popen([daemon.process.args[0], "--data", daemon.data, "--listen", "127.0.0.1:0"], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True) as process:
        if process.stdout.readline():  # it serves
            process.kill()
        said = process.stderr.read()
    assert process.returncode == 1 and str(daemon.data) in said, said
    assert "check --adopt" in said and "backup" in said
    after = {path: path.read_bytes() for path in daemon.data.rglob("*") if path.is_file() and "whittled.db" not in path.name}
    assert after == before
    return said


@pytest.fixture(name="filled")
def make_filled(make_daemon):
    """A daemon that has ended, with a job in its folder, and how that looks."""
    daemon = make_daemon()
    daemon.job_id = daemon.submit(SMALL)
    daemon.ended(daemon.job_id)
    daemon.result = daemon.curl(f"/v1/jobs/{daemon.job_id}/outputs/cloud.ply").body
    assert daemon.stop() == 0
    return daemon


@pytest.mark.parametrize("how", ["removed", "emptied", "fresh", "stranger"])
def test_a_folder_without_its_database_is_refused(filled, make_daemon, how):
    path, own = filled.data / "whittled.db", (filled.data / "whittled.db").read_bytes()
    path.unlink()
    if how == "emptied":
        path.write_bytes(b"")
    elif how != "removed":
        other = make_daemon()
        if how == "stranger":
            other.ended(other.submit(SMALL))  # even one that knows the same cloud
        assert other.stop() == 0
        path.write_bytes((other.data / "whittled.db").read_bytes())
    lacks, sizes = how in ("removed", "emptied"), {p: p.stat().st_size for p in filled.data.glob("whittled.db*")}
    for _ in range(2):
        assert ("the database is missing or empty" in refused(filled)) == lacks
        assert not lacks or {p: p.stat().st_size for p in filled.data.glob("whittled.db*")} == sizes  # it isn't made
    for leftover in filled.data.glob("whittled.db*"):
        leftover.unlink()
    path.write_bytes(own)
    filled.start()
    assert filled.curl(f"/v1/jobs/{filled.job_id}/outputs/cloud.ply").body == filled.result
    assert not (filled.data / "lost+found").exists()


def test_a_database_whose_rows_are_gone_loses_no_file(filled):
    with sqlite3.connect(filled.data / "whittled.db") as database:
        for table in ("jobs", "outputs", "clouds", "usage"):
            database.execute(f"DELETE FROM {table}")
    database.close()
    filled.start()
    assert filled.curl(f"/v1/jobs/{filled.job_id}").status == 404
    assert f"clouds/{hashlib.sha256(SMALL).hexdigest()}" in lost(filled)
    assert f"jobs/{filled.job_id}/outputs/cloud.ply" in lost(filled)


def test_an_older_database_loses_no_file(make_daemon):
    daemon = make_daemon()
    old = daemon.submit(SMALL)
    daemon.ended(old)
    subprocess.run(["sqlite3", daemon.data / "whittled.db", f".backup '{daemon.folder / 'old.db'}'"], check=True)
    new = daemon.submit(SMALL + b"0 0 0\n")
    daemon.ended(new)
    result = daemon.curl(f"/v1/jobs/{new}/outputs/cloud.ply").body
    assert daemon.stop() == 0
    newer = (daemon.data / "whittled.db").read_bytes()
    (daemon.data / "whittled.db").write_bytes((daemon.folder / "old.db").read_bytes())
    daemon.start()
    assert daemon.curl(f"/v1/jobs/{old}/outputs/cloud.ply").status == 200
    assert daemon.curl(f"/v1/jobs/{new}").status == 404
    start = next((daemon.data / "lost+found").iterdir())
    assert (start / "jobs" / new / "outputs" / "cloud.ply").read_bytes() == result
    assert f"moved to {daemon.data}/lost+found/{start.name}" in daemon.log_text() and lost_count(daemon) == 2
    assert daemon.stop() == 0
    (daemon.data / "whittled.db").write_bytes(newer)  # it turns up after all
    subprocess.run(["cp", "-al", f"{start}/.", f"{daemon.data}/"], check=True)
    daemon.start()
    assert daemon.curl(f"/v1/jobs/{new}/outputs/cloud.ply").body == result


def test_a_folder_is_adopted_where_its_database_is_lost_for_good(filled):
    (filled.data / "whittled.db").unlink()
    refused(filled)
    done = subprocess.run([BUILD / "whittled", "check", "--adopt", "--data", filled.data], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0 and done.stdout.startswith("adopted: "), done.stderr
    filled.start()
    assert (next((filled.data / "lost+found").iterdir()) / "jobs" / filled.job_id / "outputs" / "cloud.ply"
            ).read_bytes() == filled.result
    assert filled.ended(filled.submit(SMALL))["status"] == "successful"
    assert filled.stop() == 0 and filled.check()[0] == 0


def test_a_folder_of_an_earlier_version_gets_its_identity_silently(filled):
    (filled.data / "identity").unlink()
    with sqlite3.connect(filled.data / "whittled.db") as database:
        database.execute("DELETE FROM identity")
    database.close()
    filled.start()
    assert filled.curl(f"/v1/jobs/{filled.job_id}/outputs/cloud.ply").body == filled.result
    assert len((filled.data / "identity").read_text()) == 32 and not (filled.data / "lost+found").exists()


def test_an_upload_alone_is_known(make_daemon):
    daemon = make_daemon()
    upload = daemon.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Length: 10")
    assert daemon.stop() == 0
    (daemon.data / "identity").unlink()
    daemon.start()
    assert daemon.curl(upload.headers["location"]).status == 200


def test_a_lock_file_removed_by_hand_lets_no_second_service_in(daemon):
    (daemon.data / "lock").unlink()
    for _ in range(2):
        done = subprocess.run([BUILD / "whittled", "--data", daemon.data, "--listen", "127.0.0.1:0"],
                              capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        assert done.returncode == 1 and "another whittled serves the folder" in done.stderr
    assert daemon.ended(daemon.submit(SMALL))["status"] == "successful"


def test_the_start_tells_of_lost_outputs(make_daemon):
    daemon = make_daemon()
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    daemon.kill()
    (daemon.data / "jobs" / job_id / "outputs").rename(daemon.data / "elsewhere")
    daemon.start()
    gone = daemon.curl(f"/v1/jobs/{job_id}")
    assert gone.status == 410 and gone.json["reason"] == "lost"


def test_a_newer_database_is_left_alone(make_daemon):
    daemon = make_daemon()
    daemon.kill()
    with sqlite3.connect(daemon.data / "whittled.db") as database:
        database.execute("PRAGMA user_version = 999")
    database.close()
    done = subprocess.run([daemon.process.args[0], "--data", daemon.data, "--listen", "127.0.0.1:0"],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "schema 999" in done.stderr


@pytest.mark.parametrize("moment", range(6))
def test_kill_at_any_moment_loses_no_accepted_job(make_daemon, moment):
    daemon = make_daemon()
    accepted = []
    for _ in range(2 + moment):
        accepted.append(daemon.submit(SMALL))
    daemon.kill()
    daemon.start()
    for job_id in accepted:
        assert daemon.ended(job_id)["status"] == "successful"
    assert daemon.leftovers() == []


def stop_attempt(daemon, job_id, attempt):
    """Stops the process of an attempt, and waits until it is ended for that."""
    pid = int(wait_until(lambda: re.search(rf"job={job_id} .* attempt={attempt} pid=(\d+)", daemon.log_text()),
                         f"attempt {attempt}")[1])
    with contextlib.suppress(ProcessLookupError):  # on a busy machine it may have stood still by itself
        os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: not process_lives(pid), "the end of what stands still")


def test_a_process_that_stands_still_is_ended_and_its_job_tried_again(make_daemon, large, tmp_path):
    settings = tmp_path / "settings"
    settings.write_text("job-stall = 1s\n")
    daemon = make_daemon("--workers", "1", "--config", settings)
    job_id = daemon.submit(large)
    stop_attempt(daemon, job_id, 1)
    settings.write_text("job-stall = 1h\n")  # so that waiting for a processor doesn't count, however long
    daemon.process.send_signal(signal.SIGHUP)
    job = daemon.ended(job_id)
    assert job["status"] == "successful" and job["attempt"] > 1
    assert re.search(r"queued again attempt=1 .* it stood still", daemon.log_text())


def test_a_process_that_always_stands_still_fails_its_job(make_daemon, large):
    daemon = make_daemon("--workers", "1", "--job-stall", "1s")
    job_id = daemon.submit(large)
    for attempt in (1, 2, 3):
        stop_attempt(daemon, job_id, attempt)
    job = daemon.ended(job_id)
    problem = job["problem"]
    assert (job["status"], job["attempt"]) == ("failed", 3) and problem["type"] == "/problems/worker-crashed"
    assert (problem["setting"], problem["limit_ms"]) == ("job-stall", 1000) and "stood still" in problem["detail"]


def test_a_process_may_stand_still_for_ever_where_nothing_forbids_it(make_daemon, large):
    daemon = make_daemon("--workers", "1", "--job-stall", "0", "--job-wall", "3s")
    job_id = daemon.submit(large)
    os.kill(daemon.worker_pid(job_id), signal.SIGSTOP)
    assert daemon.ended(job_id)["problem"]["type"] == "/problems/time-limit"


# ---------------------------------------------------------------------------------------------- signals, files

def waits_in(pid):
    """The number of the system call that the process's first thread waits in."""
    return pathlib.Path(f"/proc/{pid}/task/{pid}/syscall").read_text().split()[0]


def pending(pid):
    status = pathlib.Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"ShdPnd:\s*(\w+)", status)[1], 16)


def test_a_second_signal_ends_a_daemon_whose_main_thread_hangs(make_daemon):
    """A sweep waits for a database that another process has locked."""
    daemon = make_daemon("--retention", "1s")
    daemon.ended(daemon.submit(SMALL))
    database = sqlite3.connect(daemon.data / "whittled.db", isolation_level=None)
    database.execute("BEGIN IMMEDIATE")
    with subprocess.Popen(["sleep", "1000"]) as asleep:
        wait_until(lambda: waits_in(asleep.pid).isdigit(), "a sleep")
        sleeping = waits_in(asleep.pid)
        asleep.kill()
    pid = daemon.process.pid
    wait_until(lambda: waits_in(pid) == sleeping, "the sweep")
    daemon.process.send_signal(signal.SIGTERM)
    wait_until(lambda: not pending(pid), "the first signal's being heard")
    daemon.process.send_signal(signal.SIGTERM)
    daemon.may_end(128 + signal.SIGTERM)
    assert daemon.process.wait(PATIENCE_S) == 128 + signal.SIGTERM
    assert "second signal: ending at once" in daemon.log_text()
    database.close()


@pytest.mark.parametrize("setting", ["config", "tokens-file", "tls-cert", "tls-key", "webhook-secret-file"])
@pytest.mark.parametrize("kind", ["fifo", "folder", "device"])
def test_only_regular_files_are_read_as_settings(tmp_path, setting, kind):
    path = tmp_path / "odd"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    needs = {"webhook-secret-file": ["--webhooks"]}
    if setting.startswith("tls-"):
        certificate, key = make_certificate(tmp_path / "tls")
        needs = {"tls-cert": ["--tls-key", key], "tls-key": ["--tls-cert", certificate]}
    done = subprocess.run([BUILD / "whittled", "--listen", "127.0.0.1:0", "--data", tmp_path / "data", f"--{setting}", path,
                           *needs.get(setting, [])], capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 2 and f"{setting}: {path} is not a regular file" in done.stderr


def test_a_fifo_in_the_place_of_a_file_does_not_stop_a_reload(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"a:submit,read:{hashlib.sha256(b'a').hexdigest()}\n")
    daemon = make_daemon("--tokens-file", tokens)
    tokens.unlink()
    os.mkfifo(tokens)
    daemon.process.send_signal(signal.SIGHUP)
    wait_until(lambda: "the tokens stay as they were" in daemon.log_text(), "the reload")
    assert f"{tokens} is not a regular file" in daemon.log_text()
    assert daemon.curl("/v1/jobs", "-H", "Authorization: Bearer a").status == 200
    assert daemon.stop() == 0
