# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job's process can't do, tried from inside: the daemon runs tests/tools/confined_probe.c in place of whittle."""
import ctypes
import os
import pathlib
import pwd
import re
import shutil
import signal
import subprocess
import tempfile

import pytest

from conftest import BUILD, HOSTS, Daemon, SANITIZED, SMALL, children_of, end_all, process_lives, wait_until

PROBE = BUILD / "tests" / "tools" / "confined_probe"
NOBODY = 65534
CAPABILITIES_LEFT = 1 << 1 | 1 << 2  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH: of root alone
NOT_PERMITTED, NO_ACCESS = "refused: Operation not permitted", "refused: Permission denied"


FLAGS = ("--worker-sandbox=on", "--job-memory", "256M", "--job-cpu", "1s", "--job-file-bytes", "3M", "--workers", "2")
# As other kernels are: Debian 12's, whose Landlock knows of files alone; one without Landlock; one where nobody may have
# a namespace, or none of process ids; one with nothing but filters.
KERNELS = {"this": "", "old": "landlock-newer=enosys", "bare": "landlock=enosys", "closed": "namespaces=enosys",
           "shared": "pid-namespace=enosys", "filters": "landlock=enosys,namespaces=enosys"}


@pytest.fixture(name="make_probe")
def make_make_probe(make_daemon):
    if not PROBE.exists():
        pytest.skip("the probe isn't built")
    return lambda *flags: make_daemon("--worker", PROBE.resolve(), *FLAGS, *flags)


@pytest.fixture(name="probe")
def make_one_probe(make_probe):
    return make_probe()


@pytest.fixture(name="anywhere", params=KERNELS)
def make_probe_anywhere(make_probe, request):
    """The probe, on each of these kernels."""
    daemon = make_probe("--fault", KERNELS[request.param])
    held = next(line for line in daemon.log_text().splitlines() if "jobs are confined by" in line)
    assert ("Landlock" in held) == (request.param not in ("bare", "filters") and has_landlock())
    assert request.param != "old" or not has_landlock() or "Landlock 2" in held or "Landlock 1" in held
    return daemon


def has_landlock():
    """As the kernel answers landlock_create_ruleset, which is 444 everywhere."""
    return ctypes.CDLL(None).syscall(444, None, 0, 1) > 0


def holds(daemon, what):
    line = next(line for line in daemon.log_text().splitlines() if "jobs are confined by" in line)
    return what in line


def need(daemon, what):
    if not holds(daemon, what):
        pytest.skip(f"{what}: not on this machine")


def probe_input(daemon, *words):
    return f"# service {daemon.process.pid}\n# probe {' '.join(map(str, words))}\n".encode() + SMALL


def attempt(daemon, *words):
    job = daemon.ended(daemon.submit(probe_input(daemon, *words)))
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
         "settimeofday", "setpriority", "sched_setaffinity", "setpgid", "setsid", "chdir", "quotactl", "tgkill", "rt_sigqueueinfo",
         "rt_tgsigqueueinfo", "pidfd_send_signal", "timer_create", "setitimer", "mq_notify", "io_setup", "io_submit", "prctl",
         "get_robust_list", "kcmp", "copy_file_range", "sched_setscheduler", "ioprio_set", "flock", "seccomp",
         "ioctl", "unknown", "x32"]


def signal_of_old_calls():
    """What ends a confined process that calls as 32-bit programs do: the filter, or the kernel itself where it has no such
    calls, so that they end any process."""
    anybody = subprocess.run([PROBE], input=f"# service {os.getpid()}\n# probe old", text=True, check=False)
    return signal.SIGSEGV if anybody.returncode == -signal.SIGSEGV else signal.SIGSYS


def test_no_system_call_gets_through_that_a_job_has_no_use_for(probe):
    need(probe, "seccomp")
    through = {}
    for deed, ends_with in [*((("call", name), signal.SIGSYS) for name in CALLS), (("old",), signal_of_old_calls())]:
        problem = attempt(probe, *deed)
        killed = problem["type"] == "/problems/worker-crashed" and problem.get("signal") == ends_with
        if not killed and problem["detail"] != NOT_PERMITTED:
            through[deed] = problem
    assert through == {}
    assert outcome(probe, "thread") == "got through"


