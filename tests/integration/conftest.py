# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts whittled for a test, on a free port and a data folder of its own, and talks to it with curl."""
import contextlib
import ctypes
import fnmatch
import http.client
import json
import math
import os
import pathlib
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time

import pytest

BUILD = pathlib.Path(os.environ.get("WHITTLE_BUILD", "build/release"))
SANITIZED = bool(re.search("asan|tsan", str(BUILD)))
PATIENCE_S = int(os.environ.get("WHITTLE_PATIENCE_S", 600 if SANITIZED else 180))  # how long a condition may take before the test gives up
# Sanitizers reserve address space that a limit would deny, and do what confinement forbids.
UNLIMITED = ("--job-memory", "1024T", "--worker-sandbox=off") if SANITIZED else ()


def wait_until(condition, what="the condition"):
    """Returns what condition() answers as soon as that is true."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        answer = condition()
        if answer:
            return answer
        time.sleep(0.01)
    raise AssertionError(f"{what} did not come in {PATIENCE_S} s")


def pytest_make_parametrize_id(val):
    """Bytes are named by their length: the content may differ between two processes that collect the same tests."""
    return f"{len(val)} bytes" if isinstance(val, bytes) else None


class Reply:
    """What curl -D gives: status, headers (lower-case names), body."""

    def __init__(self, status, headers, body):
        self.status, self.headers, self.body = status, headers, body

    @property
    def json(self):
        return json.loads(self.body)

    @property
    def slug(self):
        assert self.headers["content-type"] == "application/problem+json", self.headers
        document = self.json
        assert document["status"] == self.status
        assert document["title"] and document["detail"]
        return document["type"].removeprefix("/problems/")


SANITIZERS_SAY = re.compile(r"(?:ERROR|WARNING): \w+Sanitizer.*|.*: runtime error: .*")


def children_of(pid):
    found = []
    for task in pathlib.Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += map(int, task.read_text().split())
        except OSError:
            pass  # the thread has ended
    return found


# ---------------------------------------------------------------------------------------------- where the state is

HOSTS = "hosts" == os.environ.get("WHITTLE_BACKEND", "")  # PostgreSQL and S3 for each service; else SQLite and a folder
POSTGRES = pathlib.Path(os.environ.get("POSTGRES_BIN", "/usr/lib/postgresql/15/bin"))


class Shared:
    """What services of several hosts share: a database and a prefix of a bucket, both empty, of the servers that
    WHITTLE_CATALOG and WHITTLE_BLOBS name.  Each process of the tests has a database of its own to copy from."""
    count = 0
    template = None

    def __init__(self, blobs=None):
        Shared.count += 1
        self.name = f"whittle_{os.getpid()}_{Shared.count}"
        if not Shared.template:
            Shared.template = f"whittle_{os.getpid()}"
            self.sql(f"CREATE DATABASE {Shared.template}")
            subprocess.run([BUILD / "whittled", "migrate", "--catalog", self.url_of(Shared.template)], check=True)
        self.sql(f"CREATE DATABASE {self.name} TEMPLATE {Shared.template}")
        self.catalog = self.url_of(self.name)
        if not blobs:
            bucket, query = os.environ["WHITTLE_BLOBS"].split("?")
            blobs = f"{bucket}/{self.name}?{query}"
        self.blobs = blobs
        self.flags = ["--catalog", self.catalog, "--blobs", self.blobs]

    @staticmethod
    def url_of(name):
        return re.sub(r"/\w+\?", f"/{name}?", os.environ["WHITTLE_CATALOG"])

    @staticmethod
    def sql(text, url=None):
        """What psql prints, unadorned."""
        done = subprocess.run([POSTGRES / "psql", "-X", "-q", "-A", "-t", "-v", "ON_ERROR_STOP=1", "-c", text,
                               url or os.environ["WHITTLE_CATALOG"]], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    def ask(self, text):
        return self.sql(text, self.catalog)

    def remove(self):
        self.sql(f"DROP DATABASE IF EXISTS {self.name} WITH (FORCE)")


class Process(subprocess.Popen):
    """Knows whether it was told to stop: a second signal would end it at once."""
    stopping = False

    def send_signal(self, sig):
        self.stopping = self.stopping or sig in (signal.SIGTERM, signal.SIGINT)
        super().send_signal(sig)


class Daemon:
    """A whittled of this test's own.  How each of its processes ended is looked at when the test is over: with status 0,
    unless the test killed it, gave it a fault that kills, or says otherwise (may_end)."""

    def __init__(self, folder, *flags):
        self.folder, self.flags = folder, flags
        self.data = folder / "data"
        self.log = folder / "log"
        self.process = None
        self.processes = []  # all that there were
        self.allowed = {0} | ({-signal.SIGKILL} if any("=kill" in str(flag) for flag in flags) else set())
        self.curl_flags = ()
        self.prefix = ()  # a command that ends in exec of its arguments
        self.program = BUILD / "whittled"
        self.shared = Shared() if HOSTS and "--catalog" not in flags else None
        if self.shared:
            self.flags = (*self.shared.flags, *flags)

    def start(self, *more):
        with open(self.log, "ab") as log:
            self.process = Process(
                [*self.prefix, self.program, "--listen", "127.0.0.1:0", "--data", self.data, *UNLIMITED, *self.flags, *more],
                stdout=subprocess.PIPE, stderr=log, text=True)
        self.processes.append(self.process)
        if any("=kill" in str(flag) for flag in more):
            self.may_end(-signal.SIGKILL)
        line = self.process.stdout.readline()
        assert re.match("listening on https?://127.0.0.1:", line), (line, self.log_text()[-4000:])
        self.url = line.split()[-1]
        return self

    @property
    def port(self):
        return int(self.url.rsplit(":", 1)[1])

    def log_text(self):
        return self.log.read_text(errors="replace")

    def may_end(self, *statuses):
        """This test ends it so on purpose."""
        self.allowed.update(statuses)

    def kill(self):
        self.may_end(-signal.SIGKILL)
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(PATIENCE_S)

    def stop(self):
        """Drains; returns the exit status."""
        if self.process and self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(PATIENCE_S)
        return self.process.returncode if self.process else None

    def give_up(self):
        """Ends it as a service manager does; what still runs is not waited for, but killed."""
        def ended():
            # Children that were there before it said that it has ended are jobs'; later ones the leak check's.
            children = children_of(self.process.pid)
            said_so = re.search(r" info +ended$", self.log_text().rpartition(" listening on ")[2], re.M)
            for pid in () if said_so else children:
                try:
                    os.kill(pid, signal.SIGKILL)
                except ProcessLookupError:
                    pass
            return self.process.poll() is not None

        if self.process and self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            if not self.process.stopping:
                self.process.send_signal(signal.SIGTERM)
            wait_until(ended, "the end of whittled")

    def __enter__(self):
        return self.start()

    def __exit__(self, *reason):
        end_all([self])

    def faults(self):
        """What is wrong with how its processes ended; those that haven't are killed."""
        ends = []
        for process in self.processes:
            late = process.poll() is None
            if late:
                process.kill()
                process.wait()
            ends.append("nothing but SIGKILL" if late else process.returncode)
        return ([f"whittled ended with {end}" for end in ends if end not in self.allowed]
                + SANITIZERS_SAY.findall(self.log_text() if self.log.exists() else ""))

    def request(self, method, path, body=None, headers=None, connection=None):
        """(status, headers, body) without curl, for the many requests of a campaign; connection: one that is kept."""
        own = connection or http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            own.request(method, path, body=body, headers=headers or {})
            reply = own.getresponse()
            return reply.status, dict(reply.getheaders()), reply.read()
        finally:
            if not connection:
                own.close()

    def curl_command(self, path, *arguments):
        return ["curl", "-sS", "--max-time", str(PATIENCE_S), "-D", "-", *map(str, (*self.curl_flags, *arguments)),
                self.url + path]

    def curl(self, path, *arguments, data=None):
        done = subprocess.run(self.curl_command(path, *arguments), input=data, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr
        return parse_reply(done.stdout, "-L" in arguments)

    def post(self, path, data, *arguments):
        return self.curl(path, "-X", "POST", "--data-binary", "@-", "-H", "Expect:", *arguments, data=data)

    def submit(self, data, query=""):
        reply = self.post(f"/v1/jobs{query}", data)
        assert reply.status == 201, reply.body
        return reply.json["id"]

    def job(self, job_id):
        return self.curl(f"/v1/jobs/{job_id}").json

    def wait_for(self, job_id, *states):
        def reached():
            job = self.job(job_id)
            return job if job["status"] in states else None
        return wait_until(reached, f"{' or '.join(states)} of {job_id}: {self.job(job_id)}")

    def ended(self, job_id):
        return self.wait_for(job_id, "successful", "failed", "dismissed")

    def worker_pid(self, job_id):
        """The process that runs the job, once it is one: between fork and exec it still is a copy of the daemon."""
        def started():
            return re.findall(rf"job={job_id} accepted -> running attempt=\d+ pid=(\d+)", self.log_text())
        pid = int(wait_until(started, "the worker's start")[-1])
        own = read_of(self.process.pid, "cmdline")
        wait_until(lambda: read_of(pid, "cmdline") != own, "the worker's program")
        return pid

    def check(self):
        """Runs `whittled check` on the folder, which nothing may serve; returns exit status and lines."""
        shared = self.shared.flags if self.shared else []
        done = subprocess.run([BUILD / "whittled", "check", "--data", self.data, *shared], capture_output=True, text=True,
                              check=False)
        return done.returncode, (done.stdout + done.stderr).splitlines()

    def ask(self, statement):
        """The rows of a statement that its catalog's database understands, whichever that is; numbers as such."""
        if self.shared:
            rows = [line.split("|") for line in self.shared.ask(statement).splitlines()]
            return [tuple(int(v) if re.fullmatch("-?[0-9]+", v) else v for v in row) for row in rows]
        with contextlib.closing(sqlite3.connect(self.data / "whittled.db", timeout=60)) as database, database:
            return database.execute(statement).fetchall()

    def kept(self, what):
        """The names of the "jobs" or "clouds" that it has: by its folder, or where hosts share a store, which removes
        them after a grace, by the rows that name them."""
        if self.shared:
            rows = {"jobs": "SELECT id FROM jobs", "clouds": "SELECT cloud FROM jobs UNION SELECT sha256 FROM clouds"}
            return sorted(row[0] for row in self.ask(rows[what]))
        return sorted(path.name for path in (self.data / what).iterdir())

    def leftovers(self):
        return sorted(p.name for p in (self.data / "tmp").iterdir())


def parse_reply(output, follows=False):
    """The last of the header blocks, and the body; follows: what a redirection leads to."""
    while True:
        head, _, rest = output.partition(b"\r\n\r\n")
        lines = head.decode("latin-1").split("\r\n")
        status = int(lines[0].split()[1])
        if status != 100 and not (follows and 300 <= status < 400):
            break
        output = rest
    headers = {}
    for line in lines[1:]:
        name, _, value = line.partition(":")
        headers[name.lower()] = value.strip()
    return Reply(status, headers, rest)


def process_lives(pid):
    """Whether the process exists and is no zombie."""
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def sphere(count, place=0):
    """Points spread evenly over a unit sphere about (place, 0, 0), as XYZ text."""
    turn = math.pi * (3 - math.sqrt(5))
    lines = []
    for i in range(count):
        z = 1 - (2 * i + 1) / count
        r = math.sqrt(1 - z * z)
        lines.append(f"{r * math.cos(turn * i) + place:.6f} {r * math.sin(turn * i):.6f} {z:.6f}\n")
    return "".join(lines).encode()


SMALL = sphere(300)


# ---------------------------------------------------------------------------------------------- folders and skips

# Files that take longest, by the clock.  Each process of pytest-xdist takes a file at a time, so that what a file sets up
# is set up once; these begin first, and none of them is what all others wait for at the end.
LONGEST = [f"test_{name}.py" for name in (
    "tasks odd_geometries tiles matrix durability registries surface faults confinement tileset open_surfaces http refusals "
    "rules release endings clock lint memory service uploads upgrade hosts webhooks cross_site parameters batches systemd limits").split()]


def pytest_collection_modifyitems(items):
    """Where the state is in PostgreSQL and S3, tests of SQLite's file and of the folder of blobs are left out."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))
    table = pathlib.Path(__file__).with_name("one_host.txt")  # which tests of this file itself don't take along
    rows = [line.split(None, 2) for line in table.read_text().splitlines()
            if line.strip() and not line.startswith("#")] if HOSTS and table.exists() else []
    for item in items:
        for file, name, reason in rows:
            if item.path.name == file and (
                    fnmatch.fnmatch(item.originalname or item.name, name) or fnmatch.fnmatch(item.name, name)):
                item.add_marker(pytest.mark.skip(reason=f"of one host: {reason}"))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    if call.when == "call":
        item.stash[PASSED] = outcome.get_result().passed


PASSED = pytest.StashKey()


@pytest.fixture(name="tmp_path")
def make_tmp_path(request, tmp_path_factory):
    """As pytest's own, but gone when the test has passed: what all of them leave is a gigabyte."""
    path = tmp_path_factory.mktemp(re.sub(r"\W", "_", request.node.name)[:30])
    yield path
    if request.node.stash.get(PASSED, False):
        shutil.rmtree(path, ignore_errors=True)


def pytest_addoption(parser):
    parser.addoption("--allowed-skips", metavar="FILE", help="fail when a test is skipped that this file doesn't name")
    parser.addoption("--again", metavar="N", type=int, default=0,
                     help="run up to N tests that failed once more, with nothing beside them; fail when one fails again")


def allowed_skips(path):
    """Lines of when (always, plain, sanitized), file and reason, the latter two patterns as the shell has them."""
    rows = [line.split(None, 2) for line in pathlib.Path(path).read_text().splitlines()
            if line.strip() and not line.startswith("#")]
    now = "sanitized" if SANITIZED else "plain"
    return [(file, reason) for when, file, reason in rows if when in ("always", now)]


def unexpected_skips(reports, path):
    """"file: reason" of each skip that no line allows."""
    rows, found = allowed_skips(path), set()
    for report in reports:
        file, _, reason = report.longrepr
        name, reason = pathlib.Path(report.nodeid.split("::")[0] or file).name, reason.removeprefix("Skipped: ")
        if not any(fnmatch.fnmatch(name, f) and fnmatch.fnmatch(reason, r) for f, r in rows):
            found.add(f"{name}: {reason}")
    return sorted(found)


def pass_alone(failed, terminal):
    """Whether the tests that failed pass when nothing runs beside them.  Says so of each: such a test is to be mended."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *failed]
    result = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    terminal.write_line(result.stdout[-20000:])
    for test in failed:
        terminal.write_line(f"{'unsteady' if result.returncode == 0 else 'failed again'}: {test}", red=True)
    return result.returncode == 0


# ---------------------------------------------------------------------------------------------- what is left running

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
ENDING_S = float(os.environ.get("WHITTLE_ENDING_S", 10))  # how long a process may still be there that nobody has killed


def pytest_configure(config):
    """Told to end, we end what the tests have started, as at the keyboard."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if not hasattr(config, "workerinput"):
        stand_guard()


def stand_guard():
    """Goes on in a child.  This process adopts, and waits for, what tests and their processes leave behind, as process 1
    would; when the child has ended it ends what is still there, and says so."""
    libc = ctypes.CDLL(None)
    sys.stdout.flush()
    libc.prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    child = os.fork()
    if child == 0:
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the keyboard tells the child as well
    signal.signal(signal.SIGTERM, lambda *_: os.kill(child, signal.SIGTERM))
    ended = None
    while ended is None:
        pid, status = os.wait()
        ended = os.waitstatus_to_exitcode(status) if pid == child else None
    left = end_what_is_left()
    os.write(1, "".join(f"{line}\n" for line in left).encode())
    os._exit(1 if left and ended == 0 else 128 - ended if ended < 0 else ended)


def left_running(pid):
    """All processes below it that live."""
    found = []
    for child in children_of(pid):
        found += [child] * process_lives(child) + left_running(child)
    return found


def read_of(pid, name):
    """What /proc has of a process, on one line; "" where it may not be read or has ended."""
    with contextlib.suppress(OSError):
        return pathlib.Path(f"/proc/{pid}/{name}").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    return ""


def is_killed(pid):
    """Whether SIGKILL has been sent to it, or it has no memory any more.  Until it is given a processor it is there: a
    job's process is nicer than its service, and beside enough others that takes longer than ENDING_S."""
    pending = re.findall(r"(?:SigPnd|ShdPnd):\s*(\w+)", read_of(pid, "status"))
    return any(int(mask, 16) >> signal.SIGKILL - 1 & 1 for mask in pending) or not read_of(pid, "cmdline")


def told_of(pid):
    """Its command, as far as it may be read, the test that it was started in, and what it waits for."""
    test = re.search(r"PYTEST_CURRENT_TEST=(\S+ \(\w+\))", read_of(pid, "environ"))
    command = read_of(pid, "cmdline") or "a process without memory"
    state = ", ".join(re.findall("(?:Name|State|PPid|NSpid|SigPnd|ShdPnd):.*", read_of(pid, "status")))
    return (f"{command[:200]} of {test[1] if test else 'a test that its environment does not name'}; {state}, "
            f"waits in {read_of(pid, 'wchan')}")


def wait_for_what_is_left():
    """Until nothing below this process lives, for a while; for what has been killed, however long that takes."""
    begin = time.monotonic()
    while True:
        for child in children_of(os.getpid()):
            with contextlib.suppress(ChildProcessError):
                os.waitpid(child, os.WNOHANG)
        left, waited = left_running(os.getpid()), time.monotonic() - begin
        if not left or waited > PATIENCE_S or (waited > ENDING_S and not any(map(is_killed, left))):
            return
        time.sleep(0.05)


def end_what_is_left():
    """Ends the processes that are left below this one, and returns what they were."""
    wait_for_what_is_left()
    left = [(pid, told_of(pid)) for pid in left_running(os.getpid())]
    for pid, _ in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    wait_for_what_is_left()
    return [f"left running: {pid} {what}" for pid, what in left]


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session, exitstatus):
    """Where all is well nothing is left, and what was skipped is looked at."""
    config = session.config
    path, terminal = config.getoption("--allowed-skips"), config.pluginmanager.get_plugin("terminalreporter")
    if terminal and not hasattr(config, "workerinput") and exitstatus == pytest.ExitCode.TESTS_FAILED:
        reports = terminal.stats.get("failed", []) + terminal.stats.get("error", [])
        failed = sorted({report.nodeid for report in reports if isinstance(report, pytest.TestReport)})
        if len(reports) and len(failed) <= config.getoption("--again") and all(
                isinstance(report, pytest.TestReport) for report in reports) and pass_alone(failed, terminal):
            session.exitstatus = exitstatus = pytest.ExitCode.OK
    if path and terminal and not hasattr(config, "workerinput"):
        config.unexpected = unexpected_skips(terminal.stats.get("skipped", []), path)
        if config.unexpected and exitstatus == 0:
            session.exitstatus = exitstatus = pytest.ExitCode.TESTS_FAILED
    folder = getattr(getattr(config, "_tmp_path_factory", None), "_basetemp", None)
    if folder and exitstatus == 0:
        shutil.rmtree(folder, ignore_errors=True)


