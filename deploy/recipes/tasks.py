#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks for a runner as Airflow, Prefect or Dagster: each is a function of plain values that may be run again.

    tasks.py URL FOLDER OUT      (all of it, in order, without a runner)

With Airflow:

    @dag(schedule=None)
    def survey():
        clouds = PythonOperator.partial(task_id="upload", python_callable=tasks.upload).expand(...)

What is handed from task to task are ids and paths, never data.  A task that is run again does nothing twice: a cloud is
its content, and the same cloud with the same parameters is the same result.
"""
import pathlib
import sys

import whittle


def upload(url, path, token=None):
    """The id of the cloud in a file."""
    return whittle.Client(url, token).upload(path)


def submit(url, cloud, ratio, token=None):
    """The id of a job for it."""
    return whittle.Client(url, token).simplify(cloud, ratio=ratio, outputs=["cloud", "mesh"], label="survey")["id"]


def fetch(url, job, out, token=None):
    """The path of the mesh, once the job has ended; raises whittle.Problem where it failed."""
    client = whittle.Client(url, token)
    client.wait(job)
    out = pathlib.Path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    client.save(job, "mesh.ply", out)
    return str(out)


def main(url, folder, out):
    scans = sorted(path for path in pathlib.Path(folder).iterdir() if path.is_file())
    jobs = [(scan, submit(url, upload(url, scan), 0.1)) for scan in scans]
    for scan, job in jobs:
        print(fetch(url, job, pathlib.Path(out) / f"{scan.stem}.ply"))


if __name__ == "__main__":
    main(*sys.argv[1:])
