#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the service costs beside the work itself, with nginx on the same machine in the same run as the measure.

Usage: overhead.py BUILD_FOLDER [--seconds 4] [--megabytes 256]

Prints the time from POST to the finished output of a trivial job (median), the requests a second of GET /v1/jobs/{id}
against nginx serving a file of the same size (wrk, 32 connections), and the throughput of an upload and a download
against nginx's (curl).  Rounds alternate between the two servers; ratios are of medians, and of the best.  The two
don't do the same for an upload: nginx answers when the bytes are in the page cache, whittled when they are hashed and
on the disk, so what it costs to copy and flush such a file is told too.  No upload has content that is there already.
Wants nginx-light, wrk and curl (Debian's).  Both servers bind loopback, on free ports, in a temporary folder, and end
with this program.
"""
import argparse
import contextlib
import http.client
import json
import os
import pathlib
import re
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time

ROUNDS = 9
NGINX = """
daemon off; pid {root}/nginx.pid; error_log {root}/nginx.log; worker_processes 2; {user}
events {{ worker_connections 1024; }}
http {{
    access_log off; sendfile on; keepalive_requests 100000000; types {{}} default_type application/json;
    client_body_temp_path {root}/t1; proxy_temp_path {root}/t2; fastcgi_temp_path {root}/t3; uwsgi_temp_path {root}/t4;
    scgi_temp_path {root}/t5;
    server {{
        listen 127.0.0.1:{port}; root {root}/www; client_max_body_size 0;
        location /put/ {{ dav_methods PUT; create_full_put_path on; }}
    }}
}}
"""


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def process(*command, **options):
    """A program that ends with the block."""
    running = subprocess.Popen([str(part) for part in command], stderr=subprocess.DEVNULL, **options)
    try:
        yield running
    finally:
        running.terminate()
        running.wait()


@contextlib.contextmanager
def nginx(root):
    port = free_port()
    (root / "www/put").mkdir(parents=True)
    conf = root / "nginx.conf"
    conf.write_text(NGINX.format(root=root, port=port, user="user root;" if os.geteuid() == 0 else ""))
    with process("nginx", "-c", conf, "-e", root / "nginx.log"):
        wait_for(port)
        yield f"http://127.0.0.1:{port}"


def wait_for(port):
    end = time.monotonic() + 20
    while time.monotonic() < end:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)):
            return
        time.sleep(0.01)
    sys.exit(f"nothing listens on port {port}")


@contextlib.contextmanager
def whittled(build, root):
    # What is measured is the cost of a job, not of finding an earlier one's outputs again.
    with process(build / "whittled", "--listen", "127.0.0.1:0", "--data", root / "data", "--admin-listen", "off",
                 "--result-cache=0", stdout=subprocess.PIPE, text=True) as daemon:
        yield re.search(r"http://[0-9.:]+", daemon.stdout.readline()).group()


def ask(connection, method, path, body=None):
    connection.request(method, path, body)
    reply = connection.getresponse()
    data = reply.read()
    if reply.status >= 300:
        sys.exit(f"{method} {path}: {reply.status} {data[:300]!r}")
    return data


def trivial_jobs(url, count=60):
    """Milliseconds of each one-shot job over a cloud of eight points, on one connection."""
    corners = "".join(f"{x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)).encode()
    connection = http.client.HTTPConnection(url.removeprefix("http://"))
    times = []
    for _ in range(count):
        start = time.monotonic()
        ask(connection, "POST", "/v1/simplify?points=4", corners)
        times.append((time.monotonic() - start) * 1e3)
    return times


def finished_job(url):
    connection = http.client.HTTPConnection(url.removeprefix("http://"))
    ask(connection, "POST", "/v1/simplify?points=4", b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 1\n")
    job = json.loads(ask(connection, "GET", "/v1/jobs"))["jobs"][0]
    return f"/v1/jobs/{job['id']}", ask(connection, "GET", f"/v1/jobs/{job['id']}")


def requests_a_second(url, seconds):
    told = subprocess.run(["wrk", "-t2", "-c32", f"-d{seconds}s", url], capture_output=True, text=True, check=True)
    if "Non-2xx" in told.stdout:
        sys.exit(told.stdout)
    return float(re.search(r"Requests/sec:\s*([0-9.]+)", told.stdout).group(1))


def bytes_a_second(kind, url, *flags):
    told = subprocess.run(["curl", "-fsS", "-o", "/dev/null", "-w", f"%{{speed_{kind}}}", *flags, url],
                          capture_output=True, text=True, check=True)
    return float(told.stdout)


def against(name, unit, scale, ours, theirs):
    """Prints the medians of both, measured in turns."""
    columns = list(zip(*((ours(i), theirs(i)) for i in range(ROUNDS))))
    (mine, peer), (top, peer_top) = ([what(column) / scale for column in columns] for what in (statistics.median, max))
    print(f"{name:28s} whittled {mine:9.0f} {unit}   nginx {peer:9.0f} {unit}   ratio {mine / peer:.2f}, "
          f"of the best {top / peer_top:.2f}", flush=True)


def big_cloud(path, megabytes):
    """A binary PLY of that size; its points are distinct but mean nothing."""
    points = megabytes * 1024 * 1024 // 12
    with open(path, "wb") as out:
        out.write(b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
                  b"property float z\nend_header\n" % points)
        block = bytes(range(1, 61)) * 20000
        left = points * 12
        while left:
            left -= out.write(block[:left])
        return out.tell()


def change(path):
    """Gives the file other bytes at its end."""
    with open(path, "r+b") as file:
        file.seek(-12, os.SEEK_END)
        file.write(os.urandom(12))


def copies_a_second(path, copy):
    """Bytes a second of copying a file and flushing the copy."""
    start = time.monotonic()
    with open(path, "rb") as source, open(copy, "wb") as target:
        while os.sendfile(target.fileno(), source.fileno(), None, 1 << 20):
            pass
        os.fsync(target.fileno())
    return os.path.getsize(copy) / (time.monotonic() - start)


def uploads(url, peer, cloud, spare):
    def ours(_):
        change(cloud)
        return bytes_a_second("upload", f"{url}/v1/clouds", "-X", "POST", "-T", str(cloud))

    against("upload", "MB/s", 1e6, ours, lambda i: bytes_a_second("upload", f"{peer}/put/{i}", "-T", str(cloud)))
    copied = statistics.median(copies_a_second(cloud, spare) for _ in range(ROUNDS)) / 1e6
    print(f"{'copying it and fsync':28s} {copied:18.0f} MB/s", flush=True)


def downloads(url, peer, cloud, served):
    told = subprocess.run(["curl", "-fsS", "-X", "POST", "-T", str(cloud), f"{url}/v1/clouds"], capture_output=True,
                          text=True, check=True).stdout
    stored = json.loads(told)["id"]
    os.link(cloud, served)
    against("download", "MB/s", 1e6, lambda _: bytes_a_second("download", f"{url}/v1/clouds/{stored}/data"),
            lambda _: bytes_a_second("download", f"{peer}/{served.name}"))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--seconds", type=int, default=4)
    parser.add_argument("--megabytes", type=int, default=256)
    chosen = parser.parse_args()
    for wanted in ("nginx", "wrk", "curl"):
        if not shutil.which(wanted):
            sys.exit(f"{wanted} is missing: make overhead installs it")
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        with nginx(root) as peer, whittled(chosen.build.resolve(), root) as url:
            times = trivial_jobs(url)
            print(f"{'trivial job, one shot':28s} median {statistics.median(times):.1f} ms, "
                  f"fastest {min(times):.1f}, slowest {max(times):.1f}", flush=True)
            path, document = finished_job(url)
            (root / "www/job").write_bytes(document)
            against(f"GET a job ({len(document)} bytes)", "/s", 1, lambda _: requests_a_second(url + path, chosen.seconds),
                    lambda _: requests_a_second(peer + "/job", chosen.seconds))
            cloud = root / "big.ply"
            big_cloud(cloud, chosen.megabytes)
            uploads(url, peer, cloud, root / "copy.ply")
            downloads(url, peer, cloud, root / "www/big.ply")


if __name__ == "__main__":
    main()
