# SPDX-License-Identifier: GPL-3.0-or-later
"""`whittled check`: what is whole, what is damaged, what a crash left; and databases of earlier versions."""
import hashlib
import shutil
import sqlite3

import pytest

from conftest import SMALL

JOB = "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e"

# The first version's tables, as it made them.
FIRST_SCHEMA = """
CREATE TABLE jobs (id TEXT PRIMARY KEY, state INTEGER NOT NULL, sequence INTEGER NOT NULL, attempt INTEGER NOT NULL,
    created INTEGER NOT NULL, started INTEGER NOT NULL, finished INTEGER NOT NULL, updated INTEGER NOT NULL,
    expires INTEGER NOT NULL, label TEXT NOT NULL, cloud TEXT NOT NULL, input_bytes INTEGER NOT NULL,
    input_points INTEGER NOT NULL, input_format TEXT NOT NULL, params TEXT NOT NULL, stage TEXT NOT NULL DEFAULT '',
    message TEXT NOT NULL DEFAULT '', fraction REAL NOT NULL DEFAULT 0, cpu REAL NOT NULL DEFAULT 0,
    wall REAL NOT NULL DEFAULT 0, rss INTEGER NOT NULL DEFAULT 0, report TEXT, problem TEXT) STRICT;
CREATE INDEX jobs_by_state ON jobs (state, id);
CREATE INDEX jobs_by_label ON jobs (label, id);
CREATE INDEX jobs_by_cloud ON jobs (cloud);
CREATE INDEX jobs_by_expiry ON jobs (expires);
CREATE TABLE outputs (job TEXT NOT NULL, position INTEGER NOT NULL, name TEXT NOT NULL, bytes INTEGER NOT NULL,
    sha256 TEXT NOT NULL, PRIMARY KEY (job, position)) STRICT, WITHOUT ROWID;
CREATE TABLE tombstones (id TEXT PRIMARY KEY, reason TEXT NOT NULL, at INTEGER NOT NULL) STRICT;
PRAGMA user_version = 1;
"""


@pytest.fixture(name="ended")
def make_ended(make_daemon):
    """A daemon that has run one job, and has ended."""
    daemon = make_daemon()
    daemon.job_id = daemon.submit(SMALL)
    assert daemon.ended(daemon.job_id)["status"] == "successful"
    assert daemon.stop() == 0
    return daemon


def change_database(daemon, *statements):
    database = sqlite3.connect(daemon.data / "whittled.db")
    for statement in statements:
        database.execute(statement)
    database.commit()
    database.close()


def findings(daemon, status):
    returned, lines = daemon.check()
    assert returned == status, lines
    assert lines[-1].startswith("checked 1 jobs, 1 clouds, 2 outputs"), lines
    return lines[:-1]


def test_a_folder_that_is_whole(ended):
    assert ended.check() == (0, ["checked 1 jobs, 1 clouds, 2 outputs: 0 damaged, 0 unfinished"])


def test_a_folder_that_is_served_or_none(make_daemon, tmp_path):
    daemon = make_daemon()
    status, lines = daemon.check()
    assert status == 2 and "another whittled serves" in lines[0]
    daemon.stop()
    daemon.data = tmp_path / "none"
    status, lines = daemon.check()
    assert status == 2 and "there is no" in lines[0] and not daemon.data.exists()


def test_content_that_has_changed_is_named(ended):
    outputs = ended.data / "jobs" / ended.job_id / "outputs"
    cloud = next((ended.data / "clouds").iterdir())
    cloud.write_bytes(b"x" + cloud.read_bytes()[1:])
    (outputs / "cloud.ply").write_bytes(b"")
    (outputs / "report.json").unlink()
    lines = findings(ended, 1)
    assert [line.split()[:2] for line in lines] == [
        ["damaged:", f"clouds/{cloud.name}"],
        ["damaged:", f"jobs/{ended.job_id}/outputs/cloud.ply"],
        ["damaged:", f"jobs/{ended.job_id}/outputs/report.json"]]
    assert "has the hash" in lines[0] and "has 0 bytes" in lines[1] and "is missing" in lines[2]


def test_one_flipped_bit_is_found_wherever_it_is(ended):
    files = [*(ended.data / "clouds").iterdir(), *(ended.data / "jobs" / ended.job_id / "outputs").iterdir()]
    for file in files:
        whole = file.read_bytes()
        for at in (0, len(whole) // 2, len(whole) - 1):
            file.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1:])
            lines = findings(ended, 1)
            assert len(lines) == 1 and file.name in lines[0] and "has the hash" in lines[0]
        file.write_bytes(whole)
    assert findings(ended, 0) == []


def test_a_file_that_no_row_names_is_found_among_outputs(ended):
    (ended.data / "jobs" / ended.job_id / "outputs" / "other.ply").write_bytes(b"x")
    assert findings(ended, 1) == [f"damaged: jobs/{ended.job_id}/outputs has 3 files, not 2"]
    ended.start()
    assert ended.curl(f"/v1/jobs/{ended.job_id}/outputs/other.ply").slug == "no-such-output"


def test_a_job_whose_folder_is_gone(ended):
    shutil.rmtree(ended.data / "jobs" / ended.job_id)
    lines = findings(ended, 1)
    assert len(lines) == 2 and all("is missing" in line for line in lines)


def test_a_database_of_a_later_version_is_damage_that_is_named(ended):
    change_database(ended, "PRAGMA user_version = 999")
    lines = findings(ended, 1)
    assert len(lines) == 1 and lines[0].startswith("damaged: the database has schema 999, this program knows ")