def pytest_unconfigure(config):
    """Last of all that is printed, below the list of skips: which of them made the run fail."""
    for line in getattr(config, "unexpected", []):
        config.get_terminal_writer().line(f"may not be skipped: {line}", red=True)


@pytest.fixture(name="gated")
def make_gated(tmp_path):
    """(gate, flags): jobs of a service with these flags begin their work while the gate, a file, isn't there."""
    gate, worker = tmp_path / "gate", tmp_path / "worker"
    worker.write_text(f'#!/bin/sh\nwhile [ -e "{gate}" ]; do sleep 0.02; done\nexec "{BUILD / "whittle"}" "$@"\n')
    worker.chmod(0o755)
    yield gate, ("--worker", worker, "--worker-sandbox=off", "--workers", "1")
    gate.unlink(missing_ok=True)


@pytest.fixture(name="large", scope="session")
def make_large():
    """A cloud that takes seconds."""
    return sphere(400000)


def end_all(daemons):
    """The end of a fixture that started them: stops those that run, and looks how each ended.  None is left, whatever
    keeps one of them from ending."""
    faults = []
    for daemon in daemons:
        try:
            daemon.give_up()
        except AssertionError as reason:
            faults.append(str(reason))
    for daemon in daemons:
        print(daemon.log_text()[-20000:] if daemon.log.exists() else "")
        faults += daemon.faults()
    assert not faults, "; ".join(faults)


@pytest.fixture(name="make_daemon")
def make_make_daemon(tmp_path):
    """make_daemon(*flags) starts one; all are ended with the test."""
    daemons = []

    def make(*flags):
        folder = tmp_path / f"daemon{len(daemons)}"
        folder.mkdir()
        daemons.append(Daemon(folder, *flags))
        return daemons[-1].start()

    yield make
    end_all(daemons)


@pytest.fixture(name="daemon")
def make_one_daemon(make_daemon):
    return make_daemon()
