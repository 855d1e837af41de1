# SPDX-License-Identifier: GPL-3.0-or-later
"""What the programs say of themselves: settings, manual pages, health."""
import os
import pathlib
import re
import shutil
import subprocess
import tempfile

import pytest

from conftest import BUILD, SMALL

WHITTLED = BUILD / "whittled"
PLAIN = {name: value for name, value in os.environ.items() if not name.startswith("WHITTLED_")}


def run(*arguments, program=WHITTLED, **environment):
    return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, env={**PLAIN, **environment},
                          check=False, timeout=60)


def settings_of(text):
    return dict(line.split(" = ", 1) for line in text.splitlines() if " = " in line and not line.startswith("#"))


def test_printed_settings_are_read_back_as_the_same(tmp_path):
    odd = run("--max-body-bytes", "3000000", "--retention", "90m", "--job-wall=1500ms", "--max-queue", "7", "--data",
              "a#b/c d", "--print-config", WHITTLED_SYNC_MAX="7200")
    assert odd.returncode == 0, odd.stderr
    settings = settings_of(odd.stdout)
    assert settings["max-body-bytes"] == "3000000" and settings["retention"] == "90m"
    assert settings["job-wall"] == "1500ms" and settings["sync-max"] == "2h" and settings["max-queue"] == "7"
    assert settings["data"] == "a#b/c d" and "config" not in settings
    file = tmp_path / "whittled.conf"
    file.write_text(odd.stdout)
    assert run("--config", file, "--print-config").stdout == odd.stdout


def test_every_setting_is_in_help_page_and_file():
    named = set(re.findall(r"^  --([a-z-]+)", run("--help").stdout, re.M)) - {"help", "version", "man", "config",
                                                                              "print-config", "check-config"}
    assert named == set(settings_of(run("--print-config").stdout))
    page = run("--man").stdout.replace("\\-", "-")
    assert all(f"--{name}" in page for name in named)


def test_whittles_page_has_what_its_help_has():
    flags = [set(re.findall(r"--[a-z][a-z_-]+", run(what, program=BUILD / "whittle").stdout.replace("\\-", "-")))
             for what in ("--help", "--man")]
    assert flags[0] == flags[1] and {"--ratio", "--outputs"} <= flags[0]


def test_check_says_what_is_wrong_and_serves_nothing(tmp_path):
    file = tmp_path / "bad.conf"
    file.write_text("max-queue = many\n")
    bad = run("--config", file, "--check-config")
    assert bad.returncode == 2 and "max-queue" in bad.stderr and "many" in bad.stderr
    file.write_text("# fine\nmax-queue = 5 # jobs\n")
    good = run("--config", file, "--check-config", "--data", tmp_path / "never-made")
    assert good.returncode == 0 and not (tmp_path / "never-made").exists()
    assert run("--check-config", WHITTLED_NO_SUCH="1").returncode == 2
    file.write_text("= 5\n")
    assert run("--config", file, "--check-config").stderr == "whittled: config: unknown setting in the file\n"


ADDRESSES = [("127.0.0.1:99999", "65535"), ("127.0.0.1:65536", "65535"), ("127.0.0.1:abc", "65535"), ("18095", "65535"),
             ("127.0.0.1:-1", "65535"), ("127.0.0.1:", "65535"), ("127.0.0.1: 80", "65535"), (":8080", "65535"),
             ("nosuchhost.invalid:1", "'nosuchhost.invalid:1': "), ("0.0.0.0:8080", "beyond loopback")]


@pytest.mark.parametrize("setting", ["listen", "admin-listen"])
@pytest.mark.parametrize("address, says", ADDRESSES)
def test_what_is_no_address_is_refused_beforehand_and_at_the_start(tmp_path, setting, address, says):
    given = [f"--{setting}", address, "--data", tmp_path / "data"]
    if setting == "admin-listen":
        given += ["--listen", "127.0.0.1:0"]
    for also in (["--check-config"], []):
        refused = run(*given, *also)
        assert refused.returncode == 2 and f"{setting}: " in refused.stderr and says in refused.stderr, refused.stderr


def test_health_and_metrics_have_a_port_of_their_own_or_the_start_is_refused(tmp_path):
    last = ["--listen", "127.0.0.1:65535", "--data", tmp_path / "data"]
    for also in (["--check-config"], []):
        refused = run(*last, *also)
        assert refused.returncode == 2 and "admin-listen: there is no port after listen's" in refused.stderr
    for address in ("off", "127.0.0.1:0", "[::1]:8081", "localhost:8081"):
        assert run(*last, "--admin-listen", address, "--check-config").returncode == 0


