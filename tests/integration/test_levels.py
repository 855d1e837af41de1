# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarser levels of a cloud: a prefix of an output is the output of another job."""
import base64
import hashlib

import pytest

from conftest import SMALL, sphere

COLOURED = b"# x y z red nx\n" + b"".join(
    line + f" {i % 256} {i / 7:.3f}\n".encode() for i, line in enumerate(sphere(700).splitlines()))


def tagged():
    """A PLY with a list, comments and faces."""
    points = sphere(400).decode().splitlines()
    head = ("ply\nformat ascii 1.0\ncomment element vertex 7\nobj_info made by hand\n"
            f"element vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\n"
            "property list uchar ushort seen\nproperty uchar red\nelement face 1\n"
            "property list uchar int vertex_indices\nend_header\n")
    rows = "".join(f"{p} {i % 4} {' '.join(str(i + j) for j in range(i % 4))} {i % 256}\n".replace("  ", " ")
                   for i, p in enumerate(points))
    return (head + rows + "3 0 1 2\n").encode()


def output(daemon, cloud, query, name="cloud.ply"):
    job = daemon.ended(daemon.submit(cloud, query))
    assert job["status"] == "successful", job
    return f"/v1/jobs/{job['id']}/outputs/{name}"


@pytest.mark.parametrize("cloud", [SMALL, COLOURED, tagged()], ids=["plain", "coloured", "lists"])
@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_a_level_is_the_output_of_a_job_of_its_own(daemon, cloud, encoding):
    for name in ("cloud.ply", "cloud.xyz"):
        path = output(daemon, cloud, f"?ratio=0.6&encoding={encoding}&outputs=cloud,xyz", name)
        for goal in ("points=1", "points=77", "ratio=0.31", "ratio=0.0001", "ratio=0.6"):
            fresh = daemon.curl(output(daemon, cloud, f"?{goal}&encoding={encoding}&outputs=cloud,xyz", name))
            level = daemon.curl(f"{path}?{goal}")
            assert level.status == 200 and level.body == fresh.body
            for header in ("etag", "repr-digest", "content-type", "content-length", "cache-control"):
                assert level.headers[header] == fresh.headers[header]


def test_levels_of_a_denoised_cloud_and_of_a_ratio_over_distinct_points(daemon):
    twice = SMALL + SMALL
    path = output(daemon, twice, "?ratio=1")
    assert daemon.curl(f"{path}?ratio=1").body == daemon.curl(path).body
    path = output(daemon, sphere(900), "?ratio=0.5&denoise=full")
    fresh = daemon.curl(output(daemon, sphere(900), "?ratio=0.2&denoise=full"))
    assert daemon.curl(f"{path}?ratio=0.2").body == fresh.body


def test_a_level_has_ranges_tags_and_a_name(daemon):
    path = output(daemon, SMALL, "?points=200&label=ball") + "?points=100"
    whole = daemon.curl(path)
    assert whole.headers["content-disposition"] == 'attachment; filename="ball-cloud-100.ply"'
    assert whole.headers["repr-digest"] == f"sha-256=:{base64.b64encode(hashlib.sha256(whole.body).digest()).decode()}:"
    part = daemon.curl(path, "-H", "Range: bytes=10-19", "-H", f"If-Range: {whole.headers['etag']}")
    assert part.status == 206 and part.body == whole.body[10:20]
    assert daemon.curl(path, "-H", f"If-None-Match: {whole.headers['etag']}").status == 304
    assert daemon.curl(path, "-H", "Range: bytes=999999-").slug == "range-not-satisfiable"
    head = daemon.curl(path, "-I", "-o", "/dev/null")
    assert head.headers["content-length"] == str(len(whole.body))
    assert daemon.leftovers() == []


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.xyz"])
def test_more_points_than_there_are_names_the_range(daemon, name):
    path = output(daemon, SMALL, "?points=50&outputs=cloud,xyz", name)
    for goal in ("points=51", "ratio=0.9"):
        reply = daemon.curl(f"{path}?{goal}")
        assert (reply.status, reply.slug) == (400, "invalid-parameter")
        assert reply.json["errors"][0]["parameter"] == goal.split("=")[0]
        assert reply.json["errors"][0]["value"] == goal.split("=")[1]
        assert "1 to 50 points" in reply.json["errors"][0]["allowed"]


@pytest.mark.parametrize("query, slug", [("points=0", "invalid-parameter"), ("ratio=2", "invalid-parameter"),
                                         ("points", "invalid-parameter"), ("ratio=nan", "invalid-parameter"),
                                         ("points=5&ratio=0.1", "conflicting-parameters"),
                                         ("seed=5", "unknown-parameter"), ("points=5&points=6", "unknown-parameter")])
def test_a_wrong_level_is_refused(daemon, query, slug):
    reply = daemon.curl(f"{output(daemon, SMALL, '?points=50')}?{query}")
    assert (reply.status, reply.slug) == (400, slug)


def test_a_wrong_level_is_named_with_its_value_and_what_is_allowed(daemon):
    reply = daemon.curl(f"{output(daemon, SMALL, '?points=50')}?points=0")
    assert reply.json["detail"] == "points: '0' is not allowed; it takes a whole number from 1 to 4294967294"
    assert reply.json["errors"] == [{"parameter": "points", "value": "0", "allowed": "a whole number from 1 to 4294967294"}]


def test_only_clouds_have_levels(daemon):
    path = output(daemon, SMALL, "?points=50", "report.json")
    assert daemon.curl(f"{path}?points=5").slug == "invalid-parameter"
    assert daemon.curl(path.replace("report.json", "mesh.ply") + "?points=5").slug == "no-such-output"
