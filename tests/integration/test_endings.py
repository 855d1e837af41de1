# SPDX-License-Identifier: GPL-3.0-or-later
"""What the other tests rely on: an end of whittled that is no clean one is seen, and so is a test that is skipped."""
import ast
import fnmatch
import os
import pathlib
import re
import signal
import subprocess
import sys

import pytest

import conftest

HERE = pathlib.Path(__file__).parent


@pytest.fixture(name="daemon")
def make_own_daemon(tmp_path):
    daemon = conftest.Daemon(tmp_path).start()
    yield daemon
    for process in daemon.processes:  # which those tests end, when they pass
        if process.poll() is None:
            process.kill()
            process.wait()


def test_a_clean_end_is_one_with_jobs_under_way_too(daemon, large):
    daemon.worker_pid(daemon.submit(large, "?outputs=mesh"))
    conftest.end_all([daemon])
    assert daemon.process.returncode == 0 and daemon.log_text().rstrip().endswith("ended")


def test_a_crash_after_the_last_answer_is_seen(daemon):
    daemon.process.send_signal(signal.SIGSEGV)
    with pytest.raises(AssertionError, match=r"whittled ended with (-11|\d+)"):
        conftest.end_all([daemon])


def test_so_is_one_before_a_restart(daemon):
    daemon.process.send_signal(signal.SIGABRT)
    daemon.process.wait(conftest.PATIENCE_S)
    daemon.start()
    with pytest.raises(AssertionError, match=r"whittled ended with (-6|\d+)"):
        conftest.end_all([daemon])


def test_what_the_test_did_itself_is_no_fault(daemon):
    daemon.kill()
    daemon.start().process.send_signal(signal.SIGSTOP)
    conftest.end_all([daemon])


@pytest.mark.parametrize("line", ["==7==ERROR: LeakSanitizer: detected memory leaks", "a.c:1:2: runtime error: overflow",
                                  "WARNING: ThreadSanitizer: data race (pid=7)"])
def test_what_a_sanitizer_says_is_a_fault(daemon, line):
    with open(daemon.log, "a", encoding="utf-8") as log:
        log.write(line + "\n")
    with pytest.raises(AssertionError, match=re.escape(line.split("==")[-1][:20])):
        conftest.end_all([daemon])


CASES = """
import pytest
def test_passes(tmp_path): (tmp_path / "large").write_bytes(bytes(1 << 20))
@pytest.mark.skipif(True, reason="chromium is not installed")
def test_is_skipped(tmp_path): pass
"""


def run_pytest(tmp_path, cases, allowed, *flags):
    folder = tmp_path / "cases"
    folder.mkdir(exist_ok=True)
    (folder / "conftest.py").write_text((HERE / "conftest.py").read_text())
    (folder / "test_cases.py").write_text(cases)
    (folder / "allowed").write_text(allowed)
    (tmp_path / "temporary").mkdir(exist_ok=True)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", "--rootdir", folder, *flags,
         "--allowed-skips", folder / "allowed", folder / "test_cases.py"], capture_output=True, text=True, check=False,
        env=dict(os.environ, TMPDIR=str(tmp_path / "temporary")))
    return done.returncode, done.stdout, [str(p) for p in (tmp_path / "temporary").rglob("large")]


def test_one_that_does_not_end_keeps_no_other_from_ending(daemon, tmp_path, monkeypatch):
    def give_up():
        raise AssertionError("the end of whittled did not come")
    monkeypatch.setattr(daemon, "give_up", give_up)
    (tmp_path / "other").mkdir()
    with conftest.Daemon(tmp_path / "other") as other:
        with pytest.raises(AssertionError, match="the end of whittled did not come; whittled ended with nothing but SIGKILL"):
            conftest.end_all([daemon, other])
        assert daemon.process.returncode == -signal.SIGKILL and other.process.returncode == 0


LEAVES = """
import pathlib, subprocess, pytest
def note(pid, name): (pathlib.Path(__file__).parent / name).write_text(str(pid))
@pytest.fixture(name="left", scope="module")
def make_left():
    process = subprocess.Popen(["sleep", "1001"], start_new_session=True)
    note(process.pid, "child")
    yield process
    assert False, "before it is ended"
def test_of_a_fixture(left): assert left.poll() is None
def test_that_forks():
    sleep = "sleep 1002 >/dev/null 2>&1 & echo $!"
    note(subprocess.run(["setsid", "sh", "-c", sleep], stdout=subprocess.PIPE, text=True, check=True).stdout, "grandchild")
"""


@pytest.mark.parametrize("flags", [(), ("-n", "2")], ids=["one process", "two"])
def test_a_process_that_is_left_fails_the_run_and_is_ended(tmp_path, flags):
    code, text, _ = run_pytest(tmp_path, LEAVES.replace("assert False", "assert True"), "", *flags)
    assert code == 1 and "2 passed" in text
    for seconds, test in ((1001, "test_of_a_fixture (setup)"), (1002, "test_that_forks (call)")):
        assert re.search(rf"left running: \d+ sleep {seconds} of \S+{re.escape(test)}", text), text
    for name in ("child", "grandchild"):
        assert not conftest.process_lives(int((tmp_path / "cases" / name).read_text()))
    code, text, _ = run_pytest(tmp_path, LEAVES.replace("100", "0.0"), "", *flags)
    assert code == 1 and "before it is ended" in text and "left running" not in text


