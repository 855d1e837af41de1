# SPDX-License-Identifier: GPL-3.0-or-later
"""The manifests of deploy/kubernetes: put together by kubectl, validated against the JSON schemas of their kinds (types
and what is required) and against the models of Kubernetes' client (unknown fields), and checked for what ties them
together: selectors, ports, volumes, limits, and settings that the daemon itself accepts.  Then podman runs the pod from
the manifests as they are: the test makes the secret, asks what the probes would ask, and crashes and ends the pod."""
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess

import pytest

from conftest import BUILD, ROOT, crash_during_a_job, free_port, main_job, need, report_of, run, say, wait_until

NODE = ROOT / "tests/node"
yaml = pytest.importorskip("yaml")


@pytest.fixture(name="objects", scope="module")
def make_objects():
    need("kubectl")
    text = run("kubectl", "kustomize", ROOT / "deploy/kubernetes")
    objects = [o for o in yaml.safe_load_all(text) if o]
    say("kubectl kustomize: " + ", ".join(o["kind"] for o in objects))
    return objects


@pytest.fixture(name="by_kind", scope="module")
def make_by_kind(objects):
    return {o["kind"]: o for o in objects}


@pytest.fixture(name="container", scope="module")
def make_container(by_kind):
    return by_kind["Deployment"]["spec"]["template"]["spec"]["containers"][0]


def validate(objects):
    return subprocess.run(["node", NODE / "kubernetes.js"], input=json.dumps(objects), capture_output=True, text=True,
                          check=False)


@pytest.fixture(name="schemas", scope="module")
def make_schemas():
    need("node", "npm")
    if not (NODE / "node_modules/.package-lock.json").exists():  # what npm writes last
        done = subprocess.run(["npm", "ci", "--silent", "--no-fund", "--no-audit"], cwd=NODE, capture_output=True,
                              text=True, check=False)
        if done.returncode:
            pytest.skip(f"npm ci: {done.stderr.strip()[-300:]}")


def test_yamllint_finds_nothing():
    need("yamllint")
    rules = "{extends: default, rules: {document-start: disable, line-length: {max: 120}, truthy: {check-keys: false}}}"
    print(run("yamllint", "-s", "-d", rules, ROOT / "deploy/kubernetes", ROOT / "deploy/compose.yaml", ROOT / "deploy/compose.job-account.yaml",
              ROOT / "deploy/hosts", ROOT / "deploy/monitoring"))


def test_every_object_fits_its_schema(objects, schemas):
    done = validate(objects)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("ok ") == len(objects)
    say(f"{len(objects)} objects fit their JSON schemas")


def test_those_of_many_hosts_fit_their_schemas(schemas):
    need("kubectl")
    hosts = [o for o in yaml.safe_load_all(run("kubectl", "kustomize", ROOT / "deploy/hosts/kubernetes")) if o]
    done = validate(hosts)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("ok ") == len(hosts) > 10
    say(f"{len(hosts)} objects of many hosts fit their JSON schemas")


def test_the_component_gives_jobs_an_account_of_their_own(schemas, tmp_path):
    """What it changes is what deploy/compose.job-account.yaml changes; the rest stays as it is."""
    need("kubectl")
    folder = tmp_path / "kubernetes"
    shutil.copytree(ROOT / "deploy/kubernetes", folder)
    with open(folder / "kustomization.yaml", "a") as file:
        file.write("components: [job-account]\n")
    objects = [o for o in yaml.safe_load_all(run("kubectl", "kustomize", folder)) if o]
    done = validate(objects)
    assert done.returncode == 0, done.stdout + done.stderr
    pod = next(o for o in objects if o["kind"] == "Deployment")["spec"]["template"]["spec"]
    container, compose = pod["containers"][0], yaml.safe_load((ROOT / "deploy/compose.job-account.yaml").read_text())
    whittled = compose["services"]["whittled"]
    assert (pod["securityContext"]["runAsUser"], pod["securityContext"]["runAsNonRoot"]) == (0, False)
    assert whittled["user"] == "0:0" and container["command"] == whittled["entrypoint"]
    assert container["securityContext"]["capabilities"] == {"drop": ["ALL"], "add": whittled["cap_add"]}
    assert not container["securityContext"]["allowPrivilegeEscalation"] and container["args"]
    space = next(o for o in objects if o["kind"] == "Namespace")
    assert space["metadata"]["labels"] == {"pod-security.kubernetes.io/enforce": "baseline"}


def test_the_validation_sees_a_mistake(objects, schemas):
    broken = json.loads(json.dumps(objects))
    next(o for o in broken if o["kind"] == "Deployment")["spec"]["replicas"] = "one"
    done = validate(broken)
    assert done.returncode == 1 and "spec/replicas must be integer" in done.stdout


