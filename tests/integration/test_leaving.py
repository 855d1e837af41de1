# SPDX-License-Identifier: GPL-3.0-or-later
"""Clients that leave: in mid-upload, while they wait, while they listen.  Nothing of them stays behind."""
import contextlib
import http.client
import random
import re
import signal
import socket
import struct
import subprocess
import threading

import pytest

from conftest import SANITIZED, SMALL, Daemon, process_lives, sphere, wait_until


def connect(daemon):
    return socket.create_connection(("127.0.0.1", daemon.port), timeout=60)


def reset(connection):
    """Closes with RST instead of FIN, as a process that is killed with unread data does."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def open_connections(daemon):
    return int(float(re.search(r"^whittled_http_connections (\S+)", daemon.curl("/metrics").body.decode(), re.M)[1]))


def read_all(connection):
    answer = b""
    while True:
        part = connection.recv(65536)
        if not part:
            return answer
        answer += part


# ---------------------------------------------------------------------------------------------- uploads

def test_an_upload_cut_at_any_byte_leaves_nothing(daemon):
    """At random places, at each byte around the end of the headers, by FIN and by RST, with and without a length."""
    body = SMALL
    whole = b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n" % len(body) + body
    chunked = (b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n%x\r\n" % len(body) + body +
               b"\r\n0\r\n\r\n")
    chance = random.Random(1)
    for message in (whole, chunked):
        head = message.index(b"\r\n\r\n")
        cuts = set(range(head - 3, head + 9)) | {chance.randrange(1, len(message)) for _ in range(40)}
        cuts |= {1, len(message) - 1, len(message) - 3}
        for cut in sorted(cuts):
            connection = connect(daemon)
            connection.sendall(message[:cut])
            if cut % 2:
                connection.close()
            else:
                reset(connection)
    wait_until(lambda: open_connections(daemon) <= 1, "the end of all connections")
    assert daemon.leftovers() == []
    jobs = daemon.curl("/v1/jobs?limit=500").json["jobs"]
    assert jobs == daemon.kept("clouds") == []
    assert daemon.post("/v1/simplify", SMALL).status == 200


def test_a_body_that_cannot_come_any_more_is_noticed(daemon):
    """The client has closed its half: nothing more will come, long before any limit of time."""
    with connect(daemon) as connection:
        connection.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n" + SMALL)
        wait_until(daemon.leftovers, "the upload's file")
        connection.shutdown(socket.SHUT_WR)
        assert b" 201 " not in read_all(connection)
    wait_until(lambda: not daemon.leftovers(), "the file's removal")


def was_noticed(daemon):
    """By the watchdog, which counts it, or by libmicrohttpd, where it reads once more after the last bytes."""
    counted = 'whittled_http_connections_cut_total{reason="half_closed"} 1' in daemon.curl("/metrics").body.decode()
    return counted or "closed by remote side with incomplete request" in daemon.log_text()


@pytest.mark.parametrize("before", [b"", b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"], ids=["first", "second"])
def test_a_head_that_cannot_come_any_more_is_noticed(make_daemon, before):
    daemon = make_daemon("--header-timeout", "1h", "--idle-timeout", "1h")
    with connect(daemon) as connection:
        connection.sendall(before + b"GET /v1/jobs HTTP/1.1\r\nHo")
        connection.shutdown(socket.SHUT_WR)
        answer = read_all(connection)
    assert answer.count(b"HTTP/1.1 200") == bool(before), answer
    assert was_noticed(daemon)


def test_a_whole_body_before_a_closed_half_is_taken(daemon):
    with connect(daemon) as connection:
        connection.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n" % len(SMALL) + SMALL)
        connection.shutdown(socket.SHUT_WR)
        assert read_all(connection).startswith(b"HTTP/1.1 201 ")


LIST = b"GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\n\r\n"
STORE = b"POST /v1/clouds HTTP/1.1\r\nHost: localhost\r\n"
CHUNKS = b"Transfer-Encoding: chunked\r\n\r\n%x\r\n%s\r\n0\r\n\r\n" % (len(SMALL), SMALL)


def answers_to_several_at_once(daemon, request, connections=6):
    """Of as many connections, each with one request and half closed: how many answers each gets."""
    with contextlib.ExitStack() as stack:
        sent = [stack.enter_context(connect(daemon)) for _ in range(connections)]
        for connection in sent:
            connection.sendall(request)
            connection.shutdown(socket.SHUT_WR)
        return [read_all(connection).count(b"HTTP/1.1 20") for connection in sent]


@pytest.mark.parametrize("request_bytes, answers", [
    (LIST, 1), (3 * LIST, 3), (STORE + b"Content-Length: %d\r\n\r\n" % len(SMALL) + SMALL, 1), (STORE + CHUNKS, 1),
], ids=["read", "pipelined", "length", "chunked"])
def test_whole_requests_before_closed_halves_are_answered_each(daemon, request_bytes, answers):
    """Also where another connection's handler ends while this one's does, and both are resumed together."""
    for _ in range(25):
        assert answers_to_several_at_once(daemon, request_bytes) == [answers] * 6


# ---------------------------------------------------------------------------------------------- one-shots

def start_one_shot(daemon, data):
    """Sends a one-shot and returns its connection and the id of its job, once that runs."""
    connection = connect(daemon)
    connection.sendall(b"POST /v1/simplify?output=mesh HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n" % len(data) + data)
    jobs = wait_until(lambda: daemon.curl("/v1/jobs?status=running").json["jobs"], "the job")
    return connection, jobs[0]["id"]


@pytest.mark.parametrize("leave", [socket.socket.close, reset], ids=["fin", "rst"])
def test_an_abandoned_one_shot_frees_its_slot(make_daemon, large, leave):
    daemon = make_daemon("--workers", "1")
    connection, job_id = start_one_shot(daemon, large)
    pid = daemon.worker_pid(job_id)
    leave(connection)
    assert daemon.ended(job_id)["status"] == "dismissed"
    wait_until(lambda: not process_lives(pid), "the end of its process")
    assert daemon.post("/v1/simplify", SMALL).status == 200


def test_an_abandoned_one_shot_that_waits_never_runs(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    running = daemon.submit(large)
    daemon.wait_for(running, "running")
    connection = connect(daemon)
    connection.sendall(b"POST /v1/simplify HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n" % len(SMALL) + SMALL)
    waiting = wait_until(lambda: daemon.curl("/v1/jobs?status=accepted").json["jobs"], "the job")[0]["id"]
    connection.close()
    assert daemon.ended(waiting)["status"] == "dismissed"
    assert daemon.job(running)["status"] == "running"


def test_an_abandoned_one_shot_goes_on_where_that_is_wanted(make_daemon):
    daemon = make_daemon("--oneshot-abandon=0", "--workers", "1")
    connection, job_id = start_one_shot(daemon, sphere(60000))
    connection.close()
    assert daemon.ended(job_id)["status"] == "successful"


# ---------------------------------------------------------------------------------------------- listeners

def test_event_streams_and_long_polls_that_vanish_are_noticed(make_daemon, large):
    daemon = make_daemon("--workers", "1")
    job_id = daemon.submit(large, "?outputs=mesh")
    daemon.wait_for(job_id, "running")
    waiting = daemon.submit(large + b"0 0 0\n")
    etag = daemon.curl(f"/v1/jobs/{waiting}").headers["etag"].encode()
    listeners = []
    for i in range(10):
        listeners.append(connect(daemon))
        if i % 2:
            listeners[-1].sendall(b"GET /v1/jobs/%s/events HTTP/1.1\r\nHost: localhost\r\n\r\n" % waiting.encode())
            assert listeners[-1].recv(12) == b"HTTP/1.1 200"
        else:
            listeners[-1].sendall(b"GET /v1/jobs/%s HTTP/1.1\r\nHost: localhost\r\nPrefer: wait=60\r\nIf-None-Match: %s\r\n\r\n"
                                  % (waiting.encode(), etag))
    wait_until(lambda: open_connections(daemon) >= 11, "all listeners")
    for i, listener in enumerate(listeners):
        if i % 3:
            listener.close()
        else:
            reset(listener)
    wait_until(lambda: open_connections(daemon) <= 1, "the end of all listeners")
    for job in (job_id, waiting):
        daemon.curl(f"/v1/jobs/{job}", "-X", "DELETE")


def test_a_download_that_is_cut_ends(daemon):
    job_id = daemon.submit(sphere(60000), "?ratio=1&outputs=cloud")
    daemon.ended(job_id)
    connection = connect(daemon)
    connection.sendall(b"GET /v1/jobs/%s/outputs/cloud.ply HTTP/1.1\r\nHost: localhost\r\n\r\n" % job_id.encode())
    assert connection.recv(12) == b"HTTP/1.1 200"
    reset(connection)
    wait_until(lambda: open_connections(daemon) <= 1, "the connection's end")


# ---------------------------------------------------------------------------------------------- draining

def test_an_upload_may_finish_while_the_service_drains(make_daemon):
    daemon = make_daemon("--drain-timeout", "60s")
    client = http.client.HTTPConnection("127.0.0.1", daemon.port, timeout=60)
    client.putrequest("POST", "/v1/jobs")
    client.putheader("Content-Length", str(len(SMALL)))
    client.endheaders(SMALL[:100])
    wait_until(daemon.leftovers, "the upload's file")
    daemon.process.send_signal(signal.SIGTERM)
    wait_until(lambda: daemon.curl("/readyz").status == 503, "not ready")
    assert daemon.post("/v1/jobs", SMALL).slug == "draining"
    client.send(SMALL[100:])
    reply = client.getresponse()
    assert reply.status == 201
    job_id = reply.getheader("Location").rsplit("/", 1)[1]
    client.close()
    assert daemon.process.wait(60) == 0
    daemon.start()
    assert daemon.ended(job_id)["status"] == "successful"


def test_a_second_sigterm_ends_at_once_and_loses_nothing(make_daemon, large):
    daemon = make_daemon("--workers", "1", "--drain-timeout", "1h")
    running, waiting = daemon.submit(large, "?outputs=mesh"), daemon.submit(SMALL)
    pid = daemon.worker_pid(running)
    daemon.process.send_signal(signal.SIGTERM)
    wait_until(lambda: "draining" in daemon.log_text(), "draining")
    daemon.process.send_signal(signal.SIGHUP)  # ends nothing
    assert daemon.curl("/readyz").status == 503
    daemon.process.send_signal(signal.SIGTERM)
    daemon.may_end(128 + signal.SIGTERM)
    assert daemon.process.wait(60) == 128 + signal.SIGTERM
    wait_until(lambda: not process_lives(pid), "the end of the worker")
    daemon.start()
    assert daemon.job(running)["status"] in ("accepted", "running")
    daemon.curl(f"/v1/jobs/{running}", "-X", "DELETE")
    assert daemon.ended(waiting)["status"] == "successful"


# The main thread, which ends the service, is slow to take a listening socket out of a set that others poll.
SLOW_TO_REMOVE = """
#include <dlfcn.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>
int epoll_ctl(int set, int what, int fd, struct epoll_event *event) {
    int (*really)(int, int, int, struct epoll_event *) = dlsym(RTLD_NEXT, "epoll_ctl");
    int listens = 0;
    socklen_t bytes = sizeof listens;
    struct timespec pause = {0, 30000000};
    if (what == EPOLL_CTL_DEL && gettid() == getpid() &&
        getsockopt(fd, SOL_SOCKET, SO_ACCEPTCONN, &listens, &bytes) == 0 && listens)
        nanosleep(&pause, 0);
    return really(set, what, fd, event);
}
"""


def slow_to_remove(folder):
    """What a service is started with so that its main thread is slow there; sanitizers must come first, so nothing then."""
    if SANITIZED:
        return ()
    (folder / "slow.c").write_text(SLOW_TO_REMOVE, encoding="ascii")
    subprocess.run(["cc", "-shared", "-fPIC", "-D_GNU_SOURCE", "-o", folder / "slow.so", folder / "slow.c"], check=True)
    return ("env", f"LD_PRELOAD={folder / 'slow.so'}")


def test_the_service_ends_while_clients_come_and_go(tmp_path):
    """None is taken from the moment of its end on, whatever its threads are at; who was taken is answered."""
    prefix = slow_to_remove(tmp_path)
    for attempt in range(5):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        daemon = Daemon(folder)
        daemon.prefix = prefix
        daemon.start()
        answers, ended = [], threading.Event()

        def come_and_go():
            while not ended.is_set():
                try:
                    with connect(daemon) as client:
                        client.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
                        answers.append(read_all(client)[:12])
                except OSError:  # it doesn't listen any more
                    pass

        clients = [threading.Thread(target=come_and_go) for _ in range(6)]
        for client in clients:
            client.start()
        wait_until(lambda: len(answers) > 50, "some answers")
        daemon.process.send_signal(signal.SIGTERM)
        code = daemon.process.wait(60)
        ended.set()
        for client in clients:
            client.join()
        assert code == 0, daemon.log_text()
        assert set(answers) <= {b"HTTP/1.1 200", b""}  # those who came as it ended may hear nothing


@pytest.mark.parametrize("attempt", range(4))
def test_heads_that_are_refused_at_the_end_end_nothing_but_themselves(make_daemon, attempt):
    """SIGTERM comes while libmicrohttpd refuses one head after the other, more at each attempt."""
    daemon = make_daemon()
    head = b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nCookie: " + b"a=b;" * 15000 + b"\r\n\r\n"
    refused, ended = [], threading.Event()

    def refuse():
        while not ended.is_set():
            try:
                with socket.create_connection(("127.0.0.1", daemon.port), timeout=60) as client:
                    client.sendall(head)
                    refused.append(b"".join(iter(lambda: client.recv(65536), b""))[:12])
            except OSError:  # it doesn't listen any more, or ends before it has read all
                pass

    clients = [threading.Thread(target=refuse) for _ in range(4 + 4 * attempt)]
    for client in clients:
        client.start()
    try:
        wait_until(lambda: len(refused) > 40, "heads that are refused")
        assert daemon.stop() == 0
    finally:
        ended.set()
        for client in clients:
            client.join()
    assert set(refused) <= {b"HTTP/1.1 431", b""}
