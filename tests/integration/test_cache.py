# SPDX-License-Identifier: GPL-3.0-or-later
"""The same cloud with the same parameters is computed once."""
import pytest

from conftest import SMALL, sphere

HIT, MISS = "whittled; hit", "whittled; fwd=miss"


def files_of(daemon, job_id):
    manifest = daemon.curl(f"/v1/jobs/{job_id}/outputs").json["outputs"]
    return {output["name"]: daemon.curl(output["href"]).body for output in manifest}


def create(daemon, query="?ratio=0.2&outputs=cloud,mesh", *arguments, data=SMALL):
    reply = daemon.post(f"/v1/jobs{query}", data, *arguments)
    assert reply.status == 201, reply.body
    return reply


def test_the_second_job_has_the_outputs_of_the_first_at_once(daemon):
    first = create(daemon)
    assert first.headers["cache-status"] == MISS
    before = daemon.ended(first.json["id"])
    second = create(daemon, "?outputs=mesh,cloud&threads=1&label=again&ratio=0.2")
    job = second.json
    assert second.headers["cache-status"] == HIT
    assert job["status"] == "successful" and job["id"] != before["id"] and job["label"] == "again"
    assert job["report"] == before["report"] and job["attempt"] == 0 and job["resources"] is None
    assert job["created"] <= job["started"] <= job["finished"] < job["expires"]
    assert files_of(daemon, job["id"]) == files_of(daemon, before["id"])
    assert create(daemon, "?ratio=0.2&outputs=cloud,mesh&seed=1").headers["cache-status"] == MISS
    assert create(daemon, data=sphere(301)).headers["cache-status"] == MISS


@pytest.mark.parametrize("first_to_go", [0, 1])
def test_deleting_one_leaves_the_other_also_over_a_restart(daemon, first_to_go):
    first = create(daemon).json["id"]
    daemon.ended(first)
    ids = [first, create(daemon).json["id"]]
    files = files_of(daemon, first)
    daemon.curl(f"/v1/jobs/{ids.pop(first_to_go)}", "-X", "DELETE")
    assert files_of(daemon, ids[0]) == files
    daemon.stop()
    daemon.start()
    assert files_of(daemon, ids[0]) == files
    assert create(daemon).headers["cache-status"] == HIT
    daemon.curl(f"/v1/jobs/{ids[0]}", "-X", "DELETE")


def test_nothing_is_taken_from_deleted_or_failed_jobs(daemon):
    job_id = create(daemon).json["id"]
    daemon.ended(job_id)
    daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE")
    assert create(daemon).headers["cache-status"] == MISS
    flat = "".join(f"{i % 5} {i // 5} 0\n" for i in range(25)).encode()
    for _ in range(2):
        reply = create(daemon, "?ratio=1&outputs=mesh&surface=closed", data=flat)
        assert reply.headers["cache-status"] == MISS
        assert daemon.ended(reply.json["id"])["status"] == "failed"


def test_a_client_or_a_setting_can_ask_for_a_run(make_daemon):
    daemon = make_daemon()
    daemon.ended(create(daemon).json["id"])
    fresh = create(daemon, "?ratio=0.2&outputs=cloud,mesh", "-H", "Cache-Control: no-cache")
    assert fresh.headers["cache-status"] == MISS
    without = make_daemon("--result-cache=0")
    without.ended(create(without).json["id"])
    assert create(without).headers["cache-status"] == MISS


def test_one_shots_share_too(daemon):
    first, second = (daemon.post("/v1/simplify?ratio=0.2", SMALL) for _ in range(2))
    assert (first.headers["cache-status"], second.headers["cache-status"]) == (MISS, HIT)
    assert first.body == second.body and first.headers["job-stats"] == second.headers["job-stats"]
    assert first.headers["link"] != second.headers["link"]
    reply = daemon.post("/v1/simplify?ratio=0.2", SMALL, "-H", "Prefer: respond-async")
    assert reply.status == 202 and reply.headers["cache-status"] == HIT and reply.json["status"] == "successful"
