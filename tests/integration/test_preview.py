# SPDX-License-Identifier: GPL-3.0-or-later
"""preview.png, by the command and by the service: a sound PNG that shows the cloud, the same for any number of threads."""
import base64
import json
import os
import re
import shutil
import struct
import subprocess
import zlib

import pytest

from test_parameters import torus, write

WHITTLE = os.path.abspath(os.path.join(os.environ.get("WHITTLE_BUILD", "build/release"), "whittle"))
PAPER = bytes((250, 250, 248))


def decode(data):
    """Width and rows (bytes of RGB) of a PNG; every chunk's checksum is looked at."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, chunks = 8, []
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        assert zlib.crc32(kind + body) == struct.unpack(">I", data[at + 8 + length:at + 12 + length])[0]
        chunks.append((kind, body))
        at += 12 + length
    assert chunks[0][0] == b"IHDR" and chunks[-1] == (b"IEND", b"")
    width, height, depth, colour, *_ = struct.unpack(">IIBBBBB", chunks[0][1])
    assert (depth, colour) == (8, 2)
    return width, unfilter(zlib.decompress(b"".join(body for kind, body in chunks if kind == b"IDAT")), width, height)


def unfilter(raw, width, height):
    stride, rows = 3 * width, [bytes(3 * width)]
    assert len(raw) == (stride + 1) * height
    for y in range(height):
        how, line, above = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)]), rows[-1]
        for i in range(stride):
            a, b, c = line[i - 3] if i >= 3 else 0, above[i], above[i - 3] if i >= 3 else 0
            nearest = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            line[i] = (line[i] + (0, a, b, (a + b) // 2, nearest)[how]) & 255
        rows.append(bytes(line))
    return rows[1:]


def run(scan, out, *more):
    done = subprocess.run([WHITTLE, scan, "-o", out, "-q", *more], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(name="scan", scope="module")
def make_scan(tmp_path_factory):
    return write(tmp_path_factory.mktemp("scan") / "torus.obj", torus())


def pictures(data, size):
    """The three pictures' pixels, each as rows of three bytes, from between their words."""
    width, rows = decode(data)
    gap = size // 40 + 1
    assert width == gap + 3 * (size + gap)
    letters = max(8, size / 40)
    body = rows[int(3.2 * letters):len(rows) - int(4.6 * letters)]
    return [[row[3 * (gap + i * (size + gap)):][:3 * size] for row in body] for i in range(3)]


def covered(rows):
    pixels = [row[i:i + 3] for row in rows for i in range(0, len(row), 3)]
    return sum(pixel != PAPER for pixel in pixels) / len(pixels)


@pytest.mark.parametrize("outputs", ["preview.png", "mesh,preview.png"])
def test_before_after_and_deviation_show_the_same_silhouette(scan, tmp_path, outputs):
    out = run(scan, tmp_path / "out", "--outputs", outputs, "--preview_size", "120", "--ratio", "0.5")
    shares = [covered(rows) for rows in pictures((out / "preview.png").read_bytes(), 120)]
    assert 0.25 < shares[0] < 0.8 and shares[2] == shares[0]
    assert abs(shares[1] - shares[0]) < 0.06, shares


