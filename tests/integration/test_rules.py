# SPDX-License-Identifier: GPL-3.0-or-later
"""Ten rules that hold where several hosts share a database and a blob store, each with what would break it: hosts that
are killed or stopped, a database that is stopped or whose answers are lost, clocks that are off.  The rules of uploads
(8) and of downloads (9) are in test_hosts.py."""
import concurrent.futures
import contextlib
import json
import os
import pathlib
import pwd
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time

import pytest

from conftest import BUILD, PATIENCE_S, SMALL, end_all, process_lives, sphere, wait_until
from test_clock import LIBRARY, Clocked
from test_hosts import (PROGRAMS, SMALLS_CLOUD, TUS, begin_parts, content, join_parts, make_gate,  # pylint: disable=unused-import
                        make_server, make_shared, names)
from test_webhooks import SECRET, Receiver


def ask(flags, statement):
    done = subprocess.run([PROGRAMS / "psql", "-X", "-q", "-A", "-t", "-c", statement, flags[1]], capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def with_(flags, name, value):
    """The flags, one of them with another value."""
    at = flags.index(name) + 1
    return [*flags[:at], value, *flags[at + 1:]]


# ---------------------------------------------------------------------------------------------- a database in the way

class Relay:
    """Passes connections on to the server's socket.  It may lose the answer to a COMMIT: of the next transaction that
    says `lose`, the COMMIT is sent on, its answer awaited, and the connection closed instead."""

    def __init__(self, folder, server):
        self.to, self.lose, self.lost = f"{server}/.s.PGSQL.5432", None, 0
        self.folder = folder
        folder.mkdir()
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(str(folder / ".s.PGSQL.5432"))
        self.listener.listen(64)
        threading.Thread(target=self.take, daemon=True).start()

    def flags(self, flags):
        """Of a host that connects through it."""
        return with_(flags, "--catalog", re.sub("host=.*", f"host={self.folder}", flags[1]))

    def take(self):
        while True:
            client = self.listener.accept()[0]
            server = socket.socket(socket.AF_UNIX)
            server.connect(self.to)
            link = {"said": b"", "ends": False}
            threading.Thread(target=self.ask, args=[client, server, link], daemon=True).start()
            threading.Thread(target=self.answer, args=[server, client, link], daemon=True).start()

    def ask(self, client, server, link):
        with contextlib.suppress(OSError):
            while data := client.recv(65536):
                if b"BEGIN\0" in data:
                    link["said"] = b""
                link["said"] += data
                if self.lose and self.lose in link["said"] and b"COMMIT\0" in data:
                    self.lose, link["ends"] = None, True
                server.sendall(data)
        self.close(client, server)

    def answer(self, server, client, link):
        with contextlib.suppress(OSError):
            while data := server.recv(65536):
                if link["ends"]:
                    self.lost += 1
                    break
                client.sendall(data)
        self.close(client, server)

    @staticmethod
    def close(*ends):
        for end in ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


@pytest.fixture(name="relay")
def make_relay(tmp_path, server):
    return Relay(tmp_path / "relay", server)


def processes_of(server):
    """The server's and those of its connections."""
    first = int((pathlib.Path(server) / "data/postmaster.pid").read_text().split()[0])
    return [first, *map(int, pathlib.Path(f"/proc/{first}/task/{first}/children").read_text().split())]


@contextlib.contextmanager
def stopped(server):
    """Nothing of the server answers, and nothing is closed; connections that come are taken by the kernel."""
    pids = processes_of(server)
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


# ---------------------------------------------------------------------------------------------- 1: claims, leases, fences

def test_rule_1_no_transaction_is_open_while_a_job_runs(make_daemon, shared, gate):
    _, gated = gate
    host = make_daemon(*shared, *gated)
    host.wait_for(host.submit(SMALL), "running")
    for _ in range(20):
        oldest = ask(shared, "SELECT coalesce(max(extract(epoch FROM clock_timestamp() - xact_start)), 0)::int FROM "
                             "pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()")
        assert int(oldest) < 60
        time.sleep(0.05)
    assert ask(shared, "SELECT state, attempt, owner <> '', lease > created FROM jobs") == "1|1|t|t"


def test_rule_1_a_host_that_was_stopped_past_its_lease_is_fenced(make_daemon, shared, gate):
    """It goes on when another host has run its job: its process ends, what it writes changes nothing."""
    gate, gated = gate
    front, back = make_daemon(*shared, "--roles", "http"), make_daemon(*shared, *gated)
    job = front.submit(SMALL)
    front.wait_for(job, "running")
    pid = back.worker_pid(job)
    back.process.send_signal(signal.SIGSTOP)
    other = make_daemon(*shared)
    ended = front.ended(job)
    assert ended["status"] == "successful" and ended["attempt"] == 2
    before = content(front, job)
    gate.unlink()  # its process ends, too, and has outputs
    back.process.send_signal(signal.SIGCONT)
    wait_until(lambda: f"job={job} attempt=1 is lost" in back.log_text(), "the loss being seen")
    wait_until(lambda: not process_lives(pid), "the end of its process")
    again = front.job(job)
    assert again["attempt"] == 2 and again["finished"] == ended["finished"] and content(front, job) == before
    assert ask(shared, "SELECT count(*) FROM outputs WHERE job = '%s'" % job) == str(len(front.curl(
        f"/v1/jobs/{job}/outputs").json["outputs"]))
    wait_until(lambda: back.leftovers() == [], "the end of what it made")
    assert f"job={job} running -> successful attempt=2" in other.log_text()


# ---------------------------------------------------------------------------------------------- 2: time

@pytest.mark.skipif(not LIBRARY, reason="libfaketime is not installed")
@pytest.mark.skipif("asan" in str(BUILD) or "tsan" in str(BUILD), reason="sanitizers come first")
@pytest.mark.parametrize("seconds", [3600, -3600])
def test_rule_2_a_host_whose_clock_is_off_steals_nothing_and_expires_nothing(make_daemon, shared, gate, tmp_path, seconds):
    gate, gated = gate
    flags = with_(shared, "--lease", "20s")
    right = make_daemon(*flags, *gated, "--retention", "30m")
    first = right.submit(SMALL, "?ratio=0.3")
    gate.unlink()
    assert right.ended(first)["attempt"] == 1
    gate.touch()
    job = right.submit(SMALL)
    right.wait_for(job, "running")
    (tmp_path / "wrong").mkdir()
    wrong = Clocked(tmp_path / "wrong", *flags, "--retention", "30m", "--idempotency-retention", "200ms")
    wrong.set_clock(seconds)
    try:
        wrong.start()
        wrong.has_swept()
        assert wrong.job(job)["status"] == "running" and wrong.job(first)["status"] == "successful"
        later = wrong.submit(SMALL, "?ratio=0.7")
        gate.unlink()
        assert right.ended(job)["attempt"] == 1 and right.ended(later)["status"] == "successful"
        wrong.has_swept()
        assert content(right, first) and content(right, later)
        off = int(ask(flags, "SELECT max(abs(extract(epoch FROM now()) - finished / 1000))::bigint FROM jobs"))
        assert off < 600
    finally:
        end_all([wrong])


# ---------------------------------------------------------------------------------------------- 3: 201 is durable

def kill_at(host, point, cloud):
    """A job that is submitted to a host that dies at the point; whether it was told anything."""
    host.kill()
    host.start("--fault", f"{point}=kill")
    done = subprocess.run(host.curl_command("/v1/jobs", "-X", "POST", "-H", "Expect:", "--data-binary", "@-"), input=cloud,
                          capture_output=True, check=False)
    host.process.wait(60)
    return b" 201 " in done.stdout


def test_rule_3_a_cloud_without_a_row_goes_after_a_grace_and_none_before(make_daemon, shared):
    host, other = (make_daemon(*shared, "--roles", "http", "--idempotency-retention", "200ms") for _ in range(2))
    cloud = SMALL + b"0 0 0.5\n"
    assert not kill_at(host, "submit-kept", cloud)
    assert ask(shared, "SELECT count(*) FROM jobs") == "0" and ask(shared, "SELECT count(*) FROM expected") == "1"
    wait_until(lambda: other.curl("/healthz").status == 200, "the other host")
    assert ask(shared, "SELECT count(*) FROM expected WHERE until > whittle_now() + 60000") == "1"  # its grace
    ask(shared, "UPDATE expected SET until = 0")
    wait_until(lambda: ask(shared, "SELECT removed FROM expected") == "1", "its end")
    job = other.submit(cloud)  # which brings its bytes along, and they stay
    assert other.job(job)["status"] == "accepted"


def test_rule_3_a_row_has_its_cloud_and_any_host_runs_it(make_daemon, shared):
    host = make_daemon(*shared, "--roles", "http")
    kill_at(host, "submit-committed", SMALL)
    job = ask(shared, "SELECT id FROM jobs")
    other = make_daemon(*shared)
    assert other.ended(job)["status"] == "successful" and content(other, job)


def test_rule_3_what_a_deleted_job_leaves_is_marked_and_goes(make_daemon, shared):
    host, other = make_daemon(*shared), make_daemon(*shared, "--roles", "http", "--idempotency-retention", "200ms")
    job = host.submit(SMALL)
    other.ended(job)
    assert other.curl(f"/v1/jobs/{job}", "-X", "DELETE").status == 200
    assert ask(shared, "SELECT name FROM marks WHERE until > whittle_now() + 60000") == f"jobs/{job}"
    ask(shared, "UPDATE marks SET until = 0")
    wait_until(lambda: ask(shared, "SELECT count(*) FROM marks") == "0", "the end of the mark")


# ---------------------------------------------------------------------------------------------- 4: a COMMIT's answer is lost

def test_rule_4_a_job_whose_commit_had_no_answer_is_there_once(make_daemon, shared, relay):
    host = make_daemon(*relay.flags(shared), "--roles", "http")
    relay.lose = b"INSERT INTO jobs"
    reply = host.post("/v1/jobs", SMALL)
    assert reply.status == 201 and relay.lost == 1, reply.body
    assert [job["id"] for job in host.curl("/v1/jobs").json["jobs"]] == [reply.json["id"]]


def test_rule_4_an_end_whose_commit_had_no_answer_is_reported_once(make_daemon, shared, relay, gate, tmp_path):
    gate, gated = gate
    secret = tmp_path / "secret"
    secret.write_text(SECRET + "\n")
    secret.chmod(0o600)
    receiver = Receiver(204)
    hooks = ["--webhooks", "--webhook-secret-file", secret, "--webhook-allow", "127.0.0.1"]
    host = make_daemon(*relay.flags(with_(shared, "--lease", "60s")), *gated, *hooks)
    job = host.submit(SMALL, f"?webhook={receiver.url}")
    host.wait_for(job, "running")
    relay.lose = b"INSERT INTO outputs"
    gate.unlink()
    ended = host.ended(job)
    assert ended["status"] == "successful" and ended["attempt"] == 1
    wait_until(lambda: relay.lost == 1, "the answer being lost, which the end doesn't wait for")
    wait_until(lambda: receiver.taken, "the webhook")
    assert host.stop() == 0 and len(receiver.taken) == 1


def test_rule_4_a_claim_whose_commit_had_no_answer_is_run_again(make_daemon, shared, relay):
    """Nobody runs it under that claim, so its lease ends."""
    host = make_daemon(*relay.flags(shared), "--workers", "1")
    other = make_daemon(*shared, "--roles", "http", "--idempotency-retention", "200ms")
    relay.lose = b"UPDATE usage SET served"
    job = host.submit(SMALL)
    ended = other.ended(job)
    assert relay.lost == 1 and ended["status"] == "successful" and ended["attempt"] <= 3


def test_rule_4_a_piece_whose_commit_had_no_answer_is_there_once(make_daemon, shared, relay):
    from test_hosts import SMALLS_CLOUD, begin_upload, offset_at, send_piece
    host = make_daemon(*relay.flags(shared), "--roles", "http")
    upload, half = begin_upload(host), len(SMALL) // 2
    relay.lose = b"INSERT INTO pieces"
    reply = send_piece(host, upload, 0, SMALL[:half])
    assert reply.status == 204 and relay.lost == 1, reply.body
    assert offset_at(host, upload) == half
    assert send_piece(host, upload, half, SMALL[half:]).status == 204
    assert host.curl(f"/v1/uploads/{upload}").json["cloud"] == SMALLS_CLOUD


# ---------------------------------------------------------------------------------------------- 5: notifications

def test_rule_5_submit_cancel_and_end_alone_are_notified(make_daemon, shared, gate):
    gate, gated = gate
    host = make_daemon(*shared, *gated)
    with subprocess.Popen([PROGRAMS / "psql", "-X", "-q", "-A", "-t", shared[1]], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as listener:
        listener.stdin.write("LISTEN whittle;\nSELECT 'listens';\n")
        listener.stdin.flush()
        while "listens" not in listener.stdout.readline():
            pass
        job = host.submit(SMALL)
        host.wait_for(job, "running")
        progress = int(ask(shared, f"SELECT sequence FROM jobs WHERE id = '{job}'"))
        gate.unlink()
        host.ended(job)
        assert int(ask(shared, f"SELECT sequence FROM jobs WHERE id = '{job}'")) > progress
        gate.touch()
        second = host.submit(sphere(500))
        host.wait_for(second, "running")
        assert host.curl(f"/v1/jobs/{second}", "-X", "DELETE").status in (200, 202)
        wait_until(lambda: host.job(second)["status"] == "dismissed", "its end")
        notes, _ = listener.communicate("SELECT 'over';\n")
    kinds = re.findall(rf"whittle.*? (\d) ({job}|{second})", notes)
    assert sorted(kinds) == sorted([("1", job), ("0", job), ("1", second), ("2", second), ("0", second)]), notes


def test_rule_5_what_was_notified_while_nobody_listened_is_found(make_daemon, shared):
    """The connections of the host that waits are ended again and again."""
    front, back = make_daemon(*shared, "--roles", "http"), make_daemon(*shared)
    for ratio in (0.2, 0.4, 0.6):
        ask(shared, "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity WHERE datname = current_database() "
                    "AND pid <> pg_backend_pid()")
        job = wait_until(lambda r=ratio: front.post(f"/v1/jobs?ratio={r}", SMALL).json.get("id"), "a job's being taken")
        ask(shared, "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity WHERE datname = current_database() "
                    "AND query LIKE '%jobs WHERE updated%' AND pid <> pg_backend_pid()")
        assert wait_until(lambda j=job: front.curl(f"/v1/jobs/{j}", "-H", "Prefer: wait=5").json.get("finished"), "its end")
    assert back.stop() == 0


# ---------------------------------------------------------------------------------------------- 6: limits

def test_rule_6_a_key_is_one_job_however_many_hosts_are_asked_at_once(make_daemon, shared):
    hosts = [make_daemon(*shared, "--roles", "http") for _ in range(3)]
    found, lock = [], threading.Lock()

    def send(host):
        reply = host.post("/v1/jobs", SMALL, "-H", "Idempotency-Key: one")
        with lock:
            found.append(reply)
    threads = [threading.Thread(target=send, args=[hosts[n % 3]]) for n in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {reply.status for reply in found} <= {201, 409}, [reply.body for reply in found]
    assert len({reply.json["id"] for reply in found if reply.status == 201}) == 1
    assert ask(shared, "SELECT count(*) FROM jobs") == "1"


def test_rule_6_a_key_that_is_used_behind_a_request_s_back_is_its_job_when_it_comes_again(make_daemon, shared):
    """A host that was held up past its session, or a commit that comes after its answer was given up, uses the key
    between the look for it and the row of the job."""
    host = make_daemon(*shared, "--roles", "http")
    job = host.post("/v1/jobs", SMALL, "-H", "Idempotency-Key: one").json["id"]
    with subprocess.Popen([PROGRAMS / "psql", "-X", "-q", shared[1]], stdin=subprocess.PIPE, text=True) as other:
        other.stdin.write("BEGIN; UPDATE replies SET key = 'two';\n")
        other.stdin.flush()
        wait_until(lambda: ask(shared, "SELECT 1 FROM pg_stat_activity WHERE state = 'idle in transaction' "
                                       "AND query LIKE '%replies SET key%'"), "the other's use")
        found = []
        thread = threading.Thread(target=lambda: found.append(host.post("/v1/jobs", SMALL, "-H", "Idempotency-Key: two")))
        thread.start()
        wait_until(lambda: ask(shared, "SELECT 1 FROM pg_locks WHERE NOT granted AND locktype = 'transactionid'"),
                   "the request's use")
        other.stdin.write("COMMIT;\n")
        other.stdin.close()
        thread.join()
    assert found[0].status == 503 and int(found[0].headers["retry-after"]) > 0, found[0].body
    again = host.post("/v1/jobs", SMALL, "-H", "Idempotency-Key: two")
    assert again.status == 201 and again.json["id"] == job, again.body
    assert ask(shared, "SELECT count(*) FROM jobs") == "1"


def test_rule_6_the_queue_has_one_limit_for_all_hosts_at_once(make_daemon, shared):
    hosts = [make_daemon(*shared, "--roles", "http", "--max-queue", "5") for _ in range(3)]
    found, lock = [], threading.Lock()

    def send(n):
        status = hosts[n % 3].post(f"/v1/jobs?points={20 + n}", SMALL).status
        with lock:
            found.append(status)
    threads = [threading.Thread(target=send, args=[n]) for n in range(15)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found.count(201) == 5 and found.count(503) == 10, found
    assert ask(shared, "SELECT waiting FROM usage") == "5"


# ---------------------------------------------------------------------------------------------- 7: the database is away

def test_rule_7_a_database_that_is_stopped_is_a_503_and_work_goes_on_after_it(make_daemon, shared, server, gate):
    """Nothing hangs: writes are refused, what is cached is read, the job that runs ends and is reported later."""
    gate, gated = gate
    host = make_daemon(*with_(shared, "--lease", "60s"), *gated, "--idempotency-retention", "1h")
    done = host.submit(SMALL, "?ratio=0.3")
    gate.unlink()
    host.ended(done)
    gate.touch()
    job = host.submit(SMALL)
    host.wait_for(job, "running")
    pid = host.worker_pid(job)
    with stopped(server):
        reply = wait_until(lambda: (lambda r: r if r.status == 503 else None)(
            host.post("/v1/jobs?ratio=0.5", SMALL, "-H", "Idempotency-Key: a")), "a refusal")
        assert reply.slug == "not-ready" and int(reply.headers["retry-after"]) > 0
        assert host.post("/v1/clouds", SMALL).status == 503
        assert host.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H", "Upload-Length: 9").status == 503
        began = time.monotonic()
        for _ in range(20):  # which doesn't wait for what is known to be silent
            assert host.post("/v1/jobs", SMALL, "-H", "Idempotency-Key: b").status == 503
        assert host.curl("/healthz").status == 200 and host.curl("/v1/parameters").status == 200
        assert time.monotonic() - began < 60
        assert host.curl(f"/v1/jobs/{done}").json["status"] == "successful"  # its document is cached
        gate.unlink()
        wait_until(lambda: not process_lives(pid), "the end of the job's process")
    assert host.ended(job)["status"] == "successful" and host.job(job)["attempt"] == 1
    assert host.ended(host.submit(SMALL, "?ratio=0.6"))["status"] == "successful"
    again = wait_until(lambda: (lambda r: r if r.status == 201 else None)(
        host.post("/v1/jobs?ratio=0.5", SMALL, "-H", "Idempotency-Key: a")), "its key's being free")
    assert host.ended(again.json["id"])["status"] == "successful"
    wait_until(lambda: host.curl("/readyz").status == 200, "readiness")


def test_rule_7_a_store_that_is_away_is_a_503_and_its_work_goes_on_after_it(make_daemon, server, tmp_path):
    """The gateway's port refuses; then it is there again."""
    if "WHITTLE_BLOBS" not in os.environ:
        pytest.skip("WHITTLE_BLOBS names no S3 store")
    bucket, query = os.environ["WHITTLE_BLOBS"].split("?")
    to = re.search(r"endpoint=http://([^:]*):(\d+)", query).groups()
    name = f"rules{next(names)}"
    subprocess.run([PROGRAMS / "createdb", "-h", server, "-U", "whittle", name], check=True)
    url = f"postgresql://whittle@/{name}?host={server}"
    subprocess.run([BUILD / "whittled", "migrate", "--catalog", url], check=True)
    gateway = Gateway((to[0], int(to[1])))
    blobs = f"{bucket}/{os.getpid()}-{name}?endpoint=http://127.0.0.1:{gateway.port}"
    host = make_daemon("--catalog", url, "--blobs", blobs, "--lease", "60s", "--result-cache=0")
    job = host.submit(SMALL)
    host.ended(job)
    gateway.close()
    reply = host.post("/v1/jobs", SMALL)
    assert reply.status == 503 and int(reply.headers["retry-after"]) > 0, reply.body
    assert host.curl(f"/v1/jobs/{job}").json["status"] == "successful"
    assert host.curl(f"/v1/jobs/{job}/outputs/cloud.ply").status == 503
    assert int(ask(["", url], "SELECT count(*) FROM jobs")) == 1
    gateway.open()
    assert host.ended(host.submit(SMALL))["status"] == "successful" and content(host, job)


class Pair:
    """A primary and its synchronous standby, each on a socket of its own."""

    def __init__(self, folder):
        self.folder, self.processes = folder, {}
        folder.chmod(0o755)
        shutil.chown(folder, account())
        self.run(PROGRAMS / "initdb", "-D", self.data("a"), "-U", "whittle", "-A", "trust", "--no-sync")
        self.start("a")
        self.run(PROGRAMS / "pg_basebackup", "-D", self.data("b"), "-R", "-X", "stream", "-c", "fast", "-U", "whittle",
                 "-h", self.socket("a"))
        self.start("b")
        self.ask("a", "ALTER SYSTEM SET synchronous_standby_names = '*'")
        self.ask("a", "SELECT pg_reload_conf()")
        wait_until(lambda: self.ask("a", "SELECT sync_state FROM pg_stat_replication") == "sync", "the standby")

    def data(self, node):
        return self.folder / f"{node}.data"

    def socket(self, node):
        return self.folder / node

    def run(self, *command):
        subprocess.run([*as_account(), *command], cwd=self.folder, check=True, capture_output=True, timeout=PATIENCE_S)

    def start(self, node):
        self.run("mkdir", self.socket(node))
        with open(self.folder.parent / f"{node}.log", "wb") as log:
            self.processes[node] = subprocess.Popen(  # pylint: disable=consider-using-with
                [*as_account(), PROGRAMS / "postgres", "-D", self.data(node), "-k", self.socket(node), "-c",
                 "listen_addresses=", "-c", "fsync=off"], cwd=self.folder, stdout=log, stderr=log)
        wait_until(lambda: subprocess.run([PROGRAMS / "pg_isready", "-q", "-h", self.socket(node)],
                                          check=False).returncode == 0, "PostgreSQL")

    def ask(self, node, statement):
        return ask(["", f"postgresql://whittle@/postgres?host={self.socket(node)}"], statement)

    def promote(self, node):
        """The other one isn't told: it takes changes as before, whose commits wait for ever."""
        self.ask(node, "ALTER SYSTEM SET synchronous_standby_names = ''")
        self.ask(node, "SELECT pg_promote()")
        wait_until(lambda: self.ask(node, "SELECT pg_is_in_recovery()") == "f", "the promotion")

    def close(self):
        for process in self.processes.values():
            process.send_signal(signal.SIGQUIT)  # what waits for its standby would keep it
        for process in self.processes.values():
            process.wait(PATIENCE_S)


def account():
    """Which PostgreSQL runs as: it doesn't as root."""
    return "postgres" if os.getuid() == 0 else pwd.getpwuid(os.getuid()).pw_name


def as_account():
    return ["setpriv", "--reuid", "postgres", "--regid", "postgres", "--clear-groups"] if os.getuid() == 0 else []


@pytest.fixture(name="pair")
def make_pair():
    if not (PROGRAMS / "initdb").exists():
        pytest.skip("PostgreSQL 15 isn't installed")
    with tempfile.TemporaryDirectory(prefix="pair.") as outer:  # a short path, for the sockets
        os.chmod(outer, 0o755)
        folder = pathlib.Path(outer) / "of"
        folder.mkdir()
        pair = Pair(folder)
        yield pair
        pair.close()


def test_rule_7_a_primary_that_was_deposed_is_left_when_its_commits_hang(make_daemon, pair, tmp_path):
    """It still says that it takes changes, and is the first that is asked; nothing that was answered is lost with it."""
    url = f"postgresql://whittle@/postgres?host={pair.socket('a')},{pair.socket('b')}&target_session_attrs=read-write"
    subprocess.run([BUILD / "whittled", "migrate", "--catalog", url], check=True)
    flags = ["--catalog", url, "--blobs", f"file:{tmp_path / 'blobs'}", "--lease", "5s", "--result-cache=0"]
    hosts = [make_daemon(*flags), make_daemon(*flags)]
    before = [host.submit(SMALL, "?ratio=0.3") for host in hosts]
    for host, job in zip(hosts, before):
        host.ended(job)
    pair.promote("b")
    assert pair.ask("a", "SELECT pg_is_in_recovery()") == "f"
    for number, host in enumerate(hosts):
        answers = []

        def accepted(host=host, number=number, answers=answers):
            answers.append(host.post("/v1/jobs?ratio=0.6", SMALL, "-H", f"Idempotency-Key: {number}"))
            return answers[-1].status == 201
        wait_until(accepted, "work at the new primary")
        assert all(a.status in (201, 409, 503) for a in answers), [a.body for a in answers]
        job = answers[-1].json["id"]
        assert host.ended(job)["status"] == "successful" and content(host, job)
    for job in before:
        assert hosts[0].job(job)["status"] == "successful"
    assert pair.ask("b", "SELECT count(*), count(DISTINCT id) FROM jobs") == "4|4"


def test_rule_7_a_primary_that_was_deposed_is_not_believed_that_something_is_not_there(make_daemon, pair, tmp_path):
    """A host that still asks it doesn't answer 404 for what others were told of by the new one, but 503 until it leaves."""
    url = f"postgresql://whittle@/postgres?host={pair.socket('a')},{pair.socket('b')}&target_session_attrs=read-write"
    subprocess.run([BUILD / "whittled", "migrate", "--catalog", url], check=True)
    flags = ["--catalog", url, "--blobs", f"file:{tmp_path / 'blobs'}", "--lease", "5s", "--result-cache=0"]
    ahead, *behind = [make_daemon(*flags) for _ in range(6)]
    pair.promote("b")
    cloud = wait_until(lambda: (lambda r: r if r.status == 201 else None)(ahead.post("/v1/clouds", SMALL)),
                       "the new primary")
    job, other = ahead.submit(SMALL), ahead.submit(SMALL, "?ratio=0.2")
    document = json.dumps({"clouds": [f"/v1/clouds/{cloud.json['id']}"]}).encode()
    made = ahead.post("/v1/batches", document, "-H", "Content-Type: application/json")
    upload = ahead.curl("/v1/uploads", "-X", "POST", "-H", "Tus-Resumable: 1.0.0", "-H", f"Upload-Length: {len(SMALL)}")
    assert (made.status, upload.status) == (201, 201), (made.body, upload.body)
    asked = [(f"/v1/jobs/{job}",), (f"/v1/jobs/{other}", "-X", "DELETE"), (f"/v1/clouds/{cloud.json['id']}",),
             (f"/v1/batches/{made.json['id']}",),
             (upload.headers["location"][upload.headers["location"].index("/v1/"):], "-I", "-H", "Tus-Resumable: 1.0.0")]

    def ask(host, question):
        answers = []
        wait_until(lambda: answers.append(host.curl(*question).status) or answers[-1] < 300, f"an answer on {question}")
        return answers
    with concurrent.futures.ThreadPoolExecutor(len(asked)) as threads:
        answers = list(threads.map(ask, behind, asked))
    assert {status for each in answers for status in each[:-1]} == {503}, list(zip(asked, answers))
    assert ahead.curl("/v1/jobs/00000000-0000-7000-8000-000000000000").status == 404


class Gateway:
    """A port that leads to the store's, or refuses."""

    def __init__(self, to):
        self.to, self.port, self.listener, self.links = to, 0, None, []
        self.open()

    def open(self):
        self.listener = socket.create_server(("127.0.0.1", self.port))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self.take, args=[self.listener], daemon=True).start()

    def close(self):
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        for link in self.links:
            Relay.close(link)
        self.links.clear()

    def take(self, listener):
        with contextlib.suppress(OSError):
            while True:
                ends = listener.accept()[0], socket.create_connection(self.to)
                self.links += ends
                for source, sink in (ends, ends[::-1]):
                    threading.Thread(target=self.copy, args=[source, sink], daemon=True).start()

    @staticmethod
    def copy(source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                sink.sendall(data)
        Relay.close(source, sink)


# ---------------------------------------------------------------------------------------------- 10: upgrades

def refused(flags, tmp_path):
    """What a start says, and what migrating does, where both are refused."""
    found = []
    for command in (["--listen", "127.0.0.1:0", "--data", tmp_path / "new", *flags], ["migrate", *flags[:2]]):
        run = subprocess.run([BUILD / "whittled", *command], capture_output=True, text=True, check=False, timeout=PATIENCE_S)
        assert run.returncode == 1, command
        found.append(run.stderr)
    return found


def test_rule_10_hosts_are_upgraded_one_after_the_other(make_daemon, shared, tmp_path):
    """The next version's tables are there: hosts of this one go on, start and are asked to migrate, which does nothing.
    With the tables of the one after that they are refused, but those that run go on."""
    host = make_daemon(*shared)
    first = host.submit(SMALL, "?ratio=0.3")
    migrate = "UPDATE schema_steps SET count = count + 1, oldest = count"
    ask(shared, f"ALTER TABLE jobs ADD COLUMN something BIGINT NOT NULL DEFAULT 0; {migrate}")
    assert host.ended(first)["status"] == "successful"
    subprocess.run([BUILD / "whittled", "migrate", *shared[:2]], check=True, timeout=PATIENCE_S)
    late = make_daemon(*shared)
    job = late.submit(SMALL)
    assert late.ended(job)["status"] == "successful" and content(late, job)
    assert host.job(first)["status"] == late.job(first)["status"] == "successful"
    ask(shared, f"ALTER TABLE jobs ADD COLUMN another BIGINT NOT NULL DEFAULT 0; {migrate}")
    assert all("more than a version newer" in said for said in refused(shared, tmp_path))
    job = host.submit(SMALL, "?ratio=0.6")
    assert host.ended(job)["status"] == "successful" and content(host, job)


def refuses(flags, statement):
    """Whether it ends as if the server were away."""
    done = subprocess.run([PROGRAMS / "psql", "-X", "-q", "-v", "VERBOSITY=verbose", "-c", statement, flags[1]],
                          capture_output=True, text=True, check=False)
    return done.returncode != 0 and "57P03" in done.stderr


def test_rule_10_a_host_of_the_version_before_leaves_a_batch_s_webhook_alone(make_daemon, shared, tmp_path):
    """It knows webhooks of jobs: without a job of this name it would remove the row."""
    secret = tmp_path / "secret"
    secret.write_text(SECRET + "\n")
    secret.chmod(0o600)
    receiver = Receiver(500)
    host = make_daemon(*shared, "--webhooks", "--webhook-secret-file", secret, "--webhook-allow", "127.0.0.1",
                       "--webhook-retry", "200ms")
    cloud = "/v1/clouds/" + host.post("/v1/clouds", SMALL).json["id"]
    batch = host.post("/v1/batches", json.dumps({"clouds": [cloud], "webhook": receiver.url}).encode(), "-H",
                      "Content-Type: application/json").json["id"]
    job = host.submit(SMALL, f"?ratio=0.7&webhook={receiver.url}")
    wait_until(lambda: {taken[0]["webhook-id"] for taken in receiver.taken} == {batch, job}, "both being tried")
    claim = "UPDATE outbox SET owner = 'before', due = due + 600000 WHERE job = '%s' RETURNING job"
    assert ask(shared, claim % batch) == "" and ask(shared, claim % job) == job  # as that version asks
    receiver.statuses[:] = [204]
    wait_until(lambda: ask(shared, "SELECT count(*) FROM outbox") == "1", "the batch's webhook")
    assert ask(shared, "SELECT job FROM outbox") == job and receiver.taken[-1][0]["webhook-id"] == batch


# As the version before claims a job.
FIRST_JOB = ("SELECT first.id FROM usage CROSS JOIN LATERAL (SELECT id FROM jobs WHERE state = 0 AND principal = "
             "usage.principal ORDER BY due, id LIMIT 1) AS first WHERE usage.waiting > 0 ORDER BY usage.served, first.id "
             "LIMIT 1")
CLAIM_BEFORE = ("UPDATE jobs SET state = 1, attempt = attempt + 1, started = whittle_now(), updated = whittle_now(), "
                "owner = 'before', lease = whittle_now() + 600000, writer = 'before' "
                f"WHERE id = ({FIRST_JOB}) AND state = 0 RETURNING id")


@pytest.mark.parametrize("shared", ["file"], indirect=True)
def test_rule_10_a_host_of_the_version_before_leaves_jobs_alone_that_it_would_do_otherwise(make_daemon, shared):
    """It doesn't know denoise=noisy, which is the default of this one, and would take none for it; nor tiles.  What it
    can't claim isn't in the way of what it can."""
    front = make_daemon(*shared, "--roles", "http")
    meshes = [front.submit(SMALL, f"?outputs=mesh,report&ratio=0.{i}") for i in (3, 4)]
    tiled = front.submit(SMALL, "?ratio=0.2")
    ask(shared, f"UPDATE jobs SET tiles = -1 WHERE id = '{tiled}'")
    cloud, given = front.submit(SMALL, "?ratio=0.5"), front.submit(SMALL, "?outputs=mesh,report&denoise=none")
    claimed = [ask(shared, CLAIM_BEFORE) for _ in range(8)]
    assert sorted(filter(None, claimed)) == sorted([cloud, given])
    assert {front.job(job)["status"] for job in meshes + [tiled]} == {"accepted"}
    ask(shared, f"UPDATE jobs SET tiles = 0 WHERE id = '{tiled}'")
    make_daemon(*shared)
    for job in meshes + [tiled]:
        ended = front.ended(job)
        assert ended["status"] == "successful" and ended["attempt"] == 1, ended


@pytest.mark.parametrize("shared", ["file"], indirect=True)
def test_rule_10_a_host_leaves_jobs_alone_whose_parameters_only_a_newer_one_knows(make_daemon, shared):
    front = make_daemon(*shared, "--roles", "http")
    strange, unknown, usual, plain = (front.submit(SMALL, f"?ratio=0.{i}") for i in (2, 3, 4, 5))

    def change(job, *values):
        params = ask(shared, f"SELECT params FROM jobs WHERE id = '{job}'") + "\n"
        for before, after in values:
            assert before in params
            params = params.replace(before, after)
        ask(shared, f"UPDATE jobs SET params = '{params}' WHERE id = '{job}'")
    change(strange, ("given=", "shade=7\ngiven=shade,"))  # a parameter
    change(unknown, ("denoise=noisy\n", "denoise=softly\n"))  # another default of one that is known
    change(usual, ("given=", "shade=7\ngiven="))  # a parameter that is as if it weren't there
    back = make_daemon(*shared)
    for job in (usual, plain, front.submit(SMALL, "?ratio=0.6")):
        assert front.ended(job)["status"] == "successful"
    for job in (strange, unknown):
        assert front.job(job)["status"] == "accepted" and f"job={job}" not in back.log_text()
    change(strange, ("shade=7\ngiven=shade,", "given="))  # as if a host came that knows it
    change(unknown, ("denoise=softly\n", "denoise=noisy\n"))
    for job in (strange, unknown):
        ended = front.ended(job)
        assert ended["status"] == "successful" and ended["attempt"] == 1, ended


def test_rule_10_a_host_of_the_version_before_leaves_parts_of_uploads_alone(make_daemon, shared):
    """It takes them for uploads: a whole one would become a cloud, or go where it is none."""
    host = make_daemon(*shared, "--roles", "http")
    parts = begin_parts([host])
    for statement in ("UPDATE uploads SET writer = 'before'", "DELETE FROM uploads",
                      "UPDATE uploads SET cloud = 'abc', writer = ''"):  # as that version asks
        assert refuses(shared, statement), statement
    assert host.curl(parts[0], "-X", "DELETE", *TUS).status == 204
    parts[0] = begin_parts([host])[0]
    assert join_parts(host, parts).json["cloud"] == SMALLS_CLOUD
    late = begin_parts([host])
    ask(shared, "UPDATE uploads SET expires = 1")
    ask(shared, "DELETE FROM uploads WHERE expires = 1")  # what has expired goes by any host
    assert host.curl(late[0]).status == 404
