# SPDX-License-Identifier: GPL-3.0-or-later
"""Several hosts that share one catalog, in PostgreSQL, and one blob store: any of them answers for any job, and each may
die."""
import concurrent.futures
import contextlib
import hashlib
import itertools
import json
import os
import pathlib
import re
import signal
import socket
import sqlite3
import subprocess
import threading
import urllib.parse

import pytest

from conftest import BUILD, PATIENCE_S, SMALL, process_lives, sphere, wait_until
from test_webhooks import SECRET, Receiver

ROOT = pathlib.Path(__file__).parents[2]

PROGRAMS = pathlib.Path("/usr/lib/postgresql/15/bin")
names = itertools.count()


@pytest.fixture(name="server", scope="module")
def make_server():
    """A PostgreSQL server of this module's own; the socket's folder."""
    if not (PROGRAMS / "initdb").exists():
        pytest.skip("PostgreSQL 15 isn't installed")
    with subprocess.Popen([ROOT / "tests/tools/with_postgres.sh", "sh", "-c", "echo $WHITTLE_CATALOG; cat"],
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        url = process.stdout.readline().strip()
        assert "host=" in url, url
        yield url.split("host=")[1]
        process.stdin.close()


@pytest.fixture(name="shared", params=["file", "s3"])
def make_shared(server, tmp_path, request):
    """Flags of hosts that share a catalog and a blob store, both empty."""
    blobs = f"file:{tmp_path / 'blobs'}"
    if request.param == "s3":
        if "WHITTLE_BLOBS" not in os.environ:
            pytest.skip("WHITTLE_BLOBS names no S3 store")
        bucket, query = os.environ["WHITTLE_BLOBS"].split("?")
        blobs = f"{bucket}/{os.getpid()}-{next(names)}?{query}"
    name = f"hosts{next(names)}"
    subprocess.run([PROGRAMS / "createdb", "-h", server, "-U", "whittle", name], check=True)
    url = f"postgresql://whittle@/{name}?host={server}"
    subprocess.run([BUILD / "whittled", "migrate", "--catalog", url], check=True)
    return ["--catalog", url, "--blobs", blobs, "--lease", "500ms"]


@pytest.fixture(name="gate")
def make_gate(tmp_path):
    """Flags of a host whose jobs begin their work when the gate, a file, is removed."""
    gate, worker = tmp_path / "gate", tmp_path / "worker"
    gate.touch()
    worker.write_text(f'#!/bin/sh\nwhile [ -e "{gate}" ]; do sleep 0.02; done\nexec "{BUILD / "whittle"}" "$@"\n')
    worker.chmod(0o755)
    yield gate, ["--worker", worker, "--worker-sandbox=off", "--workers", "1"]
    gate.unlink(missing_ok=True)


def content(daemon, job, name="cloud.ply"):
    reply = daemon.curl(f"/v1/jobs/{job}/outputs/{name}")
    assert reply.status == 200
    return reply.body


def test_a_job_is_run_by_another_host_than_took_it(make_daemon, shared):
    front, back = make_daemon(*shared, "--roles", "http"), make_daemon(*shared)
    job = front.submit(SMALL)
    assert front.ended(job)["status"] == "successful"
    assert f"job={job} running -> successful" in back.log_text() and "running" not in front.log_text()
    assert content(front, job) == content(back, job)
    log = front.curl(f"/v1/jobs/{job}/log")
    assert log.status == 200 and b"attempt 1: successful" in log.body and log.body == back.curl(f"/v1/jobs/{job}/log").body
    assert [j["id"] for j in back.curl("/v1/jobs").json["jobs"]] == [job]
    again = back.submit(SMALL)  # the result of the first
    assert front.job(again)["status"] == "successful" and content(front, again) == content(front, job)
    assert front.curl(f"/v1/jobs/{job}", "-X", "DELETE").status == 200
    assert back.curl(f"/v1/jobs/{job}").status == 410 and content(back, again)
    assert front.stop() == 0 and back.stop() == 0


def test_a_host_that_is_killed_loses_its_lease_and_the_job_runs_again(make_daemon, shared, gate):
    gate, gated = gate
    front, back = make_daemon(*shared, "--roles", "http"), make_daemon(*shared, *gated)
    job = front.submit(SMALL)
    front.wait_for(job, "running")
    back.kill()
    other = make_daemon(*shared)  # which has its own folder
    ended = front.ended(job)
    assert ended["status"] == "successful" and ended["attempt"] == 2
    assert f"job={job} running -> successful attempt=2" in other.log_text()
    assert b"attempt 2: successful" in front.curl(f"/v1/jobs/{job}/log").body
    gate.unlink()
    back.start()  # it comes back, and finds nothing to mend of what others have done
    assert back.job(job)["status"] == "successful" and content(back, job) == content(front, job)


@pytest.mark.parametrize("shared", ["file"], indirect=True)
def test_outputs_that_a_dying_host_left_are_nobody_s(make_daemon, shared, tmp_path):
    """It dies when they are kept and the end isn't recorded: whoever queues the job again removes them."""
    front, back = make_daemon(*shared, "--roles", "http"), make_daemon(*shared, "--fault", "outputs-kept=kill:1")
    job = front.submit(SMALL)
    back.process.wait(PATIENCE_S)
    folder = tmp_path / "blobs" / "jobs" / job
    assert (folder / "outputs").is_dir()
    wait_until(lambda: not (folder / "outputs").exists(), "the sweep of the host that is left")
    assert front.job(job)["status"] == "accepted"
    other = make_daemon(*shared)
    assert front.ended(job)["attempt"] == 2 and content(front, job) == content(other, job)
    assert sorted(path.name for path in folder.glob("outputs*")) == ["outputs.2"]


def test_what_is_deleted_at_another_host_ends_where_it_runs(make_daemon, shared, gate):
    _, gated = gate
    front, back = make_daemon(*shared, "--roles", "http"), make_daemon(*shared, *gated)
    job = front.submit(SMALL)
    front.wait_for(job, "running")
    pid = back.worker_pid(job)
    assert front.curl(f"/v1/jobs/{job}", "-X", "DELETE").status in (200, 202)
    assert front.ended(job)["status"] == "dismissed"
    wait_until(lambda: not process_lives(pid), "the end of its process")
    assert back.leftovers() == []


def test_a_start_takes_nothing_of_other_hosts(make_daemon, shared, gate):
    """Jobs that run elsewhere, clouds that are kept elsewhere, a folder that is new."""
    gate, gated = gate
    first = make_daemon(*shared, *gated)
    job = first.submit(SMALL)
    first.wait_for(job, "running")
    second = make_daemon(*shared, "--roles", "http")
    assert second.job(job)["status"] == "running"
    gate.unlink()
    assert second.ended(job)["attempt"] == 1 and content(second, job)
    assert "set_aside=0" in second.log_text()


def test_each_webhook_is_delivered_by_one_host(make_daemon, shared, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text(SECRET + "\n")
    secret.chmod(0o600)
    hooks = ["--webhooks", "--webhook-secret-file", secret, "--webhook-allow", "127.0.0.1", "--result-cache=0"]
    receiver = Receiver(204)
    hosts = [make_daemon(*shared, *hooks) for _ in range(2)]
    jobs = [hosts[n % 2].submit(SMALL, f"?webhook={receiver.url}") for n in range(8)]
    ids = set(jobs)
    wait_until(lambda: {taken[0]["webhook-id"] for taken in receiver.taken} == ids, "every webhook")
    for host in hosts:
        assert host.stop() == 0
    assert len(receiver.taken) == len(ids)


def test_the_webhook_of_a_batch_is_delivered_once_whoever_ends_the_last_job(make_daemon, shared, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text(SECRET + "\n")
    secret.chmod(0o600)
    hooks = ["--webhooks", "--webhook-secret-file", secret, "--webhook-allow", "127.0.0.1", "--result-cache=0"]
    receiver = Receiver(204)
    hosts = [make_daemon(*shared, *hooks, "--workers", "2") for _ in range(2)]
    clouds = ["/v1/clouds/" + hosts[0].post("/v1/clouds", SMALL + b"# %d\n" % n).json["id"] for n in range(4)]
    ids = set()
    for n in range(4):
        document = json.dumps({"clouds": clouds, "webhook": receiver.url}).encode()
        ids.add(hosts[n % 2].post("/v1/batches", document, "-H", "Content-Type: application/json").json["id"])
    wait_until(lambda: {taken[0]["webhook-id"] for taken in receiver.taken} == ids, "every webhook")
    for host in hosts:
        listed = host.curl("/v1/batches").json["batches"]
        assert {batch["id"] for batch in listed} == ids and {batch["status"] for batch in listed} == {"successful"}
        assert host.stop() == 0
    assert len(receiver.taken) == len(ids)
    for _, body, _ in receiver.taken:
        assert json.loads(body)["data"]["counts"]["successful"] == 4


def test_a_batch_is_dismissed_at_another_host(make_daemon, shared, gate):
    _, gated = gate
    front, back = make_daemon(*shared, "--roles", "http"), make_daemon(*shared, *gated)
    cloud = "/v1/clouds/" + front.post("/v1/clouds", SMALL).json["id"]
    batch = front.post("/v1/batches", json.dumps({"clouds": 3 * [cloud]}).encode(), "-H",
                       "Content-Type: application/json").json
    back.wait_for(batch["jobs"][0]["id"], "running")
    ended = front.curl(f"/v1/batches/{batch['id']}", "-X", "DELETE").json
    assert ended["status"] == "dismissed" and ended["counts"]["dismissed"] == 3
    assert back.curl(f"/v1/batches/{batch['id']}").json == ended


def test_limits_and_keys_hold_for_all_hosts(make_daemon, shared):
    hosts = [make_daemon(*shared, "--roles", "http", "--max-queue", "3") for _ in range(2)]
    replies = [hosts[n % 2].post("/v1/jobs", SMALL).status for n in range(5)]
    assert replies == [201, 201, 201, 429, 429] or replies == [201, 201, 201, 503, 503]
    first = hosts[0].curl("/v1/clouds", "-H", "Idempotency-Key: k", data=SMALL)
    again = hosts[1].curl("/v1/clouds", "-H", "Idempotency-Key: k", data=SMALL)
    assert first.json == again.json and first.status == again.status


def test_a_link_opens_at_every_host(make_daemon, shared, tmp_path):
    tokens, who = tmp_path / "tokens", ("-H", "Authorization: Bearer alice-secret")
    tokens.write_text(f"alice:submit,read:{hashlib.sha256(b'alice-secret').hexdigest()}\n")
    front, back = (make_daemon(*shared, "--tokens-file", tokens) for _ in range(2))
    job = front.post("/v1/jobs", SMALL, *who).json["id"]
    wait_until(lambda: front.curl(f"/v1/jobs/{job}", *who).json["status"] == "successful", "the job's end")
    href = front.curl(f"/v1/jobs/{job}/outputs/cloud.ply/link", "-X", "POST", *who).json["href"]
    whole = front.curl(f"/v1/jobs/{job}/outputs/cloud.ply", *who).body
    assert front.curl(href).body == back.curl(href).body == whole
    changed = href[:-1] + ("0" if href[-1] != "0" else "1")
    assert back.curl(changed).status in (401, 403)


# ---------------------------------------------------------------------------------------------- locks of rows

@contextlib.contextmanager
def locked(flags, statement):
    """A transaction that holds what the statement locks; gives a function that runs others in it."""
    with subprocess.Popen([PROGRAMS / "psql", "-X", "-q", "-A", "-t", flags[1]], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as process:
        def run(text):
            process.stdin.write(f"{text};\nSELECT 'done';\n")
            process.stdin.flush()
            while "done" not in process.stdout.readline():
                assert process.poll() is None, text
        run(f"BEGIN; {statement}")
        yield run
        run("COMMIT")
        process.stdin.close()


def query(flags, statement):
    return subprocess.run([PROGRAMS / "psql", "-X", "-q", "-A", "-t", "-c", statement, flags[1]], capture_output=True,
                          text=True, check=True).stdout.strip()


def waiting(flags, text=""):
    """How many connections wait for a lock, with a statement of this text."""
    return int(query(flags, "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() "
                            f"AND wait_event_type = 'Lock' AND query LIKE '%{text}%'"))


def deadlocks(flags):
    return query(flags, "SELECT deadlocks FROM pg_stat_database WHERE datname = current_database()")


def test_a_job_of_a_batch_is_deleted_while_another_one_ends(make_daemon, shared, gate):
    """Both change the batch, and what its principal has: in the same order, so that neither is given up for the other."""
    gate, gated = gate
    gate.unlink()
    host, front = make_daemon(*shared, *gated), make_daemon(*shared, "--roles", "http")
    host.ended(host.submit(SMALL))
    gate.touch()
    clouds = ["/v1/clouds/" + host.post("/v1/clouds", SMALL + end).json["id"] for end in (b"", b"# another\n")]
    batch = host.post("/v1/batches", json.dumps({"clouds": clouds}).encode(), "-H", "Content-Type: application/json").json
    done, running = (job["id"] for job in batch["jobs"])
    assert host.job(done)["status"] == "successful"  # the result of the first
    host.wait_for(running, "running")
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        with locked(shared, "SELECT FROM usage FOR UPDATE"):
            deleted = pool.submit(front.curl, f"/v1/jobs/{done}", "-X", "DELETE")
            wait_until(lambda: waiting(shared), "the job's being deleted")
            gate.unlink()
            wait_until(lambda: waiting(shared) >= 2, "the other one's end")
        assert deleted.result().status == 200, deleted.result().body
    ended = host.ended(running)
    assert ended["status"] == "successful" and ended["attempt"] == 1 and deadlocks(shared) == "0"


def test_a_lost_job_is_queued_again_by_one_host_alone(make_daemon, shared, gate):
    """All that are left find it; the others say nothing of it."""
    _, gated = gate
    hosts, back = [make_daemon(*shared, "--roles", "http") for _ in range(2)], make_daemon(*shared, *gated)
    job = hosts[0].submit(SMALL)
    hosts[0].wait_for(job, "running")
    back.kill()
    with locked(shared, "SELECT FROM jobs FOR UPDATE"):
        wait_until(lambda: waiting(shared, "SELECT state, attempt, cancelled") >= 2, "each host's finding it")
    hosts[0].wait_for(job, "accepted")
    assert "".join(host.log_text() for host in hosts).count(f"job={job} was running when its host ended: queued again") == 1


def test_a_cloud_is_uploaded_again_while_it_expires(make_daemon, shared):
    host = make_daemon(*shared, "--roles", "http")
    other = make_daemon(*shared, "--roles", "http", "--idempotency-retention", "200ms")  # which looks often
    host.post("/v1/clouds", SMALL)
    other.process.send_signal(signal.SIGSTOP)
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        with locked(shared, "UPDATE clouds SET expires = 1; COMMIT; BEGIN; SELECT FROM usage FOR UPDATE"):
            again = pool.submit(host.post, "/v1/clouds", SMALL)
            wait_until(lambda: waiting(shared), "its coming")
            other.process.send_signal(signal.SIGCONT)
            wait_until(lambda: waiting(shared, "DELETE FROM clouds"), "its end")
        assert again.result().status in (200, 201), again.result().body
    wait_until(lambda: query(shared, "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND "
                                     "state <> 'idle' AND query LIKE 'DELETE FROM clouds%'") == "0", "the sweep's end")
    assert deadlocks(shared) == "0" and other.curl(f"{SMALLS_CLOUD}/data").body == SMALL


# ---------------------------------------------------------------------------------------------- resumable uploads

TUS = ("-H", "Tus-Resumable: 1.0.0")
SMALLS_CLOUD = f"/v1/clouds/{hashlib.sha256(SMALL).hexdigest()}"


def begin_upload(host, *more, length=len(SMALL)):
    reply = host.curl("/v1/uploads", "-X", "POST", *TUS, "-H", f"Upload-Length: {length}", *more)
    assert reply.status == 201, reply.body
    return reply.json["id"]


def send_piece(host, upload, offset, data, *more):
    return host.curl(f"/v1/uploads/{upload}", "-X", "PATCH", *TUS, "-H", f"Upload-Offset: {offset}", "-H",
                     "Content-Type: application/offset+octet-stream", "--data-binary", "@-", *more, data=data)


def offset_at(host, upload):
    reply = host.curl(f"/v1/uploads/{upload}", "-I", *TUS)
    assert reply.status == 200, reply.status
    return int(reply.headers["upload-offset"])


def test_rule_8_an_upload_goes_on_at_any_host(make_daemon, shared):
    hosts = [make_daemon(*shared, "--roles", "http") for _ in range(3)]
    upload, step = begin_upload(hosts[0]), len(SMALL) // 7 + 1
    for n, at in enumerate(range(0, len(SMALL), step)):
        assert offset_at(hosts[(n + 1) % 3], upload) == at
        reply = send_piece(hosts[n % 3], upload, at, SMALL[at:at + step])
        assert reply.status == 204 and int(reply.headers["upload-offset"]) == min(at + step, len(SMALL)), reply.body
    found = {host.curl(f"/v1/uploads/{upload}").json["cloud"] for host in hosts}
    assert found == {SMALLS_CLOUD}
    assert [host.curl(f"{SMALLS_CLOUD}/data").body for host in hosts] == [SMALL] * 3
    assert hosts[1].curl(f"/v1/uploads/{upload}", "-X", "DELETE", *TUS).status == 204
    assert hosts[2].curl(f"/v1/uploads/{upload}").status == 404


def test_rule_8_parts_of_an_upload_come_to_any_host_and_are_joined_at_another(make_daemon, shared):
    hosts = [make_daemon(*shared, "--roles", "http") for _ in range(3)]
    step = len(SMALL) // 3 + 1
    pieces = [SMALL[at:at + step] for at in range(0, len(SMALL), step)]
    partial = ("-H", "Upload-Concat: partial")
    parts = [begin_upload(host, *partial, length=len(piece)) for host, piece in zip(hosts, pieces)]
    for n, (part, piece) in enumerate(zip(parts, pieces)):
        half = len(piece) // 2
        assert send_piece(hosts[(n + 1) % 3], part, 0, piece[:half]).status == 204
        assert send_piece(hosts[(n + 2) % 3], part, half, piece[half:]).status == 204
        assert hosts[n].curl(f"/v1/uploads/{part}", "-I", *TUS).headers["upload-concat"] == "partial"
    hosts[0].kill()
    final = "final;" + " ".join(f"/v1/uploads/{part}" for part in parts)
    reply = hosts[1].curl("/v1/uploads", "-X", "POST", *TUS, "-H", f"Upload-Concat: {final}")
    assert reply.status == 201 and reply.json["cloud"] == SMALLS_CLOUD, reply.body
    assert hosts[2].curl(reply.headers["location"], "-I", *TUS).headers["upload-concat"] == final
    assert hosts[2].curl(f"{SMALLS_CLOUD}/data").body == SMALL
    assert {hosts[2].curl(f"/v1/uploads/{part}").status for part in parts} == {404}
    assert hosts[1].stop() == 0 and not list((hosts[1].data / "uploads").iterdir())


def begin_parts(hosts):
    """Three parts of an upload, each whole, at any of the hosts; their paths."""
    step, paths = len(SMALL) // 3 + 1, []
    for n, at in enumerate(range(0, len(SMALL), step)):
        piece = SMALL[at:at + step]
        part = begin_upload(hosts[n % len(hosts)], "-H", "Upload-Concat: partial", length=len(piece))
        assert send_piece(hosts[(n + 1) % len(hosts)], part, 0, piece).status == 204
        paths.append(f"/v1/uploads/{part}")
    return paths


def join_parts(host, paths):
    return host.curl("/v1/uploads", "-X", "POST", *TUS, "-H", "Upload-Concat: final;" + " ".join(paths))


def test_rule_8_a_final_upload_is_the_same_at_every_host(make_daemon, shared):
    """The host that has made it dies before it answers."""
    first, second = (make_daemon(*shared, "--roles", "http") for _ in range(2))
    paths = begin_parts([first, second])
    reply = join_parts(first, paths)
    first.kill()
    again = join_parts(second, paths)
    assert again.status == 201 and again.headers["location"] == reply.headers["location"], again.body
    assert again.json == reply.json and again.json["cloud"] == SMALLS_CLOUD


def test_rule_8_a_final_upload_that_fails_leaves_nothing(make_daemon, shared):
    """Its piece can't be noted: the row that was there by then goes, and the parts make it when all is well."""
    host = make_daemon(*shared, "--roles", "http")
    paths = begin_parts([host])
    query(shared, "CREATE FUNCTION refuse() RETURNS TRIGGER LANGUAGE plpgsql AS $$ BEGIN RAISE 'refused'; END $$; "
                  "CREATE TRIGGER refused BEFORE INSERT ON pieces FOR EACH ROW EXECUTE FUNCTION refuse()")
    assert join_parts(host, paths).status >= 500
    assert query(shared, "SELECT count(*), count(*) FILTER (WHERE concat = 'partial') FROM uploads") == "3|3"
    query(shared, "DROP TRIGGER refused ON pieces")
    assert join_parts(host, paths).json["cloud"] == SMALLS_CLOUD


def whole_and_no_cloud(make_daemon, shared):
    """An upload that has all its bytes, and a host that died before it made a cloud of it."""
    host = make_daemon(*shared, "--roles", "http")
    upload = begin_upload(host)
    (host.data.parent / "piece").write_bytes(SMALL)
    with locked(shared, "LOCK TABLE expected"), subprocess.Popen(host.curl_command(
            f"/v1/uploads/{upload}", "-X", "PATCH", *TUS, "-H", "Upload-Offset: 0", "-H",
            "Content-Type: application/offset+octet-stream", "--data-binary", f"@{host.data.parent / 'piece'}"),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL):
        wait_until(lambda: query(shared, "SELECT position = length FROM uploads") == "t", "the piece")
        wait_until(lambda: waiting(shared, "INSERT INTO expected"), "its being about to")
        host.kill()
    assert query(shared, "SELECT position = length, cloud = '' FROM uploads") == "t|t"
    return upload


def go_on(host, upload):
    """Asks as a client of tus does that is about to: what is whole becomes a cloud."""
    return host.curl(f"/v1/uploads/{upload}", "-I", "-H", "Tus-Resumable: 1.0.0", "-o", "/dev/null")


def test_rule_8_hosts_that_complete_an_upload_at_once_make_one_cloud(make_daemon, shared):
    upload = whole_and_no_cloud(make_daemon, shared)
    hosts = [make_daemon(*shared, "--roles", "http") for _ in range(2)]
    with concurrent.futures.ThreadPoolExecutor(6) as pool:
        with locked(shared, "LOCK TABLE expected"):
            replies = [pool.submit(go_on, hosts[n % 2], upload) for n in range(6)]
            wait_until(lambda: waiting(shared, "INSERT INTO expected") >= 2, "each host's being about to")
        replies = [reply.result() for reply in replies]
    assert [(reply.status, reply.headers.get("whittle-cloud")) for reply in replies] == 6 * [(200, SMALLS_CLOUD)]
    assert hosts[0].curl(f"{SMALLS_CLOUD}/data").body == SMALL
    assert all(not list((host.data / "uploads").iterdir()) for host in hosts)


def test_rule_8_an_upload_that_another_host_has_completed_meanwhile_is_its_cloud(make_daemon, shared):
    """The pieces are gone when they are looked for: nothing is made of what is left of them, and nothing is removed."""
    upload = whole_and_no_cloud(make_daemon, shared)
    host = make_daemon(*shared, "--roles", "http")
    assert host.post("/v1/clouds", SMALL).status == 201
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        with locked(shared, "LOCK TABLE pieces") as run:
            reply = pool.submit(go_on, host, upload)
            wait_until(lambda: waiting(shared, "FROM pieces"), "the look for pieces")
            run(f"UPDATE uploads SET cloud = '{SMALLS_CLOUD[-64:]}', writer = ''; DELETE FROM pieces")
        reply = reply.result()
    assert (reply.status, reply.headers.get("whittle-cloud")) == (200, SMALLS_CLOUD)
    assert host.curl(f"/v1/uploads/{upload}").json["cloud"] == SMALLS_CLOUD


def test_rule_8_an_upload_outlives_the_host_that_was_killed_between_its_pieces(make_daemon, shared):
    first, second = (make_daemon(*shared, "--roles", "http") for _ in range(2))
    half = len(SMALL) // 2
    upload = begin_upload(first)
    assert send_piece(first, upload, 0, SMALL[:half]).status == 204
    first.kill()
    assert offset_at(second, upload) == half
    assert send_piece(second, upload, half, SMALL[half:]).status == 204
    assert second.curl(f"/v1/uploads/{upload}").json["cloud"] == SMALLS_CLOUD
    first.start()  # which has nothing of it, and takes nothing away
    assert first.curl(f"/v1/uploads/{upload}").json["cloud"] == SMALLS_CLOUD


def test_rule_8_a_host_that_dies_with_a_piece_leaves_the_offset_where_it_was(make_daemon, shared):
    """The blob is there, its row isn't."""
    first, second = (make_daemon(*shared, "--roles", "http") for _ in range(2))
    upload, half = begin_upload(second), len(SMALL) // 2
    assert send_piece(second, upload, 0, SMALL[:half]).status == 204
    first.kill()
    first.start("--fault", "piece-kept=kill")
    subprocess.run(first.curl_command(f"/v1/uploads/{upload}", "-X", "PATCH", *TUS, "-H", f"Upload-Offset: {half}", "-H",
                                      "Content-Type: application/offset+octet-stream", "--data-binary", "@-"),
                   input=SMALL[half:], capture_output=True, check=False)
    first.process.wait(60)
    assert offset_at(second, upload) == half
    assert send_piece(second, upload, half, SMALL[half:]).status == 204
    assert second.curl(f"/v1/uploads/{upload}").json["cloud"] == SMALLS_CLOUD


def test_rule_8_the_newest_writer_fences_the_one_before(make_daemon, shared):
    """A piece that is on its way at one host while another host goes on: its bytes are refused, and none is twice."""
    first, second = (make_daemon(*shared, "--roles", "http") for _ in range(2))
    upload = begin_upload(first)
    with socket.create_connection(("127.0.0.1", first.port)) as slow:
        slow.sendall(f"PATCH /v1/uploads/{upload} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
                     f"Content-Type: application/offset+octet-stream\r\nContent-Length: {len(SMALL)}\r\n\r\n".encode())
        slow.sendall(SMALL[:100].replace(b"1", b"2"))
        wait_until(lambda: first.leftovers(), "the piece's file")
        assert offset_at(second, upload) == 0
        assert send_piece(second, upload, 0, SMALL[:200]).status == 204
        slow.sendall(SMALL[100:])
        assert slow.recv(200).startswith(b"HTTP/1.1 409 ")
    assert offset_at(first, upload) == 200
    assert send_piece(first, upload, 200, SMALL[200:]).status == 204
    assert second.curl(f"/v1/uploads/{upload}").json["cloud"] == SMALLS_CLOUD


def test_rule_8_what_a_broken_connection_has_brought_is_kept(make_daemon, shared):
    first, second = (make_daemon(*shared, "--roles", "http") for _ in range(2))
    cloud = sphere(6000)  # so large that pieces of it are written at once
    upload = begin_upload(first, length=len(cloud))
    with socket.create_connection(("127.0.0.1", first.port)) as broken:
        broken.sendall(f"PATCH /v1/uploads/{upload} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
                       f"Content-Type: application/offset+octet-stream\r\nContent-Length: {len(cloud)}\r\n\r\n".encode())
        broken.sendall(cloud[:100000])
        least = wait_until(lambda: first.curl(f"/v1/uploads/{upload}").json["offset"], "what is sent")
    at = offset_at(first, upload)
    assert least <= at <= 100000 and offset_at(second, upload) == at
    assert send_piece(second, upload, at, cloud[at:]).status == 204
    assert first.curl(first.curl(f"/v1/uploads/{upload}").json["cloud"] + "/data").body == cloud


def test_uploads_of_all_hosts_count_together(make_daemon, shared):
    hosts = [make_daemon(*shared, "--roles", "http", "--max-uploads", "3") for _ in range(2)]
    uploads = [begin_upload(hosts[n % 2]) for n in range(3)]
    reply = hosts[1].curl("/v1/uploads", "-X", "POST", *TUS, "-H", "Upload-Length: 9")
    assert reply.status == 503 and reply.slug == "too-many-uploads" and reply.headers["retry-after"]
    assert hosts[0].curl(f"/v1/uploads/{uploads[1]}", "-X", "DELETE", *TUS).status == 204
    begin_upload(hosts[1])


# ---------------------------------------------------------------------------------------------- bytes in the store

@pytest.fixture(name="in_s3")
def make_in_s3(server, request):
    """Flags of hosts whose blobs are in S3, in parts of 5 MiB; and the gateway's address."""
    if "WHITTLE_BLOBS" not in os.environ:
        pytest.skip("WHITTLE_BLOBS names no S3 store")
    bucket, query = os.environ["WHITTLE_BLOBS"].split("?")
    name = f"hosts{next(names)}"
    subprocess.run([PROGRAMS / "createdb", "-h", server, "-U", "whittle", name], check=True)
    url = f"postgresql://whittle@/{name}?host={server}"
    subprocess.run([BUILD / "whittled", "migrate", "--catalog", url], check=True)
    blobs = f"{bucket}/{os.getpid()}-{name}?{query}&part=5"
    return ["--catalog", url, "--blobs", blobs, "--lease", "500ms"], query.split("endpoint=")[1]


def keys_in(s3_flags, query):
    """What the store itself lists, below the hosts' prefix."""
    bucket, _, prefix = s3_flags[3].split("?")[0].removeprefix("s3://").partition("/")
    endpoint = re.search("endpoint=([^&]*)", s3_flags[3])[1]
    query = query.replace("PREFIX", urllib.parse.quote(prefix, safe=""))
    done = subprocess.run(["curl", "-sS", "--aws-sigv4", "aws:amz:us-east-1:s3", "--user",
                           f"{os.environ['AWS_ACCESS_KEY_ID']}:{os.environ['AWS_SECRET_ACCESS_KEY']}", "-H",
                           "x-amz-content-sha256: UNSIGNED-PAYLOAD", f"{endpoint}/{bucket}?{query}"],
                          capture_output=True, text=True, check=True)
    assert "Result" in done.stdout, done.stdout
    return [key for key in re.findall("<Key>([^<]*)</Key>", done.stdout) if key.startswith(prefix)]


def unfinished_in(s3_flags):
    """Uploads in parts that were not completed."""
    return keys_in(s3_flags, "uploads=")


def objects_in(s3_flags):
    return keys_in(s3_flags, "list-type=2&prefix=PREFIX")


@pytest.fixture(name="long", scope="module")
def make_long():
    """A cloud of 12 MiB: three parts."""
    return sphere(450000)


def test_what_is_long_is_put_in_parts_and_is_the_same(make_daemon, in_s3, long):
    flags, _ = in_s3
    host, other = make_daemon(*flags, "--roles", "http"), make_daemon(*flags, "--roles", "http")
    assert len(long) > 2 * (5 << 20)
    cloud = host.post("/v1/clouds", long)
    assert cloud.status == 201, cloud.body
    assert other.curl(f"/v1/clouds/{cloud.json['id']}/data").body == long
    assert unfinished_in(flags) == []


def test_a_put_in_parts_that_its_host_does_not_end_is_given_up(make_daemon, in_s3, long, server):
    """Killed after its first part: the mark in the catalog says what there is, and when it is over another host ends it."""
    flags, _ = in_s3
    host, other = make_daemon(*flags, "--roles", "http"), make_daemon(*flags, "--roles", "http")
    host.kill()
    host.start("--fault", "part-put=kill")
    subprocess.run(host.curl_command("/v1/clouds", "-X", "POST", "-H", "Expect:", "--data-binary", "@-"), input=long,
                   capture_output=True, check=False)
    host.process.wait(PATIENCE_S)
    assert len(unfinished_in(flags)) == 1
    ask = [PROGRAMS / "psql", "-X", "-q", "-A", "-t", "-c"]
    found = subprocess.run([*ask, "UPDATE marks SET until = 0 WHERE name LIKE 'unfinished %' RETURNING name", flags[1]],
                           capture_output=True, text=True, check=True).stdout
    assert "clouds/" in found
    wait_until(lambda: not unfinished_in(flags), "the end of what was begun")
    wait_until(lambda: subprocess.run([*ask, "SELECT count(*) FROM marks", flags[1]], capture_output=True, text=True,
                                      check=True).stdout.strip() == "0", "the end of its mark")
    assert other.curl("/v1/clouds").json["clouds"] == []


@pytest.mark.parametrize("fault", ["part-put=kill", "submit-kept=kill"])
def test_one_machine_ends_what_it_began_in_the_store_too(make_daemon, in_s3, long, tmp_path, fault):
    """Killed between the parts of a put, or when a job's cloud is there and its row isn't: nobody names that."""
    flags, _ = in_s3
    flags = ["--catalog", f"sqlite:{tmp_path}/catalog.db", *flags[2:]]
    host = make_daemon(*flags)
    host.stop()
    host.start("--fault", fault)
    subprocess.run(host.curl_command("/v1/jobs", "-X", "POST", "-H", "Expect:", "--data-binary", "@-"), input=long,
                   capture_output=True, check=False)
    host.process.wait(PATIENCE_S)
    left = {"part-put=kill": unfinished_in, "submit-kept=kill": objects_in}[fault]
    assert len(left(flags)) == 1
    with contextlib.closing(sqlite3.connect(tmp_path / "catalog.db")) as database, database:
        database.execute("UPDATE marks SET until = 1")
    host.start()
    wait_until(lambda: not left(flags), "the end of what was begun")
    assert host.curl("/v1/clouds").json["clouds"] == host.curl("/v1/jobs").json["jobs"] == []


class Counting:
    """Passes connections on to the gateway, and counts the bytes that come back."""

    def __init__(self, endpoint):
        host, port = endpoint.removeprefix("http://").split(":")
        self.to, self.returned = (host, int(port)), 0
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}"
        threading.Thread(target=self.take, daemon=True).start()

    def take(self):
        while True:
            try:
                client = self.listener.accept()[0]
            except OSError:
                return
            store = socket.create_connection(self.to)
            threading.Thread(target=self.copy, args=[client, store, False], daemon=True).start()
            threading.Thread(target=self.copy, args=[store, client, True], daemon=True).start()

    def copy(self, source, sink, counts):
        try:
            while data := source.recv(65536):
                self.returned += len(data) * counts
                sink.sendall(data)
        except OSError:
            pass
        for end in (source, sink):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass


def test_of_a_range_no_more_is_fetched(make_daemon, in_s3, long):
    flags, endpoint = in_s3
    proxy = Counting(endpoint)
    flags = [flag.replace(endpoint, proxy.url) for flag in flags]
    host = make_daemon(*flags, "--roles", "http")
    path = f"/v1/clouds/{host.post('/v1/clouds', long).json['id']}/data"
    before = proxy.returned
    for first, last in ((0, 0), (5 << 20, (5 << 20) + 999), (len(long) - 10, len(long) - 1)):
        reply = host.curl(path, "-H", f"Range: bytes={first}-{last}")
        assert reply.status == 206 and reply.body == long[first:last + 1]
        assert reply.headers["content-range"] == f"bytes {first}-{last}/{len(long)}"
    etag = host.curl(path, "-I").headers["etag"]
    assert host.curl(path, "-H", f"If-None-Match: {etag}").status == 304
    assert host.curl(path, "-H", f"Range: bytes={len(long)}-").status == 416
    assert proxy.returned - before < 100000 < len(long)
    assert host.curl(path).body == long and proxy.returned - before > len(long)


def by_host(url):
    """The URL of the same place in the store, whose bucket is named by the host: BUCKET.localhost is this machine."""
    return url.replace("//127.0.0.1", "//localhost") + "&style=host"


@pytest.mark.parametrize("style", ["path", "host"])
def test_rule_9_programs_are_sent_to_the_store(make_daemon, in_s3, style):
    flags, endpoint = in_s3
    if style == "host":
        bucket = flags[3].removeprefix("s3://").split("/")[0]
        flags, endpoint = [*flags[:3], by_host(flags[3]), *flags[4:]], endpoint.replace("127.0.0.1", f"{bucket}.localhost")
    host = make_daemon(*flags, "--blob-redirect")
    job = host.submit(SMALL, "?label=a+ball")
    host.ended(job)
    path = f"/v1/jobs/{job}/outputs/cloud.ply"
    through = host.curl(path, "-H", "Sec-Fetch-Site: same-origin")  # a browser's page
    reply = host.curl(path)
    assert reply.status == 302 and reply.headers["location"].startswith(endpoint + "/")
    assert reply.headers["cache-control"] == "no-store"
    fetched = host.curl(path, "-L")
    assert fetched.status == 200 and fetched.body == through.body
    assert fetched.headers["content-type"] == through.headers["content-type"] == "model/ply"
    assert fetched.headers["content-disposition"] == through.headers["content-disposition"]
    part = host.curl(path, "-L", "-H", "Range: bytes=10-19")
    assert part.status == 206 and part.body == through.body[10:20]
    tag = through.headers["etag"]
    assert host.curl(path, "-H", f"If-None-Match: {tag}").status == 304
    assert host.curl(path, "-L", "-H", 'If-None-Match: "another"').body == through.body
    assert host.curl(path, "-H", f"If-Match: {tag}").status == 200  # the store has a tag of its own
    assert host.curl(path, "-H", 'If-Match: "another"').status == 412
    assert host.curl(path, "-I").headers["etag"] == tag
    assert host.post("/v1/clouds", SMALL).status in (200, 201)
    assert host.curl(SMALLS_CLOUD + "/data").status == 302 and host.curl(SMALLS_CLOUD + "/data", "-L").body == SMALL
    changed = reply.headers["location"].replace("X-Amz-Expires=300", "X-Amz-Expires=3000")
    assert subprocess.run(["curl", "-s", "-o", "/dev/null", "-w", "%{http_code}", changed], capture_output=True, text=True,
                          check=True).stdout == "403"


def test_hosts_without_a_common_blob_store_are_refused(shared, tmp_path):
    run = subprocess.run([BUILD / "whittled", "--listen", "127.0.0.1:0", "--data", tmp_path / "data", *shared[:2]],
                         capture_output=True, text=True, check=False, timeout=60)
    assert run.returncode == 2 and "--blobs" in run.stderr


def test_tables_that_are_missing_are_named(server, tmp_path):
    name = f"empty{next(names)}"
    subprocess.run([PROGRAMS / "createdb", "-h", server, "-U", "whittle", name], check=True)
    url = f"postgresql://whittle@/{name}?host={server}"
    run = subprocess.run([BUILD / "whittled", "--listen", "127.0.0.1:0", "--data", tmp_path / "data", "--catalog", url,
                          "--blobs", f"file:{tmp_path / 'blobs'}"], capture_output=True, text=True, check=False,
                         timeout=60)
    assert run.returncode == 1 and "whittled migrate" in run.stderr
