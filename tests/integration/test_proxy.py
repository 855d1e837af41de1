# SPDX-License-Identifier: GPL-3.0-or-later
"""The nginx configuration of deploy/nginx, run by Debian's nginx in front of a daemon: TLS, uploads, events, ranges,
limits.  Only ports, paths and certificates are put in their places.  Under a prefix: test_prefix.py."""
import json
import pathlib
import shutil
import socket
import subprocess

import pytest

import conftest

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
FILES = pathlib.Path(__file__).resolve().parents[2] / "deploy" / "nginx"
pytestmark = pytest.mark.skipif(not NGINX or not shutil.which("openssl"), reason="nginx and openssl aren't installed")
MAIN = """
daemon off; master_process off; pid {folder}/pid; error_log {folder}/error.log notice;
events {{ worker_connections 256; }}
http {{
    access_log off;
    client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
    include {folder}/conf.d/*.conf;
}}
"""


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Proxy(conftest.Daemon):
    """nginx with the files of deploy/nginx; curl goes to it, over TLS."""

    def __init__(self, folder, upstream, **changes):
        super().__init__(folder)
        self.plain_port, self.tls_port = free_port(), free_port()
        (folder / "conf.d").mkdir(parents=True)
        (folder / "snippets").mkdir()
        replaced = {"listen 80;": f"listen 127.0.0.1:{self.plain_port};", "listen [::]:80;": "",
                    "listen 443 ssl http2;": f"listen 127.0.0.1:{self.tls_port} ssl http2;",
                    "listen [::]:443 ssl http2;": "", "/etc/nginx/whittled/": f"{folder}/",
                    "127.0.0.1:8080": f"127.0.0.1:{upstream}", **changes}
        for name, place in (("upstream.conf", "conf.d"), ("whittled.conf", "conf.d"),
                            ("whittled-proxy.conf", "snippets")):
            text = (FILES / name).read_text()
            for old, new in replaced.items():
                text = text.replace(old, new)
            (folder / place / name).write_text(text)
        (folder / "nginx.conf").write_text(MAIN.format(folder=folder))
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1",
                        "-nodes", "-days", "2", "-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1",
                        "-keyout", folder / "tls.key", "-out", folder / "tls.crt"], check=True, capture_output=True)
        self.url = f"https://127.0.0.1:{self.tls_port}"
        self.log = folder / "error.log"
        self.log.touch()

    def start(self, *_):
        self.process = subprocess.Popen([NGINX, "-p", self.folder, "-c", self.folder / "nginx.conf"],
                                        stderr=subprocess.PIPE, text=True)

        def listens():
            assert self.process.poll() is None, self.process.stderr.read() + self.log_text()
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", self.tls_port)) == 0
        conftest.wait_until(listens, "nginx")
        return self

    def curl_command(self, path, *arguments):
        return super().curl_command(path, "--cacert", self.folder / "tls.crt", "--http1.1", *arguments)


@pytest.fixture(name="proxy")
def make_proxy(daemon, tmp_path):
    proxy = Proxy(tmp_path / "nginx", daemon.port).start()
    yield proxy
    proxy.stop()
    print(proxy.log_text()[-5000:])


def done_job(proxy):
    reply = proxy.post("/v1/jobs?points=50&outputs=cloud,mesh,report", conftest.SMALL)
    assert reply.status == 201, reply.body
    where = reply.headers["location"]
    conftest.wait_until(lambda: proxy.curl(where).json["status"] == "successful", "the job")
    return where


def test_plain_http_is_sent_to_tls(proxy):
    reply = conftest.parse_reply(subprocess.run(
        ["curl", "-sS", "-D", "-", f"http://127.0.0.1:{proxy.plain_port}/v1/info"], capture_output=True,
        check=True).stdout)
    assert reply.status == 308 and reply.headers["location"] == "https://127.0.0.1/v1/info"


def test_the_main_job_goes_over_tls(proxy):
    where = done_job(proxy)
    assert where.startswith("/v1/jobs/")
    assert b"end_header" in proxy.curl(where + "/outputs/mesh.ply").body
    assert "max-age" in proxy.curl("/v1/info").headers["strict-transport-security"]


def test_http_2_is_spoken(proxy):
    done = subprocess.run(["curl", "-sS", "--http2", "--cacert", proxy.folder / "tls.crt", "-o", "/dev/null", "-w",
                           "%{http_version}", proxy.url + "/v1/info"], capture_output=True, text=True, check=True)
    assert done.stdout == "2"


def test_metrics_are_not_for_everyone(proxy, daemon):
    assert daemon.curl("/metrics").status == 200
    assert proxy.curl("/metrics").status == proxy.curl("/whittle/metrics").status == 404


def test_events_come_while_the_job_runs(proxy, daemon, large):
    job = proxy.post("/v1/jobs?ratio=0.1", large).json["id"]
    with subprocess.Popen(proxy.curl_command(f"/v1/jobs/{job}/events", "-N"), stdout=subprocess.PIPE,
                          text=True) as events:
        for line in events.stdout:
            if line.startswith("event: progress"):
                break
        assert daemon.job(job)["status"] == "running", "the event came after the job's end"
        assert proxy.curl(f"/v1/jobs/{job}", "-X", "DELETE").json["status"] == "dismissed"
        rest = events.stdout.read()
    assert "event: end" in rest


@pytest.mark.parametrize("range_, status, length", [("0-99", 206, 100), ("-10", 206, 10), ("999999999-", 416, None)])
def test_ranges_pass(proxy, daemon, range_, status, length):
    path = done_job(proxy) + "/outputs/cloud.ply"
    reply = proxy.curl(path, "-H", f"Range: bytes={range_}")
    assert reply.status == status
    if length:
        whole = daemon.curl(path).body
        assert reply.body == (whole[:100] if range_ == "0-99" else whole[-10:])
        assert reply.headers["content-range"].endswith(f"/{len(whole)}")


def fat_cloud(megabytes):
    """Few points with many properties."""
    count, properties = megabytes * 1024, 128
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    names = ["x", "y", "z"] + [f"p{i}" for i in range(properties - 3)]
    header += "".join(f"property double {name}\n" for name in names) + "end_header\n"
    return header.encode() + bytes(count * properties * 8)


def test_a_large_upload_passes_without_being_kept_by_the_proxy(proxy):
    body = fat_cloud(96)
    reply = proxy.post("/v1/jobs?points=10", body)
    assert reply.status == 201 and reply.json["input"]["bytes"] == len(body)
    assert not [p for p in (proxy.folder / "body").rglob("*") if p.is_file()]
    assert "buffered to a temporary file" not in proxy.log_text()


def test_a_body_over_the_limit_is_a_problem_document(daemon, tmp_path):
    proxy = Proxy(tmp_path / "nginx", daemon.port, **{"client_max_body_size 2g": "client_max_body_size 1m"}).start()
    try:
        reply = proxy.curl("/v1/jobs", "-X", "POST", "--data-binary", "@-", data=bytes(3 << 20))
        assert reply.status == 413 and reply.slug == "body-too-large"
    finally:
        proxy.stop()


def test_a_service_that_is_away_is_a_problem_document(proxy, daemon):
    daemon.stop()
    reply = proxy.curl("/v1/info")
    assert reply.status == 503 and json.loads(reply.body)["status"] == 503
    assert reply.headers["retry-after"] == "5"
