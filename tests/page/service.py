# SPDX-License-Identifier: GPL-3.0-or-later
"""A service with the page, for programs that look at it in a browser."""
import contextlib
import http.client
import json
import pathlib
import re
import subprocess
import tempfile
import urllib.request


@contextlib.contextmanager
def serving(build, *settings):
    """Runs a whittled of its own on a free port; gives its address, HOST:PORT."""
    with tempfile.TemporaryDirectory(prefix="page-") as folder:
        with subprocess.Popen([build / "whittled", "--listen", "127.0.0.1:0", "--data", pathlib.Path(folder, "data"), *settings],
                              text=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as daemon:
            try:
                found = re.match(r"listening on http://(\S+)", daemon.stdout.readline())
                if not found:
                    raise SystemExit("whittled doesn't start")
                yield found[1]
            finally:
                daemon.terminate()
                daemon.wait()


def job_of(address, cloud, query):
    """Runs a job on a file to its end; gives its id."""
    request = urllib.request.Request(f"http://{address}/v1/jobs?{query}", cloud.read_bytes(),
                                     {"Prefer": "wait=600", "Content-Type": "application/octet-stream"})
    with urllib.request.urlopen(request) as reply:
        job = json.load(reply)
    while job["status"] in ("accepted", "running"):
        connection = http.client.HTTPConnection(address)
        connection.request("GET", f"/v1/jobs/{job['id']}", headers={"Prefer": "wait=60"})
        job = json.load(connection.getresponse())
        connection.close()
    if job["status"] != "successful":
        raise SystemExit(f"the job ended as {job['status']}")
    return job["id"]
