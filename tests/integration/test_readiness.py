# SPDX-License-Identifier: GPL-3.0-or-later
"""/readyz says whether work can be done, and what is in the way; /healthz goes on meanwhile."""
import contextlib
import re
import shutil
import sqlite3

from conftest import BUILD, wait_until


def refused(daemon):
    """What is in the way, once it shows."""
    reply = wait_until(lambda: (reply := daemon.curl("/readyz")).status != 200 and reply, "the end of readiness")
    assert daemon.curl("/healthz").status == 200
    return reply


def ready_again(daemon):
    wait_until(lambda: daemon.curl("/readyz").status == 200, "readiness")


def test_a_database_that_somebody_else_holds(daemon):
    assert daemon.curl("/readyz").status == 200
    with contextlib.closing(sqlite3.connect(daemon.data / "whittled.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        reply = refused(daemon)
        assert (reply.status, reply.slug) == (503, "not-ready") and int(reply.headers["retry-after"]) > 0
        assert reply.json["detail"] == "the database takes no changes: the database says: database is locked"
        other.execute("ROLLBACK")
    ready_again(daemon)


def test_a_program_for_jobs_that_is_gone(make_daemon, tmp_path):
    program = tmp_path / "whittle"
    shutil.copy(BUILD / "whittle", program)
    daemon = make_daemon("--worker", program)
    assert daemon.curl("/readyz").status == 200
    for spoil, why in ((program.unlink, "No such file or directory"), (program.mkdir, "Is a directory")):
        spoil()
        said = f"the program for jobs, {program}, can't be executed: {why}"
        wait_until(lambda said=said: refused(daemon).json["detail"] == said, "the reason")
        reply = refused(daemon)
        assert (reply.status, reply.slug) == (503, "not-ready")
    program.rmdir()
    shutil.copy(BUILD / "whittle", program)
    ready_again(daemon)


def test_a_disk_that_takes_no_files_is_not_called_full(make_daemon):
    reply = refused(make_daemon("--fault", "scratch=erofs:1-1000000"))
    assert (reply.status, reply.slug) == (503, "not-ready")
    assert "takes no files" in reply.json["detail"] and "Read-only file system" in reply.json["detail"]


def test_a_disk_that_is_full(make_daemon):
    reply = refused(make_daemon("--fault", "scratch=enospc:1-1000000"))
    assert (reply.status, reply.slug) == (507, "storage-full")


def test_a_disk_that_hangs_is_told_at_once(make_daemon):
    """Who asks doesn't wait for it, and hears what it is."""
    daemon = make_daemon("--fault", "scratch=hang:2-1000000")
    assert daemon.curl("/readyz").status == 200
    reply = refused(daemon)
    assert (reply.status, reply.slug) == (503, "not-ready")
    assert re.fullmatch("the data folder hasn't answered for [0-9]+ s", reply.json["detail"])
    daemon.kill()
