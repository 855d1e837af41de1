# SPDX-License-Identifier: GPL-3.0-or-later
"""The image: deploy/Dockerfile built by buildah upon a Debian of mmdebstrap's, turned into a bundle by umoci, and run by
runc as the image says: not as root, with a read-only root and one volume."""
import gzip
import json
import os
import pathlib
import shutil
import subprocess
import time

import pytest

from conftest import ROOT, answers, main_job, need, need_root, report_of, run, say, wait_until

MOST_COMPRESSED_MB = 100
UID = 10001


class Store:
    """buildah with a store of its own."""

    def __init__(self, folder):
        self.base = ["buildah", "--root", folder / "root", "--runroot", folder / "run", "--storage-driver",
                     "overlay" if overlay_works(folder) else "vfs"]

    def __call__(self, *command):
        return run(*self.base, *command)


def overlay_works(folder):
    probe = folder / "probe"
    for name in ("lower", "upper", "work", "merged"):
        (probe / name).mkdir(parents=True)
    options = f"lowerdir={probe}/lower,upperdir={probe}/upper,workdir={probe}/work"
    done = subprocess.run(["unshare", "--mount", "mount", "-t", "overlay", "overlay", "-o", options, probe / "merged"],
                          capture_output=True, check=False)
    return done.returncode == 0


@pytest.fixture(name="image", scope="session")
def make_image(debian, tmp_path_factory):
    """The built image as an OCI folder, and its configuration."""
    need_root()
    need("buildah", "umoci", "runc")
    folder = tmp_path_factory.mktemp("image")
    began = time.monotonic()
    buildah = Store(folder)
    scratch = buildah("from", "scratch")
    buildah("add", scratch, debian, "/")
    buildah("commit", "--rm", scratch, "docker.io/library/debian:12-slim")
    run(ROOT / "deploy/dist.sh", folder / "source")
    source = next(p for p in (folder / "source").iterdir() if p.is_dir())
    buildah("build", "--pull-never", "--isolation", "chroot", "--format", "docker", "--layers=false", "-f",
            source / "deploy/Dockerfile", "-t", "whittle", source)
    config = json.loads(buildah("inspect", "--type", "image", "whittle"))["Docker"]["config"]
    buildah("push", "whittle", f"oci:{folder}/oci:whittle")
    say(f"the image of deploy/Dockerfile in {time.monotonic() - began:.0f} s")
    yield folder / "oci", config
    shutil.rmtree(folder, ignore_errors=True)


def test_it_is_small(image):
    oci, _ = image
    blobs = sum(p.stat().st_size for p in (oci / "blobs/sha256").iterdir())
    say(f"{blobs / 1e6:.1f} MB compressed")
    assert blobs < MOST_COMPRESSED_MB * 1e6


def test_its_configuration_says_how_to_run_it(image):
    _, config = image
    assert config["User"] == f"{UID}:{UID}" and config["StopSignal"] == "SIGTERM"
    assert list(config["Volumes"]) == ["/data"]
    assert config["Healthcheck"]["Test"] == ["CMD", "/usr/bin/whittled", "healthcheck"]
    assert config["Entrypoint"][0].endswith("/tini")


class Container:
    """The image, run by runc on the host's network with a data folder as its volume."""

    def __init__(self, oci, config, folder):
        self.folder, self.config = folder, config
        self.name = f"whittle-test-{os.getpid()}-{folder.name}"
        self.data = folder / "data"
        self.data.mkdir()
        os.chown(self.data, UID, UID)
        self.runc = ["runc", "--root", folder / "state"]
        run("umoci", "unpack", "--image", f"{oci}:whittle", folder / "bundle")
        path = folder / "bundle/config.json"
        spec = json.loads(path.read_text())
        process = spec["process"]
        process.update(terminal=False, noNewPrivileges=True, capabilities={}, args=[
            *config["Entrypoint"], *config["Cmd"], "--listen", "127.0.0.1:0"])
        assert process["user"]["uid"] == UID and process["user"]["gid"] == UID
        spec["root"]["readonly"] = True
        spec["linux"]["namespaces"] = [{"type": t} for t in ("pid", "ipc", "uts", "mount")]
        spec["linux"].pop("resources", None)
        spec["mounts"] = [m for m in spec["mounts"] if m["destination"] not in ("/data", "/etc/resolv.conf")]
        spec["mounts"].append({"destination": "/data", "type": "bind", "source": str(self.data),
                               "options": ["rbind", "rw", "nosuid", "nodev", "noexec"]})
        path.write_text(json.dumps(spec))

    def start(self):
        self.log = open(self.folder / "log", "ab")
        self.process = subprocess.Popen([*self.runc, "run", "--bundle", self.folder / "bundle", self.name],
                                        stdout=subprocess.PIPE, stderr=self.log, stdin=subprocess.DEVNULL, text=True)
        line = self.process.stdout.readline()
        if not line.startswith("listening on"):
            why = (self.folder / "log").read_text()
            assert "runc" not in why, pytest.skip(f"runc can't run here: {why[-300:]}")
            raise AssertionError(why)
        self.url = line.split()[-1]
        return self

    def execute(self, *command):
        return subprocess.run([*self.runc, "exec", self.name, *command], capture_output=True, text=True, check=False)

    def stop(self):
        run(*self.runc, "kill", self.name, self.config["StopSignal"])
        status = self.process.wait(90)
        self.log.close()
        return status


@pytest.fixture(name="container")
def make_container(image, tmp_path):
    container = Container(*image, tmp_path)
    yield container
    if container.process.poll() is None:
        subprocess.run([*container.runc, "kill", container.name, "KILL"], check=False)
        container.process.wait(30)
    subprocess.run([*container.runc, "delete", "--force", container.name], capture_output=True, check=False)


def test_it_does_the_main_job_stops_cleanly_and_keeps_its_data(container, scan):
    container.start()
    mine = json.loads(run(*container.runc, "state", container.name))
    status = pathlib.Path(f"/proc/{mine['pid']}/status").read_text()
    assert f"Uid:\t{UID}\t{UID}" in status and "CapEff:\t0000000000000000" in status
    refused = container.execute("/bin/sh", "-c", "touch /usr/bin/x /etc/x /x")
    assert refused.returncode and "Read-only file system" in refused.stderr
    say(f"runs as user {UID} without capabilities, its root is read-only")

    healthy = container.execute(*container.config["Healthcheck"]["Test"][1:], "--url", container.url)
    assert healthy.returncode == 0, healthy.stderr
    say("its health check says so")
    where, report = main_job(container.url, scan)

    # What loses its parent becomes a child of process 1, which has to reap it.
    container.execute("/bin/sh", "-c", "(sleep 0.1 & ) ; exit 0")

    def zombies():
        return container.execute("/bin/sh", "-c", "grep -l '^State:.Z' /proc/[0-9]*/status 2>/dev/null | wc -l").stdout
    wait_until(lambda: zombies().strip() == "0", "the end of all zombies")
    say("process 1 reaps")

    assert container.stop() == 0
    say("stopped by SIGTERM with status 0")
    container.start()
    assert report_of(container.url + where[where.index("/v1/"):]) == report
    say("its data is there after a restart")
    assert container.stop() == 0
