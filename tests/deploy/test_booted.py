# SPDX-License-Identifier: GPL-3.0-or-later
"""The package on a machine that is run by systemd: a fresh Debian, booted by systemd-nspawn, with the unit as it is.

Only the port and the watchdog's period are changed, the way an administrator would: settings and a drop-in."""
import json
import os
import re
import shutil
import signal
import socket
import subprocess

import pytest

from conftest import answers, curl, main_job, need, report_of, run, say, wait_until

WATCHDOG_S = 4


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Booted:
    """A machine under systemd; booted(command...) runs in it."""

    def __init__(self, machine, port):
        self.machine, self.port = machine, port
        self.url = f"http://127.0.0.1:{port}"
        self.nspawn = subprocess.Popen(
            ["systemd-nspawn", "-q", "-D", machine.root, f"--machine=whittle-test-{os.getpid()}", "--register=no",
             "--keep-unit", "--boot", "--console=pipe", "--resolv-conf=off",
             "--system-call-filter=landlock_create_ruleset landlock_add_rule landlock_restrict_self"],
            stdin=subprocess.DEVNULL, stdout=open(machine.root.parent / "console", "wb"), stderr=subprocess.STDOUT)
        self.init = wait_until(self.find_init, "systemd in the machine")
        wait_until(lambda: self.try_run("systemctl", "is-system-running", "--wait").stdout.strip() in
                   ("running", "degraded"), "the end of booting")

    def find_init(self):
        if self.nspawn.poll() is not None:
            pytest.skip("systemd-nspawn can't boot here: "
                        + (self.machine.root.parent / "console").read_text(errors="replace")[-400:])
        done = subprocess.run(["ps", "-o", "pid=,args=", "--ppid", str(self.nspawn.pid)], capture_output=True,
                              text=True, check=False)
        found = re.search(r"^\s*(\d+) \S*(init|systemd)\b", done.stdout, re.M)
        return found and int(found[1])

    def try_run(self, *command):
        return subprocess.run(["nsenter", "-t", str(self.init), "-a", *map(str, command)], capture_output=True,
                              text=True, check=False)

    def __call__(self, *command):
        return run("nsenter", "-t", self.init, "-a", *command)

    def show(self, unit, name):
        return self("systemctl", "show", "-P", name, unit)

    def is_active(self):
        return self.show("whittled.service", "ActiveState") == "active"

    def journal(self):
        return self("journalctl", "--no-pager", "-o", "cat", "-u", "whittled")

    def close(self):
        if self.nspawn.poll() is None:
            os.kill(self.init, signal.SIGRTMIN + 4)  # systemd's wish to power off
            try:
                self.nspawn.wait(60)
            except subprocess.TimeoutExpired:
                self.nspawn.kill()
                self.nspawn.wait()


@pytest.fixture(name="booted")
def make_booted(package, machine):
    need("systemd-nspawn", "nsenter", "ps")
    root, port = machine.root, free_port()
    shutil.copy(package, root / "whittle.deb")
    machine("apt-get", "update", "-qq")
    machine("apt-get", "install", "-y", "-qq", "--no-install-recommends", "systemd-sysv", "/whittle.deb")
    with open(root / "etc/whittled/whittled.conf", "a", encoding="utf-8") as file:
        file.write(f"listen = 127.0.0.1:{port}\nadmin-listen = 127.0.0.1:0\n")
    for unit, text in (("whittled.service", f"[Service]\nWatchdogSec={WATCHDOG_S}\n"),
                       ("whittled.socket", f"[Socket]\nListenStream=\nListenStream=127.0.0.1:{port}\n")):
        (root / f"etc/systemd/system/{unit}.d").mkdir()
        (root / f"etc/systemd/system/{unit}.d/test.conf").write_text(text)
    booted = Booted(machine, port)
    yield booted
    booted.close()


def test_the_unit_runs_and_is_looked_after(booted, scan):
    wait_until(booted.is_active, "the service")
    status = booted.show("whittled.service", "StatusText")
    assert status == f"listening on {booted.url}"
    confined = re.search(r"jobs are confined by (.*)", booted.journal())[1]
    assert "seccomp" in confined and "no network" in confined, confined
    pid = booted.show("whittled.service", "MainPID")
    facts = booted("cat", f"/proc/{pid}/status")
    assert not re.search(r"^Uid:\t0\t", facts, re.M) and re.search(r"^CapBnd:\t0+$", facts, re.M)
    say(f"booted, started with the machine: {status}; jobs are confined by {confined}")
    where, report = main_job(booted.url, scan)
    path = where[where.index("/v1/"):]

    booted("systemctl", "reload", "whittled")
    assert booted.show("whittled.service", "MainPID") == pid and answers(booted.url)
    say("systemctl reload: the same process goes on")

    booted("systemctl", "stop", "whittled")
    assert booted.show("whittled.service", "Result") == "success"
    booted("systemctl", "start", "whittled")
    assert report_of(booted.url + path) == report
    say("systemctl stop and start: its data is there")

    pid = booted.show("whittled.service", "MainPID")
    booted("systemctl", "kill", "--kill-who=main", "--signal=KILL", "whittled")
    wait_until(lambda: booted.show("whittled.service", "MainPID") not in ("0", pid) and booted.is_active(), "a restart")
    say("killed: systemd starts it again")

    pid = booted.show("whittled.service", "MainPID")
    booted("systemctl", "kill", "--kill-who=main", "--signal=STOP", "whittled")
    wait_until(lambda: booted.show("whittled.service", "MainPID") not in ("0", pid) and booted.is_active(),
               "the watchdog")
    assert "watchdog" in booted("journalctl", "--no-pager", "-o", "cat", "-u", "whittled").lower()
    assert report_of(booted.url + path) == report
    say("hung: the watchdog ended it, systemd started it again, its data is there")

    booted("systemctl", "disable", "--now", "-q", "whittled.service")
    booted("systemctl", "start", "whittled.socket")
    assert not booted.is_active()
    assert json.loads(curl(booted.url + "/v1/info"))["name"] == "whittled"
    assert booted.is_active() and report_of(booted.url + path) == report
    say("socket unit: the first connection started it")
    booted("systemctl", "stop", "whittled.socket", "whittled.service")
