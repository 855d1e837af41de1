# SPDX-License-Identifier: GPL-3.0-or-later
"""What others make of the contract: two linters, and a proxy that holds traffic against it.

They come from npm (`make test-contract` installs them into tests/node); without them these tests skip.
"""
import json
import os
import pathlib
import shutil
import socket
import subprocess

import pytest

from conftest import SMALL, parse_reply, wait_until
from tables import CONTRACT_FILE

NODE = pathlib.Path(__file__).parent.parent / "node"
PROGRAMS = NODE / "node_modules/.bin"
QUIET = {**os.environ, "REDOCLY_TELEMETRY": "off", "SCARF_ANALYTICS": "false", "NO_COLOR": "1", "CI": "1"}

pytestmark = pytest.mark.skipif(not (PROGRAMS / "prism").exists() or not shutil.which("node"),
                                reason="node, or what make test-contract installs into tests/node, is not there")


def run(*command, cwd=NODE):
    return subprocess.run(command, cwd=cwd, env=QUIET, capture_output=True, text=True, check=False, timeout=600)


def test_redocly_finds_nothing(tmp_path):
    for name in ("redocly.yaml", ".redocly.lint-ignore.yaml"):  # which names the document beside it
        shutil.copy(NODE / name, tmp_path)
    shutil.copy(CONTRACT_FILE, tmp_path)
    done = run(PROGRAMS / "redocly", "lint", "openapi.json", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


def test_spectral_finds_nothing():
    done = run(PROGRAMS / "spectral", "lint", "--fail-severity=hint", CONTRACT_FILE)
    assert done.returncode == 0, done.stdout + done.stderr


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@pytest.fixture(name="proxied")
def make_proxied(daemon, tmp_path):
    """Sends by way of prism, which answers itself where request or reply are not as described."""
    port = free_port()
    log = tmp_path / "prism.log"
    with open(log, "wb") as out:
        process = subprocess.Popen([PROGRAMS / "prism", "proxy", CONTRACT_FILE, daemon.url, "--port",
                                    str(port), "--errors"], cwd=NODE, env=QUIET, stdout=out, stderr=out)
    url = f"http://127.0.0.1:{port}"

    def curl(path, *arguments, data=None):
        done = subprocess.run(["curl", "-sS", "--max-time", "60", "-D", "-", "-H", "Authorization: Bearer any", "-H",
                               "Expect:", *map(str, arguments), url + path], input=data, capture_output=True,
                              check=False)
        assert done.returncode == 0, done.stderr
        reply = parse_reply(done.stdout)
        assert b"stoplight.io/prism" not in reply.body, reply.body.decode(errors="replace")
        assert "sl-violations" not in reply.headers, reply.headers["sl-violations"]
        return reply

    def listens():
        assert process.poll() is None, log.read_text()
        return subprocess.run(["curl", "-so", "/dev/null", f"{url}/healthz"], check=False).returncode == 0
    wait_until(listens, "prism")
    yield curl
    process.terminate()
    process.wait(60)


def test_the_main_traffic_is_as_described(daemon, proxied):
    binary = ("--data-binary", "@-", "-H", "Content-Type: application/octet-stream")

    created = proxied("/v1/jobs?ratio=0.5&outputs=cloud&outputs=mesh&label=ball", *binary, "-H", "Idempotency-Key: k", data=SMALL)
    assert created.status == 201
    job_id = created.json["id"]
    daemon.ended(job_id)
    etag = proxied(f"/v1/jobs/{job_id}").headers["etag"]
    assert proxied(f"/v1/jobs/{job_id}", "-H", f"If-None-Match: {etag}").status == 304
    assert proxied("/v1/jobs?limit=1&status=successful&label=ball").json["jobs"][0]["id"] == job_id
    assert len(proxied(f"/v1/jobs/{job_id}/outputs").json["outputs"]) == 3
    assert proxied(f"/v1/jobs/{job_id}/outputs/report.json").json["points_out"] == 150
    assert proxied(f"/v1/jobs/{job_id}/outputs/cloud.ply?points=9").body.startswith(b"ply")
    assert proxied(f"/v1/jobs/{job_id}/outputs/mesh.ply", "-H", "Range: bytes=0-2").body == b"ply"
    assert proxied(f"/v1/jobs/{job_id}/log").status == 200

    cloud = proxied("/v1/clouds", *binary, data=SMALL).json["id"]
    assert proxied("/v1/clouds").json["clouds"][0]["id"] == cloud
    by_name = json.dumps({"params": {"ratio": 0.5, "outputs": ["cloud", "mesh"]}})
    again = proxied(f"/v1/clouds/{cloud}/jobs", "--data-binary", "@-", "-H", "Content-Type: application/json", data=by_name.encode())
    assert again.status == 201 and again.headers["cache-status"] == "whittled; hit"
    assert proxied("/v1/simplify?ratio=0.2", *binary, data=SMALL).status == 200

    assert proxied("/v1/jobs/01900000-0000-7000-8000-000000000000").status == 404
    assert proxied("/v1/simplify?points=2&ratio=0.5", *binary, data=SMALL).status == 400
    assert proxied(f"/v1/jobs/{job_id}", "-X", "DELETE").status == 200
    assert proxied(f"/v1/jobs/{job_id}").status == 410
    for path in ("/v1/info", "/v1/parameters", "/openapi.json", "/readyz", "/problems/no-such-job"):
        assert proxied(path).status == 200