OTHERS_SIGNALLED = ["signal", "own", "limits"] + [f"fcntl {name}" for name in (
    "setown", "setown-group", "setown-wide", "setown-ex", "setsig", "async", "async-wide", "lease", "notify", "lock",
    "lock-wait", "lock-file", "pipe", "dup-wide")] + [f"ioctl {name}" for name in (
        "fioasync", "fiosetown", "siocspgrp", "fionbio", "tiocsti", "tiocspgrp", "async-wide", "tcgets-wide")]
CODE_MADE = ["code", "mapped", "input", "protect", "filter", "unlimit", "outlive 0"]


def test_what_a_job_may_not_do_fails_on_any_kernel(anywhere):
    """Nobody is signalled, nothing that was written is executed, and the service lives."""
    need(anywhere, "seccomp")
    said = {deed: outcome(anywhere, *deed.split()) for deed in OTHERS_SIGNALLED + CODE_MADE}
    assert {deed: word for deed, word in said.items() if word != NOT_PERMITTED} == {}
    assert outcome(anywhere, "flags") == "got through" and outcome(anywhere, "thread") == "got through"
    assert anywhere.process.poll() is None


def test_what_confines_jobs_is_told_alike_everywhere(anywhere):
    info = anywhere.curl("/v1/info").json["confinement"]
    metrics = dict(re.findall(r'^whittled_confinement{measure="(\w+)"} (\d+)$', anywhere.curl("/metrics").body.decode(), re.M))
    assert {name: str(value) for name, value in info.items()} == metrics
    said = {"seccomp": "seccomp", "landlock": f"Landlock {info['landlock']}", "no_network": "no network",
            "own_process_ids": "own process ids", "thread_limit": "threads", "own_account": "user "}
    assert set(said) == set(info)
    assert {name: holds(anywhere, words) for name, words in said.items()} == {name: bool(info[name]) for name in said}


def test_the_service_s_memory_is_out_of_reach_on_any_kernel(anywhere):
    assert outcome(anywhere, "parent", "mem") == NO_ACCESS
    assert anywhere.process.poll() is None


NOTHING_ELSE = "seccomp=enosys,landlock=enosys"  # what keeps a job from signals is taken away, but for what is tried
REACHES = ["kill", "signal", "trace", "own", "fcntl setown", "fcntl setown-ex", "limits"]


@pytest.mark.parametrize("who", ["make_probe", "unprivileged"])
def test_a_job_has_no_name_for_the_service_where_its_process_ids_are_its_own(request, who):
    daemon = request.getfixturevalue(who)("--fault", NOTHING_ELSE)
    need(daemon, "own process ids")
    said = {deed: outcome(daemon, *deed.split()) for deed in REACHES}
    assert {deed: word for deed, word in said.items() if word != "refused: No such process"} == {}
    assert outcome(daemon, "parent", "mem") == NO_ACCESS
    assert daemon.process.poll() is None


@pytest.mark.parametrize("point", ["keeper-forked", "worker-forked"])
def test_who_forks_both_may_be_killed_and_leaves_nobody(make_daemon, point):
    """A keeper that the service didn't know of was a process without an end for as long as the service ran."""
    daemon = make_daemon("--fault", f"{point}=kill")
    need(daemon, "own process ids")
    job_id = daemon.submit(SMALL)
    if point == "worker-forked":
        assert daemon.ended(job_id)["status"] == "successful"
    else:
        said = "can't be started yet: can't fork: Resource temporarily unavailable"
        wait_until(lambda: daemon.log_text().count(said) > 1, "two attempts")
        daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE")
        assert daemon.ended(job_id)["status"] == "dismissed"
    assert children_of(daemon.process.pid) == []
    daemon.allowed = {0}


