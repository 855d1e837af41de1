# SPDX-License-Identifier: GPL-3.0-or-later
"""The unit files, and what the daemon says to a service manager: readiness, stopping, watchdog, inherited sockets.

The manager is played by the test's own datagram socket, and by systemd-socket-activate where that is at hand."""
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import sys

import pytest

import conftest

SYSTEMD = pathlib.Path(__file__).resolve().parents[2] / "deploy" / "systemd"
MOST_EXPOSURE = 2.0
# ACTIVATE FD COMMAND...: the command with the socket as its descriptor 3 and LISTEN_PID set, as a manager leaves it.
ACTIVATE = ("import os, sys; os.dup2(int(sys.argv[1]), 3); os.environ['LISTEN_PID'] = str(os.getpid()); "
            "os.execv(sys.argv[2], sys.argv[2:])")


class Manager:
    """Receives what a service says to NOTIFY_SOCKET."""

    def __init__(self, folder):
        self.path = folder / "notify"
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.settimeout(conftest.PATIENCE_S)
        self.socket.bind(str(self.path))

    def hear(self):
        return self.socket.recv(4096).decode()

    def hear_until(self, start):
        """Everything up to the first message that starts so."""
        heard = [self.hear()]
        while not heard[-1].startswith(start):
            heard.append(self.hear())
        return heard

    def silence(self):
        """Forgets what was said already."""
        self.socket.setblocking(False)
        try:
            while True:
                self.socket.recv(4096)
        except BlockingIOError:
            self.socket.settimeout(conftest.PATIENCE_S)


@pytest.fixture(name="manager")
def make_manager(tmp_path):
    manager = Manager(tmp_path)
    yield manager
    manager.socket.close()


class Unit(conftest.Daemon):
    """A whittled that is started the way a manager does it."""

    def launch(self, environment=None, prefix=(), flags=(), pass_fds=()):
        with open(self.log, "ab") as log:
            self.process = conftest.Process(
                [*map(str, prefix), str(conftest.BUILD / "whittled"), "--data", str(self.data), "--admin-listen",
                 "127.0.0.1:0", *conftest.UNLIMITED, *flags],
                stdout=subprocess.PIPE, stderr=log, text=True, pass_fds=pass_fds,
                env=dict(os.environ, **(environment or {})))
        self.processes.append(self.process)
        return self

    def answered(self):
        line = self.process.stdout.readline()
        assert line.startswith("listening on http://"), (line, self.log_text())
        self.url = line.split()[-1]
        return self


@pytest.fixture(name="unit")
def make_unit(tmp_path):
    unit = Unit(tmp_path)
    yield unit
    conftest.end_all([unit])


def listening_socket(address="127.0.0.1"):
    made = socket.socket()
    made.bind((address, 0))
    made.listen(16)
    return made


def test_it_is_ready_when_it_answers_and_stopping_when_it_drains(unit, manager):
    unit.launch({"NOTIFY_SOCKET": str(manager.path)}, flags=("--listen", "127.0.0.1:0"))
    ready = manager.hear()
    assert ready.startswith("READY=1\nSTATUS=listening on http://127.0.0.1:")
    unit.url = ready.split()[-1]
    assert unit.curl("/v1/info").status == 200
    unit.process.send_signal(signal.SIGTERM)
    assert manager.hear().split("\n")[0] == "STOPPING=1"
    assert unit.process.wait(conftest.PATIENCE_S) == 0


def test_an_abstract_socket_is_told_too(unit):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as abstract:
        name = f"whittle-test-{os.getpid()}"
        abstract.bind("\0" + name)
        abstract.settimeout(conftest.PATIENCE_S)
        unit.launch({"NOTIFY_SOCKET": "@" + name}, flags=("--listen", "127.0.0.1:0"))
        assert abstract.recv(4096).startswith(b"READY=1")


def test_a_manager_that_is_gone_does_not_keep_it_from_serving(unit, tmp_path):
    unit.launch({"NOTIFY_SOCKET": str(tmp_path / "nobody")}, flags=("--listen", "127.0.0.1:0")).answered()
    assert unit.curl("/v1/info").status == 200
    assert "the service manager" in unit.log_text()


