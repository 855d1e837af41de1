# SPDX-License-Identifier: GPL-3.0-or-later
"""The image: deploy/Dockerfile built by buildah upon a Debian of mmdebstrap's, turned into a bundle by umoci, and run
by runc as the image says: not as root, with a read-only root and one volume; killed during a job; its volume full."""
import json
import os
import pathlib
import re
import signal
import subprocess

import pytest

from conftest import crash_during_a_job, free_port, main_job, need, report_of, run, say, wait_until

MOST_COMPRESSED_MB = 100
UID = 10001


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
        self.url = f"http://127.0.0.1:{free_port()}"
        self.runc = ["runc", "--root", folder / "state"]
        run("umoci", "unpack", "--image", f"{oci}:whittle", folder / "bundle")
        spec = self.spec()
        process = spec["process"]
        process.update(terminal=False, noNewPrivileges=True, capabilities={}, args=[
            *config["Entrypoint"], *config["Cmd"], "--listen", self.url.removeprefix("http://"),
            "--admin-listen", "127.0.0.1:0"])
        assert process["user"]["uid"] == UID and process["user"]["gid"] == UID
        spec["root"]["readonly"] = True
        spec["linux"]["namespaces"] = [{"type": t} for t in ("pid", "ipc", "uts", "mount")]
        spec["linux"].pop("resources", None)
        spec["mounts"] = [m for m in spec["mounts"] if m["destination"] not in ("/data", "/etc/resolv.conf")]
        self.write(spec)
        (folder / "data").mkdir()
        os.chown(folder / "data", UID, UID)
        self.put_volume({"type": "bind", "source": str(folder / "data"), "options": ["rbind", "rw", "nosuid", "nodev"]})

    def spec(self):
        return json.loads((self.folder / "bundle/config.json").read_text())

    def write(self, spec):
        (self.folder / "bundle/config.json").write_text(json.dumps(spec))

    def put_volume(self, mount, *flags):
        """What is mounted on /data, and more flags for the service."""
        spec = self.spec()
        spec["mounts"] = [m for m in spec["mounts"] if m["destination"] != "/data"] + [{"destination": "/data", **mount}]
        spec["process"]["args"].extend(flags)
        self.write(spec)

    def start(self):
        self.log = open(self.folder / "log", "ab")
        self.process = subprocess.Popen([*self.runc, "run", "--bundle", self.folder / "bundle", self.name],
                                        stdout=subprocess.PIPE, stderr=self.log, stdin=subprocess.DEVNULL, text=True)
        line = self.process.stdout.readline()
        if not line.startswith("listening on"):
            why = (self.folder / "log").read_text()
            assert "runc" not in why, pytest.skip(f"runc can't run here: {why[-300:]}")
            raise AssertionError(why)
        assert line.split()[-1] == self.url

    def execute(self, *command):
        return subprocess.run([*self.runc, "exec", self.name, *command], capture_output=True, text=True, check=False)

    def crash(self):
        """Kills process 1, and with it the container; starts it again."""
        os.kill(json.loads(run(*self.runc, "state", self.name))["pid"], signal.SIGKILL)
        assert self.process.wait(90) == 128 + signal.SIGKILL
        subprocess.run([*self.runc, "delete", "--force", self.name], capture_output=True, check=False)
        self.start()

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
    assert report_of(where) == report
    say("its data is there after a restart")
    assert container.stop() == 0


def test_jobs_have_an_account_of_their_own_with_four_capabilities(container, scan):
    """As deploy/Dockerfile, compose.job-account.yaml and the component for Kubernetes start it."""
    spec = container.spec()
    arguments = spec["process"]["args"]
    assert arguments[:3] == container.config["Entrypoint"]
    spec["process"]["args"] = ["/usr/share/whittle/with-job-account", *arguments[3:]]
    spec["process"]["user"] = {"uid": 0, "gid": 0}
    names = ["CAP_CHOWN", "CAP_KILL", "CAP_SETGID", "CAP_SETUID"]
    spec["process"]["capabilities"] = {kind: names for kind in ("bounding", "effective", "permitted")}
    container.write(spec)
    container.start()
    assert json.loads(run("curl", "-sS", container.url + "/v1/info"))["confinement"]["own_account"] == 1
    mine = pathlib.Path(f"/proc/{json.loads(run(*container.runc, 'state', container.name))['pid']}/status").read_text()
    assert f"Uid:\t{UID}\t{UID}" in mine and "CapEff:\t00000000000000e1" in mine
    where, report = main_job(container.url, scan)
    confined = re.findall(r"jobs are confined by (.*)", (container.folder / "log").read_text())[-1]
    assert "user whittle-job" in confined and "seccomp" in confined, confined
    say(f"the service runs as user {UID}; jobs are confined by {confined}")
    assert container.stop() == 0
    container.start()
    assert report_of(where) == report
    assert container.stop() == 0


def test_what_is_killed_during_a_job_goes_on_after_the_start(container, scan):
    container.start()
    crash_during_a_job(container.url, scan, container.crash)
    say("process 1 killed during a job: the next start ended the job")
    assert container.stop() == 0


def test_a_full_volume_is_said_and_survived(container, scan):
    container.put_volume({"type": "tmpfs", "source": "tmpfs", "options": [
        "size=16m", f"uid={UID}", f"gid={UID}", "mode=0700"]}, "--min-free", "0")
    container.start()
    where, report = main_job(container.url, scan)
    assert container.execute("/bin/sh", "-c", "head -c 20000000 /dev/zero > /data/other").returncode
    refused = subprocess.run(["curl", "-s", "-X", "POST", "-T", scan, container.url + "/v1/jobs"], capture_output=True,
                             check=True).stdout
    assert json.loads(refused)["status"] == 507 and json.loads(refused)["type"] == "/problems/storage-full"
    assert report_of(where) == report
    say("full volume: an upload is refused with 507, what is there is served")
    assert container.execute("/bin/rm", "/data/other").returncode == 0
    main_job(container.url, scan)
    say("room again: it works again")
    assert container.stop() == 0
