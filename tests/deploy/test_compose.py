# SPDX-License-Identifier: GPL-3.0-or-later
"""deploy/compose.yaml, started by docker-compose with podman as its engine: our image behind nginx (Debian's, under the
name of nginx's image), in networks of their own, with TLS.  Only the published ports are changed."""
import os
import shutil
import signal
import subprocess

import pytest

from conftest import (ROOT, certificate, crash_during_a_job, free_port, main_job, need, report_of, run, say,
                      wait_until)
import containers

yaml = pytest.importorskip("yaml")
COMPOSE = ROOT / "deploy/compose.yaml"


@pytest.fixture(name="document", scope="module")
def make_document():
    return yaml.safe_load(COMPOSE.read_text())


def test_docker_compose_accepts_it():
    need("docker-compose")
    services = run("docker-compose", "-f", COMPOSE, "config", "--services").split()
    assert sorted(services) == ["nginx", "whittled"]
    say("docker-compose accepts it")


def test_what_it_mounts_is_there(document):
    for service in document["services"].values():
        for volume in service["volumes"]:
            source = volume.split(":")[0]
            if source in document["volumes"] or source == "./tls":  # the certificate is the administrator's
                continue
            assert (COMPOSE.parent / source).is_file(), source
    build = document["services"]["whittled"]["build"]
    assert (COMPOSE.parent / build["context"] / build["dockerfile"]).is_file()


def test_nobody_but_nginx_reaches_the_open_port(document):
    service = document["services"]["whittled"]
    assert "ports" not in service and service["networks"] == ["inside"] and document["networks"]["inside"]["internal"]
    assert service["read_only"] and service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]


class Project:
    """The services of compose.yaml, with podman's service as what docker-compose talks to."""

    def __init__(self, store, folder):
        self.store, self.folder = store, folder / "deploy"
        shutil.copytree(ROOT / "deploy", self.folder)
        (self.folder / "tls").mkdir()
        self.ca = certificate(self.folder / "tls", "IP:127.0.0.1")
        text, ports = COMPOSE.read_text(), (free_port(), free_port())
        changed = text.replace('"80:80", "443:443"', f'"127.0.0.1:{ports[0]}:80", "127.0.0.1:{ports[1]}:443"')
        assert changed != text
        (self.folder / "compose.yaml").write_text(changed)
        self.plain, self.url = (f"{s}://127.0.0.1:{p}" for s, p in zip(("http", "https"), ports))
        address = f"unix://{folder}/engine"
        self.environment = dict(os.environ, DOCKER_HOST=address)
        self.engine = subprocess.Popen(store.command("system", "service", "--time", "0", address),
                                       env=store.environment, stderr=open(folder / "engine.log", "wb"))
        wait_until((folder / "engine").exists, "podman's service")

    def command(self, *command):
        return ["docker-compose", "-p", f"whittle-test-{os.getpid()}", "-f", str(self.folder / "compose.yaml"),
                *command]

    def __call__(self, *command):
        return run(*self.command(*command), env=self.environment)

    def container(self, service):
        return self.store.podman("ps", "-aq", "--filter", f"label=com.docker.compose.service={service}")

    def inspect(self, service, what):
        return self.store.podman("inspect", "--format", "{{." + what + "}}", self.container(service))

    def healthy(self):
        """Runs the image's health check once, as an engine with systemd would now and then."""
        found = self.container("whittled")
        return found and subprocess.run(self.store.command("healthcheck", "run", found), env=self.store.environment,
                                        capture_output=True, check=False).returncode == 0

    def up(self):
        with subprocess.Popen(self.command("up", "-d", "--no-build"), env=self.environment, stderr=subprocess.PIPE,
                              text=True) as process:
            wait_until(lambda: self.healthy() or process.poll(), "a healthy whittled")
            said = process.communicate()[1]
        assert process.returncode == 0, said

    def close(self):
        subprocess.run(self.command("down", "--volumes"), env=self.environment, capture_output=True, check=False)
        self.engine.terminate()
        self.engine.wait(60)


@pytest.fixture(name="project")
def make_project(store, image, tmp_path):
    need("docker-compose", "podman", "openssl")
    assert image
    store.needs_podman()
    containers.build_nginx(store)
    project = Project(store, tmp_path)
    yield project
    project.close()


def test_it_serves_over_tls_and_keeps_its_data(project, scan):
    project.up()
    say("docker-compose up: nginx waited until whittled was healthy")
    flags = ("--cacert", project.ca)
    redirect = run("curl", "-sS", "-o", os.devnull, "-w", "%{http_code} %{redirect_url}", project.plain + "/v1/info")
    assert redirect == "308 https://127.0.0.1/v1/info"
    assert project.inspect("whittled", "HostConfig.ReadonlyRootfs") == "true"
    assert project.inspect("whittled", "Config.User") == "10001:10001"
    where, report = main_job(project.url, scan, *flags)

    process = int(project.inspect("whittled", "State.Pid"))
    crash_during_a_job(project.url, scan, lambda: os.kill(process, signal.SIGKILL), *flags)
    say("process 1 killed during a job: the container was started again, the job went on")

    project("stop")
    assert project.inspect("whittled", "State.ExitCode") == project.inspect("nginx", "State.ExitCode") == "0"
    say("docker-compose stop: both ended with status 0")
    project("down")
    project.up()
    assert report_of(where, *flags) == report
    say("docker-compose down and up: its data is there")
