# SPDX-License-Identifier: GPL-3.0-or-later
"""HTTPS by certificate and key files, and their exchange while the service runs."""
import re
import shutil
import signal
import socket
import ssl
import subprocess

import pytest

from conftest import BUILD, SMALL, parse_reply, sphere, wait_until

pytestmark = pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")


def make_certificate(folder, name="localhost"):
    folder.mkdir(exist_ok=True)
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                    "-days", "2", "-subj", f"/CN={name}", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1",
                    "-keyout", folder / "key.pem", "-out", folder / "cert.pem"], check=True, capture_output=True)
    return folder / "cert.pem", folder / "key.pem"


@pytest.fixture(name="secure")
def make_secure(tmp_path, make_daemon):
    """A daemon with TLS, whose curl trusts its certificate."""
    cert, key = make_certificate(tmp_path / "tls")
    trusted = shutil.copy(cert, tmp_path / "trusted.pem")
    daemon = make_daemon("--tls-cert", cert, "--tls-key", key)
    daemon.curl_flags = ("--cacert", trusted)
    return daemon


def served_certificate(daemon):
    return ssl.get_server_certificate(("127.0.0.1", daemon.port))


def test_a_job_over_https(secure):
    data = sphere(5000)
    job_id = secure.submit(data, "?outputs=cloud,mesh,report")
    assert secure.ended(job_id)["status"] == "successful"
    for output in secure.curl(f"/v1/jobs/{job_id}/outputs").json["outputs"]:
        reply = secure.curl(output["href"])
        assert len(reply.body) == output["bytes"]
        part = secure.curl(output["href"], "-H", "Range: bytes=100-299")
        assert part.status == 206 and part.body == reply.body[100:300]
    events = secure.curl(f"/v1/jobs/{job_id}/events").body
    assert b"event: end" in events
    assert secure.post("/v1/simplify", SMALL).status == 200


@pytest.mark.parametrize("header", ["Content-Length: five", "Cookie: " + "a=b;" * 15000], ids=["length", "cookies"])
def test_what_the_library_would_refuse_twice_is_refused_once(secure, header):
    context = ssl.create_default_context(cafile=secure.curl_flags[1])
    with socket.create_connection(("127.0.0.1", secure.port), timeout=60) as plain, \
            context.wrap_socket(plain, server_hostname="localhost") as connection:
        connection.sendall(f"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\n{header}\r\n\r\n".encode())
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    assert answer.count(b"HTTP/1.1 4") == 1 and answer.startswith(b"HTTP/1.1 4")
    assert parse_reply(answer).slug == ("headers-too-large" if header.startswith("Cookie") else "malformed-request")


@pytest.mark.filterwarnings("ignore:ssl.TLSVersion")
def test_old_versions_and_plain_http_are_not_served(secure):
    with socket.create_connection(("127.0.0.1", secure.port), timeout=60) as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        try:
            assert not connection.recv(1000).startswith(b"HTTP/1.1 200")
        except ConnectionResetError:
            pass
    old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    old.check_hostname, old.verify_mode = False, ssl.CERT_NONE
    old.minimum_version, old.maximum_version = ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1
    with socket.create_connection(("127.0.0.1", secure.port), timeout=60) as connection:
        with pytest.raises((ssl.SSLError, OSError)):
            old.wrap_socket(connection)
    assert secure.curl("/healthz").status == 200


def test_a_handshake_that_does_not_come_is_cut(tmp_path, make_daemon):
    """It takes the time that the headers have."""
    cert, key = make_certificate(tmp_path / "tls")
    daemon = make_daemon("--tls-cert", cert, "--tls-key", key, "--header-timeout", "300ms")
    daemon.curl_flags = ("--cacert", cert)
    with socket.create_connection(("127.0.0.1", daemon.port), timeout=60) as connection:
        connection.sendall(b"\x16\x03\x01")
        assert connection.recv(1000) == b""
    assert daemon.curl("/healthz").status == 200


