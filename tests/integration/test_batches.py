# SPDX-License-Identifier: GPL-3.0-or-later
"""Batches: several clouds as jobs that come together, all or none, with one list and one webhook."""
import hashlib
import json
import socket
import subprocess

import pytest

pytest.importorskip("jsonschema", reason="python3-jsonschema is not installed")

from conftest import PATIENCE_S, SMALL, parse_reply, process_lives, wait_until  # noqa: E402  pylint: disable=wrong-import-position
from described import OPERATIONS, check, check_schema  # noqa: E402  pylint: disable=wrong-import-position
from tables import CONTRACT  # noqa: E402  pylint: disable=wrong-import-position
from test_webhooks import make_hooked, make_receive  # noqa: F401, E402  pylint: disable=wrong-import-position, unused-import

CREATE, GET, LIST, DELETE, EVENTS = (OPERATIONS[name] for name in ("createBatch", "getBatch", "listBatches",
                                                                   "deleteBatch", "getBatchEvents"))
ENDED = ("successful", "failed", "dismissed")


def cloud_of(daemon, data):
    return "/v1/clouds/" + daemon.post("/v1/clouds", data).json["id"]


def clouds_of(daemon, count):
    return [cloud_of(daemon, SMALL + b"# %d\n" % i) for i in range(count)]


def send(daemon, document, *arguments):
    return check(CREATE, daemon.post("/v1/batches", json.dumps(document).encode(), "-H",
                                     "Content-Type: application/json", *arguments))


def create(daemon, clouds, *arguments, **more):
    reply = send(daemon, {"clouds": clouds, **more}, *arguments)
    assert reply.status == 201, reply.body
    return reply.json


def read(daemon, batch, *arguments):
    return check(GET, daemon.curl(f"/v1/batches/{batch['id']}", *arguments))


def ended(daemon, batch):
    return wait_until(lambda: (now := read(daemon, batch).json)["status"] in ENDED and now, "the end of the batch")


def test_each_cloud_becomes_a_job_in_its_order(daemon):
    clouds = clouds_of(daemon, 3)
    reply = send(daemon, {"clouds": clouds, "params": {"ratio": 0.5}, "label": "halls", "priority": 7})
    batch = reply.json
    assert reply.status == 201 and reply.headers["location"] == f"/v1/batches/{batch['id']}"
    assert [job["cloud"] for job in batch["jobs"]] == clouds and batch["counts"]["total"] == 3
    last = ended(daemon, batch)
    assert last["status"] == "successful" and last["progress"] == 100 and last["counts"]["successful"] == 3
    jobs = [daemon.curl(job["href"]).json for job in last["jobs"]]
    assert last["finished"] == max(job["finished"] for job in jobs)
    for job, cloud in zip(jobs, clouds):
        assert job["batch"] == f"/v1/batches/{batch['id']}" and job["input"]["cloud"] == cloud
        assert job["params"]["ratio"] == 0.5 and job["label"] == "halls" and job["queue"]["priority"] == 7
        assert daemon.curl(f"{job['links'][0]['href']}/outputs/cloud.ply").status == 200
    alone = daemon.submit(SMALL)
    assert daemon.job(alone)["batch"] is None
    listed = daemon.curl(f"/v1/jobs?batch={batch['id']}&limit=2")
    assert [job["id"] for job in listed.json["jobs"]] == [last["jobs"][2]["id"], last["jobs"][1]["id"]]
    assert f"batch={batch['id']}" in listed.headers["link"]
    assert daemon.curl(f"/v1/jobs?batch={alone}").json == {"jobs": []}
    assert daemon.curl("/v1/jobs?batch=none").slug == "invalid-parameter"


