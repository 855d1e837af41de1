# SPDX-License-Identifier: GPL-3.0-or-later
"""deploy/hosts: the compose project's settings, run as processes on real PostgreSQL and S3 behind nginx; manifests for
Kubernetes that fit together, with settings that the daemon accepts."""
import os
import pathlib
import re
import shutil
import subprocess

import pytest

from conftest import BUILD, SMALL, wait_until
from test_hosts import PROGRAMS, content, make_server  # noqa: F401, a fixture
from test_proxy import NGINX, Proxy

yaml = pytest.importorskip("yaml", reason="python3-yaml is not installed")
FOLDER = pathlib.Path(__file__).parents[2] / "deploy/hosts"
MANIFESTS = FOLDER / "kubernetes"


# ---------------------------------------------------------------------------------------------- compose

@pytest.fixture(name="compose")
def make_compose():
    return yaml.safe_load((FOLDER / "compose.yaml").read_text())


def test_what_compose_mounts_is_there_and_nobody_but_nginx_is_reached(compose):
    services = compose["services"]
    for volume in services["nginx"]["volumes"]:
        source = volume.split(":")[0]
        assert source == "../tls" or (FOLDER / source).is_file(), source
    assert [name for name, service in services.items() if "ports" in service] == ["nginx"]
    assert compose["networks"]["inside"]["internal"]
    upstreams = re.findall(r"server (\w+):(\d+)", (FOLDER / "upstream.conf").read_text())
    assert upstreams == [("host1", "8080"), ("host2", "8080")]
    for name, _ in upstreams:
        service = services[name]
        assert service["read_only"] and service["cap_drop"] == ["ALL"] and "volumes" not in service
        assert service["depends_on"]["migrate"]["condition"] == "service_completed_successfully"


@pytest.mark.skipif(not NGINX or not shutil.which("openssl"), reason="nginx and openssl aren't installed")
def test_the_project_runs_as_processes(compose, server, make_daemon, tmp_path):  # noqa: F811
    """With the commands that compose gives; names of stores and hosts are put in their places."""
    if "WHITTLE_BLOBS" not in os.environ:
        pytest.skip("WHITTLE_BLOBS names no S3 store")
    services = compose["services"]
    store, _, query = os.environ["WHITTLE_BLOBS"].partition("?")
    places = {"postgresql://whittled@postgres/whittled": f"postgresql://whittle@/compose?host={server}",
              "s3://whittled/?endpoint=http://s3:8000": f"{store}/compose-{os.getpid()}?{query}"}
    subprocess.run([PROGRAMS / "createdb", "-h", server, "-U", "whittle", "compose"], check=True)

    def command(name):
        words = services[name]["command"]
        assert set(places) <= set(words)
        return [places.get(word, word) for word in words]

    assert services["migrate"]["entrypoint"] == ["/usr/bin/whittled", "migrate"]
    subprocess.run([BUILD / "whittled", "migrate", *command("migrate")], check=True)
    hosts = {name: make_daemon(*command(name), "--result-cache=0") for name in ("host1", "host2")}
    proxy = Proxy(tmp_path / "nginx", 1)
    upstream = (FOLDER / "upstream.conf").read_text()
    for name, host in hosts.items():
        upstream = upstream.replace(f"{name}:8080", f"127.0.0.1:{host.port}")
    (proxy.folder / "conf.d/upstream.conf").write_text(upstream)
    proxy.start()
    try:
        jobs = [proxy.submit(SMALL + b"# %d\n" % i, "?outputs=cloud,mesh") for i in range(6)]
        for job in jobs:
            assert proxy.ended(job)["status"] == "successful"
            assert content(proxy, job, "mesh.ply") == content(hosts["host1"], job, "mesh.ply")
        for name in hosts:  # both have been asked
            assert "method=POST path=/v1/jobs" in hosts[name].log_text(), name
        hosts["host1"].kill()
        last = wait_until(lambda: (lambda r: r.json["id"] if r.status == 201 else None)(
            proxy.post("/v1/jobs", SMALL)), "a job at the host that is left")
        assert proxy.ended(last)["status"] == "successful"
        assert [content(proxy, job, "cloud.ply") != b"" for job in jobs] == [True] * 6
    finally:
        proxy.stop()


# ---------------------------------------------------------------------------------------------- Kubernetes

@pytest.fixture(name="objects")
def make_objects():
    """Of the files that the kustomization names."""
    names = yaml.safe_load((MANIFESTS / "kustomization.yaml").read_text())["resources"]
    assert {p.name for p in MANIFESTS.glob("*.yaml")} == {*names, "kustomization.yaml"}
    return [o for name in names for o in yaml.safe_load_all((MANIFESTS / name).read_text())]


def named(objects, kind, name):
    return next(o for o in objects if (o["kind"], o["metadata"]["name"]) == (kind, name))