def test_from_above_the_hole_of_a_ring_is_open_and_from_its_side_it_is_not(scan, tmp_path):
    def middle(elevation):
        out = run(scan, tmp_path / f"{elevation}.png", "--preview_elevation", elevation, "--preview_size", "120")
        rows = pictures(out.read_bytes(), 120)[0]
        return rows[len(rows) // 2][180:183]
    assert middle("90") == PAPER != middle("0")


def test_threads_and_formats_of_the_same_cloud_change_no_byte(scan, tmp_path):
    found = {run(scan, tmp_path / f"{n}.png", "--threads", n, "--outputs", "preview.png").read_bytes()
             for n in ("1", "2", "5")}
    assert len(found) == 1


def test_a_job_has_its_picture(daemon, scan):
    job = daemon.ended(daemon.submit(scan.read_bytes(), "?outputs=mesh,preview.png&preview_size=100"))
    assert job["status"] == "successful", job
    reply = daemon.curl(f"/v1/jobs/{job['id']}/outputs/preview.png")
    assert reply.status == 200 and reply.headers["content-type"] == "image/png"
    assert all(covered(rows) > 0.2 for rows in pictures(reply.body, 100))
    again = daemon.post("/v1/simplify?output=preview.png&preview_size=100", scan.read_bytes())
    assert again.headers["content-type"] == "image/png" and decode(again.body)[0] == decode(reply.body)[0]


def test_error_of_several_levels_is_that_of_the_finest(scan, tmp_path):
    def largest(*more):
        out = run(scan, tmp_path / more[-1], "--outputs", "error,mesh,report", "--encoding", "ascii", *more)
        body = (out / "error.ply").read_text(encoding="ascii").partition("end_header\n")[2]
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
        return max(float(line.split()[3]) for line in body.splitlines()), report
    several, one = largest("--levels", "0.4,0.05")[0], largest("--ratio", "0.4")[0]
    assert several == one


def test_sizes_and_angles_out_of_range_are_refused(scan):
    for name, value in (("preview_size", "63"), ("preview_size", "1025"), ("preview_elevation", "91"),
                        ("up", "w"), ("preview_azimuth", "nan")):
        done = subprocess.run([WHITTLE, scan, f"--{name}", value, "--dry-run"], capture_output=True, text=True, check=False)
        assert done.returncode == 64 and re.search(name, done.stderr), done.stderr


def shown(scan, tmp_path, way, **environment):
    done = subprocess.run([WHITTLE, scan, f"--preview{way}", "--preview_size", "100", "-q", "-o", tmp_path / "out"],
                          capture_output=True, check=True, env=os.environ | environment)
    return done.stdout, (tmp_path / "out" / "preview.png").read_bytes()


def test_kitty_gets_the_file_itself_in_pieces(scan, tmp_path):
    said, file = shown(scan, tmp_path, "=kitty")
    pieces = re.findall(rb"\x1b_G(a=T,f=100,)?m=([01]);([A-Za-z0-9+/=]*)\x1b\\", said)
    assert [last for _, last, _ in pieces] == [b"1"] * (len(pieces) - 1) + [b"0"] and pieces[0][0]
    assert all(len(data) <= 4096 and not first for first, _, data in pieces[1:])
    assert base64.b64decode(b"".join(data for _, _, data in pieces)) == file


def test_sixels_are_the_picture_in_a_palette(scan, tmp_path):
    said, file = shown(scan, tmp_path, "=sixel")
    width, rows = decode(file)
    body = re.fullmatch(rb'\x1bP0;1q"1;1;(\d+);(\d+)(.*)\x1b\\\n', said, re.S)
    assert (int(body[1]), int(body[2])) == (width, len(rows))
    palette, pixel, x, y, colour = {}, {}, 0, 0, None
    for token in re.finditer(rb"#(\d+);2;(\d+);(\d+);(\d+)|#(\d+)|!(\d+)([?-~])|([?-~])|([$-])", body[3]):
        if token[1]:
            palette[int(token[1])] = [int(token[k]) * 255 / 100 for k in (2, 3, 4)]
        elif token[5]:
            colour = int(token[5])
        elif token[9]:
            x, y = 0, y + 6 * (token[9] == b"-")
        else:
            for _ in range(int(token[6] or 1)):
                bits = ord(token[7] or token[8]) - 63
                pixel.update({(x, y + k): colour for k in range(6) if bits >> k & 1})
                x += 1
    assert len(pixel) == width * len(rows)
    assert len({pixel[x, y] for y, row in enumerate(rows) for x in range(width) if row[3 * x:3 * x + 3] == PAPER}) == 1
    off = [abs(palette[pixel[x, y]][c] - rows[y][3 * x + c]) for y in range(len(rows)) for x in range(width) for c in range(3)]
    assert max(off) <= 52 and sum(off) / len(off) < 20


@pytest.mark.skipif(not shutil.which("sixel2png"), reason="sixel2png of libsixel isn't installed")
def test_libsixel_reads_the_same_picture(scan, tmp_path):
    said, file = shown(scan, tmp_path, "=sixel")
    data = subprocess.run(["sixel2png"], input=said, capture_output=True, check=True).stdout
    (width, rows), (read_width, read) = decode(file), decode(data)
    assert (read_width, len(read)) == (width, len(rows))
    off = [abs(a - b) for one, other in zip(rows, read) for a, b in zip(one, other)]
    assert max(off) <= 52 and sum(off) / len(off) < 20


def test_blocks_are_two_pixels_each(scan, tmp_path):
    said, file = shown(scan, tmp_path, "=blocks", COLORTERM="truecolor")
    width, rows = decode(file)
    lines = said.decode().splitlines()
    assert len(lines) == len(rows) * 80 // width // 2 and all(line.count("\u2580") == 80 for line in lines)
    first = re.match(r"\x1b\[38;2;(\d+);(\d+);(\d+)m\x1b\[48;2;", lines[-1])
    assert all(abs(int(first[c + 1]) - PAPER[c]) <= 2 for c in range(3))
    few, _ = shown(scan, tmp_path, "=blocks", COLORTERM="")
    assert b"38;2;" not in few and few.count(b"\x1b[38;5;") == 80 * len(lines)


def test_where_nothing_can_be_shown_the_file_is_named(scan, tmp_path):
    said, file = shown(scan, tmp_path, "")
    assert b"preview.png" in said and b"\x1b" not in said and decode(file)


@pytest.mark.parametrize("way, reason", [(["=dots"], "it takes auto"), (["", "-o", "one.ply"], "takes one output"),
                                         (["", "-o", "-"], "takes one output")])
def test_a_picture_beside_one_file_is_refused(scan, tmp_path, way, reason):
    done = subprocess.run([WHITTLE, scan, f"--preview{way[0]}", *way[1:]], capture_output=True, text=True, check=False,
                          cwd=tmp_path)
    assert done.returncode == 64 and reason in done.stderr and not list(tmp_path.iterdir())
