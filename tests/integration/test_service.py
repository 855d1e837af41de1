# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job over HTTP: submit, follow, read, delete."""
import base64
import hashlib
import json
import subprocess
import threading

import pytest

from conftest import SMALL, process_lives, sphere, wait_until


def test_a_job_from_cloud_to_outputs(daemon):
    created = daemon.post("/v1/jobs?ratio=0.5&outputs=cloud,xyz,mesh&label=a%20ball", SMALL)
    assert created.status == 201
    location = created.headers["location"]
    assert location == f"/v1/jobs/{created.json['id']}"
    assert created.json["status"] in ("accepted", "running") and created.json["label"] == "a ball"
    assert created.json["params"]["ratio"] == 0.5
    assert created.json["params"]["outputs"] == ["cloud", "xyz", "mesh", "report"]

    job = daemon.ended(created.json["id"])
    assert job["status"] == "successful" and job["progress"] == 100 and job["problem"] is None
    assert job["report"]["points_in"] == 300 and job["report"]["points_out"] == 150
    assert job["report"]["mesh"]["watertight"] is True
    assert job["resources"]["peak_rss_bytes"] > 0
    sha256 = hashlib.sha256(SMALL).hexdigest()
    assert job["input"] == {"cloud": f"/v1/clouds/{sha256}", "sha256": sha256, "points": 300, "bytes": len(SMALL),
                            "format": "xyz"}
    assert job["created"] <= job["started"] <= job["finished"] < job["expires"]

    outputs = daemon.curl(f"{location}/outputs").json["outputs"]
    assert [o["name"] for o in outputs] == ["cloud.ply", "cloud.xyz", "mesh.ply", "report.json"]
    for output in outputs:
        body = daemon.curl(output["href"]).body
        assert len(body) == output["bytes"]
        assert hashlib.sha256(body).hexdigest() == output["sha256"]
    assert len(daemon.curl(f"{location}/outputs/cloud.xyz").body.splitlines()) >= 150
    assert daemon.leftovers() == []


POINTS = (b"ply\nformat ascii 1.0\nelement vertex 300\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
          + SMALL)


@pytest.mark.parametrize("query, points", [("?ratio=0.105", 31), ("?ratio=0.001", 1), ("", 30), ("?points=7", 7),
                                           ("?ratio=0.1&max_error=0.01", None), ("?levels=0.5,0.1", None)])
def test_parameters_are_those_that_run_before_the_end_and_after(make_daemon, query, points):
    daemon = make_daemon("--workers", "1", "--threads-per-job", "2")
    created = daemon.post(f"/v1/jobs{query}", POINTS).json
    assert not created["report"] and created["params"]["threads"] == 2 and created["params"].get("points") == points
    job = daemon.ended(created["id"])
    assert job["params"] == created["params"] and job["report"]["params"]["threads"] == 2
    assert points in (None, job["report"]["points_out"])


def test_a_job_writes_as_many_files_as_one_may_and_no_more(daemon):
    levels = ",".join(f"{0.9 - 0.06 * i:.2f}" for i in range(14))
    job = daemon.ended(daemon.submit(POINTS, f"?outputs=cloud,xyz,pcd,las&levels={levels}"))
    assert job["status"] == "successful"
    assert len(daemon.curl(f"/v1/jobs/{job['id']}/outputs").json["outputs"]) == 61
    assert daemon.curl(f"/v1/jobs/{job['id']}/outputs/cloud_0.3.xyz").body.count(b"\n") == 90
    for query in (f"outputs=cloud,xyz,pcd,las&levels={levels},0.1",  # with the report that each job writes
                  f"outputs=cloud,xyz,pcd,las,laz&levels={levels}"):
        refused = daemon.post(f"/v1/jobs?{query}", POINTS)
        assert refused.status == 400 and "files with all levels, at most 64 are written" in refused.json["detail"]