def test_files_that_settings_name_are_looked_at_beforehand(tmp_path):
    tokens, missing = tmp_path / "tokens", tmp_path / "missing"
    certificate, key, other = (tmp_path / name for name in ("cert.pem", "key.pem", "other.pem"))
    for name in (other, key):
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                        "-subj", "/CN=localhost", "-keyout", name, "-out", certificate], check=True, capture_output=True)
    tokens.write_text("# nobody\nalice:submit,write:" + "0" * 64 + "\n")
    for given, says in ((["--tokens-file", missing], f"can't read {missing}"),
                        (["--tokens-file", tokens], "line 2"),
                        (["--tls-cert", missing, "--tls-key", key], f"tls-cert: can't read {missing}"),
                        (["--tls-cert", certificate], "tls-key: "),
                        (["--tls-cert", certificate, "--tls-key", other], "is not the key of")):
        refused = run(*given, "--check-config")
        assert refused.returncode == 2 and says in refused.stderr and not refused.stdout, refused.stderr
    tokens.write_text("alice:submit,read:" + "0" * 64 + "\n")
    allowed = run("--tokens-file", tokens, "--tls-cert", certificate, "--tls-key", key, "--listen", "0.0.0.0:0",
                  "--check-config")
    assert (allowed.returncode, allowed.stdout) == (0, "the settings are allowed\n"), allowed.stderr


@pytest.mark.parametrize("flag, value, takes", [
    ("--max-uploads", "0", "a whole number from 1 to "),
    ("--max-parameters", "65", "a whole number from 1 to 64\n"),
    ("--refuse-drain-bytes", "1025G", "a size such as 512M, from 0 to 1T\n"),
    ("--refuse-drain-time", "2d", "a duration such as 30s, from 0 to 1d\n"),
    ("--worker-sandbox", "maybe", "on or off\n"),
])
def test_what_is_out_of_its_range_is_told_the_range(flag, value, takes):
    refused = run(f"{flag}={value}", "--check-config")
    assert refused.returncode == 2
    assert f"'{value}' is not allowed; it takes {takes}" in refused.stderr


@pytest.mark.parametrize("given, value", [
    (["--webhooks"], "1"), (["--webhooks", "1"], "1"), (["--webhooks", "on"], "1"), (["--webhooks", "off"], "0"),
    (["--webhooks=false"], "0"), ([], "0")])
def test_a_switch_is_given_alone_or_with_its_value(given, value):
    done = run(*given, "--max-queue", "7", "--print-config")
    assert done.returncode == 0, done.stderr
    settings = settings_of(done.stdout)
    assert (settings["webhooks"], settings["max-queue"]) == (value, "7")


@pytest.mark.parametrize("given, text", [
    (["--webhooks", "maybe"], "webhooks: 'maybe' is not allowed; it takes on or off"),
    (["--port", "8080"], "--port: unknown flag; did you mean '--listen'? see --help"),
    (["--token-file", "t"], "did you mean '--tokens-file'?"), (["--wrokers=2"], "did you mean '--workers'?"),
    (["--colour", "red"], "--colour: unknown flag; see --help"),
    (["data"], "data: no setting; settings are --name value, see --help"),
    (["--max-queue", "7", "8"], "8: no setting; settings are --name value, see --help")])
def test_what_is_no_setting_is_told_how_settings_are_given(given, text):
    refused = run(*given, "--check-config")
    assert refused.returncode == 2 and text in refused.stderr


def test_healthcheck(daemon):
    address = daemon.url.removeprefix("http://")
    assert run("healthcheck", "--url", f"{daemon.url}/healthz").returncode == 0
    assert run("healthcheck", "--url", daemon.url).returncode == 0
    assert run("healthcheck", "--listen", address).returncode == 0
    assert run("healthcheck", WHITTLED_LISTEN=f"0.0.0.0:{daemon.port}").returncode == 0
    assert run("healthcheck", "--url", f"{daemon.url}/nothing").returncode == 1
    daemon.stop()
    silent = run("healthcheck", "--listen", address)
    assert silent.returncode == 1 and "nobody answers" in silent.stderr
    assert run("healthcheck", "--url", "ftp://here").returncode == 1
    assert run("healthcheck", "--listen", "nowhere").returncode == 1


