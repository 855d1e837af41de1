# SPDX-License-Identifier: GPL-3.0-or-later
"""buildah and podman with a store, networks and state of their own, so that nothing of the machine's is touched; and
the images that the tests run: Debian's nginx under the name that compose.yaml calls it by, and ours."""
import json
import os
import resource
import subprocess
import time

import pytest

import conftest

DEBIAN = "docker.io/library/debian:12-slim"
NGINX = "docker.io/library/nginx:1.26"
WHITTLE = "docker.io/library/whittle:latest"
# Where nginx's own image differs from Debian's package: no site of its own, logs to the terminal, and its scratch
# folders in /var/cache/nginx.
NGINX_FILE = f"""FROM {DEBIAN}
RUN apt-get update && apt-get install -y --no-install-recommends nginx-light && \\
    rm -rf /etc/nginx/sites-enabled/* /var/lib/nginx && ln -s /var/cache/nginx /var/lib/nginx && \\
    ln -sf /dev/stdout /var/log/nginx/access.log && ln -sf /dev/stderr /var/log/nginx/error.log
ENV PATH=/usr/sbin:/usr/bin:/sbin:/bin
STOPSIGNAL SIGQUIT
CMD ["nginx", "-g", "daemon off;"]
"""
SETTINGS = """[containers]
default_ulimits = ["nofile={files}:{files}", "nproc={processes}:{processes}"]
[network]
network_config_dir = "{folder}/networks"
[engine]
cgroup_manager = "cgroupfs"
events_logger = "file"
lock_type = "file"
runtime = "runc"
tmp_dir = "{folder}/tmp"
"""


def limit(which, most):
    """podman asks for a million of each, which a container within a container may not have."""
    hard = resource.getrlimit(which)[1]
    return most if hard == resource.RLIM_INFINITY else min(hard, most)


class Store:
    """Images and containers in a folder; buildah(...), podman(...)."""

    def __init__(self, folder):
        self.folder = folder
        (folder / "containers.conf").write_text(SETTINGS.format(
            folder=folder, files=limit(resource.RLIMIT_NOFILE, 8192), processes=limit(resource.RLIMIT_NPROC, 8192)))
        # Health checks are run by whoever asks for them: there is no systemd to have them run by.
        self.environment = dict(os.environ, CONTAINERS_CONF=str(folder / "containers.conf"), DISABLE_HC_SYSTEMD="true")
        self.base = ["--root", folder / "root", "--runroot", folder / "run", "--storage-driver",
                     "overlay" if overlay_works(folder) else "vfs"]

    def buildah(self, *command):
        return conftest.run("buildah", *self.base, *command, env=self.environment)

    def build(self, dockerfile, context, *tags):
        self.buildah("build", "--pull-never", "--isolation", "chroot", "--format", "docker", "--layers=false", "-f",
                     dockerfile, *(word for tag in tags for word in ("-t", tag)), context)

    def command(self, *command):
        return ["podman", *map(str, self.base), *map(str, command)]

    def podman(self, *command):
        return conftest.run(*self.command(*command), env=self.environment)

    def needs_podman(self):
        """Skips where podman can't run a container."""
        done = subprocess.run(self.command("run", "--rm", DEBIAN, "/bin/true"), env=self.environment,
                              capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"podman can't run a container here: {done.stderr.strip()[-300:]}")

    def close(self):
        """Ends what is left, and what the two mount upon their own folder."""
        for command in (("pod", "rm", "--all", "--force"), ("rm", "--all", "--force")):
            subprocess.run(self.command(*command), env=self.environment, capture_output=True, check=False)
        subprocess.run(["umount", self.folder / "root/overlay"], capture_output=True, check=False)


def overlay_works(folder):
    probe = folder / "probe"
    for name in ("lower", "upper", "work", "merged"):
        (probe / name).mkdir(parents=True)
    options = f"lowerdir={probe}/lower,upperdir={probe}/upper,workdir={probe}/work"
    done = subprocess.run(["unshare", "--mount", "mount", "-t", "overlay", "overlay", "-o", options, probe / "merged"],
                          capture_output=True, check=False)
    return done.returncode == 0


def build_debian(store, debian):
    scratch = store.buildah("from", "scratch")
    store.buildah("add", scratch, debian, "/")
    store.buildah("commit", "--rm", scratch, DEBIAN)


def build_whittle(store):
    """Builds our image as deploy/Dockerfile says; WHITTLE_IMAGE names one from before (podman save)."""
    began = time.monotonic()
    if os.environ.get("WHITTLE_IMAGE"):
        store.buildah("pull", "docker-archive:" + os.environ["WHITTLE_IMAGE"])
        return
    conftest.run(conftest.ROOT / "deploy/dist.sh", store.folder / "source")
    source = next(p for p in (store.folder / "source").iterdir() if p.is_dir())
    store.build(source / "deploy/Dockerfile", source, WHITTLE)
    conftest.say(f"the image of deploy/Dockerfile in {time.monotonic() - began:.0f} s")


def unpacked(store):
    """The image as an OCI folder, and its configuration."""
    config = json.loads(store.buildah("inspect", "--type", "image", WHITTLE))["Docker"]["config"]
    store.buildah("push", WHITTLE, f"oci:{store.folder}/oci:whittle")
    return store.folder / "oci", config


def build_nginx(store):
    (store.folder / "nginx").mkdir()
    (store.folder / "nginx/Dockerfile").write_text(NGINX_FILE)
    store.build(store.folder / "nginx/Dockerfile", store.folder / "nginx", NGINX)
