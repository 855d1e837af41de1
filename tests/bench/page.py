#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a person waits for who opens a large result in a browser.

Usage: page.py BUILD_FOLDER [--points 1000000] [--picture FILE]

Runs a daemon with the page (make page) and a job on a synthetic scan, opens that in Debian's chromium without a graphics
processor (SwiftShader, so figures are far above those of other machines), and prints as JSON: bytes and milliseconds
to the first view and until all is there; the page's longest task by the clock and by the processor time that it took
(on a busy machine the first one says more of the machine); frames while it turns; the page's memory.
"""
import argparse
import http.client
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import urllib.request

TESTS = pathlib.Path(__file__).parent.parent


def started(build, folder):
    """A daemon on a free port, and its address."""
    daemon = subprocess.Popen([build / "whittled", "--listen", "127.0.0.1:0", "--data", folder], text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    for line in daemon.stdout:
        found = re.match(r"listening on http://(\S+)", line)
        if found:
            return daemon, found[1]
    sys.exit("whittled doesn't start")


def job_of(address, cloud):
    request = urllib.request.Request(f"http://{address}/v1/jobs?ratio=0.1&outputs=cloud,error", cloud.read_bytes(),
                                     {"Prefer": "wait=600", "Content-Type": "application/octet-stream"})
    with urllib.request.urlopen(request) as reply:
        job = json.load(reply)
    while job["status"] in ("accepted", "running"):
        connection = http.client.HTTPConnection(address)
        connection.request("GET", f"/v1/jobs/{job['id']}", headers={"Prefer": "wait=60"})
        job = json.load(connection.getresponse())
        connection.close()
    if job["status"] != "successful":
        sys.exit(f"the job ended as {job['status']}")
    return job["id"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--points", type=int, default=1000000)
    parser.add_argument("--picture", type=pathlib.Path, help="a screenshot is written there")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench-page-") as folder:
        cloud = pathlib.Path(folder, "scan.ply")
        with open(cloud, "wb") as out:
            subprocess.run([arguments.build / "tests/bench/make_scan", str(arguments.points)], stdout=out, check=True)
        daemon, address = started(arguments.build, pathlib.Path(folder, "data"))
        try:
            url = f"http://{address}/jobs/{job_of(address, cloud)}"
            picture = [arguments.picture] if arguments.picture else []
            subprocess.run(["node", TESTS / "page/measure.js", shutil.which("chromium"), url, *picture], check=True)
        finally:
            daemon.terminate()
            daemon.wait()


if __name__ == "__main__":
    main()
