# SPDX-License-Identifier: GPL-3.0-or-later
"""What the deployment tests share: a fresh Debian 12, the package, a real scan, and the main job done on it.

Each test prints what it did.  They want root, and skip where something is absent, saying what."""
import json
import os
import pathlib
import shutil
import socket
import subprocess
import time

import pytest

import containers

ROOT = pathlib.Path(__file__).resolve().parents[2]
BUILD = pathlib.Path(os.environ.get("WHITTLE_BUILD", ROOT / "build/release"))
PATIENCE_S = int(os.environ.get("WHITTLE_PATIENCE_S", "120"))
# As Debian's own slim images leave documentation out.
SLIM = ["--dpkgopt=path-exclude=/usr/share/doc/*", "--dpkgopt=path-include=/usr/share/doc/*/copyright",
        "--dpkgopt=path-exclude=/usr/share/man/*", "--dpkgopt=path-exclude=/usr/share/locale/*"]


def say(text):
    print(f"    {text}", flush=True)


def run(*command, **more):
    """Runs to the end; what it printed, or an error with all of it."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **more)
    assert done.returncode == 0, f"{command} ended with {done.returncode}:\n{done.stdout[-6000:]}\n{done.stderr[-6000:]}"
    return done.stdout.strip()


def need(*programs):
    """Skips where one of the programs is absent, or where this isn't root."""
    missing = [p for p in programs if not shutil.which(p)]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")


def need_root():
    if os.geteuid() != 0:
        pytest.skip("wants root")


def wait_until(condition, what):
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        answer = condition()
        if answer:
            return answer
        time.sleep(0.05)
    raise AssertionError(f"{what} did not come in {PATIENCE_S} s")


def curl(url, *arguments):
    return run("curl", "-sS", "--fail-with-body", "--max-time", PATIENCE_S, *arguments, url)


def answers(url):
    return subprocess.run(["curl", "-sk", "--fail", "-o", os.devnull, "--max-time", "5", url + "/v1/info"],
                          check=False).returncode == 0


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def certificate(folder, name):
    """Puts tls.crt and tls.key for the name (IP:..., DNS:...) there; the certificate, which signed itself."""
    run("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
        "-subj", "/CN=whittle test", "-addext", f"subjectAltName={name}", "-keyout", folder / "tls.key", "-out",
        folder / "tls.crt")
    return folder / "tls.crt"


def submit(url, scan, query, *curl_flags):
    """The address of the new job."""
    job = json.loads(curl(f"{url}/v1/jobs?{query}", "-X", "POST", "-T", scan, *curl_flags))
    return url + next(link["href"] for link in job["links"] if link["rel"] == "self")


def main_job(url, scan, *curl_flags):
    """Uploads the scan, waits for the end; the job's address and its report."""
    where = submit(url, scan, "ratio=0.1&outputs=cloud,mesh,report", *curl_flags)
    return where, report_of(where, *curl_flags)


def ended(where, *curl_flags):
    """The job, as soon as it has ended; while it restarts, the service may be away."""
    def look():
        done = subprocess.run(["curl", "-sS", "--fail", "--max-time", "60", *map(str, curl_flags), where],
                              capture_output=True, text=True, check=False)
        job = json.loads(done.stdout) if done.returncode == 0 else {"status": done.stderr}
        return job if job["status"] in ("successful", "failed", "dismissed") else None
    return wait_until(look, "the job's end")


def crash_during_a_job(url, scan, crash, *curl_flags):
    """crash() while a job of some seconds runs; the job has to come to its end by itself, in a second attempt."""
    where = submit(url, scan, "ratio=1&outputs=cloud,mesh,report", *curl_flags)
    wait_until(lambda: json.loads(curl(where, *curl_flags))["status"] != "accepted", "the job's start")
    crash()
    job = ended(where, *curl_flags)
    assert job["status"] == "successful" and job["attempt"] == 2, job
    return where


