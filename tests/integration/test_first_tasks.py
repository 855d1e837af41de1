# SPDX-License-Identifier: GPL-3.0-or-later
"""Ten tasks of somebody who is new: the commands in the table of tests/DECISIONS.md are typed as they stand there, one
after the other, with the installed programs and nothing else; -s prints how long each took."""
import fcntl
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import time

import pytest

from conftest import BUILD, PATIENCE_S, SANITIZED, process_lives, wait_until
from test_cli import sphere

ROOT = pathlib.Path(__file__).resolve().parents[2]
TABLE = (ROOT / "tests/DECISIONS.md").read_text().split("\n## The first ten tasks\n")[1].split("\n## ")[0]
ROWS = {cells[0]: cells[1:] for cells in
        ([cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in TABLE.splitlines() if line.startswith("| "))
        if cells[0] != "task"}
pytestmark = pytest.mark.skipif(SANITIZED, reason="a library with sanitizers can't be loaded by a program without; "
                                                  "unit/test_library.c runs under them")


def commands(task):
    """What is typed for a task: the code in its last cell."""
    return [code.replace("\\|", "|") for code in re.findall("`([^`]+)`", ROWS[task][-1])]


class Desk:
    """A folder with a scan, and an environment in which the installed programs are found."""

    def __init__(self, folder):
        self.folder, self.prefix = folder / "desk", folder / "usr"
        self.folder.mkdir()
        python, = {path.parent.parent for path in self.prefix.rglob("whittle/__init__.py")} or [None]
        self.environment = {**os.environ, "PATH": f"{self.prefix}/bin:{os.environ['PATH']}", "PYTHONPATH": str(python),
                            "LD_LIBRARY_PATH": f"{self.prefix}/lib"}
        lines = "".join(f"{x:.6f} {y:.6f} {z:.6f} {i % 256} 7 9\n" for i, (x, y, z) in enumerate(sphere(4000)))
        head = "".join(f"property {kind} {name}\n" for kind, name in
                       [*(("float", axis) for axis in "xyz"), *(("uchar", c) for c in ("red", "green", "blue"))])
        (self.folder / "scan.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 4000\n{head}end_header\n{lines}")

    def type(self, *lines, **options):
        begun = time.monotonic()
        done = subprocess.run(["bash", "-ec", "\n".join(lines)], cwd=self.folder, env=self.environment, text=True,
                              capture_output=True, check=False, timeout=PATIENCE_S * 10, **options)
        assert done.returncode == 0, (lines, done.stdout + done.stderr)
        self.took = time.monotonic() - begun
        return done.stdout

    def do(self, task, *before):
        said = self.type(*before, *commands(task))
        print(f"{task}: {len(commands(task))} commands, {self.took:.2f} s")
        return said

    def head(self, name):
        return (self.folder / name).read_bytes().split(b"end_header\n")[0].decode()


@pytest.fixture(name="desk", scope="module")
def make_desk(tmp_path_factory):
    """Where the first task, to install, has been done."""
    folder = tmp_path_factory.mktemp("new")
    command, = commands("install")
    begun = time.monotonic()
    with open(pathlib.Path(BUILD) / "library.lock", "w") as lock:  # several processes of pytest, one build folder
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = subprocess.run([*command.replace("~/.local", str(folder / "usr")).split(), f"config={pathlib.Path(BUILD).name}"],
                              cwd=ROOT, capture_output=True, text=True, check=False,
                              env={k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")})
    assert done.returncode == 0, done.stdout + done.stderr
    print(f"install: 1 command, {time.monotonic() - begun:.2f} s, what was built before not counted")
    return Desk(folder)


def test_the_table_counts_what_is_typed():
    assert len(ROWS) == 10
    for task, cells in ROWS.items():
        assert int(re.match(r"\d+", cells[-2])[0]) == max(len(commands(task)), 1), task


def test_install_and_a_first_result(desk):
    assert "400 of 4000" in desk.do("a first result")
    assert "element vertex 400\n" in desk.head("small.ply")


def test_las_in_and_out(desk):
    desk.type("whittle convert -q scan.ply scan.laz")
    desk.do("LAS in and out, colours kept")
    small = json.loads(desk.type("whittle info --json --quick small.laz"))
    assert small["points"] == 400 and small["format"].startswith("laz") and "red" in json.dumps(small)


def test_colours_count(desk):
    desk.do("features that only colours show")
    assert "property uchar red\n" in desk.head("coloured.ply")


def test_a_mesh_for_blender(desk):
    assert "watertight" in desk.do("a mesh into Blender")
    assert (desk.folder / "mesh.glb").read_bytes()[:4] == b"glTF"


def test_levels_of_detail(desk):
    desk.do("levels of detail")
    made = [re.search(r"element vertex (\d+)", desk.head(path))[1] for path in (desk.folder / "lod").glob("mesh*.ply")]
    assert set(map(int, made)) == {400, 800, 1600}  # mesh.ply is the first of them


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(name="service", scope="module")
def make_service(desk):
    """(port, token) of the service that the table's commands start, and what curl got of it.  A port that was free may be
    somebody else's by the time the service starts: then the service ends, and another port is tried."""
    for port in (free_port() for _ in range(5)):
        typed = [line.replace("8080", str(port)) for line in commands("a service with a token")]
        desk.type(*typed[:2], "echo $! > pid; echo $token > token")
        pid, token = int((desk.folder / "pid").read_text()), (desk.folder / "token").read_text().strip()
        listens = f"listening on http://127.0.0.1:{port}"
        wait_until(lambda: not process_lives(pid) or listens in (desk.folder / "log").read_text(), "the service")
        if process_lives(pid):
            break
    else:
        pytest.fail(f"the service doesn't start: {(desk.folder / 'log').read_text()}")
    desk.type(f"token={token}", *typed[2:])
    yield port, token
    os.kill(pid, signal.SIGTERM)
    wait_until(lambda: not process_lives(pid), "the end of the service")


def test_a_service_with_a_token(desk, service):
    port, _ = service
    assert "element vertex 400\n" in desk.head("served.ply")
    refused = subprocess.run(["curl", "-s", "-o", "/dev/null", "-w", "%{http_code}", f"http://127.0.0.1:{port}/v1/jobs"],
                             capture_output=True, text=True, check=True)
    assert refused.stdout == "401"


def lines_of(language, count, port, token):
    """The first lines of the client's example in api/README.md, for this service."""
    code = re.search(rf"```{language}\n(.*?)```", (ROOT / "api/README.md").read_text(), re.S)[1]
    lines = [re.sub(" +(#|//) .*", "", line) for line in code.splitlines()[:count]]
    return [line.replace("8080", str(port)).replace("token=None", f"token={token!r}").replace("{ token }", f"{{ token: {token!r} }}")
            for line in lines]


def test_a_client_in_python(desk, service):
    pytest.importorskip("numpy", reason="python3-numpy isn't installed: make deps")
    lines = lines_of("python", 5, *service)
    (desk.folder / "client.py").write_text("\n".join(lines) + "\n")
    desk.do("a client in Python")
    assert "element vertex 400\n" in desk.head("mesh.ply")


@pytest.mark.skipif(not shutil.which("node"), reason="node isn't installed")
def test_a_client_in_javascript(desk, service):
    shutil.copytree(ROOT / "api/javascript", desk.folder, dirs_exist_ok=True)
    lines = [line.replace("(file,", "('scan.ply',") for line in lines_of("js", 5, *service)]
    (desk.folder / "client.mjs").write_text("\n".join(lines) + "\nconsole.log('triangles', triangles.length / 3);\n")
    said = desk.type("node client.mjs")
    assert re.search(r"^triangles 796$", said, re.M), said


def test_an_error_in_the_scans_units(desk):
    desk.type("whittle -q scan.ply mesh.glb -f --ratio 0.1")
    said = desk.do("an error in the scan's units")
    mean, largest = map(float, re.search(r"^points of B to A +4000 +(\S+) +\S+ +(\S+)", said, re.M).groups())
    assert 0 < mean < largest < 0.05  # of a ball of radius 1
