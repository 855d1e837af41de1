# SPDX-License-Identifier: GPL-3.0-or-later
"""The package on a machine that is run by systemd: a fresh Debian, booted by systemd-nspawn with a network of its own,
with the unit as it is; then what deploy/README.md says of nginx, backup, restore and upgrade, by its own commands.

Only the watchdog's period is changed, the way an administrator would: by a drop-in."""
import contextlib
import ctypes
import json
import os
import re
import shutil
import signal
import subprocess
import threading

import pytest

from conftest import (ROOT, answers, certificate, crash_during_a_job, curl, ended, main_job, need, report_of, run, say,
                      submit, wait_until)

WATCHDOG_S = 4
URL = "http://127.0.0.1:8080"
HOST = "whittle.example.org"
PACKAGES = ["systemd-sysv", "nginx-light", "curl", "sqlite3", "hostname"]
NEWER = "99.0"


@contextlib.contextmanager
def network_of(pid):
    """This thread, and what it starts, uses the network of that process."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open("/proc/self/ns/net", "rb") as own, open(f"/proc/{pid}/ns/net", "rb") as other:
        assert libc.setns(other.fileno(), 0) == 0, os.strerror(ctypes.get_errno())
        try:
            yield
        finally:
            libc.setns(own.fileno(), 0)


class Booted:
    """A machine under systemd; booted(command...) runs in it."""

    def __init__(self, machine):
        self.machine = machine
        self.nspawn = subprocess.Popen(
            ["systemd-nspawn", "-q", "-D", machine.root, f"--machine=whittle-test-{os.getpid()}",
             "--register=no", "--keep-unit", "--boot", "--console=pipe", "--resolv-conf=off", "--private-network",
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

    def shell(self, commands):
        """Lines of a README, in the source tree, with the machine's own certificate for everyone's."""
        return self("env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND=noninteractive",
                    "CURL_CA_BUNDLE=/tls/tls.crt", "bash", "-ec", "cd /whittle\n" + commands)

    def show(self, name):
        return self("systemctl", "show", "-P", name, "whittled.service")

    def is_active(self):
        return self.show("ActiveState") == "active"

    def started_again(self, pid):
        return self.show("MainPID") not in ("0", pid) and self.is_active()

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


def readme_commands(section):
    """The commands of a section's console block, without prompts."""
    text = (ROOT / "deploy/README.md").read_text().split(f"\n## {section}\n")[1]
    return [line.removeprefix("# ") for line in re.search(r"```console\n(.*?)```", text, re.S)[1].splitlines()]


def newer_package(package, folder):
    """The same with a higher version."""
    run("dpkg-deb", "-R", package, folder / "tree")
    control = folder / "tree/DEBIAN/control"
    control.write_text(re.sub("^Version: .*", f"Version: {NEWER}", control.read_text(), flags=re.M))
    run("dpkg-deb", "-b", "--root-owner-group", folder / "tree", folder / "whittle_NEW.deb")
    return folder / "whittle_NEW.deb"


@pytest.fixture(name="booted")
def make_booted(package, machine, tmp_path):
    need("systemd-nspawn", "nsenter", "ps", "openssl")
    root = machine.root
    shutil.copytree(ROOT / "deploy", root / "whittle/deploy")
    shutil.copy(package, root / "whittle/whittle.deb")
    shutil.copy(newer_package(package, tmp_path), root / "whittle/whittle_NEW.deb")
    for folder in ("tls", "backup"):
        (root / folder).mkdir()
    certificate(root / "tls", f"DNS:{HOST}")
    machine("apt-get", "update", "-qq")
    machine("apt-get", "install", "-y", "-qq", "--no-install-recommends", *PACKAGES, "/whittle/whittle.deb")
    (root / "etc/hostname").write_text(f"{HOST}\n")
    (root / "etc/hosts").write_text(f"127.0.0.1 localhost\n127.0.1.1 {HOST}\n")
    drop_in = root / "etc/systemd/system/whittled.service.d"
    drop_in.mkdir()
    (drop_in / "test.conf").write_text(f"[Service]\nWatchdogSec={WATCHDOG_S}\n")
    booted = Booted(machine)
    with network_of(booted.init):
        yield booted
    booted.close()


@pytest.fixture(name="job")
def make_job(booted, scan):
    """The main job, done: its address and its report."""
    wait_until(booted.is_active, "the service")
    return main_job(URL, scan)