def report_of(where, *curl_flags):
    """The main job's report, after a look at it and at the mesh."""
    job = ended(where, *curl_flags)
    assert job["status"] == "successful", job["problem"]
    report = job["report"]
    mesh = subprocess.run(["curl", "-sS", "--fail", *map(str, curl_flags), where + "/outputs/mesh.ply"],
                          capture_output=True, check=True).stdout
    assert f"element face {report['mesh']['triangles']}\n".encode() in mesh.partition(b"end_header\n")[0]
    assert report["mesh"]["watertight"] and report["points_out"] == round(report["points_in"] / 10), report
    say(f"{report['points_in']} points -> {report['points_out']}, {report['mesh']['triangles']} triangles, watertight, "
        f"mean error {report['error']['mean_rel']:.2e} of the diagonal")
    return report


@pytest.fixture(name="scan", scope="session")
def make_scan(tmp_path_factory):
    """A real scan as XYZ."""
    path = tmp_path_factory.mktemp("scan") / "armadillo.xyz"
    done = subprocess.run([ROOT / "tests/demo/scan.sh", "armadillo", path], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no scan: {done.stderr.strip()}")
    return path


def own_mirror():
    """Where this machine has its packages from, if that has Debian 12; else mmdebstrap chooses."""
    known = subprocess.run(["apt-get", "indextargets", "--format", "$(REPO_URI)", "Created-By: Packages",
                            "Codename: bookworm"], capture_output=True, text=True, check=False)
    return known.stdout.split()[:1]


@pytest.fixture(name="debian", scope="session")
def make_debian(tmp_path_factory):
    """A fresh Debian 12 with documentation left out, as a tar file; WHITTLE_DEBIAN names one from before."""
    need_root()
    if os.environ.get("WHITTLE_DEBIAN"):
        return pathlib.Path(os.environ["WHITTLE_DEBIAN"])
    need("mmdebstrap")
    path = tmp_path_factory.mktemp("debian") / "root.tar"
    began = time.monotonic()
    done = subprocess.run(["mmdebstrap", "--variant=minbase", "--include=ca-certificates", *SLIM, "bookworm", path,
                           *own_mirror()], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"mmdebstrap: {done.stderr.strip()[-300:]}")
    say(f"a fresh Debian 12 in {time.monotonic() - began:.0f} s, {path.stat().st_size >> 20} MB")
    return path


@pytest.fixture(name="machine")
def make_machine(debian, tmp_path):
    """The fresh Debian as a folder, with /proc, /sys and /dev: machine(command...) runs in it as root."""
    root = tmp_path / "machine"
    root.mkdir()
    run("tar", "-xf", debian, "-C", root)
    yield Machine(root)


class Machine:
    """A root folder; each command runs in mount and process namespaces of its own, which end with it."""

    def __init__(self, root):
        self.root = root
        shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")

    def command(self, *command):
        inner = ('mount --rbind /dev "$0/dev" && mount -t tmpfs tmpfs "$0/tmp" && mount -t proc proc "$0/proc" && '
                 'exec chroot "$0" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root DEBIAN_FRONTEND=noninteractive '
                 'TERM=dumb LC_ALL=C.UTF-8 "$@"')
        return ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--propagation", "private", "sh", "-c", inner,
                str(self.root), *map(str, command)]

    def __call__(self, *command):
        return run(*self.command(*command))


@pytest.fixture(name="store", scope="session")
def make_store(debian, tmp_path_factory):
    """Where images and containers are kept, with a Debian in it."""
    need("buildah")
    store = containers.Store(tmp_path_factory.mktemp("store"))
    containers.build_debian(store, debian)
    yield store
    store.close()
    shutil.rmtree(store.folder, ignore_errors=True)


@pytest.fixture(name="image", scope="session")
def make_image(store):
    """The image of deploy/Dockerfile: an OCI folder, and its configuration."""
    containers.build_whittle(store)
    return containers.unpacked(store)


@pytest.fixture(name="package", scope="session")
def make_package(tmp_path_factory):
    """The Debian package, built here; WHITTLE_PACKAGE names one from before."""
    need_root()
    if os.environ.get("WHITTLE_PACKAGE"):
        return pathlib.Path(os.environ["WHITTLE_PACKAGE"])
    need("dpkg-buildpackage", "dh")
    began = time.monotonic()
    path = pathlib.Path(run(ROOT / "deploy/deb.sh", tmp_path_factory.mktemp("deb")).splitlines()[0])
    say(f"{path.name} in {time.monotonic() - began:.0f} s, {path.stat().st_size >> 10} KB")
    return path
