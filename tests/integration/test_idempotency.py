# SPDX-License-Identifier: GPL-3.0-or-later
"""A request that is sent again under the same Idempotency-Key isn't done again."""
import concurrent.futures
import http.client
import subprocess

import pytest

from conftest import SMALL, sphere, wait_until


def keyed(key):
    return "-H", f"Idempotency-Key: {key}"


def jobs_of(daemon):
    return [job["id"] for job in daemon.curl("/v1/jobs").json["jobs"]]


def test_the_first_reply_is_given_again_also_after_a_restart(daemon):
    first = daemon.post("/v1/jobs?ratio=0.5&label=x", SMALL, *keyed("k-1"))
    daemon.ended(first.json["id"])
    again = daemon.post("/v1/jobs?label=x&ratio=0.5", SMALL, *keyed("k-1"))
    assert again.status == 201 and again.body == first.body
    assert again.headers["location"] == first.headers["location"] and again.headers["etag"] == first.headers["etag"]
    daemon.kill()
    daemon.start()
    assert daemon.post("/v1/jobs?ratio=0.5&label=x", SMALL, *keyed("k-1")).body == first.body
    assert len(jobs_of(daemon)) == 1 and daemon.leftovers() == []
    assert daemon.post("/v1/jobs?ratio=0.5&label=x", SMALL, *keyed("k-2")).json["id"] != first.json["id"]
    assert daemon.post("/v1/jobs?ratio=0.5&label=x", SMALL).json["id"] != first.json["id"]


@pytest.mark.parametrize("path, data", [("/v1/jobs?ratio=0.4", SMALL), ("/v1/jobs?ratio=0.5", sphere(299)),
                                        ("/v1/jobs?ratio=0.5&label=y", SMALL), ("/v1/simplify?ratio=0.5", SMALL),
                                        ("/v1/jobs?ratio=0.5&priority=1", SMALL)])
def test_another_request_under_the_same_key_is_refused(daemon, path, data):
    assert daemon.post("/v1/jobs?ratio=0.5", SMALL, *keyed("k")).status == 201
    other = daemon.post(path, data, *keyed("k"))
    assert (other.status, other.slug) == (422, "idempotency-key-reused")
    assert len(jobs_of(daemon)) == 1


def test_fifty_at_once_make_one_job(daemon):
    def post(_):
        return daemon.post("/v1/jobs?ratio=0.5", SMALL, *keyed("same"))
    with concurrent.futures.ThreadPoolExecutor(50) as pool:
        replies = list(pool.map(post, range(50)))
    created = [reply for reply in replies if reply.status == 201]
    assert created and len({reply.body for reply in created}) == 1
    for reply in replies:
        if reply.status != 201:
            assert (reply.status, reply.slug) == (409, "idempotency-in-progress") and reply.headers["retry-after"]
    assert jobs_of(daemon) == [created[0].json["id"]]


def test_a_key_under_way_is_free_again_when_its_client_leaves(daemon):
    connection = http.client.HTTPConnection("127.0.0.1", daemon.port)
    connection.putrequest("POST", "/v1/jobs?ratio=0.5")
    connection.putheader("Content-Length", str(len(SMALL)))
    connection.putheader("Idempotency-Key", "k")
    connection.endheaders(SMALL[:100])
    def refused():
        reply = daemon.post("/v1/jobs?ratio=0.5", SMALL, *keyed("k"))
        return reply if reply.status == 409 else None
    assert wait_until(refused, "the first request").slug == "idempotency-in-progress"
    connection.close()
    wait_until(lambda: daemon.post("/v1/jobs?ratio=0.5", SMALL, *keyed("k")).status == 201, "the key's release")


def test_a_refused_request_leaves_its_key_free(daemon):
    assert daemon.post("/v1/jobs?ratio=5", SMALL, *keyed("k")).status == 400
    refused = daemon.post("/v1/jobs?ratio=0.5", b"", *keyed("k"))
    assert (refused.status, refused.slug) == (422, "malformed-cloud")
    assert daemon.post("/v1/jobs?ratio=0.5", SMALL, *keyed("k")).status == 201
    assert daemon.post("/v1/jobs?ratio=0.5", b"\x89PNG\r\n\x1a\n" + bytes(100), *keyed("k2")).status == 415
    assert daemon.post("/v1/jobs?ratio=0.5", SMALL, *keyed("k2")).status == 201