def test_the_unit_runs_and_is_looked_after(booted, job, scan):
    where, report = job
    status = booted.show("StatusText")
    assert status == f"listening on {URL}"
    confined = re.search(r"jobs are confined by (.*)", booted.journal())[1]
    assert "seccomp" in confined and "no network" in confined and "own process ids" in confined, confined
    pid = booted.show("MainPID")
    facts = booted("cat", f"/proc/{pid}/status")
    assert not re.search(r"^Uid:\t0\t", facts, re.M) and re.search(r"^CapBnd:\t0+$", facts, re.M)
    say(f"booted, started with the machine: {status}; jobs are confined by {confined}")

    booted("systemctl", "reload", "whittled")
    assert booted.show("MainPID") == pid and answers(URL)
    say("systemctl reload: the same process goes on")

    booted("systemctl", "stop", "whittled")
    assert booted.show("Result") == "success"
    booted("systemctl", "start", "whittled")
    assert report_of(where) == report
    say("systemctl stop and start: its data is there")

    pid = booted.show("MainPID")

    def crash():
        booted("systemctl", "kill", "--kill-who=main", "--signal=KILL", "whittled")
        wait_until(lambda: booted.started_again(pid), "a restart")
    crash_during_a_job(URL, scan, crash)
    say("killed during a job: systemd starts it again, the job goes on")

    pid = booted.show("MainPID")
    booted("systemctl", "kill", "--kill-who=main", "--signal=STOP", "whittled")
    wait_until(lambda: booted.started_again(pid), "the watchdog")
    assert "watchdog" in booted.journal().lower()
    assert report_of(where) == report
    say("hung: the watchdog ended it, systemd started it again, its data is there")

    booted("systemctl", "disable", "--now", "-q", "whittled.service")
    booted("systemctl", "start", "whittled.socket")
    assert not booted.is_active()
    assert json.loads(curl(URL + "/v1/info"))["name"] == "whittled"
    assert booted.is_active() and report_of(where) == report
    say("socket unit: the first connection started it")
    booted("systemctl", "stop", "whittled.socket", "whittled.service")


def test_jobs_have_an_account_of_their_own_with_the_drop_in(booted, job, scan):
    """By the commands at the top of the file that the package brings."""
    where, report = job
    text = booted("cat", "/usr/share/whittle/job-account.conf")
    commands = re.findall(r"^#   (.+)", text, re.M)
    assert len(commands) == 3 and "useradd" in commands[0]
    booted.shell("\n".join(commands))
    wait_until(booted.is_active, "the service")
    assert json.loads(curl(URL + "/v1/info"))["confinement"]["own_account"] == 1
    pid = booted.show("MainPID")
    facts = booted("cat", f"/proc/{pid}/status")
    assert int(re.search(r"^CapEff:\t(\w+)$", facts, re.M)[1], 16) == 1 << 0 | 1 << 5 | 1 << 6 | 1 << 7
    assert report_of(where) == report
    main_job(URL, scan)
    confined = re.findall(r"jobs are confined by (.*)", booted.journal())[-1]
    assert "user whittle-job" in confined and "seccomp" in confined, confined
    say(f"with the drop-in jobs are confined by {confined}")


def serve_through_nginx(booted, scan):
    install, *rest = readme_commands("One machine in six commands")
    assert len(rest) == 5 and "make deb" in install  # the fixtures did that
    booted.shell("\n".join(rest).replace("/path/to/", "/tls/"))
    flags = ("--cacert", booted.machine.root / "tls/tls.crt", "--resolve", f"{HOST}:443:127.0.0.1")
    main_job(f"https://{HOST}", scan, *flags)
    say("the README's six commands: the main job goes through nginx, with TLS")


def back_up_and_restore(booted, job, scan):
    where, report = job
    commands = readme_commands("Backup and restore")
    assert "backup.sh" in commands[0] and "stop" in commands[1] and "start" in commands[-1]
    kept = submit(URL, scan, "ratio=1&outputs=cloud,mesh")
    booted.shell(commands[0])
    lost = submit(URL, scan, "ratio=0.3&outputs=cloud")
    ended(lost)
    booted.shell("\n".join(commands[1:]))
    assert report_of(where) == report and ended(kept)["status"] == "successful"
    missing = subprocess.run(["curl", "-s", lost], capture_output=True, check=True).stdout
    assert json.loads(missing)["type"] == "/problems/no-such-job"
    say("backup with a job at work, restore: its data is there, the job went on; what came later is gone")


def upgrade(booted, job, scan):
    """With systemd holding the socket nobody notices, but for who looks at the version."""
    where, report = job
    booted.shell("systemctl enable -q whittled.socket; systemctl stop whittled\n"
                 "systemctl start whittled.socket whittled\n"
                 "echo 'max-queue = 7' >> /etc/whittled/whittled.conf")
    kept, pid = submit(URL, scan, "ratio=1&outputs=cloud,mesh"), booted.show("MainPID")
    stop, refused, asked = threading.Event(), [], []

    def ask():
        while not stop.is_set():
            (asked if answers(URL) else refused).append(1)
    asking = threading.Thread(target=ask)
    asking.start()
    try:
        booted.shell("apt-get install -y -qq --no-install-recommends -o Dpkg::Options::=--force-confold "
                     "./whittle_NEW.deb")
        wait_until(lambda: booted.started_again(pid), "the new version")
    finally:
        stop.set()
        asking.join()
    assert booted("dpkg-query", "-W", "-f", "${Version}", "whittle") == NEWER
    assert asked and not refused, f"{len(refused)} of {len(refused) + len(asked)} requests got no answer"
    assert ended(kept)["status"] == "successful" and report_of(where) == report
    assert "max-queue = 7" in (booted.machine.root / "etc/whittled/whittled.conf").read_text()
    say(f"upgraded while a job ran and {len(asked)} requests came: none was refused, the job went on, settings and "
        "data are there")


def test_the_readme_on_nginx_backup_and_upgrade(booted, job, scan):
    serve_through_nginx(booted, scan)
    back_up_and_restore(booted, job, scan)
    upgrade(booted, job, scan)