def test_the_keeper_of_a_job_s_process_ids_ends_with_the_job_and_with_the_service(probe):
    need(probe, "own process ids")
    job_id = probe.submit(probe_input(probe, "nothing"))
    wait_until(lambda: probe.job(job_id)["stage"] == "nothing", "the probe's word")
    keepers = [pid for pid in children_of(probe.process.pid) if pid != probe.worker_pid(job_id)]
    assert len(keepers) == 1
    assert os.readlink(f"/proc/{keepers[0]}/ns/pid") == os.readlink(f"/proc/{probe.worker_pid(job_id)}/ns/pid")
    assert os.readlink(f"/proc/{keepers[0]}/ns/pid") != os.readlink(f"/proc/{probe.process.pid}/ns/pid")
    assert len(os.listdir(f"/proc/{keepers[0]}/fd")) == 1
    assert probe.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"
    assert children_of(probe.process.pid) == []
    probe.submit(probe_input(probe, "nothing"))
    keeper = wait_until(lambda: children_of(probe.process.pid)[:1], "the next keeper")[0]
    probe.kill()
    wait_until(lambda: not process_lives(keeper), "the keeper's end with the service")


@pytest.fixture(name="unprivileged")
def make_unprivileged(tmp_path_factory):
    """unprivileged(*flags): the probe's daemon of a user without rights but these, in a folder of its own."""
    if os.geteuid() != 0 or not shutil.which("setpriv"):
        pytest.skip("another user takes root, and setpriv of util-linux")
    if not PROBE.exists():
        pytest.skip("the probe isn't built")
    programs = pathlib.Path(tempfile.mkdtemp(prefix="whittle-probe-"))  # where that user gets at it
    daemons = []

    def make(*flags, worker=PROBE, capabilities=(), ends=0):
        programs.chmod(0o755)
        folder = pathlib.Path(tempfile.mkdtemp(prefix="data-", dir=programs))
        os.chown(folder, NOBODY, NOBODY)
        for program in (BUILD / "whittled", worker):
            shutil.copy(program, programs)
        daemon = Daemon(folder, "--worker", programs / worker.name, *(FLAGS if worker == PROBE else ()), *flags)
        kept = "".join(f",+{name}" for name in capabilities)
        daemon.program = programs / "whittled"
        daemon.prefix = ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", f"--bounding-set=-all{kept}",
                         f"--inh-caps=-all{kept}", f"--ambient-caps=-all{kept}", "--")
        daemon.may_end(ends)
        daemons.append(daemon)
        return daemon.start()

    yield make
    end_all(daemons)
    shutil.rmtree(programs)


@pytest.fixture(name="other_user")
def make_other_user(make_daemon):
    """other_user(program, *flags): a daemon of root's whose jobs run as nobody."""
    if os.geteuid() != 0:
        pytest.skip("another user takes root")
    programs = pathlib.Path(tempfile.mkdtemp(prefix="whittle-probe-"))  # where that user gets at it
    programs.chmod(0o755)

    def make(program, *flags):
        shutil.copy(program, programs)
        return make_daemon("--worker", programs / program.name, "--job-user", "nobody", "--workers", "2", *flags)

    before = os.getgroups()
    os.setgroups([*before, 4, 20])  # further ones of root's, which the daemon has from us
    yield make
    os.setgroups(before)
    shutil.rmtree(programs)


@pytest.mark.parametrize("kernel", KERNELS)
def test_jobs_of_another_user_reach_nothing_of_the_service(other_user, kernel):
    if not PROBE.exists():
        pytest.skip("the probe isn't built")
    daemon = other_user(PROBE, *FLAGS, "--fault", KERNELS[kernel])
    assert holds(daemon, "user nobody") and daemon.curl("/v1/info").json["confinement"]["own_account"] == 1
    job_id = daemon.submit(probe_input(daemon, "nothing"))
    wait_until(lambda: daemon.job(job_id)["stage"] == "nothing", "the probe's word")
    pid = daemon.worker_pid(job_id)
    status = dict(line.split(":\t", 1) for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines()
                  if ":\t" in line)
    account = pwd.getpwnam("nobody")
    assert status["Uid"].split() == [str(NOBODY)] * 4 and status["Gid"].split() == [str(account.pw_gid)] * 4
    assert status["Groups"].strip() == ""
    assert int(status["CapEff"], 16) == int(status["CapPrm"], 16) == 0
    for path in (daemon.data / "whittled.db", daemon.data / "signing.key", daemon.data / "jobs"):
        assert outcome(daemon, "read", path) == NO_ACCESS
    assert outcome(daemon, "parent", "mem") == NO_ACCESS
    daemon.kill()
    wait_until(lambda: not process_lives(pid), "the process's end with the service")