def test_an_earlier_result_serves_a_job_of_a_batch(daemon):
    first, second = clouds_of(daemon, 2)
    done = ended(daemon, create(daemon, [first]))
    again = create(daemon, [first, second, first])
    assert [job["status"] for job in again["jobs"]][::2] == ["successful"] * 2
    assert ended(daemon, again)["counts"]["successful"] == 3
    outputs = [daemon.curl(f"{job['href']}/outputs/cloud.ply").body for job in (*done["jobs"], again["jobs"][2])]
    assert outputs[0] == outputs[1]
    fresh = create(daemon, [first], "-H", "Cache-Control: no-cache")
    assert daemon.curl(ended(daemon, fresh)["jobs"][0]["href"]).json["attempt"] == 1


def test_one_that_fails_fails_the_batch_and_no_other_job(daemon):
    good, bad = cloud_of(daemon, SMALL), cloud_of(daemon, b"1 2 3\nx\n" + SMALL)
    last = ended(daemon, create(daemon, [bad, good]))
    assert last["status"] == "failed" and [job["status"] for job in last["jobs"]] == ["failed", "successful"]


@pytest.mark.parametrize("document, slug, parameter", [
    ({}, "invalid-parameter", "clouds"),
    ({"clouds": []}, "invalid-parameter", "clouds"),
    ({"clouds": ["/v1/clouds/" + 64 * "0"] * 257}, "invalid-parameter", "clouds"),
    ({"clouds": "/v1/clouds/" + 64 * "0"}, "invalid-parameter", "clouds"),
    ({"clouds": ["/v1/clouds/" + 64 * "0", "scan.ply"]}, "invalid-parameter", "clouds[1]"),
    ({"clouds": ["/v1/clouds/" + 64 * "0"], "input": "/v1/clouds/" + 64 * "0"}, "unknown-parameter", "input"),
    ({"clouds": ["/v1/clouds/" + 64 * "0"], "join": []}, "unknown-parameter", "join"),
    ({"clouds": ["/v1/clouds/" + 64 * "0"], "params": {"ratoi": 1}}, "unknown-parameter", "params.ratoi"),
    ({"clouds": ["/v1/clouds/" + 64 * "0"], "webhook": "http://host/"}, "invalid-parameter", "webhook")])
def test_what_is_wrong_is_named(daemon, document, slug, parameter):
    reply = send(daemon, document)
    assert (reply.status, reply.slug) == (400, slug) and reply.json["errors"][0]["parameter"] == parameter


def test_clouds_are_no_member_of_a_job(daemon):
    cloud = cloud_of(daemon, SMALL)
    reply = daemon.post(f"{cloud}/jobs", json.dumps({"clouds": [cloud]}).encode(), "-H", "Content-Type: application/json")
    assert (reply.status, reply.slug) == (400, "unknown-parameter")


def test_all_or_none(daemon, make_daemon):
    clouds = clouds_of(daemon, 3)
    reply = send(daemon, {"clouds": [*clouds, "/v1/clouds/" + 64 * "0"]})
    assert (reply.status, reply.slug) == (404, "no-such-cloud")
    assert daemon.curl("/v1/jobs").json == {"jobs": []} and daemon.curl("/v1/batches").json == {"batches": []}
    full = make_daemon("--max-queue", "2")
    clouds = clouds_of(full, 3)
    reply = send(full, {"clouds": clouds})
    assert (reply.status, reply.slug) == (503, "queue-full")
    assert full.curl("/v1/jobs").json == {"jobs": []} and create(full, clouds[:2])


def test_a_cloud_over_a_limit_is_named(make_daemon):
    daemon = make_daemon("--job-memory", "32M")
    small = cloud_of(daemon, SMALL)
    many = cloud_of(daemon, b"".join(b"%d %d %d\n" % (i % 97, i % 89, i) for i in range(300000)))
    reply = send(daemon, {"clouds": [small, many], "params": {"outputs": ["mesh"]}})
    if reply.status == 201:
        pytest.skip("the cloud fits into the memory of a job")
    assert reply.slug == "would-exceed-memory" and reply.json["detail"].startswith("clouds[1]: ")