def test_points_of_a_text_are_known_once_they_are_counted(make_daemon):
    daemon = make_daemon("--threads-per-job", "2")
    created = daemon.post("/v1/jobs?ratio=0.5&threads=1", SMALL + SMALL[:SMALL.index(b"\n") + 1] * 300).json
    assert created["params"]["threads"] == 1 and "points" not in created["params"]
    job = daemon.ended(created["id"])
    assert job["params"]["points"] == job["report"]["points_out"] == 300  # of 300 distinct ones among 600


def test_one_shot_answers_bytes_and_numbers(daemon):
    reply = daemon.post("/v1/simplify?ratio=0.1", SMALL)
    assert reply.status == 200 and reply.body.startswith(b"ply\n")
    assert "points-in=300, points-out=30" in reply.headers["job-stats"]
    assert "total;dur=" in reply.headers["server-timing"]
    job = reply.headers["link"].split(">")[0].lstrip("<")
    assert daemon.curl(job).json["status"] == "successful"
    report = daemon.post("/v1/simplify?ratio=0.1&output=report", SMALL)
    assert report.json["points_out"] == 30
    mesh = daemon.post("/v1/simplify?points=100&output=mesh", SMALL)
    assert b"element face" in mesh.body[:1000] and "triangles=" in mesh.headers["job-stats"]


def test_one_shot_is_the_same_as_the_command_line(daemon, tmp_path):
    source = tmp_path / "ball.xyz"
    source.write_bytes(SMALL)
    whittle = daemon.process.args[0].parent / "whittle"
    subprocess.run([whittle, source, "--ratio", "0.2", "--outputs", "cloud", "-q", "-o", tmp_path], check=True)
    assert daemon.post("/v1/simplify?ratio=0.2", SMALL).body == (tmp_path / "cloud.ply").read_bytes()


def test_one_shot_goes_on_as_a_job_when_asked(daemon):
    reply = daemon.post("/v1/simplify?ratio=0.1", SMALL, "-H", "Prefer: respond-async")
    assert reply.status == 202
    assert daemon.ended(reply.headers["location"].rsplit("/", 1)[1])["status"] == "successful"


def test_one_shot_that_takes_too_long_names_its_job(daemon, large):
    reply = daemon.post("/v1/simplify?ratio=0.1", large, "-H", "Prefer: wait=0")
    assert reply.status == 504 and reply.slug == "sync-timeout"
    job_id = reply.headers["location"].rsplit("/", 1)[1]
    assert reply.json["job"] == job_id
    assert daemon.ended(job_id)["status"] == "successful"


def test_one_shot_of_a_bad_cloud_answers_its_problem(daemon):
    reply = daemon.post("/v1/simplify", b"0 0 0\n1 1 1\nnot a point\n")
    assert (reply.status, reply.slug) == (422, "malformed-cloud")
    assert reply.json["line"] == 3
    flat = "".join(f"{i % 5} {i // 5} 0\n" for i in range(25)).encode()
    reply = daemon.post("/v1/simplify?output=mesh&ratio=1&surface=closed", flat)
    assert (reply.status, reply.slug) == (422, "degenerate-cloud")


def test_a_chunked_body_is_the_same_cloud(daemon):
    plain = daemon.post("/v1/simplify?ratio=0.3", SMALL)
    chunked = daemon.post("/v1/simplify?ratio=0.3", SMALL, "-H", "Transfer-Encoding: chunked")
    assert chunked.status == 200 and chunked.body == plain.body


def test_upload_as_in_the_readme(daemon, tmp_path):
    source = tmp_path / "in.ply"
    source.write_bytes(daemon.post("/v1/simplify?ratio=1", SMALL).body)
    out = tmp_path / "out.ply"
    subprocess.run(["curl", "-fsS", "-X", "POST", "-T", source, f"{daemon.url}/v1/simplify?ratio=0.1", "-o", out],
                   check=True)
    assert b"element vertex 30\n" in out.read_bytes()


# ---------------------------------------------------------------------------------------------- following a job

def events_of(text):
    events = []
    for block in text.split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
        if "event" in fields:
            events.append((fields["event"], int(fields["id"]), json.loads(fields["data"])))
    return events