def unknown_fields(client, value, kind, where):
    """Fields that the model of this kind doesn't know."""
    of_list, of_map = re.fullmatch(r"list\[(.*)\]", kind), re.fullmatch(r"dict\(str, (.*)\)", kind)
    if of_list:
        return [u for i, v in enumerate(value) for u in unknown_fields(client, v, of_list[1], f"{where}[{i}]")]
    if of_map:
        return [u for k, v in value.items() for u in unknown_fields(client, v, of_map[1], f"{where}.{k}")]
    model = getattr(client, kind, None)
    if not model or not isinstance(value, dict):
        return []
    types = {model.attribute_map[a]: t for a, t in model.openapi_types.items()}
    found = [f"{where}.{k}" for k in value if k not in types]
    for key, inner in value.items():
        if key in types:
            found += unknown_fields(client, inner, types[key], f"{where}.{key}")
    return found


def model_name(object_):
    group, _, version = object_["apiVersion"].rpartition("/")
    return version.capitalize() + object_["kind"] if group != "monitoring.coreos.com" else None


def test_no_object_has_a_field_that_kubernetes_does_not_know(objects):
    client = pytest.importorskip("kubernetes.client", reason="python3-kubernetes is not installed")
    known = [o for o in objects if model_name(o)]
    for object_ in known:
        assert hasattr(client, model_name(object_)), model_name(object_)
        assert not unknown_fields(client, object_, model_name(object_), object_["kind"])
    wrong = json.loads(json.dumps(known))
    next(o for o in wrong if o["kind"] == "Deployment")["spec"]["template"]["spec"]["containers"][0]["livenesProbe"] = 1
    assert [u for o in wrong for u in unknown_fields(client, o, model_name(o), o["kind"])] == [
        "Deployment.spec.template.spec.containers[0].livenesProbe"]
    say(f"{len(known)} objects have no unknown field")


def test_selectors_ports_and_volumes_meet(by_kind, container):
    labels = by_kind["Deployment"]["spec"]["template"]["metadata"]["labels"].items()
    pod = by_kind["Deployment"]["spec"]["template"]["spec"]
    for selector in (by_kind["Service"]["spec"]["selector"],
                     by_kind["Deployment"]["spec"]["selector"]["matchLabels"],
                     by_kind["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"],
                     by_kind["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"]):
        assert selector.items() <= labels
    assert by_kind["ServiceMonitor"]["spec"]["selector"]["matchLabels"].items() <= \
        by_kind["Service"]["metadata"]["labels"].items()
    ports = {p["name"] for p in container["ports"]}
    assert {p["targetPort"] for p in by_kind["Service"]["spec"]["ports"]} <= ports
    assert {e["port"] for e in by_kind["ServiceMonitor"]["spec"]["endpoints"]} <= ports
    assert {container[p]["httpGet"]["port"] for p in ("startupProbe", "livenessProbe", "readinessProbe")} <= ports
    assert {m["name"] for m in container["volumeMounts"]} == {v["name"] for v in pod["volumes"]}
    claims = [v["persistentVolumeClaim"]["claimName"] for v in pod["volumes"] if "persistentVolumeClaim" in v]
    assert claims == [by_kind["PersistentVolumeClaim"]["metadata"]["name"]]
    maps = [v["configMap"]["name"] for v in pod["volumes"] if "configMap" in v]
    assert maps == [by_kind["ConfigMap"]["metadata"]["name"]]