@pytest.mark.parametrize("kernel", ["", ",pid-namespace=enosys", ",namespaces=enosys"])
def test_no_signal_of_another_user_s_job_reaches_the_service(other_user, kernel):
    if not PROBE.exists():
        pytest.skip("the probe isn't built")
    daemon = other_user(PROBE, *FLAGS, "--fault", NOTHING_ELSE + kernel)
    for deed in ("kill", "signal", "trace", "limits"):
        assert outcome(daemon, deed) in ("refused: No such process", NOT_PERMITTED)
    job_id = daemon.submit(probe_input(daemon, "own"))  # the kernel may take the order, and doesn't follow it
    assert daemon.ended(job_id)["status"] == "failed"
    assert daemon.process.poll() is None and daemon.curl("/healthz").status == 200


@pytest.mark.skipif(SANITIZED, reason="sanitizers can't be confined")
def test_outputs_of_another_user_become_the_service_s(other_user):
    daemon = other_user(BUILD / "whittle")
    job = daemon.ended(daemon.submit(SMALL, "?ratio=0.5&outputs=cloud,mesh,report"))
    assert job["status"] == "successful", job
    folder = daemon.data / "jobs" / job["id"] / "outputs"
    assert {entry.stat().st_uid for entry in (folder, *folder.iterdir())} == {0}
    assert daemon.leftovers() == []


FOR_ANOTHER_USER = ("setuid", "setgid", "chown", "kill")


@pytest.mark.parametrize("kernel", ["", ",namespaces=enosys"])
def test_four_capabilities_are_enough_for_jobs_of_another_user(unprivileged, kernel):
    daemon = unprivileged("--job-user", "daemon", "--fault", NOTHING_ELSE + kernel, capabilities=FOR_ANOTHER_USER)
    job_id = daemon.submit(probe_input(daemon, "nothing"))
    wait_until(lambda: daemon.job(job_id)["stage"] == "nothing", "the probe's word")
    status = pathlib.Path(f"/proc/{daemon.worker_pid(job_id)}/status").read_text()
    account = pwd.getpwnam("daemon")
    assert re.search(rf"^Uid:(\t{account.pw_uid}){{4}}$", status, re.M) and re.search(r"^Groups:\t ?$", status, re.M)
    assert re.findall(r"^Cap(?:Inh|Prm|Eff|Amb):\t(\w+)$", status, re.M) == ["0" * 16] * 4
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"  # its signals reach the job
    for deed in ("kill", "signal", "trace", "limits"):
        assert outcome(daemon, deed) in ("refused: No such process", NOT_PERMITTED)
    for path in (daemon.data / "whittled.db", daemon.data / "signing.key", daemon.data / "jobs"):
        assert outcome(daemon, "read", path) == NO_ACCESS
    assert attempt(daemon, "many", 1000)["detail"].endswith("13 files, a job may have 12")
    assert daemon.process.poll() is None and daemon.leftovers() == []


@pytest.mark.skipif(SANITIZED, reason="sanitizers can't be confined")
def test_outputs_come_back_from_another_user_by_these_capabilities(unprivileged):
    daemon = unprivileged("--job-user", "daemon", worker=BUILD / "whittle", capabilities=FOR_ANOTHER_USER)
    job = daemon.ended(daemon.submit(SMALL, "?ratio=0.5&outputs=cloud,mesh,report"))
    assert job["status"] == "successful", job
    folder = daemon.data / "jobs" / job["id"] / "outputs"
    assert {entry.stat().st_uid for entry in (folder, *folder.iterdir())} == {NOBODY}
    assert daemon.leftovers() == []