def test_a_key_is_free_once_its_answer_is_there(daemon):
    both = [http.client.HTTPConnection("127.0.0.1", daemon.port) for _ in range(2)]
    for i in range(100):
        answers = [daemon.request("POST", "/v1/clouds", SMALL, {"Idempotency-Key": f"k{i}"}, one) for one in both]
        assert [status for status, _, _ in answers] == [200 if i else 201] * 2
        assert answers[0][2] == answers[1][2]


def test_a_one_shot_that_timed_out_is_taken_up_again(make_daemon):
    daemon = make_daemon("--sync-max", "10m")
    cloud = sphere(60000)
    late = daemon.post("/v1/simplify?ratio=0.1", cloud, *keyed("k"), "-H", "Prefer: wait=0")
    assert late.status == 504
    done = daemon.post("/v1/simplify?ratio=0.1", cloud, *keyed("k"))
    assert done.status == 200 and late.headers["location"] in done.headers["link"]
    again = daemon.post("/v1/simplify?ratio=0.1", cloud, *keyed("k"))
    assert again.body == done.body and again.headers["link"] == done.headers["link"]
    assert len(jobs_of(daemon)) == 1
    daemon.curl(late.headers["location"], "-X", "DELETE")
    assert daemon.post("/v1/simplify?ratio=0.1", cloud, *keyed("k")).slug == "job-gone"


@pytest.mark.parametrize("key", ["", "two words", "x" * 256, "tab\there", "\x7f"])
def test_a_malformed_key_is_refused(daemon, key):
    reply = daemon.post("/v1/jobs", SMALL, "-H", f"Idempotency-Key: {key}" if key else "Idempotency-Key;")
    assert (reply.status, reply.slug) == (400, "malformed-request")
    twice = daemon.post("/v1/jobs", SMALL, *keyed("a"), *keyed("b"))
    assert twice.status == 400


def test_keys_are_forgotten_after_their_time(make_daemon):
    daemon = make_daemon("--idempotency-retention", "1ms", "--retention", "100ms")
    first = daemon.post("/v1/jobs?ratio=0.5", SMALL, *keyed("k")).json["id"]
    wait_until(lambda: daemon.post("/v1/jobs?ratio=0.5", SMALL, *keyed("k")).json["id"] != first, "forgetting")


def test_a_key_on_other_operations_means_nothing(daemon):
    assert daemon.curl("/v1/jobs", *keyed("two words")).status == 200
    done = subprocess.run(["curl", "-sf", "-X", "DELETE", *keyed("k"), f"{daemon.url}/v1/jobs/x"], check=False)
    assert done.returncode == 22


def test_clouds_have_keys_too(daemon):
    first = daemon.post("/v1/clouds", SMALL, *keyed("c"))
    again = daemon.post("/v1/clouds", SMALL, *keyed("c"))
    assert first.status == again.status == 201 and first.body == again.body
    assert first.headers["location"] == again.headers["location"]
    assert daemon.post("/v1/clouds", SMALL).status == 200
    assert daemon.post("/v1/clouds", sphere(200), *keyed("c")).slug == "idempotency-key-reused"
    assert daemon.post("/v1/jobs", SMALL, *keyed("c")).slug == "idempotency-key-reused"


def test_a_form_with_another_boundary_is_the_same_request(daemon, tmp_path):
    source = tmp_path / "ball.xyz"
    source.write_bytes(SMALL)
    first, again = (daemon.curl("/v1/jobs?ratio=0.5", "-F", f"file=@{source}", *keyed("f")) for _ in range(2))
    assert first.status == again.status == 201 and first.body == again.body
    cloud = daemon.post("/v1/clouds", SMALL).headers["location"]
    by_name = daemon.post("/v1/jobs", f'{{"input":"{cloud}","params":{{"ratio":0.5}}}}'.encode(), *keyed("f"), "-H",
                          "Content-Type: application/json")
    assert by_name.body == first.body  # the same job, asked for in another way
