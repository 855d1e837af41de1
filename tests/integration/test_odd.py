# SPDX-License-Identifier: GPL-3.0-or-later
"""What clumsy and hostile clients ask: odd targets, odd folders, files that are nearly right."""
import re
import socket
import subprocess

import pytest

from conftest import BUILD, SMALL


def exchange(daemon, request):
    """All that comes until the other side closes."""
    with socket.create_connection(("127.0.0.1", daemon.port), 60) as connection:
        connection.sendall(request)
        received = b""
        while piece := connection.recv(65536):
            received += piece
    return received


def whittle(*arguments):
    return subprocess.run([BUILD / "whittle", *map(str, arguments)], capture_output=True, text=True, check=False)


CORNERS = (b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
           b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n")


def host_of(target):
    return target.split(b"/")[2]


@pytest.mark.parametrize("target, status", [(b"http://localhost:1/healthz", 200), (b"HTTPS://localhost/healthz?", 200),
                                            (b"http://localhost", 200), (b"http://localhost/nowhere", 404)])
def test_a_target_in_absolute_form_is_its_path(daemon, target, status):
    reply = exchange(daemon, b"GET " + target + b" HTTP/1.1\r\nHost: " + host_of(target) + b"\r\nConnection: close\r\n\r\n")
    assert reply.startswith(b"HTTP/1.1 %d" % status)


def test_head_of_events_sends_nothing_after_the_headers(daemon):
    job_id = daemon.submit(SMALL)
    reply = exchange(daemon, f"HEAD /v1/jobs/{job_id}/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    head, _, rest = reply.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200") and not rest
    assert re.search(rb"(?i)connection: close", head)


def test_ply_after_a_byte_order_mark_is_a_cloud(daemon):
    job = daemon.ended(daemon.submit(b"\xef\xbb\xbf" + CORNERS, "?ratio=0.5"))
    assert job["status"] == "successful" and job["input"]["format"].startswith("ply/")


def test_a_folder_that_takes_no_files_is_refused_before_the_input_is_read(tmp_path):
    (tmp_path / "file").write_text("mine")
    for folder in (tmp_path / "file", tmp_path / "file" / "under", tmp_path / "no" / "such"):
        done = whittle(tmp_path / "input-that-is-not-there", "-o", folder)
        assert done.returncode == 73 and "folder" in done.stderr, done
    for empty in (("-o", ""), ("--output=",)):
        assert whittle(tmp_path / "input", *empty).returncode == 64
    assert (tmp_path / "file").read_text() == "mine" and not (tmp_path / "no").exists()
