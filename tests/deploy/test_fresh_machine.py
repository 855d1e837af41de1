# SPDX-License-Identifier: GPL-3.0-or-later
"""The README's two commands in a fresh Debian 12 with make and git, on a clean clone: a step of the set-up that is
missing shows here.  Of `make test` the lint and the unit tests are run, with everything that it builds and installs;
with WHITTLE_FRESH=full all of it."""
import os
import re
import subprocess
import time

from conftest import ROOT, need, run, say

FULL = os.environ.get("WHITTLE_FRESH") == "full"
PASSED_ON = [f"{n}={os.environ[n]}" for n in ("WHITTLE_PATIENCE_S",) if n in os.environ]


def bring_source(machine):
    """A clean clone, or where there is no git the released tree."""
    if (ROOT / ".git").exists():
        need("git")
        run("git", "clone", "-q", "--no-local", ROOT, machine.root / "whittle")
        if run("git", "-C", ROOT, "status", "--porcelain"):
            say("there are changes that are not committed; the clone is without them")
        return
    run(ROOT / "deploy/dist.sh", machine.root)
    next(p for p in machine.root.glob("whittle-*") if p.is_dir()).rename(machine.root / "whittle")


def timed(machine, *command):
    began = time.monotonic()
    done = subprocess.run(machine.command("env", *PASSED_ON, "sh", "-c", "cd /whittle && exec \"$@\"", "sh", *command),
                          text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-6000:]
    say(f"{' '.join(command)}: {time.monotonic() - began:.0f} s")
    return done.stdout


def test_both_commands_of_the_readme_work_on_a_fresh_machine(machine):
    commands = re.findall(r"^\$ (make \w+) ", (ROOT / "README.md").read_text(), re.M)
    assert commands[:2] == ["make demo", "make test"]
    bring_source(machine)
    machine("apt-get", "update", "-qq")
    machine("apt-get", "install", "-y", "-qq", "--no-install-recommends", "make", "git")
    demo = timed(machine, "make", "demo")
    print("\n".join(line for line in demo.splitlines() if line.startswith("  ") and "CC " not in line))
    assert re.search(r"watertight +true", demo)
    assert (machine.root / "whittle/out/mesh.ply").stat().st_size > 10000
    tested = timed(machine, "make", *(["test"] if FULL else ["deps", "lint", "test-unit", f"-j{os.cpu_count()}"]))
    if FULL:
        say(re.findall(r"^\d+ passed.*", tested, re.M)[-1])