def test_without_these_capabilities_another_user_is_refused(unprivileged):
    with pytest.raises(AssertionError, match="has to start as root, or with the capabilities CAP_SETUID"):
        unprivileged("--job-user", "daemon", ends=2)


def test_an_account_that_can_t_be_had_is_refused_at_the_start(tmp_path):
    for name, said in (("no-such-account", "is no account"), ("root", "is no account other than root's")):
        done = subprocess.run([BUILD / "whittled", "--listen", "127.0.0.1:0", "--data", tmp_path / "data", "--job-user",
                               name], capture_output=True, text=True, check=False)
        assert done.returncode == 2 and said in done.stderr, done.stderr


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_same_holds_where_the_service_has_no_rights(unprivileged, kernel):
    daemon = unprivileged("--fault", KERNELS[kernel])
    need(daemon, "seccomp")
    said = {deed: outcome(daemon, *deed.split()) for deed in OTHERS_SIGNALLED + CODE_MADE}
    assert {deed: word for deed, word in said.items() if word != NOT_PERMITTED} == {}
    assert outcome(daemon, "parent", "mem") == NO_ACCESS
    assert outcome(daemon, "thread") == "got through"


def test_a_program_in_the_job_s_folder_can_t_be_executed(make_probe):
    """By Landlock, where the filter doesn't end who tries."""
    daemon = make_probe("--fault", "seccomp=enosys")
    need(daemon, "Landlock")
    assert not holds(daemon, "seccomp") and outcome(daemon, "program") == NO_ACCESS


def test_files_outside_of_the_folder_are_out_of_reach(probe, tmp_path):
    need(probe, "Landlock")
    secret = tmp_path / "secret"
    secret.write_text("secret")
    state = "signing.key" if HOSTS else "whittled.db"
    for path in (secret, probe.data / state, "/etc/passwd", "/proc/self/status", "/proc/self/mem"):
        assert outcome(probe, "read", path) == NO_ACCESS
    for path in (tmp_path, probe.data / "jobs", "/", "/etc"):
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
    assert outcome(probe, "memory", 100) == "refused: Cannot allocate memory"  # far more than was predicted
    assert outcome(probe, "memory", 10) == "got through"
    assert outcome(probe, "length", 4) == "refused: File too large"
    assert outcome(probe, "length", 3) == "got through"
    assert outcome(probe, "files", 100) == "refused: Too many open files"
    problem = attempt(probe, "time")
    assert 500 < problem["cpu_ms"] < 10000
    assert problem["type"] == "/problems/time-limit" and problem["signal"] == signal.SIGXCPU


def test_a_job_may_write_so_much_in_all(make_probe):
    daemon = make_probe("--job-write-bytes", "16M")
    problem = attempt(daemon, "sum", 20)
    assert problem["type"] == "/problems/worker-crashed" and problem["setting"] == "job-write-bytes"
    assert problem["limit"] == 16 << 20 and "bytes written, a job may have 16777216 (setting job-write-bytes)" in \
        problem["detail"]
    job_id = daemon.submit(probe_input(daemon, "sum", 10))
    wait_until(lambda: daemon.job(job_id)["stage"] == "sum", "the probe's word")
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"
    assert daemon.leftovers() == []


def test_a_job_may_have_so_many_files(probe):
    problem = attempt(probe, "many", 1000)
    assert problem["type"] == "/problems/worker-crashed" and problem["limit"] == 2 * 2 + 8
    assert problem["detail"] == "the process of attempt 1 was ended in stage many: 13 files, a job may have 12"
    assert probe.leftovers() == []


def test_a_job_may_have_so_many_threads(probe):
    """As root the kernel counts them for nobody; then who has too many is ended."""
    problem = attempt(probe, "threads", 500)
    if holds(probe, "threads"):
        assert problem["detail"] == "refused: Resource temporarily unavailable"
    else:
        assert problem["detail"].endswith(f" threads, a job may have {problem['limit']}") and problem["limit"] < 100


