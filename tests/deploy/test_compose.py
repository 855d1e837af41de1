# SPDX-License-Identifier: GPL-3.0-or-later
"""deploy/compose.yaml: accepted by docker-compose, its files are there, and what it grants is no more than it says.
The configuration of nginx that it mounts is run by tests/integration/test_proxy.py."""
import pytest

from conftest import ROOT, need, run, say

yaml = pytest.importorskip("yaml")
COMPOSE = ROOT / "deploy/compose.yaml"


def test_docker_compose_accepts_it():
    need("docker-compose")
    services = run("docker-compose", "-f", COMPOSE, "config", "--services").split()
    assert sorted(services) == ["nginx", "whittled"]
    say("docker-compose accepts it")


def test_what_it_mounts_is_there():
    document = yaml.safe_load(COMPOSE.read_text())
    for service in document["services"].values():
        for volume in service["volumes"]:
            source = volume.split(":")[0]
            if source in document["volumes"] or source == "./tls":  # the certificate is the administrator's
                continue
            assert (COMPOSE.parent / source).is_file(), source
    build = document["services"]["whittled"]["build"]
    assert (COMPOSE.parent / build["context"] / build["dockerfile"]).is_file()


def test_nobody_but_nginx_reaches_the_open_port():
    document = yaml.safe_load(COMPOSE.read_text())
    service = document["services"]["whittled"]
    assert "ports" not in service and service["networks"] == ["inside"] and document["networks"]["inside"]["internal"]
    assert service["read_only"] and service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