def test_the_watchdog_is_fed_while_jobs_run(unit, manager):
    unit.launch({"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "200000"}, flags=("--listen", "127.0.0.1:0"))
    unit.answered()
    job = unit.submit(conftest.SMALL, "?points=50")
    assert unit.ended(job)["status"] == "successful"
    manager.silence()
    assert [manager.hear() for _ in range(3)] == ["WATCHDOG=1"] * 3


def test_a_watchdog_of_another_process_is_not_fed(unit, manager):
    unit.launch({"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "1000", "WATCHDOG_PID": "1"},
                flags=("--listen", "127.0.0.1:0")).answered()
    assert manager.hear().startswith("READY=1")
    unit.process.send_signal(signal.SIGTERM)
    assert manager.hear().startswith("STOPPING=1")


def test_the_watchdog_starves_when_the_queue_is_broken(unit, manager):
    unit.launch({"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "100000"}, flags=("--listen", "127.0.0.1:0"))
    unit.answered()
    manager.hear_until("WATCHDOG=1")
    # A database whose pages are noise: its next reader finds that out.
    for name in ("whittled.db", "whittled.db-wal", "whittled.db-shm"):
        path = unit.data / name
        if path.exists() and path.stat().st_size:
            with open(path, "r+b") as file:
                file.write(os.urandom(path.stat().st_size))
    conftest.wait_until(lambda: "its watchdog isn't fed" in unit.log_text(), "the starved watchdog")


@pytest.mark.parametrize("fault", ["commit=hang:4",  # schema, identity, job, and its claim: with the lock held
                                   "rename-jobs=hang"])  # in the thread that runs the job, half a minute ago
def test_the_watchdog_starves_when_the_supervisor_hangs(unit, manager, fault):
    unit.launch({"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "200000"},
                flags=("--listen", "127.0.0.1:0", "--job-stall", "1s", "--fault", fault))
    unit.answered()
    manager.hear_until("WATCHDOG=1")
    job = unit.submit(conftest.SMALL)

    def is_silent():
        manager.silence()
        manager.socket.settimeout(4)
        try:
            return not manager.hear()
        except TimeoutError:
            return True
    conftest.wait_until(is_silent, "the end of the feeding")
    assert unit.curl("/healthz").status == 200  # only who asks the supervisor can know
    for _ in range(2):
        unit.process.send_signal(signal.SIGTERM)
        conftest.wait_until(lambda: "draining" in unit.log_text(), "the drain")
    unit.may_end(128 + signal.SIGTERM)
    assert unit.process.wait(conftest.PATIENCE_S) == 128 + signal.SIGTERM
    unit.launch(flags=("--listen", "127.0.0.1:0")).answered()
    assert unit.ended(job)["status"] == "successful"


def activate(unit, inherited, environment, *flags):
    fd = inherited.fileno()
    return unit.launch({"LISTEN_FDS": "1", **environment}, (sys.executable, "-c", ACTIVATE, fd), flags, (fd,))


def refusal(unit):
    unit.may_end(2)
    assert unit.process.wait(conftest.PATIENCE_S) == 2
    return unit.log_text()


@pytest.mark.parametrize("names", [{"LISTEN_FDNAMES": "http"}, {"LISTEN_FDNAMES": "whittled.socket"}, {}])
def test_an_inherited_socket_is_served(unit, names):
    with listening_socket() as inherited:
        activate(unit, inherited, names)
        assert unit.answered().port == inherited.getsockname()[1]
        job = unit.submit(conftest.SMALL, "?points=50")
        assert unit.ended(job)["status"] == "successful"
    assert unit.stop() == 0


def test_who_comes_while_the_service_restarts_is_served_by_the_next(unit):
    with listening_socket() as held:
        activate(unit, held, {"LISTEN_FDNAMES": "http"}).answered()
        job = unit.submit(conftest.SMALL, "?points=50")
        unit.ended(job)
        assert unit.stop() == 0
        early = subprocess.Popen(unit.curl_command(f"/v1/jobs/{job}"), stdout=subprocess.PIPE)
        activate(unit, held, {"LISTEN_FDNAMES": "http"}).answered()
        reply = conftest.parse_reply(early.communicate(timeout=conftest.PATIENCE_S)[0])
        assert reply.json["status"] == "successful"


def test_one_socket_without_a_name_is_not_taken_twice(unit):
    with listening_socket() as inherited:
        activate(unit, inherited, {}).answered()
        administrative = unit.process.stdout.readline()
        assert administrative.startswith("health and metrics on"), administrative
        assert int(administrative.rsplit(":", 1)[1]) != inherited.getsockname()[1]


def test_a_socket_for_something_else_is_left_alone(unit):
    with listening_socket() as inherited:
        activate(unit, inherited, {"LISTEN_FDNAMES": "other"}, "--listen", "127.0.0.1:0").answered()
        assert unit.port != inherited.getsockname()[1]


def test_a_descriptor_that_is_no_listening_socket_is_refused(unit):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams:
        activate(unit, datagrams, {"LISTEN_FDNAMES": "http"})
        assert "no listening TCP socket" in refusal(unit)


def test_an_inherited_socket_beyond_loopback_wants_to_be_allowed(unit):
    with listening_socket("0.0.0.0") as open_to_all:
        activate(unit, open_to_all, {"LISTEN_FDNAMES": "http"})
        assert "beyond loopback" in refusal(unit)


@pytest.mark.skipif(not shutil.which("systemd-socket-activate"), reason="systemd-socket-activate is not installed")
def test_systemd_socket_activate_starts_it_with_the_first_connection(unit):
    with listening_socket() as probe:  # systemd takes no port 0
        port = probe.getsockname()[1]
    unit.launch(prefix=("systemd-socket-activate", f"--listen=127.0.0.1:{port}", "--fdname=http"))
    conftest.wait_until(lambda: "Listening on" in unit.log_text(), "systemd's socket")
    unit.url = f"http://127.0.0.1:{port}"
    assert unit.curl("/v1/info").status == 200
    assert unit.answered().port == port
    assert unit.stop() == 0


needs_analyze = pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd-analyze is not installed")


@needs_analyze
def test_the_unit_is_hardened():
    done = subprocess.run(["systemd-analyze", "security", "--offline=yes", SYSTEMD / "whittled.service"],
                          capture_output=True, text=True, check=True)
    exposure = float(re.search(r"exposure level for whittled.service: ([\d.]+)", done.stdout)[1])
    print(f"exposure {exposure}, allowed {MOST_EXPOSURE}")
    assert exposure <= MOST_EXPOSURE


@needs_analyze
def test_the_units_are_valid(tmp_path):
    """In a folder of their own, with the program where it is, because verify wants to find it."""
    program = tmp_path / "whittled"
    program.symlink_to((conftest.BUILD / "whittled").resolve())
    for unit in ("whittled.service", "whittled.socket"):
        text = (SYSTEMD / unit).read_text()
        (tmp_path / unit).write_text(text.replace("/usr/bin/whittled", str(program)).replace("Documentation=man", "#"))
    done = subprocess.run(["systemd-analyze", "verify", "--recursive-errors=no", tmp_path / "whittled.service",
                           tmp_path / "whittled.socket"], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr.strip(), done.stderr


@needs_analyze
def test_the_unit_is_valid_with_an_account_for_jobs(tmp_path):
    """The drop-in adds four capabilities and the calls that they are for, and nothing else."""
    program, drop_in = tmp_path / "whittled", tmp_path / "whittled.service.d" / "job-account.conf"
    program.symlink_to((conftest.BUILD / "whittled").resolve())
    text = (SYSTEMD / "whittled.service").read_text()
    (tmp_path / "whittled.service").write_text(
        text.replace("/usr/bin/whittled", str(program)).replace("Documentation=man", "#"))
    drop_in.parent.mkdir()

    def verify(content):
        drop_in.write_text(content)
        done = subprocess.run(["systemd-analyze", "verify", "--recursive-errors=no", tmp_path / "whittled.service"],
                              capture_output=True, text=True, check=False)
        return done.stderr.strip()
    content = (SYSTEMD / "job-account.conf").read_text()
    assert "job-account.conf" in verify(content.replace("PrivateUsers=no", "PrivateUsers=perhaps"))
    assert verify(content) == ""
    granted = {line.split("=")[0]: set(line.split("=")[1].split()) for line in content.splitlines() if "Capab" in line}
    assert len(granted) == 2 and all(
        names == {"CAP_SETUID", "CAP_SETGID", "CAP_CHOWN", "CAP_KILL"} for names in granted.values())
