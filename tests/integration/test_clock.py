# SPDX-License-Identifier: GPL-3.0-or-later
"""Somebody sets the clock, by a day or by a year: nothing ends at once, nothing stays for ever, whatever runs goes on."""
import os
import pathlib
import sqlite3
import subprocess
import time

import pytest

from conftest import BUILD, SMALL, Daemon, end_all, sphere, wait_until

LIBRARY = next(pathlib.Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)
pytestmark = [pytest.mark.skipif(not LIBRARY, reason="libfaketime is not installed"),
              pytest.mark.skipif("asan" in str(BUILD) or "tsan" in str(BUILD), reason="sanitizers come first")]
DAY = 24 * 3600
UTC = -time.timezone  # time.mktime takes it for local time
OFTEN = ("--idempotency-retention", "200ms")  # it looks for what is over as often as that


class Clocked(Daemon):
    """A daemon whose clock on the wall can be set."""

    def __init__(self, folder, *flags):
        super().__init__(folder, *flags)
        self.offset = folder / "offset"
        self.set_clock(0)
        self.prefix = ("env", f"LD_PRELOAD={LIBRARY}", f"FAKETIME_TIMESTAMP_FILE={self.offset}", "FAKETIME_NO_CACHE=1",
                       "FAKETIME_DONT_FAKE_MONOTONIC=1", "DONT_FAKE_MONOTONIC=1")

    def set_clock(self, seconds):
        new = self.folder / "offset.new"
        new.write_text(f"{seconds:+d}\n")
        os.replace(new, self.offset)

    def has_swept(self):
        """Waits until it has looked for what is over once more: it forgets a key then."""
        def again():
            return self.post("/v1/jobs?ratio=0.9", SMALL, "-H", "Idempotency-Key: sweep").json["id"]
        first = again()
        wait_until(lambda: again() != first, "a sweep")


@pytest.fixture(name="clocked")
def make_clocked(tmp_path):
    daemons = []

    def make(*flags):
        daemons.append(Clocked(tmp_path, *flags))
        return daemons[-1].start()

    yield make
    end_all(daemons)


def set_and_seen(daemon, seconds):
    daemon.set_clock(seconds)
    wait_until(lambda: "the clock was set by" in daemon.log_text(), "the clock's being seen")


def seconds_of(text):
    return time.mktime(time.strptime(text[:19], "%Y-%m-%dT%H:%M:%S"))


@pytest.mark.parametrize("seconds", [DAY, -DAY, 400 * DAY, -400 * DAY])
def test_results_clouds_and_uploads_are_kept_for_as_long_as_they_were_to_be(clocked, seconds):
    daemon = clocked(*OFTEN, "--retention", "1h", "--upload-expiry", "1h")
    job_id = daemon.submit(SMALL)
    before = daemon.ended(job_id)["expires"]
    etag = daemon.curl(f"/v1/jobs/{job_id}").headers["etag"]
    cloud = daemon.post("/v1/clouds", SMALL + b"0 0 0\n").headers["location"]
    upload = daemon.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Length: 10")
    set_and_seen(daemon, seconds)
    daemon.has_swept()
    reply = daemon.curl(f"/v1/jobs/{job_id}")
    assert reply.status == 200 and reply.headers["etag"] != etag
    assert abs(seconds_of(reply.json["expires"]) - seconds_of(before) - seconds) < 60
    assert daemon.curl(cloud).status == 200
    assert daemon.curl(upload.headers["location"]).status == 200
    assert daemon.ended(daemon.submit(SMALL, "?ratio=0.4"))["status"] == "successful"
    assert daemon.stop() == 0 and daemon.check()[0] == 0


