# SPDX-License-Identifier: GPL-3.0-or-later
"""What was accepted is never lost: kills, restarts, drains."""
import contextlib
import datetime
import http.client
import os
import re
import resource
import signal
import sqlite3
import subprocess

import pytest

from conftest import PATIENCE_S, SMALL, process_lives, wait_until


def test_kill_of_the_daemon_in_mid_job(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    running, waiting = daemon.submit(large, "?ratio=0.1"), daemon.submit(SMALL, "?ratio=0.5")
    pid = daemon.worker_pid(running)
    daemon.kill()
    wait_until(lambda: not process_lives(pid), "the worker's end with its parent")
    daemon.start()
    job = daemon.ended(running)
    assert job["status"] == "successful" and job["attempt"] == 2
    assert daemon.ended(waiting)["status"] == "successful"
    assert daemon.leftovers() == []
    assert daemon.curl(f"/v1/jobs/{running}/outputs/cloud.ply").body == \
        daemon.post("/v1/simplify?ratio=0.1", large).body


def test_kill_of_the_daemon_at_each_attempt_ends_with_an_obituary(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    job_id = daemon.submit(large)
    for attempt in range(1, 4):
        wait_until(lambda a=attempt: f"job={job_id} accepted -> running attempt={a}" in daemon.log_text(), "the start")
        daemon.kill()
        daemon.start()
    job = daemon.ended(job_id)
    assert job["status"] == "failed" and job["attempt"] == 3
    assert job["problem"]["type"] == "/problems/worker-crashed" and "3 attempts" in job["problem"]["detail"]
    assert daemon.post("/v1/simplify", SMALL).status == 200


def test_kill_of_the_worker_is_tried_again(daemon, large):
    job_id = daemon.submit(large)
    os.kill(daemon.worker_pid(job_id), signal.SIGKILL)
    job = daemon.ended(job_id)
    assert job["status"] == "successful" and job["attempt"] == 2
    assert b"signal 9" in daemon.curl(f"/v1/jobs/{job_id}/log").body


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
    deaf.write_text("#!/bin/sh\ntrap '' TERM\necho 'progress deaf 0.5 x' >&3\nwhile :; do sleep 1; done\n")
    deaf.chmod(0o755)
    daemon = make_daemon("--worker", deaf, "--worker-sandbox=off")
    job_id = daemon.submit(SMALL)
    wait_until(lambda: daemon.job(job_id)["stage"] == "deaf", "its word")
    pid = daemon.worker_pid(job_id)
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"
    assert not process_lives(pid)
    group = subprocess.run(["pgrep", "-g", str(pid)], capture_output=True, text=True, check=False).stdout.split()
    assert not any(process_lives(member) for member in group)


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
        wait_until(lambda n=i: daemon.log_text().count("are read again") == n, "the reload")
    assert daemon.worker_pid(running) == pid
    job = daemon.ended(running)
    assert job["status"] == "successful" and job["attempt"] == 1
    assert b"event: end" in events.communicate(timeout=PATIENCE_S)[0]
    assert daemon.ended(waiting)["status"] == "successful"


# ---------------------------------------------------------------------------------------------- mending

def test_the_start_removes_what_nobody_knows(make_daemon):
    daemon = make_daemon()
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    daemon.kill()
    (daemon.data / "tmp" / "upload-half").write_bytes(b"x")
    (daemon.data / "tmp" / "half").mkdir()
    (daemon.data / "tmp" / "half" / "cloud.ply").write_bytes(b"x")
    (daemon.data / "clouds" / ("0" * 64)).write_bytes(b"x")
    stray = daemon.data / "jobs" / "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e" / "outputs"
    stray.mkdir(parents=True)
    (stray / "cloud.ply").write_bytes(b"x")
    daemon.start()
    assert daemon.leftovers() == []
    assert len(list((daemon.data / "clouds").iterdir())) == 1
    assert [p.name for p in (daemon.data / "jobs").iterdir()] == [job_id]
    assert daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply").status == 200
    assert "mended requeued=0 failed=0 inputs_lost=0 outputs_lost=0 clouds_lost=0 files_removed=4" in daemon.log_text()


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
