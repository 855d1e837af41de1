# SPDX-License-Identifier: GPL-3.0-or-later
"""/v1/clouds: upload once; by content; kept as long as somebody needs it."""
import base64
import gzip
import hashlib
import math
import os
import struct

import pytest

from conftest import SMALL, sphere, wait_until

PLY = (b"ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty float y\n"
       b"property double z\nproperty uchar red\nproperty list uchar int near\nend_header\n"
       b"0 0 0 1 0\n1 0 0 2 1 7\n0 1 0 3 0\n0 0 1 4 2 1 2\n")


def name_of(content):
    return hashlib.sha256(content).hexdigest()


def files(daemon):
    return daemon.kept("clouds")


def test_upload_describe_give_back_delete(daemon):
    made = daemon.post("/v1/clouds", PLY)
    assert made.status == 201 and made.headers["location"] == f"/v1/clouds/{name_of(PLY)}"
    cloud = made.json
    assert cloud["id"] == cloud["sha256"] == name_of(PLY)
    assert (cloud["bytes"], cloud["points"], cloud["format"], cloud["jobs"]) == (len(PLY), 4, "ply/ascii", 0)
    assert cloud["expires"] > cloud["created"] and cloud["bounding_box"] is None
    assert cloud["properties"] == [
        {"name": "x", "type": "float"}, {"name": "y", "type": "float"}, {"name": "z", "type": "double"},
        {"name": "red", "type": "uchar"}, {"name": "near", "type": "int", "list_count_type": "uchar"}]
    path = made.headers["location"]
    assert daemon.curl(path).json == cloud
    head = daemon.curl(path, "-I", "-o", os.devnull)
    assert head.status == 200 and int(head.headers["content-length"]) == len(daemon.curl(path).body)
    assert daemon.curl("/v1/clouds").json == {"clouds": [cloud]}
    deleted = daemon.curl(path, "-X", "DELETE")
    assert deleted.status == 200 and deleted.json == cloud
    assert daemon.curl(path).slug == "no-such-cloud" and files(daemon) == []
    assert daemon.curl(path, "-X", "DELETE").slug == "no-such-cloud"


def las(points, low, high, *, count=None):
    """LAS 1.2 of format 1: places in millimetres from the origin, and a header that tells the box (low, high) and the count."""
    head = struct.pack("<4s20xBB68xHIIBHI20x", b"LASF", 1, 2, 227, 227, 0, 1, 28, len(points) if count is None else count)
    box = [value for pair in zip(high, low) for value in pair]
    head += struct.pack("<12d", .001, .001, .001, 0, 0, 0, *box)
    return head + b"".join(struct.pack("<3i16x", *point) for point in points)


def test_the_header_of_las_tells_points_properties_and_box(daemon):
    points = [(0, 0, 0), (4000, 0, 0), (0, 5000, 1), (0, 0, 6000)]
    path = daemon.post("/v1/clouds", las(points, (0, 0, 0), (4, 5, 6))).headers["location"]
    cloud = daemon.curl(path).json
    assert cloud["points"] == 4 and cloud["bounding_box"] == {"min": [0, 0, 0], "max": [4, 5, 6]}
    assert [p["name"] for p in cloud["properties"]][:5] == ["x", "y", "z", "intensity", "return_number"]
    assert {"name": "gps_time", "type": "double"} in cloud["properties"]
    assert daemon.curl("/v1/clouds").json == {"clouds": [cloud]}
    assert daemon.curl(f"{path}/plan?ratio=0.5").json["points_out"] == [2]
    # what a job has read is told in place of what a header says
    path = daemon.post("/v1/clouds", las(points, (-9, 0, 0), (4, 5, 6), count=7)).headers["location"]
    assert daemon.curl(path).json["points"] == 7 and daemon.curl(path).json["bounding_box"]["min"] == [-9, 0, 0]
    job = daemon.ended(daemon.curl(path + "/jobs", "--json", '{"params":{"ratio":1,"outputs":["cloud"]}}').json["id"])
    assert job["status"] == "successful", job
    assert daemon.curl(path).json["points"] == 4 and daemon.curl(path).json["bounding_box"]["min"] == [0, 0, 0]


@pytest.mark.parametrize("low, high", [((math.nan, 0, 0), (4, 5, 6)), ((5, 0, 0), (4, 5, 6)), ((0, 0, 0), (4, math.inf, 6))])
def test_a_box_that_cannot_be_is_not_told(daemon, low, high):
    cloud = daemon.post("/v1/clouds", las([(0, 0, 0), (4000, 0, 0)], low, high)).json
    assert cloud["points"] == 2 and cloud["bounding_box"] is None


def test_headers_of_las_that_are_cut_short_are_no_fault(daemon):
    whole = las([(0, 0, 0), (4000, 0, 0)], (0, 0, 0), (4, 5, 6))
    for n in (4, 25, 105, 226, 227, 250):
        made = daemon.post("/v1/clouds", whole[:n])
        assert made.status in (201, 422, 400), (n, made.status)
        if made.status == 201 and n < 227:
            assert made.json["points"] is None and made.json["bounding_box"] is None and made.json["properties"] is None


