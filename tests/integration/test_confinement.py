# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job's process can't do, tried from inside: the daemon runs tests/tools/confined_probe.c in place of whittle."""
import os
import pathlib
import signal

import pytest

from conftest import BUILD, SANITIZED, SMALL, wait_until

PROBE = BUILD / "tests" / "tools" / "confined_probe"
NOT_PERMITTED, NO_ACCESS = "refused: Operation not permitted", "refused: Permission denied"


@pytest.fixture(name="probe")
def make_probe(make_daemon):
    if not PROBE.exists():
        pytest.skip("the probe isn't built")
    return make_daemon("--worker", PROBE.resolve(), "--worker-sandbox=on", "--job-memory", "256M", "--job-cpu", "1s",
                       "--job-file-bytes", "3M", "--workers", "2")


def holds(daemon, what):
    line = next(line for line in daemon.log_text().splitlines() if "jobs are confined by" in line)
    return what in line


def need(daemon, what):
    if not holds(daemon, what):
        pytest.skip(f"{what}: not on this machine")


def attempt(daemon, *words):
    job = daemon.ended(daemon.submit(f"# probe {' '.join(map(str, words))}\n".encode() + SMALL))
    assert job["status"] == "failed" and job["attempt"] == 1, job
    return job["problem"]


def outcome(daemon, *words):
    return attempt(daemon, *words)["detail"]


@pytest.mark.parametrize("deed", ["socket", "fork", "exec /bin/true", "trace"])
def test_what_only_a_hijacked_process_would_do_ends_it(probe, deed):
    need(probe, "seccomp")
    problem = attempt(probe, *deed.split())
    assert problem["type"] == "/problems/worker-crashed" and problem["signal"] == signal.SIGSYS
    assert problem["stage"] == deed.split()[0] and "system call" in problem["detail"]
    assert outcome(probe, "thread") == "got through"  # the daemon lives and runs the next


CALLS = ["unshare", "setns", "mount", "umount2", "pivot_root", "chroot", "kill", "tkill", "process_vm_readv", "pidfd_open",
         "io_uring_setup", "bpf", "perf_event_open", "userfaultfd", "keyctl", "execveat", "setuid", "setgroups",
         "memfd_create", "personality", "linkat", "mknodat", "fchmodat", "fchownat", "setxattr", "open_by_handle_at",
         "inotify_init1", "fanotify_init", "shmget", "msgget", "mq_open", "init_module", "reboot", "sethostname",
         "settimeofday", "setpriority", "sched_setaffinity", "setpgid", "setsid", "chdir", "quotactl", "unknown", "x32"]


def test_no_system_call_gets_through_that_a_job_has_no_use_for(probe):
    need(probe, "seccomp")
    through = {}
    for deed in [("call", name) for name in CALLS] + [("old",)]:
        problem = attempt(probe, *deed)
        killed = problem["type"] == "/problems/worker-crashed" and problem.get("signal") == signal.SIGSYS
        if not killed and problem["detail"] != NOT_PERMITTED:
            through[deed] = problem
    assert through == {}
    assert outcome(probe, "thread") == "got through"


@pytest.mark.parametrize("deed", ["signal", "code", "unlimit"])
def test_what_a_job_may_not_do_fails(probe, deed):
    need(probe, "seccomp")
    assert outcome(probe, deed) == NOT_PERMITTED


def test_files_outside_of_the_folder_are_out_of_reach(probe, tmp_path):
    need(probe, "Landlock")
    secret = tmp_path / "secret"
    secret.write_text("secret")
    for path in (secret, probe.data / "whittled.db", "/etc/passwd", "/proc/self/status", "/proc/self/mem"):
        assert outcome(probe, "read", path) == NO_ACCESS
    for path in (tmp_path, probe.data / "clouds", "/", "/etc"):
        assert outcome(probe, "list", path) == NO_ACCESS
    for path in (secret, tmp_path / "new", "/tmp/whittled-probe", "/dev/null"):
        assert outcome(probe, "write", path) == NO_ACCESS
    assert outcome(probe, "above", "new") == NO_ACCESS
    assert outcome(probe, "rename", tmp_path / "new").startswith("refused")
    assert secret.read_text() == "secret" and not (tmp_path / "new").exists()
    assert probe.leftovers() == []


