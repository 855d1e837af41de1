# SPDX-License-Identifier: GPL-3.0-or-later
"""`whittled import` and `whittled export`: from one machine to many hosts and back, with all that a client can see."""
import json
import re
import subprocess

import pytest

from conftest import BUILD, SMALL, Daemon, end_all, sphere, wait_until
from test_hosts import make_gate, make_server, make_shared  # noqa: F401, fixtures
from test_webhooks import SECRET, Receiver

OTHER = sphere(200)


def transfer(*arguments):
    """(status, jobs moved, clouds moved, outputs moved, errors)"""
    done = subprocess.run([BUILD / "whittled", *map(str, arguments)], capture_output=True, text=True, check=False)
    moved = re.match(r"(?:im|ex)ported (\d+) jobs, (\d+) clouds, (\d+) outputs", done.stdout)
    return (done.returncode, *(map(int, moved.groups()) if moved else (None,) * 3), done.stderr)


def check(*arguments):
    done = subprocess.run([BUILD / "whittled", "check", *map(str, arguments)], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.splitlines()[-1]


def ask(shared, statement):
    """What PostgreSQL says, by its own client."""
    name, socket = re.match(r"postgresql://whittle@/(\w+)\?host=(.*)", shared[1]).groups()
    return subprocess.run(["psql", "-XAtq", "-h", socket, "-U", "whittle", name, "-c", statement], check=True,
                          capture_output=True, text=True).stdout.strip()


@pytest.fixture(name="single")
def make_single(make_daemon):
    """A machine with jobs that have ended well, failed, were deleted; and what was told of them."""
    daemon = make_daemon("--result-cache=0")
    good = [daemon.submit(SMALL + b"# %d\n" % i, "?ratio=0.5&outputs=cloud,mesh&label=l%d" % i) for i in range(3)]
    bad = daemon.submit(SMALL, "?ratio=0.5&outputs=cloud&columns=x,y,z,nx,ny,nz")
    gone = daemon.submit(SMALL)
    keyed = daemon.post("/v1/jobs?ratio=0.25", SMALL, "-H", "Idempotency-Key: k").json["id"]
    cloud = daemon.post("/v1/clouds", OTHER).json["id"]
    for job in (*good, bad, gone, keyed):
        daemon.ended(job)
    daemon.curl(f"/v1/jobs/{gone}", "-X", "DELETE")
    link = daemon.curl(f"/v1/jobs/{good[0]}/outputs/cloud.ply/link", "-X", "POST").json["href"]
    return daemon, {"good": good, "bad": bad, "gone": gone, "keyed": keyed, "cloud": cloud, "link": link}


def seen(daemon, had):
    """All that a client sees of it."""
    said = {"link": daemon.curl(had["link"]).body, "cloud": daemon.curl(f"/v1/clouds/{had['cloud']}").json,
            "list": sorted(j["id"] for j in daemon.curl("/v1/jobs").json["jobs"]),
            "gone": daemon.curl(f"/v1/jobs/{had['gone']}").status,
            "bad": daemon.curl(f"/v1/jobs/{had['bad']}").json}
    for job in (*had["good"], had["keyed"]):
        said[job] = daemon.curl(f"/v1/jobs/{job}").json
        said[job, "log"] = daemon.curl(f"/v1/jobs/{job}/log").body
        for output in daemon.curl(f"/v1/jobs/{job}/outputs").json["outputs"]:
            said[job, output["name"]] = daemon.curl(f"/v1/jobs/{job}/outputs/{output['name']}").body
    return said


def test_from_one_machine_to_many_hosts_and_back(single, shared, make_daemon, tmp_path):  # noqa: F811
    daemon, had = single
    before = seen(daemon, had)
    assert before["gone"] == 410 and before["bad"]["status"] == "failed"
    away = ("--data", tmp_path / "scratch", *shared)
    assert transfer("import", "--from", daemon.data, *away)[:2] == (1, None)  # it is served, and no word of what came of it
    assert daemon.stop() == 0
    status, jobs, clouds, outputs, said = transfer("import", "--from", daemon.data, *away)
    assert (status, jobs, clouds) == (0, 5, 5) and outputs == 11, said
    assert transfer("import", "--from", daemon.data, *away)[:4] == (0, 0, 0, 0)
    assert check(*away) == (0, "checked 5 jobs, 5 clouds, 11 outputs: 0 damaged, 0 unfinished")

    hosts = [make_daemon(*shared, "--result-cache=0") for _ in range(2)]
    for host in hosts:
        assert seen(host, had) == before
    assert hosts[0].post("/v1/jobs?ratio=0.25", SMALL, "-H", "Idempotency-Key: k").json["id"] == had["keyed"]
    new = hosts[1].submit(SMALL + b"# new\n")
    assert hosts[0].ended(new)["status"] == "successful"
    back = tmp_path / "back"
    assert "serves the catalog" in transfer("export", "--to", back, *away)[4]
    for host in hosts:
        assert host.stop() == 0

    assert transfer("export", "--to", back, *away)[:4] == (0, 6, 6, 13)
    assert transfer("export", "--to", back, *away)[:4] == (0, 0, 0, 0)
    assert check("--data", back) == (0, "checked 6 jobs, 6 clouds, 13 outputs: 0 damaged, 0 unfinished")
    (tmp_path / "alone").mkdir()
    alone = Daemon(tmp_path / "alone", "--result-cache=0")
    alone.data = back
    alone.start()
    after = seen(alone, had)
    assert new in after["list"]
    after["list"].remove(new)
    assert after == before
    assert alone.ended(alone.submit(SMALL))["status"] == "successful"
    end_all([alone])


def test_a_batch_goes_over_with_its_jobs_and_its_webhook(make_daemon, shared, tmp_path):  # noqa: F811
    """What was moved while its jobs waited is told of where they end."""
    secret, receiver = tmp_path / "secret", Receiver(204)
    secret.write_text(SECRET + "\n")
    secret.chmod(0o600)
    hooks = ["--webhooks", "--webhook-secret-file", secret, "--webhook-allow", "127.0.0.1"]
    daemon = make_daemon(*hooks, "--roles", "http")
    cloud = "/v1/clouds/" + daemon.post("/v1/clouds", SMALL).json["id"]
    batch = daemon.post("/v1/batches", json.dumps({"clouds": [cloud, cloud], "webhook": receiver.url}).encode(), "-H",
                        "Content-Type: application/json").json
    assert daemon.stop() == 0
    away = ("--data", tmp_path / "scratch", *shared)
    for _ in range(2):
        status, *_, said = transfer("import", "--from", daemon.data, *away)
        assert status == 0, said
    host = make_daemon(*shared, *hooks)
    wait_until(lambda: receiver.taken, "the webhook")
    told = json.loads(receiver.taken[0][1])["data"]
    assert told["id"] == batch["id"] and told["counts"]["successful"] == 2
    assert [job["id"] for job in told["jobs"]] == [job["id"] for job in batch["jobs"]]
    assert host.stop() == 0
    assert transfer("import", "--from", daemon.data, *away)[:2] == (0, 0)
    assert ask(shared, "SELECT count(*) FROM outbox") == "0"  # what was told isn't told again


def test_what_was_cut_off_goes_on(single, shared, tmp_path):  # noqa: F811
    daemon, _ = single
    assert daemon.stop() == 0
    away = ("--data", tmp_path / "scratch", *shared)
    for point in ("commit=kill:4", "output-sync=kill:3", "commit=kill:3"):
        assert transfer("import", "--from", daemon.data, *away, "--fault", point)[0] == -9
        ask(shared, "DELETE FROM sessions")  # that of what was killed counts for a minute
    assert transfer("import", "--from", daemon.data, *away)[0] == 0
    assert check(*away) == (0, "checked 5 jobs, 5 clouds, 11 outputs: 0 damaged, 0 unfinished")


def test_what_is_damaged_is_not_moved(single, shared, tmp_path):  # noqa: F811
    daemon, had = single
    assert daemon.stop() == 0
    output = next((daemon.data / "jobs" / had["good"][1]).glob("outputs*/mesh.ply"))
    output.write_bytes(output.read_bytes()[:-1] + b"?")
    away = ("--data", tmp_path / "scratch", *shared)
    status, *_, said = transfer("import", "--from", daemon.data, *away)
    assert status == 1 and "isn't what its row says" in said
    assert ask(shared, f"SELECT count(*) FROM jobs WHERE id = '{had['good'][1]}'") == "0"


def test_a_job_that_ran_runs_again(make_daemon, shared, gate, tmp_path):  # noqa: F811
    gate, gated = gate
    daemon = make_daemon(*gated)
    running, waiting = daemon.submit(SMALL), daemon.submit(OTHER)
    daemon.wait_for(running, "running")
    daemon.kill()
    gate.unlink()
    away = ("--data", tmp_path / "scratch", *shared)
    assert transfer("import", "--from", daemon.data, *away)[:3] == (0, 2, 2)
    host = make_daemon(*shared)
    assert [host.ended(job)["status"] for job in (running, waiting)] == ["successful"] * 2


def test_its_arguments(tmp_path):
    assert transfer("import", "--data", tmp_path / "a")[0] == 2
    assert transfer("export", "--to")[0] == 2
    status, *_, said = transfer("import", "--from", tmp_path / "none", "--data", tmp_path / "a")
    assert status == 1 and "there is no" in said