@pytest.mark.parametrize("seconds", [DAY, -DAY])
def test_what_is_written_before_the_clock_is_seen_moves_once(clocked, seconds):
    daemon = clocked("--retention", "1h", "--upload-expiry", "1h")  # looks every 30 s
    daemon.set_clock(seconds)
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    cloud = daemon.post("/v1/clouds", SMALL + b"0 0 0\n").headers["location"]
    upload = daemon.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Length: 10")
    keyed = daemon.post("/v1/jobs?ratio=0.9", SMALL, "-H", "Idempotency-Key: k").json["id"]
    daemon.ended(keyed)
    assert "the clock was set by" not in daemon.log_text(), "a busy machine: written too late"
    set_and_seen(daemon, seconds)
    wall = time.time() + seconds

    def times():
        database = sqlite3.connect(daemon.data / "whittled.db")
        rows = database.execute("SELECT expires / 1000 - 3600 FROM jobs UNION ALL SELECT expires / 1000 - 3600 FROM clouds "
                                "UNION ALL SELECT expires / 1000 - 3600 FROM uploads UNION ALL SELECT at / 1000 FROM replies")
        found = [row[0] for row in rows]
        database.close()
        return found
    wait_until(lambda: all(abs(at - wall) < 300 for at in times()), "the ends' move")
    assert len(times()) == 5
    for path in (f"/v1/jobs/{job_id}", cloud, upload.headers["location"]):
        assert daemon.curl(path).status == 200
    assert abs(seconds_of(daemon.job(job_id)["expires"]) + UTC - wall - 3600) < 300


def test_a_clock_that_was_set_back_keeps_nothing_for_ever(clocked):
    daemon = clocked("--retention", "2s", "--upload-expiry", "2s")
    job_id = daemon.submit(SMALL)
    upload = daemon.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Length: 10")
    daemon.ended(job_id)
    daemon.set_clock(-400 * DAY)
    wait_until(lambda: daemon.curl(f"/v1/jobs/{job_id}").status == 410, "the job's end")
    wait_until(lambda: daemon.curl(upload.headers["location"]).status == 404, "the upload's end")
    wait_until(lambda: not list((daemon.data / "clouds").iterdir()), "the cloud's end")


def test_a_clock_that_was_set_back_between_two_starts(clocked):
    daemon = clocked("--retention", "3s")
    set_and_seen(daemon, 400 * DAY)
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    for _ in range(2):  # the second finds nothing in the future any more
        daemon.stop()
        daemon.set_clock(0)
        daemon.start()
    assert daemon.log_text().count("the clock was set by -") == 1
    wait_until(lambda: daemon.curl(f"/v1/jobs/{job_id}").status == 410, "the job's end")


@pytest.mark.parametrize("seconds", [DAY, -DAY])
def test_what_runs_and_waits_goes_on(clocked, seconds):
    daemon = clocked(*OFTEN, "--workers", "1", "--job-wall", "5m")
    running = daemon.submit(sphere(150000))
    daemon.wait_for(running, "running")
    waiting = daemon.submit(SMALL)
    events = subprocess.Popen(daemon.curl_command(f"/v1/jobs/{running}/events", "-N"), stdout=subprocess.PIPE)
    etag = daemon.curl(f"/v1/jobs/{waiting}").headers["etag"]
    poll = subprocess.Popen(daemon.curl_command(f"/v1/jobs/{waiting}", "-H", "Prefer: wait=50", "-H",
                                                f"If-None-Match: {etag}"), stdout=subprocess.PIPE)
    set_and_seen(daemon, seconds)
    later = daemon.submit(SMALL, "?ratio=0.7")
    first = daemon.job(later)["queue"]["ahead"]
    job = daemon.ended(running)
    assert job["status"] == "successful" and 0 < job["resources"]["wall_seconds"] < 300 and job["attempt"] == 1
    assert first >= 1 or daemon.job(waiting)["status"] != "accepted"  # who waits longer is still first
    assert b"event: end" in events.communicate(timeout=60)[0]
    assert poll.communicate(timeout=60)[0].startswith((b"HTTP/1.1 200", b"HTTP/1.1 304"))
    assert daemon.ended(waiting)["status"] == daemon.ended(later)["status"] == "successful"
    numbers = [int(line[4:]) for line in daemon.curl(f"/v1/jobs/{running}/events").body.decode().splitlines()
               if line.startswith("id: ")]
    assert numbers == sorted(numbers)


def test_links_end_by_the_clock_on_the_wall(clocked):
    daemon = clocked()
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    link = daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply/link?seconds=3600", "-X", "POST").json["href"]
    assert daemon.curl(link).status == 200
    daemon.set_clock(DAY)
    assert daemon.curl(link).slug == "forbidden"
    daemon.set_clock(-DAY)
    assert daemon.curl(link).status == 200