def test_the_share_of_a_principal_holds_for_all_of_it(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text("".join(f"{name}:submit,read:{hashlib.sha256(name.encode()).hexdigest()}\n"
                              for name in ("ann", "bob")))
    daemon = make_daemon("--tokens-file", tokens, "--principal-jobs", "2", "--workers", "1")
    ann, bob = (("-H", f"Authorization: Bearer {name}") for name in ("ann", "bob"))
    clouds = ["/v1/clouds/" + daemon.post("/v1/clouds", SMALL + b"# %d\n" % i, *ann).json["id"] for i in range(3)]
    reply = send(daemon, {"clouds": clouds}, *ann)
    assert (reply.status, reply.slug) == (429, "rate-limited")
    batch = create(daemon, clouds[:2], *ann)
    assert batch["principal"] == "ann" and ended_of(daemon, batch, ann)
    assert send(daemon, {"clouds": clouds[:1]}, *bob).slug == "no-such-cloud"
    for path in (f"/v1/batches/{batch['id']}", f"/v1/batches/{batch['id']}/events"):
        assert daemon.curl(path, *bob).slug == "no-such-batch"
    assert daemon.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE", *bob).slug == "no-such-batch"
    assert daemon.curl("/v1/batches", *bob).json == {"batches": []}
    assert len(daemon.curl("/v1/batches", *ann).json["batches"]) == 1


def ended_of(daemon, batch, token):
    return wait_until(lambda: daemon.curl(f"/v1/batches/{batch['id']}", *token).json["status"] in ENDED, "the end")


def test_a_batch_that_is_refused_leaves_nothing_of_earlier_results(make_daemon):
    """An earlier result's outputs are prepared for one of its jobs before it is known that there is no room for all."""
    daemon = make_daemon("--max-queue", "1")
    clouds = clouds_of(daemon, 3)
    done = ended(daemon, create(daemon, clouds[:1]))
    kept = daemon.kept("jobs")
    for refused in (clouds, clouds[::-1]):
        assert send(daemon, {"clouds": refused}).slug == "queue-full"
        assert daemon.kept("jobs") == kept == [done["jobs"][0]["id"]]
    again = ended(daemon, create(daemon, clouds[:1]))
    assert daemon.curl(again["jobs"][0]["href"] + "/outputs/cloud.ply").status == 200


def test_the_same_request_under_a_key_is_made_once(daemon):
    *clouds, third = clouds_of(daemon, 3)
    key = ("-H", "Idempotency-Key: k")
    first = send(daemon, {"clouds": clouds}, *key)
    again = send(daemon, {"clouds": clouds}, *key)
    assert (again.status, again.body) == (201, first.body)
    assert again.headers["location"] == first.headers["location"] and again.headers["etag"] == first.headers["etag"]
    for others in (clouds[::-1], [clouds[0], third], clouds[:1], [*clouds, third]):
        assert send(daemon, {"clouds": others}, *key).slug == "idempotency-key-reused"
    assert len(daemon.curl("/v1/jobs").json["jobs"]) == 2


def test_waiting_for_the_end(daemon):
    clouds = clouds_of(daemon, 3)
    reply = send(daemon, {"clouds": clouds}, "-H", f"Prefer: wait={int(PATIENCE_S)}")
    assert reply.status == 201 and reply.json["status"] == "successful"
    assert reply.headers["preference-applied"].startswith("wait=") and "retry-after" not in reply.headers
    batch = create(daemon, clouds, "-H", "Cache-Control: no-cache")
    done = read(daemon, batch, "-H", f"Prefer: wait={int(PATIENCE_S)}")
    assert done.json["status"] == "successful"
    assert read(daemon, batch, "-H", f"If-None-Match: {done.headers['etag']}").status == 304
    assert read(daemon, batch, "-H", 'If-Match: "1"').status == 412


def test_it_waits_with_a_tag_until_a_job_has_changed(make_daemon, gated):
    """The batch waits behind a job that doesn't end, so nothing but DELETE changes it."""
    gate, flags = gated
    gate.touch()
    daemon = make_daemon(*flags)
    daemon.wait_for(daemon.submit(SMALL), "running")
    batch = create(daemon, clouds_of(daemon, 2))
    assert batch["status"] == "accepted"
    tag = read(daemon, batch).headers["etag"]
    assert read(daemon, batch, "-H", f"If-None-Match: {tag}", "-H", "Prefer: wait=1").status == 304
    command = daemon.curl_command(f"/v1/batches/{batch['id']}", "-H", f"If-None-Match: {tag}", "-H",
                                  f"Prefer: wait={int(PATIENCE_S)}")
    with subprocess.Popen(command, stdout=subprocess.PIPE) as waiting:
        assert daemon.curl(batch["jobs"][0]["href"], "-X", "DELETE").json["status"] == "dismissed"
        reply = parse_reply(waiting.stdout.read())
    assert reply.status == 200 and reply.headers["etag"] != tag and reply.json["counts"]["dismissed"] == 1
    assert reply.json["status"] == "running"


def events_of(daemon, batch, *arguments):
    text = daemon.curl(f"/v1/batches/{batch['id']}/events", "-N", *arguments).body.decode()
    return [dict(line.split(": ", 1) for line in event.split("\n")) for event in text.split("\n\n")
            if event.startswith("event: ")]


def test_events_go_to_the_end(daemon):
    batch = create(daemon, clouds_of(daemon, 3))
    events = events_of(daemon, batch)
    assert events[0]["event"] == "status" and events[-1]["event"] == "end"
    assert [int(event["id"]) for event in events] == sorted(int(event["id"]) for event in events)
    for event in events:
        check_schema(json.loads(event["data"]), CONTRACT["components"]["schemas"]["Batch"])
    last = json.loads(events[-1]["data"])
    assert last["status"] == "successful" and "jobs" not in last and last["counts"]["successful"] == 3
    path = f"/v1/batches/{batch['id']}/events"
    assert check(EVENTS, daemon.curl(path, "-H", f"Last-Event-ID: {events[-1]['id']}")).status == 204


def test_delete_dismisses_all_that_have_not_ended_then_deletes(make_daemon, gated):
    gate, flags = gated
    daemon = make_daemon(*flags)
    clouds = clouds_of(daemon, 4)
    ended(daemon, create(daemon, clouds[:1]))
    gate.touch()
    batch = create(daemon, clouds)  # an earlier result serves the first
    daemon.wait_for(batch["jobs"][1]["id"], "running")
    pid = daemon.worker_pid(batch["jobs"][1]["id"])
    reply = check(DELETE, daemon.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE"))
    assert reply.status == 200 and reply.json["status"] == "dismissed"
    assert [job["status"] for job in reply.json["jobs"]] == ["successful", *["dismissed"] * 3]
    assert not process_lives(pid)
    assert daemon.curl(batch["jobs"][0]["href"] + "/outputs/cloud.ply").status == 200
    assert check(DELETE, daemon.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE")).status == 200
    assert read(daemon, batch).slug == "no-such-batch"
    assert {daemon.curl(job["href"]).status for job in batch["jobs"]} == {410}
    assert check(DELETE, daemon.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE")).slug == "no-such-batch"
    assert daemon.stop() == 0 and daemon.check()[0] == 0


def test_a_batch_goes_with_the_last_of_its_jobs(daemon):
    batch = ended(daemon, create(daemon, clouds_of(daemon, 2)))
    daemon.curl(batch["jobs"][0]["href"], "-X", "DELETE")
    left = read(daemon, batch).json
    assert left["counts"]["deleted"] == 1 and [job["id"] for job in left["jobs"]] == [batch["jobs"][1]["id"]]
    daemon.curl(batch["jobs"][1]["href"], "-X", "DELETE")
    assert read(daemon, batch).slug == "no-such-batch"


def test_lists_go_page_by_page(daemon):
    clouds = clouds_of(daemon, 1)
    batches = [create(daemon, clouds)["id"] for _ in range(3)]
    first = check(LIST, daemon.curl("/v1/batches?limit=2"))
    assert [batch["id"] for batch in first.json["batches"]] == batches[:0:-1]
    following = first.headers["link"].split(">")[0].lstrip("<")
    last = check(LIST, daemon.curl(following))
    assert [batch["id"] for batch in last.json["batches"]] == batches[:1] and "link" not in last.headers


def test_the_end_of_all_is_told_once_and_signed(hooked, receive):
    receiver = receive(500, 200)
    daemon = hooked("--workers", "2")
    clouds = clouds_of(daemon, 4)
    batch = create(daemon, clouds, webhook=f"{receiver.url}/hook")
    wait_until(lambda: len(receiver.taken) == 2, "the webhook, and again")
    for headers, body, path in receiver.taken:
        payload = json.loads(body)
        assert path == "/hook" and {n.lower(): v for n, v in headers.items()}["webhook-id"] == batch["id"]
        assert payload["type"] == "batch.ended" and payload["data"] == read(daemon, batch).json
        assert payload["timestamp"] == payload["data"]["finished"] and payload["data"]["counts"]["successful"] == 4
    wait_until(lambda: f"batch={batch['id']} webhook delivered" in daemon.log_text(), "the log")
    wait_until(lambda: daemon.ask("SELECT count(*) FROM outbox") == [(0,)], "the webhook's row to go")
    again = create(daemon, clouds, webhook=f"{receiver.url}/hook")  # all are served by earlier results
    wait_until(lambda: len(receiver.taken) == 3, "the webhook of a batch that had ended when it came")
    assert json.loads(receiver.taken[2][1])["data"]["id"] == again["id"]


def test_the_webhook_of_a_batch_that_is_deleted_is_not_told_any_more(hooked, receive):
    receiver = receive(500)
    daemon = hooked()
    batch = create(daemon, clouds_of(daemon, 2), webhook=receiver.url)
    wait_until(lambda: receiver.taken, "the first attempt")
    assert daemon.ask("SELECT count(*) FROM outbox") == [(1,)]
    assert daemon.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE").status == 200
    assert read(daemon, batch).slug == "no-such-batch" and daemon.ask("SELECT count(*) FROM outbox") == [(0,)]


def test_a_batch_that_is_dismissed_is_told_too(hooked, receive, gated):
    receiver = receive(200)
    gate, flags = gated
    gate.touch()
    daemon = hooked(*flags)
    batch = create(daemon, clouds_of(daemon, 3), webhook=receiver.url)
    assert daemon.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE").json["status"] == "dismissed"
    wait_until(lambda: receiver.taken, "the webhook")
    assert json.loads(receiver.taken[0][1])["data"]["counts"]["dismissed"] == 3


@pytest.mark.parametrize("point, made", [("batch-prepared", False), ("batch-committed", True)])
def test_what_a_crash_leaves_is_a_whole_batch_or_none(hooked, receive, point, made):
    receiver = receive(200)
    daemon = hooked()
    clouds = clouds_of(daemon, 3)
    ended(daemon, create(daemon, clouds[:1]))  # whose outputs serve one of the batch
    before = len(daemon.curl("/v1/jobs").json["jobs"])
    assert daemon.stop() == 0
    daemon.start("--fault", f"{point}=kill:1")
    body = json.dumps({"clouds": clouds, "webhook": receiver.url}).encode()
    with socket.create_connection(("127.0.0.1", daemon.port)) as client:
        client.sendall(b"POST /v1/batches HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
                       b"Content-Length: %d\r\n\r\n" % len(body) + body)
        daemon.process.wait(PATIENCE_S)
    daemon.start()
    if made:
        batch = daemon.curl("/v1/batches").json["batches"][0]
        assert ended(daemon, batch)["counts"]["successful"] == 3
        wait_until(lambda: receiver.taken, "the webhook")
    assert len(daemon.curl("/v1/jobs").json["jobs"]) == before + 3 * made
    assert len(daemon.curl("/v1/batches").json["batches"]) == 1 + made
    assert daemon.stop() == 0 and daemon.check()[0] == 0


# ------------------------------------------------------------------------------------------------ crashes of DELETE

def delete_and_fall(daemon, batch):
    """DELETE of the batch by a service that may end within; its status, None where it ended before it answered."""
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=PATIENCE_S) as client:
        client.sendall(b"DELETE /v1/batches/%s HTTP/1.1\r\nHost: localhost\r\n\r\n" % batch["id"].encode())
        try:
            head = client.recv(64)
        except ConnectionResetError:
            head = b""
    return int(head.split()[1]) if head else None


@pytest.mark.parametrize("point", ["delete-committed=kill:1", "delete-committed=kill:2", "delete-committed=kill:3",
                                   "remove-rename=kill:1", "removed=kill:2", "commit=kill:2", "commit=kill:3",
                                   "commit=kill:4"])  # the first commit is that of the start
def test_a_deletion_that_a_crash_cuts_short_is_gone_on_with(make_daemon, point):
    daemon = make_daemon()
    clouds = clouds_of(daemon, 3)
    batch = ended(daemon, create(daemon, clouds))
    other = ended(daemon, create(daemon, clouds[:1]))  # of the same bytes, and not deleted
    assert daemon.stop() == 0
    daemon.start("--fault", point)
    assert delete_and_fall(daemon, batch) is None
    daemon.process.wait(PATIENCE_S)
    daemon.start()
    left = read(daemon, batch)
    if left.status == 200:  # what is left is whole, and the next DELETE ends it
        assert left.json["counts"]["deleted"] + len(left.json["jobs"]) == 3
        for job in left.json["jobs"]:
            assert daemon.curl(job["href"] + "/outputs/cloud.ply").status == 200
        assert daemon.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE").status == 200
    assert read(daemon, batch).slug == "no-such-batch"
    assert {daemon.curl(job["href"]).status for job in batch["jobs"]} == {410}
    assert daemon.curl(other["jobs"][0]["href"] + "/outputs/cloud.ply").status == 200
    assert daemon.stop() == 0 and daemon.check()[0] == 0
    assert daemon.kept("jobs") == [other["jobs"][0]["id"]] and "has lost its outputs" not in daemon.log_text()


def start_and_fall(daemon, batch, fault):
    """DELETE of the batch by a service that this fault ends, be it that it ends at its start already."""
    try:
        daemon.start("--fault", fault)
        delete_and_fall(daemon, batch)
    except (AssertionError, ConnectionRefusedError):
        pass
    if daemon.process.poll() is None:
        daemon.kill()
    daemon.process.wait(PATIENCE_S)


@pytest.mark.parametrize("commit", range(1, 9))
def test_a_dismissal_that_a_crash_cuts_short_loses_no_job_and_no_webhook(hooked, receive, gated, commit):
    receiver = receive(200)
    gate, flags = gated
    gate.touch()
    daemon = hooked(*flags)
    batch = create(daemon, clouds_of(daemon, 4), webhook=receiver.url)
    daemon.wait_for(batch["jobs"][0]["id"], "running")
    daemon.kill()
    start_and_fall(daemon, batch, f"commit=kill:{commit}")
    daemon.start()
    jobs = {job["id"]: job["status"] for job in read(daemon, batch).json["jobs"]}
    assert len(jobs) == 4 and set(jobs.values()) <= {"accepted", "running", "dismissed"}
    assert daemon.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE").status == 200
    if "dismissed" not in jobs.values() or len(set(jobs.values())) > 1:
        assert read(daemon, batch).json["status"] == "dismissed"
    wait_until(lambda: receiver.taken, "the webhook")
    assert json.loads(receiver.taken[0][1])["data"]["counts"]["dismissed"] == 4
