# SPDX-License-Identifier: GPL-3.0-or-later
"""Data folders of older versions: whatever schema the database has, the service brings it to its own, serves what is
there and ends what waited; a folder of a newer version is refused.

An older database is made of the first steps of the schema in server/catalog/sqlite/schema.c, which are never edited, and of what
the current one holds of their columns."""
import contextlib
import pathlib
import re
import sqlite3
import subprocess

import pytest

from conftest import BUILD, PATIENCE_S, SMALL, sphere

SOURCE = (pathlib.Path(__file__).resolve().parents[2] / "server/catalog/sqlite/schema.c").read_text()


def schema_steps():
    """The steps as one text each: literals side by side are one, commas part them."""
    body = re.search(r"steps\[\] = \{\n(.*?)\n\};", SOURCE, re.S)[1]
    steps = [""]
    for literal, comma in re.findall(r'"((?:[^"\\]|\\.)*)"|(,)', body):
        if comma:
            steps.append("")
        steps[-1] += literal
    return [s for s in steps if s]


STEPS = schema_steps()


def columns(database, table):
    return [row[1] for row in database.execute(f"PRAGMA table_info({table})")]


def make_older(path, version):
    """Puts a database of that version in the place of the current one."""
    old = path.with_name("old.db")
    with contextlib.closing(sqlite3.connect(old)) as database:
        for step in STEPS[:version]:
            database.executescript(step)
        database.execute("ATTACH ? AS current", (str(path),))
        tables = [row[0] for row in database.execute("SELECT name FROM main.sqlite_schema WHERE type = 'table'")]
        for table in tables:
            names = ", ".join(columns(database, table))
            database.execute(f"DELETE FROM main.{table}")
            database.execute(f"INSERT INTO main.{table} ({names}) SELECT {names} FROM current.{table}")
        database.execute(f"PRAGMA main.user_version = {version}")
        database.commit()
    old.replace(path)


def version_of(path):
    with contextlib.closing(sqlite3.connect(path)) as database:
        return database.execute("PRAGMA user_version").fetchone()[0]


@pytest.mark.parametrize("version", range(1, len(STEPS) + 1))
def test_a_folder_of_an_older_version_is_taken_over(make_daemon, version):
    daemon = make_daemon("--workers", "1")
    done = daemon.submit(SMALL, "?points=50&label=kept")
    before = daemon.ended(done)
    mesh = daemon.curl(f"/v1/jobs/{done}/outputs/mesh.ply").body
    running, waiting = daemon.submit(sphere(100000)), daemon.submit(SMALL, "?points=40")
    daemon.wait_for(running, "running")
    daemon.kill()

    make_older(daemon.data / "whittled.db", version)
    daemon.start()
    after = daemon.job(done)
    for name in ("status", "report", "params", "input", "label", "created", "finished"):
        assert after[name] == before[name], name
    assert daemon.curl(f"/v1/jobs/{done}/outputs/mesh.ply").body == mesh
    assert daemon.ended(running)["status"] == daemon.ended(waiting)["status"] == "successful"
    assert [job["id"] for job in daemon.curl("/v1/jobs?label=kept").json["jobs"]] == [done]
    assert daemon.stop() == 0
    assert version_of(daemon.data / "whittled.db") == len(STEPS)
    assert daemon.check()[0] == 0


def test_a_folder_of_a_newer_version_is_left_alone(daemon):
    done = daemon.submit(SMALL, "?points=50")
    daemon.ended(done)
    daemon.stop()
    path = daemon.data / "whittled.db"
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute(f"PRAGMA user_version = {len(STEPS) + 1}")
    refused = subprocess.run([BUILD / "whittled", "--listen", "127.0.0.1:0", "--data", daemon.data],
                             capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert refused.returncode != 0 and "newer" in refused.stderr, refused.stderr
    assert version_of(path) == len(STEPS) + 1


def test_outputs_of_an_older_version_have_the_name_they_had(daemon):
    """It kept the outputs of any attempt under one name."""
    done = daemon.submit(SMALL, "?points=50")
    daemon.ended(done)
    mesh = daemon.curl(f"/v1/jobs/{done}/outputs/mesh.ply").body
    assert daemon.stop() == 0
    path = daemon.data / "whittled.db"
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE jobs SET attempt = 2")
        database.commit()
    make_older(path, len(STEPS) - 1)
    daemon.start()
    assert daemon.curl(f"/v1/jobs/{done}/outputs/mesh.ply").body == mesh
    same = daemon.submit(SMALL, "?points=50")  # served by the same outputs
    assert daemon.curl(f"/v1/jobs/{same}/outputs/mesh.ply").body == mesh
    assert daemon.stop() == 0
    assert daemon.check()[0] == 0
