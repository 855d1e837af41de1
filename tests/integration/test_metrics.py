# SPDX-License-Identifier: GPL-3.0-or-later
"""What the service counts, and that health comes on a listener of its own."""
import re
import shutil
import socket
import subprocess

import pytest

from conftest import SMALL, parse_reply, wait_until


def admin_url(daemon):
    line = daemon.process.stdout.readline()
    assert line.startswith("health and metrics on http://127.0.0.1:"), line
    return line.split()[-1]


def fetch(url):
    done = subprocess.run(["curl", "-sS", "-D", "-", "--max-time", "60", url], capture_output=True, check=True)
    return parse_reply(done.stdout)


def samples(text):
    """name{labels} -> value."""
    return {m[1]: float(m[2]) for m in re.finditer(r"^(whittled_\S+(?:\{.*\})?) (\S+)$", text, re.M)}


def scrape(daemon):
    return samples(daemon.curl("/metrics").body.decode())


def test_jobs_and_requests_are_counted(daemon):
    job_id = daemon.submit(SMALL)
    daemon.ended(job_id)
    daemon.post("/v1/jobs?ratio=7", SMALL)
    daemon.curl("/nowhere")
    wait_until(lambda: scrape(daemon).get('whittled_http_requests_total{method="other",route="none",code="404"}'), "404")
    now = scrape(daemon)
    assert now['whittled_http_requests_total{method="POST",route="/v1/jobs",code="201"}'] == 1
    assert now['whittled_http_requests_total{method="POST",route="/v1/jobs",code="400"}'] == 1
    assert now['whittled_problems_total{problem="invalid-parameter"}'] == 1
    assert now['whittled_http_request_duration_seconds_count{method="POST",route="/v1/jobs"}'] == 2
    assert now["whittled_http_request_body_bytes_total"] >= len(SMALL)
    assert now["whittled_jobs_submitted_total"] == 1
    assert now['whittled_job_runs_total{outcome="successful"}'] == 1
    assert now["whittled_worker_cpu_seconds_total"] > 0 and now["whittled_process_resident_memory_bytes"] > 1e6
    assert now['whittled_jobs{state="running"}'] == now['whittled_jobs{state="accepted"}'] == 0
    assert now["whittled_disk_free_bytes"] > 0 and now["whittled_http_connections"] >= 1


def test_a_histogram_grows_from_bucket_to_bucket(daemon):
    for _ in range(3):
        daemon.curl("/v1/jobs")
    text = daemon.curl("/metrics").body.decode()
    buckets = [float(v) for v in re.findall(r'duration_seconds_bucket\{method="GET",route="/v1/jobs",le="[^"]+"\} (\d+)', text)]
    assert len(buckets) == 14 and buckets == sorted(buckets) and buckets[-1] == 3


def test_nobody_can_make_new_series(daemon):
    daemon.curl("/x", "-X", "M")
    wait_until(lambda: any("none" in name for name in scrape(daemon)), "the request's series")
    before = set(scrape(daemon))
    for i in range(5):
        daemon.curl(f"/x{i}", "-X", f"M{i}")
    assert set(scrape(daemon)) == before


@pytest.mark.skipif(not shutil.which("promtool"), reason="promtool (Debian package prometheus) is not installed")
def test_promtool_finds_nothing_wrong(daemon):
    daemon.submit(SMALL)
    text = daemon.curl("/metrics").body
    done = subprocess.run(["promtool", "check", "metrics"], input=text, capture_output=True, check=False)
    assert done.returncode == 0 and not done.stderr, done.stderr


def test_the_admin_listener_serves_health_and_metrics_alone(daemon):
    url = admin_url(daemon)
    for path in ("/healthz", "/readyz", "/metrics"):
        assert fetch(url + path).status == 200
    for path in ("/", "/v1/jobs", "/v1/info", "/openapi.json"):
        assert fetch(url + path).slug == "no-such-resource"


def test_the_admin_listener_answers_when_the_other_is_full(make_daemon):
    daemon = make_daemon("--max-connections", "8", "--connections-per-address", "8")
    url = admin_url(daemon)
    held = [socket.create_connection(("127.0.0.1", daemon.port)) for _ in range(40)]
    assert fetch(url + "/healthz").status == 200
    assert samples(fetch(url + "/metrics").body.decode())["whittled_http_connections"] <= 10
    for connection in held:
        connection.close()


def test_metrics_want_a_token_where_there_are_tokens_but_not_on_the_admin_listener(make_daemon, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text("a:read:" + "0" * 64 + "\n")
    daemon = make_daemon("--tokens-file", tokens)
    assert daemon.curl("/metrics").status == 401
    assert fetch(admin_url(daemon) + "/metrics").status == 200


def test_the_admin_listener_can_be_off_or_elsewhere(make_daemon, tmp_path):
    daemon = make_daemon("--admin-listen", "off")
    assert daemon.curl("/healthz").status == 200
    assert daemon.stop() == 0 and daemon.process.stdout.read() == ""
    whittled = daemon.process.args[0]
    for address, word in (("0.0.0.0:0", "--insecure-open"), ("nonsense", "HOST:PORT")):
        done = subprocess.run([whittled, "--data", tmp_path / "d", "--listen", "127.0.0.1:0", "--admin-listen", address],
                              capture_output=True, text=True, check=False)
        assert done.returncode == 2 and word in done.stderr


def test_the_port_after_the_main_one_is_taken_by_itself(daemon, tmp_path):
    """Two sockets next to each other, found by trying."""
    def pair():
        with socket.socket() as main, socket.socket() as admin:
            main.bind(("127.0.0.1", 0))
            try:
                admin.bind(("127.0.0.1", main.getsockname()[1] + 1))
            except OSError:
                return None
            return main.getsockname()[1]
    port = wait_until(pair, "two free ports")
    process = subprocess.Popen([daemon.process.args[0], "--data", tmp_path / "d", "--listen", f"127.0.0.1:{port}"],
                               stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert [process.stdout.readline().rsplit(":", 1)[1].strip() for _ in range(2)] == [str(port), str(port + 1)]
    finally:
        process.kill()
        process.wait()