def test_it_runs_under_the_restricted_standard(by_kind, container):
    pod, own = by_kind["Deployment"]["spec"]["template"]["spec"]["securityContext"], container["securityContext"]
    assert pod["runAsNonRoot"] and pod["runAsUser"] and pod["seccompProfile"] == {"type": "RuntimeDefault"}
    assert own == {"allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}
    assert by_kind["Deployment"]["spec"]["strategy"] == {"type": "Recreate"}, "the data folder has one owner"


def bytes_of(text):
    number, unit = re.fullmatch(r"(\d+)([KMGT]?)i?", text).groups()
    return int(number) << {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}[unit]


def test_the_daemon_accepts_its_settings_and_they_fit_the_limits(by_kind, container, tmp_path):
    text = by_kind["ConfigMap"]["data"]["whittled.conf"]
    (tmp_path / "tokens").write_text("ci:submit,read:" + "0" * 64 + "\n")
    (tmp_path / "whittled.conf").write_text(text.replace("/etc/whittled/tokens", str(tmp_path)))
    print(run(BUILD / "whittled", "--config", tmp_path / "whittled.conf", "--check-config"))
    settings = dict(re.findall(r"^([a-z-]+) = (\S+)$", text, re.M))
    jobs = int(settings["workers"]) * bytes_of(settings["job-memory"])
    assert jobs + (512 << 20) <= bytes_of(container["resources"]["limits"]["memory"])
    drain = int(settings["drain-timeout"].removesuffix("s"))
    assert drain < by_kind["Deployment"]["spec"]["template"]["spec"]["terminationGracePeriodSeconds"]
    ports = {p["name"]: p["containerPort"] for p in container["ports"]}
    assert settings["listen"].endswith(f":{ports['http']}")
    assert settings["admin-listen"].endswith(f":{ports['admin']}")
    say("whittled accepts the settings, and memory and drain time fit the pod's")


TOKEN = "a token of this test"
BEARER = ("-H", f"Authorization: Bearer {TOKEN}")


class Pod:
    """The deployment with what it mounts, played by podman kube play; its ports are published on loopback."""

    def __init__(self, store, objects, folder):
        self.store, self.folder = store, folder
        by_kind = {o["kind"]: o for o in json.loads(json.dumps(objects))}
        self.workload, self.claim = [by_kind["ConfigMap"], by_kind["Deployment"]], by_kind["PersistentVolumeClaim"]
        self.spec = by_kind["Deployment"]["spec"]["template"]["spec"]["containers"][0]
        for port in self.spec["ports"]:
            port.update(hostPort=free_port(), hostIP="127.0.0.1")
        self.url = self.address("http")
        # What kubectl create secret does; podman 4.3 takes the text as it is.
        tokens = {"tokens": f"ci:submit,read:{hashlib.sha256(TOKEN.encode()).hexdigest()}\n"}
        (folder / "secret").write_text(json.dumps({"kind": "Secret", "data": tokens}))
        store.podman("secret", "create", "whittled-tokens", folder / "secret")

    def address(self, port):
        return next(f"http://127.0.0.1:{p['hostPort']}" for p in self.spec["ports"] if p["name"] == port)

    def play(self, *objects):
        (self.folder / "pod.yaml").write_text(yaml.safe_dump_all(objects))
        self.store.podman("kube", "play", self.folder / "pod.yaml")
        self.container = self.store.podman("ps", "-aq", "--filter", "name=-whittled$")
        wait_until(lambda: self.probe("startupProbe") == 200, "the startup probe")

    def probe(self, name):
        """The status that the kubelet would see."""
        get, seconds = self.spec[name]["httpGet"], self.spec[name].get("timeoutSeconds", 1)
        return int(subprocess.run(
            ["curl", "-s", "-o", os.devnull, "-w", "%{http_code}", "--max-time", str(seconds),
             self.address(get["port"]) + get["path"]],
            capture_output=True, text=True, check=False).stdout)

    def inspect(self, what):
        return self.store.podman("inspect", "--format", what, self.container)

    def kill(self):
        os.kill(int(self.inspect("{{.State.Pid}}")), signal.SIGKILL)

    def down(self):
        """The exit status of a stop as the kubelet does it; then the pod and what belongs to it are gone."""
        self.store.podman("pod", "stop", "--time", "90", self.inspect("{{.Pod}}"))
        status = self.inspect("{{.State.ExitCode}}")
        self.store.podman("kube", "down", self.folder / "pod.yaml")
        self.store.podman("volume", "rm", "whittled-tokens", self.workload[0]["metadata"]["name"])
        return status


@pytest.fixture(name="pod")
def make_pod(store, image, objects, tmp_path):
    need("podman")
    assert image
    store.needs_podman()
    return Pod(store, objects, tmp_path)


def test_the_pod_does_the_main_job_and_keeps_its_data(pod, scan):
    pod.play(pod.claim, *pod.workload)
    assert [pod.probe(p) for p in ("livenessProbe", "readinessProbe")] == [200, 200]
    say("podman plays the deployment: startup, liveness and readiness probe are answered with 200")
    assert pod.inspect("{{.Config.User}} {{.HostConfig.ReadonlyRootfs}} {{.EffectiveCaps}}") == "10001:10001 true []"
    assert run("curl", "-s", "-o", os.devnull, "-w", "%{http_code}", pod.url + "/v1/jobs") == "401"
    where, report = main_job(pod.url, scan, *BEARER)
    metrics = run("curl", "-sS", "--fail", pod.address("admin") + "/metrics")
    assert re.search(r"^whittled_\w+.* [1-9]", metrics, re.M)

    crash_during_a_job(pod.url, scan, pod.kill, *BEARER)
    say("process 1 killed during a job: the container was started again, the job went on")
    assert pod.down() == "0"
    say("stopped with status 0, and removed; the claim stays")
    pod.play(*pod.workload)
    assert report_of(where, *BEARER) == report
    say("a new pod on the same claim: its data is there")
    assert pod.down() == "0"