def test_replicas_share_no_volume_and_roll(objects):
    roles = {}
    for object_ in objects:
        assert object_["kind"] not in ("PersistentVolumeClaim", "StatefulSet")
        if object_["kind"] != "Deployment":
            continue
        pod = object_["spec"]["template"]["spec"]
        container = pod["containers"][0]
        assert object_["spec"]["strategy"]["type"] == "RollingUpdate"
        assert {next(k for k in v if k != "name") for v in pod["volumes"]} == {"emptyDir", "configMap", "secret"}
        assert {m["name"] for m in container["volumeMounts"]} == {v["name"] for v in pod["volumes"]}
        assert pod["initContainers"][0]["args"][0] == "migrate"
        assert pod["initContainers"][0]["args"][1:] == container["args"]
        assert pod["securityContext"]["runAsNonRoot"] and container["securityContext"]["readOnlyRootFilesystem"]
        assert container["envFrom"] == [{"secretRef": {"name": "whittled-stores"}}]
        labels = object_["spec"]["template"]["metadata"]["labels"]
        assert object_["spec"]["selector"]["matchLabels"].items() <= labels.items()
        role = next(e["value"] for e in container["env"] if e["name"] == "WHITTLED_ROLES")
        assert labels["app.kubernetes.io/component"] == role
        roles[role] = object_
    assert set(roles) == {"http", "work"}
    assert roles["http"]["spec"]["replicas"] > 1 and "replicas" not in roles["work"]["spec"]


def test_the_workers_follow_the_queue(objects):
    scaler = named(objects, "HorizontalPodAutoscaler", "whittled-workers")["spec"]
    assert named(objects, "Deployment", scaler["scaleTargetRef"]["name"])
    metric, = scaler["metrics"]
    name = metric["external"]["metric"]["name"]
    adapter = yaml.safe_load((FOLDER.parent / "monitoring/adapter.yml").read_text())
    assert [rule["name"]["as"] for rule in adapter["rules"]["external"]] == [name]
    assert 1 <= scaler["minReplicas"] < scaler["maxReplicas"]


def test_selectors_and_ports_meet(objects):
    pods = [o["spec"]["template"] for o in objects if o["kind"] == "Deployment"]
    for object_ in objects:
        spec = object_.get("spec", {})
        selector = {"Service": lambda s: s["selector"], "PodDisruptionBudget": lambda s: s["selector"]["matchLabels"],
                    "NetworkPolicy": lambda s: s["podSelector"]["matchLabels"]}.get(object_["kind"])
        if not selector:
            continue
        chosen = [p for p in pods if selector(spec).items() <= p["metadata"]["labels"].items()]
        assert chosen, object_["metadata"]["name"]
        for port in spec.get("ports", []):
            for pod in chosen:
                assert port["targetPort"] in [p["name"] for p in pod["spec"]["containers"][0]["ports"]]
    monitor = next(o for o in objects if o["kind"] == "ServiceMonitor")["spec"]["selector"]["matchLabels"]
    assert monitor.items() <= named(objects, "Service", "whittled-admin")["metadata"]["labels"].items()
    ingress = next(o for o in objects if o["kind"] == "Ingress")["spec"]["rules"][0]["http"]["paths"][0]["backend"]
    assert named(objects, "Service", ingress["service"]["name"])


def test_the_daemon_accepts_the_settings_and_they_fit_the_limits(objects, tmp_path):
    (tmp_path / "tokens").write_text("ci:submit,read:" + "0" * 64 + "\n")
    text = (MANIFESTS / "whittled.conf").read_text()
    (tmp_path / "whittled.conf").write_text(text.replace("/etc/whittled/tokens", str(tmp_path)))
    settings = dict(re.findall(r"^([a-z-]+) = (\S+)$", text, re.M))
    for deployment in (o for o in objects if o["kind"] == "Deployment"):
        pod = deployment["spec"]["template"]["spec"]
        container = pod["containers"][0]
        environment = {e["name"]: e["value"] for e in container["env"] if e["name"] == "WHITTLED_ROLES"}
        done = subprocess.run([BUILD / "whittled", "--config", tmp_path / "whittled.conf", "--check-config"],
                              env=dict(os.environ, **environment), capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert int(settings["drain-timeout"].removesuffix("s")) < pod["terminationGracePeriodSeconds"]
    limit = container["resources"]["limits"]["memory"]  # of the workers, which come last
    assert deployment["metadata"]["name"] == "whittled-workers"
    assert int(settings["workers"]) * int(settings["job-memory"].removesuffix("G")) + 0.5 <= int(limit.removesuffix("Gi"))


# ---------------------------------------------------------------------------------------------- machines

def test_the_settings_for_three_machines_are_accepted(tmp_path):
    text = re.search(r"```ini\n(.*?)```", (FOLDER / "README.md").read_text(), re.S)[1]
    (tmp_path / "tokens").write_text("ci:submit,read:" + "0" * 64 + "\n")
    (tmp_path / "whittled.conf").write_text(text.replace("/etc/whittled/tokens", str(tmp_path / "tokens")))
    unit = (FOLDER / "systemd/hosts.conf").read_text()
    start = re.search(r"^ExecStartPre=/usr/bin/whittled migrate (.*)$", unit, re.M)[1]
    words = start.replace("/etc/whittled/", f"{tmp_path}/").replace("${STATE_DIRECTORY}", str(tmp_path / "data")).split()
    done = subprocess.run([BUILD / "whittled", *words, "--check-config"], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "allowed" in done.stdout, done.stderr
