# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose turn it is, how many come before, and how long it will take."""
import statistics

import pytest

from conftest import SMALL, sphere, wait_until


@pytest.fixture(name="busy")
def make_busy(make_daemon, large):
    """A daemon whose only worker has something to do; and the id of that."""
    daemon = make_daemon("--workers", "1")
    job_id = daemon.submit(large)
    daemon.wait_for(job_id, "running")
    return daemon, job_id


def test_priority_comes_before_age(busy):
    daemon, running = busy
    ids = [daemon.submit(sphere(200 + i), f"?priority={p}") for i, p in enumerate((5, 0, 9, 9))]
    assert [daemon.job(job_id)["queue"] for job_id in ids] == [
        {"ahead": 2, "priority": 5}, {"ahead": 3, "priority": 0}, {"ahead": 0, "priority": 9},
        {"ahead": 1, "priority": 9}]
    listed = {job["id"]: job["queue"]["ahead"] for job in daemon.curl("/v1/jobs?status=accepted").json["jobs"]}
    assert listed == dict(zip(ids, (2, 3, 0, 1)))
    daemon.curl(f"/v1/jobs/{ids[2]}", "-X", "DELETE")
    assert daemon.job(ids[1])["queue"]["ahead"] == 2
    daemon.curl(f"/v1/jobs/{running}", "-X", "DELETE")
    started = {job_id: daemon.ended(job_id)["started"] for job_id in (ids[0], ids[1], ids[3])}
    assert sorted(started, key=started.get) == [ids[3], ids[0], ids[1]]


@pytest.mark.parametrize("value", ["10", "-1", "high", ""])
def test_a_priority_out_of_range_is_refused(daemon, value):
    reply = daemon.post(f"/v1/jobs?priority={value}", SMALL)
    assert (reply.status, reply.slug) == (400, "invalid-parameter")
    assert reply.json["errors"][0]["parameter"] == "priority"


def test_time_left_is_not_claimed_before_it_was_measured(make_daemon):
    """Then it is the median of what such jobs took, for each that comes before and for the job itself."""
    daemon = make_daemon("--workers", "1", "--result-cache=0")
    cloud = sphere(60000)
    job_id = daemon.submit(cloud)
    assert daemon.job(job_id)["estimate"] is None
    took = [daemon.ended(job_id)["resources"]["wall_seconds"]]
    took.append(daemon.ended(daemon.submit(cloud))["resources"]["wall_seconds"])

    def left_of_three():
        """Of all at one moment; None where the first has already run for longer than the others did."""
        ids = [daemon.submit(cloud) for _ in range(3)]
        listed = {job["id"]: job["estimate"] for job in daemon.curl("/v1/jobs").json["jobs"]}
        expected = statistics.median(took)
        took.extend(daemon.ended(job_id)["resources"]["wall_seconds"] for job_id in ids)
        assert all(daemon.job(job_id)["estimate"] is None for job_id in ids)
        return all(map(listed.get, ids)) and ([listed[job_id]["seconds_left"] for job_id in ids], expected)
    left, expected = wait_until(left_of_three, "an estimate for each")
    rounded = 0.1 + 1e-9
    assert abs(left[2] - left[1] - expected) <= rounded
    assert 0 <= left[0] <= expected + rounded and left[1] <= 2 * expected + rounded
    assert abs(left[1] - left[0] - expected) <= rounded
    other = daemon.submit(SMALL)
    assert daemon.job(other)["estimate"] is None


def test_what_was_measured_is_known_after_a_restart(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    for count in (1000, 1001):
        daemon.ended(daemon.submit(sphere(count)))
    daemon.stop()
    daemon.start()
    daemon.ended(daemon.submit(sphere(999)))
    blocked = daemon.submit(large)
    daemon.wait_for(blocked, "running")
    assert daemon.job(daemon.submit(sphere(1002)))["estimate"] is None  # what runs before it is of no known kind
    daemon.curl(f"/v1/jobs/{blocked}", "-X", "DELETE")