def test_events_tell_the_whole_story(daemon, large):
    job_id = daemon.submit(large, "?ratio=0.1")
    stream = daemon.curl(f"/v1/jobs/{job_id}/events", "-N")
    assert stream.headers["content-type"] == "text/event-stream"
    events = events_of(stream.body.decode())
    names = [name for name, _, _ in events]
    assert names[0] == "status" and names[-1] == "end" and names[-2] == "output"
    assert "progress" in names
    ids = [number for _, number, _ in events]
    assert ids == sorted(ids)
    progress = [data["progress"] for name, _, data in events if name == "progress"]
    assert progress == sorted(progress)
    assert events[-1][2]["status"] == "successful"


def test_events_of_an_ended_job_end_at_once(daemon):
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    names = [name for name, _, _ in events_of(daemon.curl(f"/v1/jobs/{job_id}/events").body.decode())]
    assert names[0] == "status" and names[-1] == "end"


def test_events_resume_where_the_client_was(daemon, large):
    job_id = daemon.submit(large, "?ratio=0.1")
    path = f"/v1/jobs/{job_id}/events"
    first = subprocess.Popen(daemon.curl_command(path, "-N"), stdout=subprocess.PIPE, text=True)
    seen = next(line for line in first.stdout if line.startswith("id: ")).split()[1]
    first.kill()
    first.communicate()
    daemon.ended(job_id)
    events = events_of(daemon.curl(path, "-H", f"Last-Event-ID: {seen}").body.decode())
    assert [name for name, _, _ in events] == ["status", "output", "output", "end"]
    assert events[0][1] > int(seen) and events[0][2]["status"] == "successful"
    over = daemon.curl(path, "-H", f"Last-Event-ID: {events[-1][1]}")
    assert over.status == 204 and over.body == b""  # an EventSource doesn't come again