@pytest.mark.parametrize("program", ["whittle", "whittled"])
def test_manual_pages_have_no_faults(program, tmp_path):
    page = run("--man", program=BUILD / program).stdout
    parts = re.findall(r"^\.SH (.+)$", page, re.M)
    assert parts[:3] == ["NAME", "SYNOPSIS", "DESCRIPTION"] and "EXIT STATUS" in parts
    for line in page.splitlines():
        assert line and (not line.startswith(".") or re.match(r"\.(SH|TH|TP|PP|br|B|BR|RI|I|EX|EE|\\\") ?", line)), line
    if not shutil.which("groff") and not shutil.which("mandoc"):
        pytest.skip("neither groff nor mandoc is installed; looked at the page's text alone")
    file = tmp_path / "page"
    file.write_text(page)
    if shutil.which("groff"):
        told = subprocess.run(["groff", "-man", "-ww", "-z", "-Tutf8", file], capture_output=True, text=True, check=True)
        assert told.stderr == ""
    if shutil.which("mandoc"):
        told = subprocess.run(["mandoc", "-T", "lint", "-W", "warning", file], capture_output=True, text=True,
                              check=False)
        # A date would make two builds of the same source differ.
        assert [line for line in told.stdout.splitlines() if line.strip() and "missing date" not in line] == []


@pytest.mark.parametrize("url", ["mysql://host/db", "sqlite:", "/var/lib/whittled.db"])
def test_what_is_no_catalog_is_refused(url):
    refused = run("--catalog", url, "--check-config")
    assert refused.returncode == 2 and "catalog" in refused.stderr and "sqlite:/" in refused.stderr


def test_the_catalog_may_be_elsewhere(make_daemon, tmp_path):
    """A database outside of the data folder belongs to it all the same: it is found again, checked, and refused with
    another folder."""
    database = tmp_path / "state.db"
    daemon = make_daemon("--catalog", f"sqlite:{database}")
    job = daemon.submit(SMALL)
    assert daemon.ended(job)["status"] == "successful"
    assert daemon.stop() == 0
    assert database.stat().st_size > 0 and not (daemon.data / "whittled.db").exists()
    daemon.start()
    assert daemon.curl(f"/v1/jobs/{job}").json["status"] == "successful"
    assert daemon.stop() == 0
    checked = run("check", "--data", daemon.data, "--catalog", f"sqlite:{database}")
    assert checked.stdout == "checked 1 jobs, 1 clouds, 2 outputs: 0 damaged, 0 unfinished\n", checked.stdout
    other = run("--listen", "127.0.0.1:0", "--data", tmp_path / "other", "--catalog", f"sqlite:{database}")
    assert other.returncode == 1 and "is another folder's" in other.stderr, other.stderr


@pytest.mark.parametrize("url", ["ftp://host/", "file:", "/var/lib/whittled"])
def test_what_is_no_blob_store_is_refused(url):
    refused = run("--blobs", url, "--check-config")
    assert refused.returncode == 2 and "blobs" in refused.stderr and "file:/" in refused.stderr


@pytest.mark.parametrize("place", ["beside", "apart"])
def test_clouds_and_outputs_may_be_elsewhere(make_daemon, tmp_path, place):
    """In another folder, of the same file system and of another one: nothing of them is in the data folder."""
    folder = tmp_path / "blobs" if place == "beside" else pathlib.Path(tempfile.mkdtemp(dir="/dev/shm"))
    try:
        daemon = make_daemon("--blobs", f"file:{folder}")
        job = daemon.submit(SMALL)
        assert daemon.ended(job)["status"] == "successful"
        assert daemon.stop() == 0
        assert len(list((folder / "clouds").iterdir())) == 1 and not (daemon.data / "clouds").exists()
        assert [path.name for path in (daemon.data / "jobs" / job).iterdir()] == ["log"]
        daemon.start()
        outputs = daemon.curl(f"/v1/jobs/{job}/outputs").json["outputs"]
        assert outputs and all(daemon.curl(f"/v1/jobs/{job}/outputs/{o['name']}").status == 200 for o in outputs)
        again = daemon.submit(SMALL)
        assert daemon.curl(f"/v1/jobs/{again}").json["status"] == "successful"  # the first one's outputs are its too
        assert daemon.curl(f"/v1/jobs/{job}", "-X", "DELETE").status == 200
        assert not (folder / "jobs" / job).exists() and not (daemon.data / "jobs" / job).exists()
        assert daemon.stop() == 0
        checked = run("check", "--data", daemon.data, "--blobs", f"file:{folder}")
        assert checked.stdout == "checked 1 jobs, 1 clouds, 2 outputs: 0 damaged, 0 unfinished\n", checked.stdout
    finally:
        shutil.rmtree(folder, ignore_errors=True)