def test_links_out_of_the_folder_are_refused(probe):
    need(probe, "seccomp")
    assert attempt(probe, "link", "/etc/passwd")["signal"] == signal.SIGSYS


def test_memory_time_files_and_descriptors_have_an_end(probe):
    assert outcome(probe, "memory", 1000) == "refused: Cannot allocate memory"
    assert outcome(probe, "memory", 100) == "got through"
    assert outcome(probe, "length", 4) == "refused: File too large"
    assert outcome(probe, "length", 3) == "got through"
    assert outcome(probe, "files", 100) == "refused: Too many open files"
    problem = attempt(probe, "time")
    assert problem["type"] == "/problems/time-limit" and problem["signal"] == signal.SIGXCPU


def test_abort_is_seen_as_what_it_is(probe):
    assert attempt(probe, "abort")["signal"] == signal.SIGABRT


def test_the_process_seen_from_outside(probe):
    job_id = probe.submit(b"# probe nothing\n" + SMALL)
    wait_until(lambda: probe.job(job_id)["stage"] == "nothing", "the probe's word")
    folder = pathlib.Path("/proc", str(probe.worker_pid(job_id)))
    status = dict(line.split(":\t", 1) for line in (folder / "status").read_text().splitlines() if ":\t" in line)
    assert status["NoNewPrivs"] == "1"
    assert status["Seccomp"] == ("2" if holds(probe, "seccomp") else "0")
    assert (folder / "environ").read_bytes() == b""
    assert sorted(entry.name for entry in (folder / "fd").iterdir()) >= ["0", "1", "2", "3"]
    assert not any("socket" in os.readlink(entry) for entry in (folder / "fd").iterdir())
    assert os.getpgid(int(folder.name)) == int(folder.name)
    if holds(probe, "no network"):
        assert os.readlink(folder / "ns" / "net") != os.readlink("/proc/self/ns/net")
        assert [line.split(":")[0].strip() for line in (folder / "net" / "dev").read_text().splitlines()[2:]] == ["lo"]
    limits = {line[:26].strip(): line[26:].split()[:2] for line in (folder / "limits").read_text().splitlines()}
    assert limits["Max address space"][0] == str(256 << 20)
    assert limits["Max file size"][0] == str(3 << 20)
    assert limits["Max cpu time"][0] == "1"
    assert limits["Max core file size"] == ["0", "0"]
    assert probe.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"


def test_a_job_is_nicer_than_the_service(probe):
    own = min(os.getpriority(os.PRIO_PROCESS, probe.process.pid) + 3, 14)
    for thread in pathlib.Path("/proc", str(probe.process.pid), "task").iterdir():
        os.setpriority(os.PRIO_PROCESS, int(thread.name), own)
    job_id = probe.submit(b"# probe nothing\n" + SMALL)
    wait_until(lambda: probe.job(job_id)["stage"] == "nothing", "the probe's word")
    assert os.getpriority(os.PRIO_PROCESS, probe.worker_pid(job_id)) == own + 5
    assert probe.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"


def test_without_the_sandbox_limits_hold_alone(make_daemon):
    if not PROBE.exists():
        pytest.skip("the probe isn't built")
    daemon = make_daemon("--worker", PROBE.resolve(), "--worker-sandbox=off", "--job-memory", "256M")
    assert "jobs are confined by limits, no new privileges\n" in daemon.log_text()
    assert outcome(daemon, "read", "/etc/passwd") == "got through"
    assert outcome(daemon, "memory", 1000) == "refused: Cannot allocate memory"


@pytest.mark.skipif(SANITIZED, reason="sanitizers can't be confined")
def test_whittle_does_everything_confined(daemon):
    outputs = "cloud,xyz,mesh,dso,error,report"
    job = daemon.ended(daemon.submit(SMALL, f"?ratio=0.5&outputs={outputs}&threads=4&denoise=full"))
    assert job["status"] == "successful", job
