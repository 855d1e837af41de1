# SPDX-License-Identifier: GPL-3.0-or-later
"""The Debian package: lintian, then a life in a fresh Debian: installed, run, removed, purged."""
import json
import os
import re
import shutil
import signal
import subprocess

import pytest

from conftest import BUILD, curl, main_job, need, report_of, run, say, wait_until


def test_lintian_finds_nothing(package):
    need("lintian")
    changes = next(package.parent.glob("*.changes"))
    done = subprocess.run(["lintian", "--allow-root", "--fail-on=error,warning", "--tag-display-limit=0", changes],
                          capture_output=True, text=True, check=False)
    found = [line for line in done.stdout.splitlines() if re.match("[EW]:", line)]
    assert done.returncode == 0 and not found, done.stdout + done.stderr
    say("lintian: no error, no warning")


def test_it_holds_what_people_expect(package):
    names = {line.split()[5] for line in run("dpkg-deb", "-c", package).splitlines()}
    expected = {"./usr/bin/whittle", "./usr/bin/whittled", "./etc/whittled/whittled.conf",
                "./lib/systemd/system/whittled.service", "./lib/systemd/system/whittled.socket",
                "./usr/share/whittle/job-account.conf", "./usr/share/whittle/with-job-account",
                "./usr/share/man/man1/whittle.1.gz", "./usr/share/man/man8/whittled.8.gz",
                "./usr/share/bash-completion/completions/whittle", "./usr/share/bash-completion/completions/whittled",
                "./usr/share/zsh/vendor-completions/_whittle", "./usr/share/fish/vendor_completions.d/whittle.fish"}
    assert expected <= names, expected - names
    say(f"{len(expected)} files that people look for are there")


def test_the_service_has_its_page(package, tmp_path):
    if not shutil.which("npm"):
        pytest.skip("npm, which the page is made with, is not there")
    run("dpkg-deb", "-x", package, tmp_path)
    program = (tmp_path / "usr/bin/whittled").read_bytes()
    assert re.search(rb"viewer-[0-9a-f]{16}\.js", program)


class Installed:
    """whittled of the package, run in the machine as its unit would, on loopback."""

    def __init__(self, machine):
        self.machine = machine

    def start(self):
        self.process = subprocess.Popen(
            self.machine.command("setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", "--no-new-privs",
                                 "/usr/bin/whittled", "--config", "/etc/whittled/whittled.conf", "--listen",
                                 "127.0.0.1:0", "--data", "/var/lib/whittled"),
            stdout=subprocess.PIPE, stderr=open(self.machine.root / "log", "ab"), text=True)
        line = self.process.stdout.readline()
        assert line.startswith("listening on"), (self.machine.root / "log").read_text()
        self.url = line.split()[-1]
        return self

    def stop(self):
        """SIGTERM to whittled itself, which is a grandchild of what was started."""
        end = self.process.pid
        while True:
            children = run("ps", "-o", "pid=", "--ppid", end).split() if has_children(end) else []
            if not children:
                break
            end = int(children[0])
        os.kill(end, signal.SIGTERM)
        return self.process.wait(60)


def has_children(pid):
    return subprocess.run(["ps", "--ppid", str(pid)], capture_output=True, check=False).returncode == 0


def test_installed_run_removed_purged(package, machine, scan):
    shutil.copy(package, machine.root / "whittle.deb")
    machine("apt-get", "update", "-qq")
    machine("apt-get", "install", "-y", "-qq", "--no-install-recommends", "/whittle.deb")
    say("installed: " + machine("whittled", "--version"))
    assert "whittle" in machine("whittle", "--version")

    machine("install", "-d", "-o", "nobody", "-g", "nogroup", "/var/lib/whittled")
    service = Installed(machine).start()
    where, report = main_job(service.url, scan)
    assert service.stop() == 0
    say("stopped by SIGTERM with status 0")
    service.start()
    assert report_of(service.url + where[where.index("/v1/"):]) == report
    say("its data is there after a restart")
    assert service.stop() == 0

    # A newer version keeps settings and data.
    config = machine.root / "etc/whittled/whittled.conf"
    config.write_text(config.read_text() + "max-queue = 7\n")
    machine("apt-get", "install", "-y", "-qq", "--reinstall", "--no-install-recommends", "-o",
            "Dpkg::Options::=--force-confold", "/whittle.deb")
    assert "max-queue = 7" in config.read_text()
    say("an upgrade keeps the changed settings")

    machine("apt-get", "remove", "-y", "-qq", "whittle")
    assert not (machine.root / "usr/bin/whittled").exists() and config.exists()
    assert (machine.root / "var/lib/whittled/whittled.db").exists()
    say("removed: settings and data are kept")
    machine("apt-get", "purge", "-y", "-qq", "whittle")
    left = [p for p in ("etc/whittled", "var/lib/whittled", "lib/systemd/system/whittled.service")
            if (machine.root / p).exists()]
    assert not left, left
    say("purged: nothing is left")