def test_long_poll_answers_when_the_job_has_changed(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    running = daemon.submit(large)
    waiting = daemon.submit(SMALL)
    etag = daemon.curl(f"/v1/jobs/{waiting}").headers["etag"]
    assert daemon.curl(f"/v1/jobs/{waiting}", "-H", f"If-None-Match: {etag}").status == 304
    late = daemon.curl(f"/v1/jobs/{waiting}", "-H", f"If-None-Match: {etag}", "-H", "Prefer: wait=0")
    assert late.status == 304
    poll = subprocess.Popen(daemon.curl_command(f"/v1/jobs/{waiting}", "-H", f"If-None-Match: {etag}", "-H",
                                                "Prefer: wait=50"), stdout=subprocess.PIPE)
    daemon.curl(f"/v1/jobs/{waiting}", "-X", "DELETE")
    output, _ = poll.communicate(timeout=50)
    assert b'"status":"dismissed"' in output
    assert daemon.ended(running)["status"] == "successful"


def test_a_long_poll_whose_client_leaves_is_let_go(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    daemon.submit(large)
    waiting = daemon.submit(SMALL)
    poll = subprocess.Popen(daemon.curl_command(f"/v1/jobs/{waiting}", "-H", "Prefer: wait=50"),
                            stdout=subprocess.PIPE)
    fds = f"/proc/{daemon.process.pid}/fd"
    def sockets():
        links = subprocess.run(["ls", "-l", fds], capture_output=True, text=True, check=False).stdout
        return links.count("socket:")
    listening = 2  # for clients, and for health and metrics
    wait_until(lambda: sockets() > listening, "the poll's connection")
    poll.kill()
    poll.wait()
    wait_until(lambda: sockets() == listening, "the end of the poll's connection")


# ---------------------------------------------------------------------------------------------- deleting

def test_delete_of_a_waiting_job_dismisses_it(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    first = daemon.submit(large)
    waiting = daemon.submit(SMALL)
    assert daemon.curl(f"/v1/jobs/{waiting}", "-X", "DELETE").json["status"] == "dismissed"
    assert daemon.ended(first)["status"] == "successful"
    assert daemon.job(waiting)["attempt"] == 0


def test_delete_of_a_running_job_ends_its_process(daemon, large):
    job_id = daemon.submit(large)
    pid = daemon.worker_pid(job_id)
    reply = daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE")
    assert reply.status == 200 and reply.json["status"] == "dismissed"
    assert not process_lives(pid)
    assert daemon.curl(f"/v1/jobs/{job_id}/outputs").slug == "no-such-output"
    assert daemon.leftovers() == []


def test_delete_of_an_ended_job_leaves_a_tombstone(daemon):
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").json["status"] == "successful"
    for path in ("", "/outputs", "/outputs/cloud.ply", "/log", "/events"):
        gone = daemon.curl(f"/v1/jobs/{job_id}{path}")
        assert (gone.status, gone.slug) == (410, "job-gone")
        assert gone.json["reason"] == "deleted" and gone.json["at"].endswith("Z")
    assert daemon.kept("jobs") == daemon.kept("clouds") == []


def test_a_cloud_stays_as_long_as_one_job_refers_to_it(daemon):
    first, second = daemon.submit(SMALL), daemon.submit(SMALL)
    for job_id in (first, second):
        daemon.ended(job_id)
    assert len(daemon.kept("clouds")) == 1
    daemon.curl(f"/v1/jobs/{first}", "-X", "DELETE")
    assert len(daemon.kept("clouds")) == 1
    daemon.curl(f"/v1/jobs/{second}", "-X", "DELETE")
    assert daemon.kept("clouds") == []


def test_ended_jobs_expire(make_daemon):
    daemon = make_daemon("--retention", "200ms")
    job_id = daemon.submit(SMALL)
    def gone():
        reply = daemon.curl(f"/v1/jobs/{job_id}")
        return reply if reply.status == 410 else None
    assert wait_until(gone, "expiry").json["reason"] == "expired"


# ---------------------------------------------------------------------------------------------- outputs

@pytest.fixture(name="output")
def make_output(daemon):
    """Path of an output, and its bytes."""
    job_id = daemon.submit(SMALL, "?ratio=0.5")
    daemon.ended(job_id)
    path = f"/v1/jobs/{job_id}/outputs/cloud.ply"
    return path, daemon.curl(path).body


def test_output_headers(daemon, output):
    path, body = output
    reply = daemon.curl(path)
    digest = hashlib.sha256(body)
    assert reply.headers["etag"] == f'"{digest.hexdigest()}"'
    assert reply.headers["repr-digest"] == f"sha-256=:{base64.b64encode(digest.digest()).decode()}:"
    assert reply.headers["accept-ranges"] == "bytes"
    assert reply.headers["content-disposition"] == 'attachment; filename="cloud.ply"'
    assert "immutable" in reply.headers["cache-control"]
    assert int(reply.headers["content-length"]) == len(body)
    head = daemon.curl(path, "-I", "-o", "/dev/null")
    assert head.status == 200 and head.body == b"" and head.headers["etag"] == reply.headers["etag"]
    assert head.headers["content-length"] == reply.headers["content-length"]
    for tag in (reply.headers["etag"], f'"x", W/{reply.headers["etag"]}', "*"):
        assert daemon.curl(path, "-H", f"If-None-Match: {tag}").status == 304
    assert daemon.curl(path, "-H", 'If-None-Match: "x"').status == 200


@pytest.mark.parametrize("spec, first, last", [("0-0", 0, 0), ("10-19", 10, 19), ("100-", 100, None), ("-7", -7, None),
                                               ("5-99999999", 5, None), ("-99999999", 0, None)])
def test_one_range(daemon, output, spec, first, last):
    path, body = output
    reply = daemon.curl(path, "-H", f"Range: bytes={spec}")
    begin = first if first >= 0 else len(body) + first
    end = len(body) - 1 if last is None else last
    assert reply.status == 206
    assert reply.headers["content-range"] == f"bytes {begin}-{end}/{len(body)}"
    assert reply.body == body[begin:end + 1]


@pytest.mark.parametrize("spec", ["bytes=99999999-", "bytes=-0"])
def test_a_range_outside_is_refused(daemon, output, spec):
    path, body = output
    reply = daemon.curl(path, "-H", f"Range: {spec}")
    assert (reply.status, reply.slug) == (416, "range-not-satisfiable")
    assert reply.headers["content-range"] == f"bytes */{len(body)}"


@pytest.mark.parametrize("spec", ["bytes=0-1,5-6", "lines=1-2", "bytes=5-2", "bytes=x", "bytes=--1",
                                  "bytes=99999999999999999999-"])
def test_what_is_no_single_range_means_the_whole(daemon, output, spec):
    path, body = output
    reply = daemon.curl(path, "-H", f"Range: {spec}")
    assert reply.status == 200 and reply.body == body


def test_if_range(daemon, output):
    path, body = output
    etag = daemon.curl(path).headers["etag"]
    assert daemon.curl(path, "-H", "Range: bytes=0-3", "-H", f"If-Range: {etag}").body == body[:4]
    assert daemon.curl(path, "-H", "Range: bytes=0-3", "-H", 'If-Range: "other"').body == body


def test_outputs_of_a_job_that_has_not_ended(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    daemon.submit(large)
    reply = daemon.curl(f"/v1/jobs/{daemon.submit(SMALL)}/outputs/cloud.ply")
    assert (reply.status, reply.slug) == (409, "result-not-ready") and reply.headers["retry-after"] == "1"


def test_the_file_name_is_made_of_the_label(daemon):
    job_id = daemon.submit(SMALL, '?label=../%22horse%22%0d%0a%2010%20%25')
    daemon.ended(job_id)
    reply = daemon.curl(f"/v1/jobs/{job_id}/outputs/cloud.ply")
    assert reply.headers["content-disposition"] == 'attachment; filename="horse-10-cloud.ply"'


# ---------------------------------------------------------------------------------------------- listing

def test_list_pages_and_filters(daemon):
    ids = [daemon.submit(SMALL, f"?label={label}") for label in ("a", "b", "a", "b", "a")]
    for job_id in ids:
        daemon.ended(job_id)
    everything = daemon.curl("/v1/jobs").json["jobs"]
    assert [job["id"] for job in everything] == ids[::-1]
    seen, path = [], "/v1/jobs?limit=2"
    while path:
        page = daemon.curl(path)
        seen += [job["id"] for job in page.json["jobs"]]
        link = page.headers.get("link", "")
        path = link.split(">")[0].lstrip("<") if 'rel="next"' in link else None
    assert seen == ids[::-1]
    assert [job["id"] for job in daemon.curl("/v1/jobs?label=b").json["jobs"]] == [ids[3], ids[1]]
    assert len(daemon.curl("/v1/jobs?status=successful").json["jobs"]) == 5
    assert daemon.curl("/v1/jobs?status=failed").json["jobs"] == []


def test_jobs_at_the_same_time(make_daemon):
    daemon = make_daemon("--workers", "2")
    clouds = [sphere(200 + i) for i in range(12)]
    replies = [None] * len(clouds)

    def one(i):
        replies[i] = daemon.post("/v1/simplify?points=50", clouds[i])
    threads = [threading.Thread(target=one, args=(i,)) for i in range(len(clouds))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i, reply in enumerate(replies):
        assert reply.status == 200, reply.body
        assert f"points-in={200 + i}, points-out=50" in reply.headers["job-stats"]
    assert daemon.leftovers() == []


def test_the_log_tells_of_the_attempt(daemon):
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    reply = daemon.curl(f"/v1/jobs/{job_id}/log")
    assert reply.headers["content-type"].startswith("text/plain")
    assert b"attempt 1 begins" in reply.body and b"successful" in reply.body
    assert daemon.curl(f"/v1/jobs/{job_id}/log", "-H", "Range: bytes=0-6").body == b"attempt"
