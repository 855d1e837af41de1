#!/usr/bin/env python3
"""Plants each mutant of mutants.toml in a copy of the tree, builds, and runs the test that is to fail.

Usage: run.py [-j N] [--pick PATTERN] build/release      (from the root of the tree, which is built)

It fails where a mutant survives, where its text isn't there exactly once, where it doesn't compile, and where its test
fails without it.  A test that doesn't end in time counts as failed.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import argparse
import concurrent.futures
import fnmatch
import os
import pathlib
import queue
import shlex
import shutil
import signal
import subprocess
import sys
import time
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[2]
TEST_S, BUILD_S, END_S = 600, 1800, 240
MAKE = ["make", "--no-print-directory", "-j2", *(f"{name}={os.environ[name]}" for name in ("CC", "CXX", "LDFLAGS")
                                                 if name in os.environ)]


class Broken(Exception):
    """A row of which nothing can be told."""


def end_all_of(folder):
    """Kills what runs a program of this folder: a mutant may be that nothing ends."""
    for link in pathlib.Path("/proc").glob("[0-9]*/exe"):
        try:
            if link.readlink().is_relative_to(folder):
                os.kill(int(link.parent.name), signal.SIGKILL)
        except OSError:
            pass  # it has ended, or is somebody else's


def run(command, folder, seconds, log):
    """The exit status; None where it took too long.  Nothing that it started is left."""
    environment = {**os.environ, "WHITTLE_BUILD": str(folder / "build/release")}
    for name in ("MAKEFLAGS", "CI"):  # a mutant may leave something unused, which is an error there
        environment.pop(name, None)
    with open(log, "wb") as out:
        process = subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.STDOUT, env=environment)
        try:
            return process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.terminate()  # tests end what they have started
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            return None
        finally:
            end_all_of(folder)


class Tree:
    """A copy of the tree, built."""

    def __init__(self, build, folder):
        self.folder = folder
        self.log = folder.with_suffix(".log")
        shutil.rmtree(folder, ignore_errors=True)
        names = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True,
                               check=True).stdout
        for name in names.splitlines():
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        shutil.copytree(build, folder / "build/release", ignore=shutil.ignore_patterns("*.log", "*.valgrind"))
        for modules in ("server/page/node_modules", "tests/page/node_modules"):  # where the page is built
            if (ROOT / modules).is_dir():
                (folder / modules).symlink_to(ROOT / modules)

    def put_page_together(self):
        """What npm gives isn't fetched again."""
        if run(["node", "server/page/build.mjs", "server/page", "build/page"], self.folder, BUILD_S, self.log) != 0:
            raise Broken("the page isn't put together: make page")

    def passes(self, test):
        """Builds what the test runs, and runs it."""
        kind, name, *rest = shlex.split(test)
        if kind == "page":
            self.put_page_together()
        program = f"build/release/tests/unit/{name}"
        tools = [f"build/release/tests/tools/{tool}" for tool in ("confined_probe", "predict_memory")]
        wanted = [program] if kind == "unit" else ["all", *tools]
        if run([*MAKE, *wanted], self.folder, BUILD_S, self.log) != 0:
            raise Broken("doesn't compile")
        if kind == "unit":
            return run([program], self.folder, TEST_S, self.log) == 0
        status = run([sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider",
                      f"tests/integration/{name}", *rest], self.folder, TEST_S, self.log)
        if status not in (0, 1, None):
            raise Broken("its test isn't found")
        return status == 0

    def kills(self, mutant):
        path = self.folder / mutant["file"]
        before = path.read_text(encoding="utf-8") if path.exists() else ""
        if before.count(mutant["old"]) != 1:
            raise Broken(f"its text is there {before.count(mutant['old'])} times")
        path.write_text(before.replace(mutant["old"], mutant["new"]), encoding="utf-8")
        try:
            return not self.passes(mutant["test"])
        finally:
            path.write_text(before, encoding="utf-8")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("-j", type=int, default=2)
    parser.add_argument("--pick", default="*")
    options = parser.parse_args()
    table = tomllib.loads((ROOT / "tests/mutants/mutants.toml").read_text(encoding="utf-8"))["mutant"]
    assert len({m["name"] for m in table}) == len(table), "two mutants have one name"
    chosen = [m for m in table if any(fnmatch.fnmatch(m["name"], p) for p in options.pick.split(","))]
    if not chosen:
        sys.exit(f"mutants: none is named {options.pick}")
    trees = queue.Queue()
    place = ROOT / "build/mutants"
    for i in range(min(options.j, len(chosen))):
        trees.put(Tree(pathlib.Path(options.build), place / f"tree{i}"))

    def attempt(look, what):
        tree, began = trees.get(), time.monotonic()
        try:
            return look(tree, what), time.monotonic() - began, ""
        except Broken as reason:
            return None, time.monotonic() - began, f"{reason}\n" + tree.log.read_text(errors="replace")[-2000:]
        finally:
            trees.put(tree)

    bad = 0  # rows that aren't as they ought to be
    with concurrent.futures.ThreadPoolExecutor(trees.qsize()) as pool:
        tests = sorted({m["test"] for m in chosen})
        for test, (passed, _, why) in zip(tests, pool.map(lambda t: attempt(Tree.passes, t), tests)):
            if not passed:
                bad += 1
                print(f"fails without any mutant: {test} {why}", flush=True)
        for m, (killed, seconds, why) in zip(chosen, pool.map(lambda m: attempt(Tree.kills, m), chosen)):
            word = "broken" if killed is None else "killed" if killed else "SURVIVED"
            bad += not killed
            print(f"{word:9} {seconds:6.0f} s  {m['name']:32} {m['breaks']}", flush=True)
            if why:
                print(why)
    for i in range(options.j):
        shutil.rmtree(place / f"tree{i}", ignore_errors=True)
    print(f"mutants: {len(chosen)}, {bad} to be looked at")
    sys.exit(bad > 0)


main()
