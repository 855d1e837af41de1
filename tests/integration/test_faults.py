# SPDX-License-Identifier: GPL-3.0-or-later
"""The system refuses, at each point in turn: a right answer, nothing left behind, and the next request is served."""
import concurrent.futures
import json
import sqlite3
import threading

import pytest

from conftest import SMALL, sphere, wait_until

UPLOAD = ["upload-open", "upload-write", "upload-sync", "rename-clouds", "sync-clouds"]
OUTPUTS = ["output-open", "output-sync", "rename-jobs", "sync-jobs"]
ANSWERS = {"enospc": (507, "storage-full"), "eio": (500, "internal-error"), "emfile": (500, "internal-error")}


def check(daemon):
    assert daemon.post("/v1/simplify?ratio=0.5", SMALL).status == 200
    assert daemon.leftovers() == []
    assert daemon.stop() == 0
    status, lines = daemon.check()
    assert status == 0 and len(lines) == 1, lines


@pytest.mark.parametrize("action", sorted(ANSWERS))
@pytest.mark.parametrize("point", UPLOAD)
def test_an_upload_that_cannot_be_stored(make_daemon, point, action):
    daemon = make_daemon("--fault", f"{point}={action}")
    reply = daemon.post("/v1/jobs", SMALL)
    assert (reply.status, reply.slug) == ANSWERS[action]
    assert daemon.curl("/v1/jobs").json["jobs"] == []
    check(daemon)


@pytest.mark.parametrize("action", sorted(ANSWERS))
@pytest.mark.parametrize("point", OUTPUTS)
def test_outputs_that_cannot_be_kept(make_daemon, point, action):
    daemon = make_daemon("--fault", f"{point}={action}")
    job = daemon.ended(daemon.submit(SMALL))
    assert job["status"] == "failed" and job["problem"]["type"] == f"/problems/{ANSWERS[action][1]}"
    check(daemon)


def test_an_end_that_cannot_be_recorded_is_recorded_later(make_daemon):
    daemon = make_daemon()
    daemon.ended(daemon.submit(SMALL, "?ratio=0.3"))
    daemon.stop()
    daemon.start("--fault", "commit=eio:3")  # the schema's, the job's, its end's
    job = daemon.ended(daemon.submit(SMALL, "?ratio=0.4"))
    assert job["status"] == "successful" and job["attempt"] == 1
    check(daemon)


DISK = {"database-write=enospc": 507, "database-write=eio": 500, "database-sync=eio": 500, "database-read=eio": 500,
        "database-map=eio": 500}


@pytest.mark.parametrize("first", [1, 3, 6, 10, 15, 22])
@pytest.mark.parametrize("fault", sorted(DISK))
def test_a_database_whose_disk_refuses_for_a_while(make_daemon, fault, first):
    daemon = make_daemon()
    kept = daemon.submit(SMALL)
    daemon.ended(kept)
    daemon.stop()
    try:
        daemon.start("--fault", f"{fault}:{first}-{first + 4}")
    except AssertionError:
        daemon.may_end(1)
        assert daemon.process.wait(60) == 1  # refused to start, and said why
        assert "the database says" in daemon.log_text()
        daemon.start()
    accepted = [kept]
    for i in range(12):
        reply = daemon.post(f"/v1/jobs?points={20 + i}", SMALL)
        assert reply.status in (201, DISK[fault]), reply.body
        if reply.status == 201:
            accepted.append(reply.json["id"])
    assert len(accepted) > 6
    for job_id in accepted:
        wait_until(lambda j=job_id: daemon.curl(f"/v1/jobs/{j}").status == 200, "the database")
        assert daemon.ended(job_id)["status"] == "successful"
    check(daemon)