def test_threads_have_a_limit_of_the_kernel_s_where_a_namespace_counts_them(unprivileged):
    daemon = unprivileged()
    need(daemon, "threads")
    assert outcome(daemon, "threads", 500) == "refused: Resource temporarily unavailable"
    assert outcome(daemon, "thread") == "got through"


def test_abort_is_seen_as_what_it_is(probe):
    assert attempt(probe, "abort")["signal"] == signal.SIGABRT


def test_the_process_seen_from_outside(probe):
    job_id = probe.submit(probe_input(probe, "nothing"))
    wait_until(lambda: probe.job(job_id)["stage"] == "nothing", "the probe's word")
    folder = pathlib.Path("/proc", str(probe.worker_pid(job_id)))
    status = dict(line.split(":\t", 1) for line in (folder / "status").read_text().splitlines() if ":\t" in line)
    assert status["NoNewPrivs"] == "1"
    assert status["Seccomp"] == ("2" if holds(probe, "seccomp") else "0")
    assert status.get("Seccomp_filters", "2") == "2" or not holds(probe, "seccomp")  # the program's own is the second
    for kind in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb"):
        assert int(status[kind], 16) & ~CAPABILITIES_LEFT == 0, (kind, status[kind])
    assert (folder / "oom_score_adj").read_text() == "500\n"
    assert (folder / "environ").read_bytes() == b""
    assert sorted(entry.name for entry in (folder / "fd").iterdir()) >= ["0", "1", "2", "3"]
    assert not any("socket" in os.readlink(entry) for entry in (folder / "fd").iterdir())
    assert os.getpgid(int(folder.name)) == int(folder.name)
    if holds(probe, "no network"):
        assert os.readlink(folder / "ns" / "net") != os.readlink("/proc/self/ns/net")
        assert [line.split(":")[0].strip() for line in (folder / "net" / "dev").read_text().splitlines()[2:]] == ["lo"]
    limits = {line[:26].strip(): line[26:].split()[:2] for line in (folder / "limits").read_text().splitlines()}
    # Both follow from the memory that is predicted for the job, some megabytes.
    assert int(limits["Max data size"][0]) == int(limits["Max data size"][1]) < 100 << 20
    assert int(limits["Max data size"][0]) < int(limits["Max address space"][0]) <= 256 << 20
    assert limits["Max stack size"] == [str(8 << 20)] * 2
    assert limits["Max file size"][0] == str(3 << 20)
    assert limits["Max cpu time"] == ["1", "6"]
    assert limits["Max core file size"] == ["0", "0"]
    assert probe.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "dismissed"


def test_a_job_s_process_ends_with_the_service(probe):
    """It would wait for ever by itself."""
    job_id = probe.submit(probe_input(probe, "nothing"))
    wait_until(lambda: probe.job(job_id)["stage"] == "nothing", "the probe's word")
    pid = probe.worker_pid(job_id)
    probe.kill()
    wait_until(lambda: not process_lives(pid), "the process's end")


def test_a_job_is_nicer_than_the_service(probe):
    own = min(os.getpriority(os.PRIO_PROCESS, probe.process.pid) + 3, 14)
    for thread in pathlib.Path("/proc", str(probe.process.pid), "task").iterdir():
        os.setpriority(os.PRIO_PROCESS, int(thread.name), own)
    job_id = probe.submit(probe_input(probe, "nothing"))
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
    assert outcome(daemon, "outlive", 0) == NOT_PERMITTED
    assert outcome(daemon, "outlive", int(signal.SIGKILL)) == "got through"  # so does a leak check's helper


@pytest.mark.skipif(SANITIZED, reason="sanitizers can't be confined")
def test_whittle_does_everything_confined(daemon):
    outputs = "cloud,xyz,mesh,dso,error,report"
    job = daemon.ended(daemon.submit(SMALL, f"?ratio=0.5&outputs={outputs}&threads=4&denoise=full"))
    assert job["status"] == "successful", job