KILLED = """
import atexit, os, subprocess, sys
HOLDS = "x = bytearray(b'1') * (1 << 29); print('full', flush=True); import time; time.sleep(1003)"
def test_that_is_over():
    process = subprocess.Popen([sys.executable, "-c", HOLDS], stdout=subprocess.PIPE)
    process.stdout.readline()
    if KILLS: atexit.register(lambda: (process.kill(), os._exit(0)))
"""


def test_what_has_been_killed_is_waited_for(tmp_path, monkeypatch):
    """Memory takes time to give back, and a processor is to be had for that; a job's process is the last to get one."""
    monkeypatch.setenv("WHITTLE_ENDING_S", "0")
    code, text, _ = run_pytest(tmp_path, KILLED.replace("KILLS", "True"), "")
    assert code == 0 and "1 passed" in text and "left running" not in text, text
    code, text, _ = run_pytest(tmp_path, KILLED.replace("KILLS", "False"), "")
    assert code == 1 and re.search(r"left running: \d+ \S+ -c x = .* of \S+test_that_is_over \(call\); .*PPid:", text), text


def test_told_to_end_the_tests_end_what_they_have_started(tmp_path):
    cases = LEAVES.replace("assert False", "assert True") + """
def test_that_waits(left):
    note(0, "waits")
    left.wait()
"""
    run_pytest(tmp_path, "def test(): pass\n", "")  # makes the folder
    (tmp_path / "cases/test_cases.py").write_text(cases)
    with subprocess.Popen([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", tmp_path / "cases",
                           tmp_path / "cases/test_cases.py"], stdout=subprocess.DEVNULL) as process:
        conftest.wait_until((tmp_path / "cases/waits").exists, "the last test")
        process.terminate()
        assert process.wait(conftest.PATIENCE_S) == pytest.ExitCode.INTERRUPTED
    for name in ("child", "grandchild"):
        assert not conftest.process_lives(int((tmp_path / "cases" / name).read_text()))


@pytest.mark.parametrize("flags", [(), ("-n", "2")], ids=["one process", "two"])
def test_a_skip_that_no_line_allows_fails_the_run(tmp_path, flags):
    code, text, left = run_pytest(tmp_path, CASES, "# when file reason\nalways test_cases.py chromium is not *\n", *flags)
    assert code == 0 and "SKIPPED" in text and "chromium is not installed" in text and left == []
    when = "plain" if conftest.SANITIZED else "sanitized"
    for allowed in ("", "always test_other.py *\n", "always test_cases.py node *\n", f"{when} test_cases.py *\n"):
        code, text, _ = run_pytest(tmp_path, CASES, allowed, *flags)
        assert code == 1 and "may not be skipped: test_cases.py: chromium is not installed" in text


def literal(node):
    """The text of a string in a test's source, with * for what is filled in; "" for anything else."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return "".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in parts
                   if isinstance(part, (ast.Constant, ast.FormattedValue)))


def reasons_to_skip(source):
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    for call in calls:
        named = [word.value for word in call.keywords if word.arg == "reason"]
        if getattr(call.func, "attr", None) in ("skip", "skipif"):
            yield from map(literal, named or call.args[-1:])


def test_scans_that_no_package_installs_may_be_absent_everywhere():
    found = [(path.name, reason) for path in HERE.glob("test_*.py") for reason in reasons_to_skip(path.read_text())
             if "../shared" in reason or "libcgal-demo" in reason]
    allowed = [line.split(None, 2) for line in (HERE / "skips.txt").read_text().splitlines() if line.startswith("always")]
    assert len(found) > 10
    assert [pair for pair in found if not any(
        fnmatch.fnmatch(pair[0], file) and fnmatch.fnmatch(pair[1], reason) for _, file, reason in allowed)] == []


def test_only_what_failed_leaves_its_folder(tmp_path):
    cases = CASES + "def test_fails(tmp_path): (tmp_path / 'large').write_text('evidence'); assert False\n"
    code, _, left = run_pytest(tmp_path, cases, "always * *\n")
    assert code == 1 and [re.findall(r"test_\w+?(?=\d*/)", path)[-1] for path in left] == ["test_fails"]


@pytest.mark.parametrize("log, code, told", [
    ("skipped: ../shared/data isn't there\n[  SKIPPED ] a\n[  SKIPPED ] 1 test(s), listed below:\n[  SKIPPED ] a\n", 0,
     "skipped in log: ../shared/data isn't there"),
    ("skipped: ../shared/data has no horse\n[  SKIPPED ] a\nskipped: ../shared/data has no venus\n[  SKIPPED ] b\n", 0,
     "skipped in log: ../shared/data has no venus"),
    ("skipped: ../shared/data isn't there\n[  SKIPPED ] a\n[  SKIPPED ] b\n", 1, "skipped without a reason"),
    ("skipped: a whim\n[  SKIPPED ] a\n", 1, "may not be skipped: a whim"),
    ("[  SKIPPED ] a\n", 1, "a test is skipped without a reason")], ids=["allowed", "two", "one of two", "not allowed", "no reason"])
def test_unit_tests_skip_for_a_reason_that_is_allowed(tmp_path, log, code, told):
    (tmp_path / "log").write_text(log)
    done = subprocess.run([HERE.parent / "unit/skipped.sh", tmp_path / "log"], capture_output=True, text=True, check=False)
    assert done.returncode == code and told in done.stdout + done.stderr