def test_content_comes_back_whole_in_parts_and_not_twice(daemon):
    path = daemon.post("/v1/clouds", SMALL).headers["location"] + "/data"
    whole = daemon.curl(path)
    assert whole.status == 200 and whole.body == SMALL
    assert whole.headers["etag"] == f'"{name_of(SMALL)}"' and whole.headers["accept-ranges"] == "bytes"
    digest = base64.b64encode(hashlib.sha256(SMALL).digest()).decode()
    assert whole.headers["repr-digest"] == f"sha-256=:{digest}:"
    assert whole.headers["content-type"].startswith("text/plain")
    part = daemon.curl(path, "-H", "Range: bytes=100-199")
    assert part.status == 206 and part.body == SMALL[100:200]
    assert daemon.curl(path, "-H", "Range: bytes=999999999-").slug == "range-not-satisfiable"
    assert daemon.curl(path, "-H", f'If-None-Match: {whole.headers["etag"]}').status == 304
    assert daemon.curl("/v1/clouds/" + "0" * 64 + "/data").slug == "no-such-cloud"


PCD = (b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\n"
       b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA ascii\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n")


@pytest.mark.parametrize("content, ending", [(PLY, "ply"), (SMALL, "xyz"), (PCD, "pcd"), (gzip.compress(SMALL), "gz")])
def test_content_comes_back_under_a_name_of_its_format(daemon, content, ending):
    made = daemon.post("/v1/clouds", content)
    assert made.status == 201, made.body
    disposition = daemon.curl(made.headers["location"] + "/data").headers["content-disposition"]
    assert disposition == f'attachment; filename="{name_of(content)[:12]}.{ending}"'


def test_the_same_content_is_the_same_cloud(daemon):
    first, second = daemon.post("/v1/clouds", SMALL), daemon.post("/v1/clouds", SMALL)
    assert (first.status, second.status) == (201, 200)
    assert first.json["created"] == second.json["created"] and first.json["expires"] <= second.json["expires"]
    assert files(daemon) == [name_of(SMALL)] and len(daemon.curl("/v1/clouds").json["clouds"]) == 1


def test_a_job_tells_what_a_cloud_holds(daemon):
    path = daemon.post("/v1/clouds", SMALL).headers["location"]
    assert daemon.curl(path).json["points"] is None
    job = daemon.ended(daemon.submit(SMALL))
    assert job["input"]["cloud"] == path
    cloud = daemon.curl(path).json
    assert (cloud["points"], cloud["jobs"]) == (300, 1)
    assert all(-1 <= low < high <= 1 for low, high in zip(cloud["bounding_box"]["min"], cloud["bounding_box"]["max"]))


def test_a_cloud_is_kept_while_jobs_refer_to_it(daemon):
    path = daemon.post("/v1/clouds", SMALL).headers["location"]
    job_id = daemon.submit(SMALL)
    refused = daemon.curl(path, "-X", "DELETE")
    assert (refused.status, refused.slug, refused.json["jobs"]) == (409, "cloud-in-use", 1)
    daemon.ended(job_id)
    assert daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE").status == 200
    assert daemon.curl(path).json["jobs"] == 0 and files(daemon) == [name_of(SMALL)]
    assert daemon.curl(path, "-X", "DELETE").status == 200 and files(daemon) == []


def test_a_jobs_own_cloud_goes_with_its_last_job(daemon):
    jobs = [daemon.submit(SMALL), daemon.submit(SMALL)]
    path = f"/v1/clouds/{name_of(SMALL)}"
    cloud = daemon.curl(path).json
    assert cloud["expires"] is None and cloud["jobs"] == 2
    for job_id in jobs:
        daemon.ended(job_id)
        assert daemon.curl(path).status == 200
        daemon.curl(f"/v1/jobs/{job_id}", "-X", "DELETE")
    assert daemon.curl(path).slug == "no-such-cloud" and files(daemon) == []


def test_clouds_expire(make_daemon):
    daemon = make_daemon("--retention", "300ms")
    path = daemon.post("/v1/clouds", SMALL).headers["location"]
    wait_until(lambda: daemon.curl(path).status == 404, "the cloud's end")
    wait_until(lambda: files(daemon) == [], "the file's end")


def test_clouds_survive_a_kill_and_lost_files_are_forgotten(make_daemon):
    daemon = make_daemon()
    kept, lost = (daemon.post("/v1/clouds", sphere(n)).headers["location"] for n in (50, 60))
    daemon.kill()
    (daemon.data / "clouds" / lost.rsplit("/", 1)[1]).unlink()
    daemon.start()
    assert daemon.curl(kept).status == 200 and daemon.curl(lost).slug == "no-such-cloud"


def test_pages(daemon):
    names = [daemon.post("/v1/clouds", sphere(40 + i)).json["id"] for i in range(5)]
    path, found = "/v1/clouds?limit=2", []
    while path:
        page = daemon.curl(path)
        found += [cloud["id"] for cloud in page.json["clouds"]]
        link = page.headers.get("link")
        path = link and link.split(">")[0].removeprefix("<")
    assert sorted(found) == sorted(names) and len(found) == 5


@pytest.mark.parametrize("query, slug", [("limit=0", "invalid-parameter"), ("limit=501", "invalid-parameter"),
                                         ("after=x", "invalid-parameter"), ("limt=3", "unknown-parameter")])
def test_refused_lists(daemon, query, slug):
    reply = daemon.curl(f"/v1/clouds?{query}")
    assert (reply.status, reply.slug) == (400, slug)


def test_refused_clouds(daemon):
    assert daemon.post("/v1/clouds?label=x", SMALL).slug == "unknown-parameter"
    assert daemon.post("/v1/clouds", b"\x89PNG\r\n\x1a\n" + bytes(9999)).slug == "unsupported-format"
    assert daemon.post("/v1/clouds", PLY.replace(b"vertex 4", b"vertex 444444444444")).status in (413, 422)
    assert daemon.post("/v1/clouds", b"").slug == "malformed-cloud"
    assert daemon.curl("/v1/clouds").json == {"clouds": []} and files(daemon) == [] and daemon.leftovers() == []