def test_a_journal_that_is_cut_anywhere_leaves_the_last_whole_state(make_daemon):
    daemon = make_daemon()
    daemon.stop()
    daemon.start()  # the database itself holds its schema and identity by now
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    daemon.kill()  # so that the journal stays
    journal = daemon.data / "whittled.db-wal"
    whole, files = journal.read_bytes(), {name: (daemon.data / name).read_bytes() for name in ("whittled.db",)}
    assert len(whole) > 10000
    for cut in range(0, len(whole), len(whole) // 12):
        (daemon.data / "whittled.db-shm").unlink(missing_ok=True)
        (daemon.data / "whittled.db").write_bytes(files["whittled.db"])
        journal.write_bytes(whole[:cut])
        status, lines = daemon.check()
        assert status in (0, 1), lines
        assert not any("malformed" in line or "database:" in line for line in lines), lines  # no page is torn
    (daemon.data / "whittled.db-shm").unlink(missing_ok=True)
    (daemon.data / "whittled.db").write_bytes(files["whittled.db"])
    journal.write_bytes(whole[:len(whole) // 2])
    daemon.start()  # an earlier state is served
    assert daemon.curl(f"/v1/jobs/{job_id}").status in (200, 404)
    assert daemon.ended(daemon.submit(SMALL))["status"] == "successful"
    daemon.stop()
    assert daemon.check()[0] == 0


def test_what_a_crash_leaves_is_no_damage(ended):
    (ended.data / "clouds" / ("0" * 64)).write_bytes(b"x")
    (ended.data / "tmp" / "upload-half").write_bytes(b"x")
    (ended.data / "jobs" / JOB).mkdir()
    change_database(ended, "INSERT INTO jobs (id, state, sequence, attempt, created, started, finished, updated, expires,"
                    " label, cloud, input_bytes, input_points, input_format, params) SELECT "
                    "'0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5f', 1, 1, 1, 1, 1, 0, 1, 0, '', cloud, 1, 1, 'xyz', '' FROM jobs")
    status, lines = ended.check()
    assert status == 0 and len(lines) == 5
    assert all(line.startswith("unfinished: ") for line in lines[:4])
    ended.start()
    assert "recovered requeued=1 failed=0 inputs_lost=0 outputs_lost=0 clouds_lost=0 files_removed=1 files_set_aside=2" in ended.log_text()
    ended.ended("0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5f")
    ended.stop()
    status, lines = ended.check()
    assert status == 0 and lines[0].startswith("set aside: lost+found has 2 ")
    assert lines[1:] == ["checked 2 jobs, 1 clouds, 4 outputs: 0 damaged, 0 unfinished"]


def test_a_database_of_another_folder_is_damage(ended, make_daemon):
    (ended.data / "identity").write_text("0" * 32)
    lines = findings(ended, 1)
    assert len(lines) == 1 and "of another folder" in lines[0] and "check --adopt" in lines[0]


def test_a_broken_database_is_found(ended):
    change_database(ended, "UPDATE jobs SET state = 7")
    assert any("has no state 7" in line for line in findings(ended, 1))
    change_database(ended, "UPDATE jobs SET state = 3")
    lines = findings(ended, 1)
    assert any("has outputs and is not successful" in line for line in lines)
    path = ended.data / "whittled.db"
    content = bytearray(path.read_bytes())
    content[4096:] = b"\x55" * (len(content) - 4096)
    path.write_bytes(content)
    status, lines = ended.check()
    assert status == 1 and any(line.startswith(("damaged: ", "whittled: ")) for line in lines)


def test_a_database_of_the_first_version_is_brought_up_to_date(make_daemon, tmp_path):
    daemon = make_daemon()
    daemon.stop()
    daemon.data = tmp_path / "old"
    outputs = daemon.data / "jobs" / JOB / "outputs"
    outputs.mkdir(parents=True)
    (outputs / "cloud.ply").write_bytes(b"result")
    name = hashlib.sha256(SMALL).hexdigest()
    (daemon.data / "clouds").mkdir()
    (daemon.data / "clouds" / name).write_bytes(SMALL)
    database = sqlite3.connect(daemon.data / "whittled.db")
    database.executescript(FIRST_SCHEMA)
    job = ("INSERT INTO jobs VALUES (?, ?, 1, ?, 1, 1, 1, 1, ?, 'old', ?, 8548, 0, 'xyz', 'ratio=0.5\n', '', '', 1, "
           "0, 0, 0, NULL, NULL)")
    database.execute(job, (JOB, 2, 1, 1 << 45, name))
    database.execute(job, (JOB[:-1] + "f", 0, 0, 0, name))
    database.execute("INSERT INTO outputs VALUES (?, 0, 'cloud.ply', 6, ?)", (JOB, hashlib.sha256(b"result").hexdigest()))
    database.execute("INSERT INTO tombstones VALUES (?, 'deleted', 1)", (JOB[:-1] + "0",))
    database.commit()
    database.close()
    status, lines = daemon.check()
    assert status == 0 and lines[0].startswith("unfinished: the database has schema 1; the next start makes it ")
    daemon.start()
    assert daemon.job(JOB)["status"] == "successful" and daemon.job(JOB)["label"] == "old"
    assert daemon.curl(f"/v1/jobs/{JOB}/outputs/cloud.ply").body == b"result"
    waited = daemon.ended(JOB[:-1] + "f")
    assert waited["status"] == "successful" and waited["params"]["ratio"] == 0.5
    daemon.stop()
    assert daemon.check() == (0, ["checked 2 jobs, 1 clouds, 3 outputs: 0 damaged, 0 unfinished"])