def test_a_database_that_is_locked_for_a_while(make_daemon):
    daemon = make_daemon()
    database = sqlite3.connect(daemon.data / "whittled.db", isolation_level=None, check_same_thread=False)
    database.execute("BEGIN IMMEDIATE")
    replies, clouds = [], [sphere(300 + i) for i in range(3)]
    threads = [threading.Thread(target=lambda cloud=cloud: replies.append(daemon.post("/v1/jobs", cloud)))
               for cloud in clouds]
    for thread in threads:
        thread.start()
    wait_until(lambda: len(daemon.leftovers()) + len(list((daemon.data / "clouds").iterdir())) == 3, "the uploads")
    for _ in range(20):  # readers don't wait
        assert daemon.request("GET", "/healthz")[0] == 200
        assert json.loads(daemon.request("GET", "/v1/jobs")[2])["jobs"] == []
    assert replies == []  # and writers do
    database.execute("ROLLBACK")
    database.close()
    for thread in threads:
        thread.join()
    assert [reply.status for reply in replies] == [201] * 3
    for reply in replies:
        assert daemon.ended(reply.json["id"])["status"] == "successful"
    check(daemon)


TUS = ("-H", "Tus-Resumable: 1.0.0")
PIECE = ("-H", "Content-Type: application/offset+octet-stream", "-H", "Upload-Offset: 0", "-X", "PATCH")


def test_all_that_writes_waits_for_a_locked_database_and_nothing_else_does(make_daemon):
    daemon = make_daemon()
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    clouds = [daemon.post("/v1/clouds", sphere(20 + i)).headers["location"] for i in range(2)]
    uploads = [daemon.curl("/v1/uploads", "-X", "POST", *TUS, "-H", "Upload-Length: 10").headers["location"]
               for _ in range(2)]
    document = json.dumps({"input": clouds[0]}).encode()
    writes = [
        (200, lambda i: daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE")),
        (200, lambda i: daemon.curl(clouds[1], "-X", "DELETE")),
        (204, lambda i: daemon.curl(uploads[1], "-X", "DELETE", *TUS)),
        (204, lambda i: daemon.post(uploads[0], b"0 0 0", *TUS, *PIECE)),
        (201, lambda i: daemon.post("/v1/jobs", document, "-H", "Content-Type: application/json")),
        *[(201, lambda i: daemon.curl("/v1/uploads", "-X", "POST", *TUS, "-H", "Upload-Length: 10"))] * 4,
        *[(201, lambda i: daemon.post("/v1/clouds", sphere(100 + i)))] * 4,
        *[(200, lambda i: daemon.post("/v1/simplify", sphere(200 + i)))] * 4,
        *[(201, lambda i: daemon.post("/v1/jobs", sphere(300 + i)))] * 4]
    database = sqlite3.connect(daemon.data / "whittled.db", isolation_level=None, check_same_thread=False)
    database.execute("BEGIN IMMEDIATE")
    with concurrent.futures.ThreadPoolExecutor(len(writes)) as pool:
        replies = [pool.submit(write, i) for i, (_, write) in enumerate(writes)]
        wait_until(lambda: len(daemon.leftovers()) + len(list((daemon.data / "clouds").iterdir())) > 8, "the uploads")
        for path in ("/healthz", "/v1/jobs", f"/v1/jobs/{job_id}", f"/v1/jobs/{job_id}/outputs/cloud.ply",
                     "/v1/clouds", clouds[0], uploads[0], "/metrics"):
            assert daemon.curl(path).status == 200, path
        wait_until(lambda: daemon.curl("/readyz").status == 503, "what says that no changes are taken")
        assert not any(reply.done() for reply in replies)
        database.execute("ROLLBACK")
        database.close()
    for (status, _), reply in zip(writes, replies):
        assert reply.result().status == status, reply.result().body
    assert daemon.stop() == 0
    status, lines = daemon.check()
    assert status == 0 and "0 damaged" in lines[-1], lines


def test_a_delete_whose_end_cannot_be_recorded_is_answered(make_daemon):
    daemon = make_daemon("--workers", "1", "--wait-max", "1s")
    job_id = daemon.submit(sphere(400000))
    daemon.wait_for(job_id, "running")
    database = sqlite3.connect(daemon.data / "whittled.db", isolation_level=None)
    database.execute("BEGIN IMMEDIATE")
    reply = daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE")
    assert (reply.status, reply.slug) == (500, "internal-error")
    database.execute("ROLLBACK")
    database.close()
    assert daemon.ended(job_id)["status"] == "dismissed"
    check(daemon)