def test_sighup_exchanges_the_certificate(tmp_path, secure):
    before = served_certificate(secure)

    def hang_up(word):
        secure.process.send_signal(signal.SIGHUP)
        wait_until(lambda: word in secure.log_text(), word)
    make_certificate(tmp_path / "tls")
    hang_up("reload: the certificate is read")
    after = served_certificate(secure)
    assert after != before
    shutil.copy(tmp_path / "tls/cert.pem", tmp_path / "trusted.pem")
    assert secure.curl("/healthz").status == 200
    (tmp_path / "tls/key.pem").write_text("nonsense")
    hang_up("the certificate stays as it was: tls-key")
    assert served_certificate(secure) == after


def test_the_admin_listener_stays_plain(secure):
    url = secure.process.stdout.readline().split()[-1]
    assert url.startswith("http://127.0.0.1:")
    done = subprocess.run(["curl", "-sS", "-D", "-", f"{url}/healthz"], capture_output=True, check=True)
    assert parse_reply(done.stdout).status == 200


@pytest.mark.parametrize("case, word", [("missing", "tls-cert"), ("nonsense", "tls-cert"), ("pair", "is not the key of"),
                                        ("alone", "tls-key")])
def test_bad_certificates_end_the_start(tmp_path, case, word):
    cert, key = make_certificate(tmp_path / "a")
    if case == "pair":
        key = make_certificate(tmp_path / "b")[1]
    elif case == "nonsense":
        cert.write_text("nonsense")
    elif case == "missing":
        cert.unlink()
    flags = ["--tls-cert", cert] + ([] if case == "alone" else ["--tls-key", key])
    done = subprocess.run([BUILD / "whittled", "--data", tmp_path / "data", "--listen", "127.0.0.1:0", *flags],
                          capture_output=True, text=True, check=False)
    assert done.returncode in (1, 2) and word in done.stderr and not re.search("listening", done.stdout)


def handshake(port, *arguments):
    """What was negotiated, as openssl says it; None where the service refuses."""
    done = subprocess.run(["openssl", "s_client", "-connect", f"127.0.0.1:{port}", "-brief", *arguments], input=b"",
                          capture_output=True, check=False, timeout=60)
    found = re.search(rb"Ciphersuite: (\S+)", done.stderr)
    return found[1].decode() if found else None


@pytest.mark.parametrize("kind", ["rsa", "ec"])
def test_only_forward_secrecy_and_authenticated_encryption_are_negotiated(tmp_path, make_daemon, kind):
    cert, key = make_certificate(tmp_path / "tls")
    if kind == "rsa":
        subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost",
                        "-keyout", key, "-out", cert], check=True, capture_output=True)
    port = make_daemon("--tls-cert", cert, "--tls-key", key).port
    listed = subprocess.run(["openssl", "ciphers", "-tls1_2", "-s", "ALL:@SECLEVEL=0"], capture_output=True, text=True,
                            check=True).stdout.strip().split(":")
    taken = {cipher for cipher in listed if handshake(port, "-tls1_2", "-cipher", f"{cipher}:@SECLEVEL=0")}
    auth = "RSA" if kind == "rsa" else "ECDSA"
    assert taken == {f"ECDHE-{auth}-AES128-GCM-SHA256", f"ECDHE-{auth}-AES256-GCM-SHA384",
                     f"ECDHE-{auth}-CHACHA20-POLY1305"}
    assert {name: handshake(port, "-tls1_3", "-ciphersuites", name) for name in (
        "TLS_AES_256_GCM_SHA384", "TLS_CHACHA20_POLY1305_SHA256", "TLS_AES_128_GCM_SHA256")} == {
            name: name for name in ("TLS_AES_256_GCM_SHA384", "TLS_CHACHA20_POLY1305_SHA256", "TLS_AES_128_GCM_SHA256")}
