# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles as an array job of Slurm: Debian's slurm-wlm, all of whose parts run here for this test, on loopback and with
all they write in its folder."""
import math
import os
import random
import socket
import subprocess

import pytest

from conftest import BUILD, ROOT, free_port, need, need_root, run, say, wait_until

POINTS, TILE, GOAL = 60000, 9000, ("--ratio", "0.05")

CONFIGURATION = """ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
SchedulerParameters=sched_interval=1
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 RealMemory=4000 State=UNKNOWN
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


@pytest.fixture(name="slurm", scope="module")
def make_slurm(tmp_path_factory):
    """The environment of its commands: a controller and a node, which has two processors."""
    need_root()
    need("slurmctld", "slurmd", "sbatch", "munged", "mungekey")
    folder, host = tmp_path_factory.mktemp("slurm"), socket.gethostname().partition(".")[0]
    for name in ("state", "spool"):
        (folder / name).mkdir()
    file = folder / "slurm.conf"
    file.write_text(CONFIGURATION.format(folder=folder, host=host, ports=[free_port(), free_port()]), encoding="ascii")
    run("mungekey", "--create", "--keyfile", folder / "munge.key")
    parts = [["munged", "--foreground", "--force", f"--socket={folder}/munge.socket", f"--key-file={folder}/munge.key",
              f"--pid-file={folder}/munged.pid", f"--seed-file={folder}/munge.seed"],
             ["slurmctld", "-D", "-f", file], ["slurmd", "-D", "-f", file]]
    environment, processes = {**os.environ, "SLURM_CONF": str(file)}, []
    try:
        for part in parts:
            with open(folder / f"{part[0]}.log", "wb") as log:
                processes.append(subprocess.Popen(list(map(str, part)), stdout=log, stderr=log, env=environment))
            if part[0] == "munged":
                wait_until((folder / "munge.socket").exists, "munge's socket")
        wait_until(lambda: "idle" in subprocess.run(["sinfo", "-h", "-o", "%t"], capture_output=True, text=True,
                                                    env=environment, check=False).stdout, "a node that is idle")
        say(run("sinfo", "-V", env=environment) + ", a node with two processors")
        yield environment
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()


@pytest.fixture(name="cloud", scope="module")
def make_cloud(tmp_path_factory):
    path, spread = tmp_path_factory.mktemp("cloud") / "cloud.xyz", random.Random(7)
    with open(path, "w", encoding="ascii") as out:
        for _ in range(POINTS):
            x, y = 40 * spread.random(), 40 * spread.random()
            out.write(f"{x:.5f} {y:.5f} {math.sin(0.9 * x) * math.cos(0.7 * y):.5f}\n")
    return path


@pytest.fixture(name="expected", scope="module")
def make_expected(cloud, tmp_path_factory):
    """What the same tiles become by the command, one after the other."""
    folder = tmp_path_factory.mktemp("expected")
    def tiles(*words):
        return run(BUILD / "whittle", "tiles", *words, "--scratch", folder / "work")
    tiles("plan", cloud, "--memory", "1G", "--tile-points", TILE, *GOAL)
    for tile in tiles("list").split():
        tiles("run", tile)
    tiles("merge", folder / "out.ply")
    return (folder / "out.ply").read_bytes()


def hand_in(slurm, cloud, folder):
    """By the script that people have; the ids of jobs, once none of them is left, with how each ended."""
    environment = {**slurm, "WHITTLE": str(BUILD / "whittle"), "MEMORY": "1G", "THREADS": "1"}
    run("sh", ROOT / "deploy/tiles.slurm", cloud, folder / "out.ply", *GOAL, "--tile-points", TILE, env=environment,
        cwd=folder)
    def ended():
        lines = run("scontrol", "-o", "show", "jobs", env=slurm).splitlines()
        fields = [dict(word.split("=", 1) for word in line.split() if "=" in word) for line in lines]
        found = {f["JobId"]: f for f in fields}
        return all(f["JobState"] in ("COMPLETED", "FAILED", "CANCELLED", "NODE_FAIL") for f in found.values()) and found
    return wait_until(ended, "the end of all jobs")


def test_tiles_as_an_array_job(slurm, cloud, expected, tmp_path):
    jobs = hand_in(slurm, cloud, tmp_path)
    array = {int(job["ArrayTaskId"]) for job in jobs.values() if "ArrayTaskId" in job}
    assert {job["JobState"] for job in jobs.values()} == {"COMPLETED"}
    assert len(array) > 4 and len(jobs) == len(array) + 1
    assert (tmp_path / "out.ply").read_bytes() == expected
    say(f"an array of {len(array)} tiles and a merge: the same bytes")
    (tmp_path / "out.ply").unlink()
    (tmp_path / "out.ply.tiles/left.3").unlink()  # a tile that was lost
    again = {number: job for number, job in hand_in(slurm, cloud, tmp_path).items() if number not in jobs}
    assert [job["ArrayTaskId"] for job in again.values() if "ArrayTaskId" in job] == ["3"] and len(again) == 2
    assert (tmp_path / "out.ply").read_bytes() == expected
    say("handed in again: the tile that was lost, and the merge")
