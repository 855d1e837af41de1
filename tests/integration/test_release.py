# SPDX-License-Identifier: GPL-3.0-or-later
"""What is released: the tarball is the same bytes whenever it is made, versions come from git, the bill of materials
names what the programs are linked with, and the shell completes what the programs know."""
import json
import os
import pathlib
import re
import shutil
import subprocess

import pytest

import conftest

ROOT = pathlib.Path(__file__).resolve().parents[2]
RELEASE_BUILD = not conftest.SANITIZED
needs_dpkg = pytest.mark.skipif(not shutil.which("dpkg-query"), reason="dpkg is not installed")
needs_bash = pytest.mark.skipif(not shutil.which("bash"), reason="bash is not installed")


def run(*command, **more):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **more)
    assert done.returncode == 0, (command, done.stdout, done.stderr)
    return done.stdout.strip()


@pytest.fixture(name="tarball", scope="module")
def make_tarball(tmp_path_factory):
    return pathlib.Path(run(ROOT / "deploy/dist.sh", tmp_path_factory.mktemp("dist")))


@pytest.mark.skipif(conftest.SANITIZED, reason="sanitizers change nothing here, and the plain run does it")
def test_the_tarball_is_the_same_bytes_each_time(tarball, tmp_path):
    again = run(ROOT / "deploy/dist.sh", tmp_path, env=dict(os.environ, TZ="Asia/Tokyo", LC_ALL="C.UTF-8"),
                preexec_fn=lambda: os.umask(0o077))
    assert pathlib.Path(again).read_bytes() == tarball.read_bytes()


@pytest.mark.skipif(conftest.SANITIZED, reason="sanitizers change nothing here, and the plain run does it")
def test_a_tarball_made_from_the_tarball_is_the_same_bytes(tarball, tmp_path):
    run("tar", "-xf", tarball, "-C", tmp_path)
    tree = tmp_path / tarball.name.removesuffix(".tar.xz")
    again = pathlib.Path(run(tree / "deploy/dist.sh", tmp_path / "again"))
    assert again.name == tarball.name and again.read_bytes() == tarball.read_bytes()
    assert run(tree / "deploy/version.sh") == run(ROOT / "deploy/version.sh")


@pytest.mark.skipif(conftest.SANITIZED, reason="sanitizers change nothing here, and the plain run does it")
def test_the_tarball_holds_the_whole_source(tarball):
    names = {n.split("/", 1)[1] for n in run("tar", "-tf", tarball).splitlines() if "/" in n}
    assert {"Makefile", "README.md", "core/pipeline/pipeline.c", "server/daemon/main.c", "deploy/Dockerfile"} <= names
    assert not [n for n in names if n.startswith(("build/", "out/", ".git/"))]


def test_the_package_is_built_with_what_the_makefile_wants():
    wanted = run("make", "-C", ROOT, "--no-print-directory", "-s", "print-packages").split()
    wanted = {p for p in wanted if p.endswith("-dev")} - {"libc6-dev", "libcmocka-dev"}
    declared = set(re.findall(r"[a-z0-9.+-]+-dev", (ROOT / "deploy/debian/control").read_text())) - {"libwhittle-dev"}
    assert wanted == declared


def build_dependencies():
    """What dpkg-buildpackage looks for: what the package declares, and build-essential."""
    control = (ROOT / "deploy/debian/control").read_text()
    declared = re.search(r"^Build-Depends: (.*(?:\n .*)*)", control, re.M)[1]
    return {re.sub(r" *\(.*\)|-compat", "", name.strip()) for name in declared.split(",")} | {"build-essential"}


def test_make_deb_installs_what_dpkg_wants():
    made = [run("make", "-C", ROOT, "--no-print-directory", "-s", target).split()
            for target in ("print-packages", "print-deb-packages")]
    assert build_dependencies() <= {name for names in made for name in names}


def test_a_folder_that_is_called_like_dependencies_is_none():
    """As fish's vendor_completions.d of the package, which `make deb` leaves in the build."""
    folder = conftest.BUILD / "vendor_completions.d"
    folder.mkdir(exist_ok=True)
    try:
        assert "odd-geometries" in run("make", "-C", ROOT, f"config={conftest.BUILD.name}", "help")
    finally:
        folder.rmdir()


@pytest.mark.skipif(conftest.SANITIZED, reason="sanitizers change nothing here, and the plain run does it")
@pytest.mark.skipif(not shutil.which("clang"), reason="clang is not installed")
def test_clang_takes_the_sources_too():
    """The fuzzers are made with it."""
    sources = [path for folder in ("core", "api", "server") for path in sorted((ROOT / folder).rglob("*.c"))]
    assert len(sources) > 100
    run("clang", "-fsyntax-only", "-std=c11", "-D_GNU_SOURCE", "-I.", "-w",
        '-DOPENAPI_JSON="api/openapi/head.json"', *sources, cwd=ROOT)


@pytest.fixture(name="repository")
def make_repository(tmp_path):
    """A repository with one commit that has version.sh."""
    (tmp_path / "deploy").mkdir()
    shutil.copy(ROOT / "deploy/version.sh", tmp_path / "deploy")

    def git(*arguments):
        return run("git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", *arguments)

    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "first")
    return lambda: run(tmp_path / "deploy/version.sh"), git, tmp_path


def test_versions_come_from_git(repository):
    version, git, folder = repository
    assert re.fullmatch(r"0\.0\.0\+1\.g[0-9a-f]{7}", version())
    git("tag", "-a", "-m", "x", "v1.2.3")
    assert version() == "1.2.3"
    git("commit", "-q", "--allow-empty", "-m", "second")
    assert re.fullmatch(r"1\.2\.3\+1\.g[0-9a-f]{7}", version())
    with open(folder / "deploy/version.sh", "a", encoding="utf-8") as file:
        file.write("# a change\n")
    assert re.fullmatch(r"1\.2\.3\+1\.g[0-9a-f]{7}\.dirty", version())


def test_a_tree_without_git_says_what_its_file_says(repository):
    version, _, folder = repository
    (folder / ".version").write_text("4.5.6 1700000000\n")
    assert version() == "4.5.6"
    assert run(folder / "deploy/version.sh", "--epoch", env={"PATH": os.environ["PATH"]}) == "1700000000"


def test_every_program_says_the_version_it_was_built_of(make_daemon, tmp_path):
    version = (conftest.BUILD / "version.stamp").read_text().strip()
    assert re.match(r"\d+\.\d+\.\d+", version)
    for program in ("whittle", "whittled"):
        assert run(conftest.BUILD / program, "--version") == f"{program} {version}"
        assert f'"whittle {version}"' in run(conftest.BUILD / program, "--man")
    assert make_daemon().curl("/v1/info").json["version"] == version
    (tmp_path / "in.xyz").write_bytes(conftest.SMALL)
    run(conftest.BUILD / "whittle", tmp_path / "in.xyz", "--outputs", "mesh.glb,report", "-q", "-o", tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["version"] == version
    assert f'"generator":"whittle {version}"'.encode() in (tmp_path / "mesh.glb").read_bytes()


def test_programs_know_their_version_whatever_flags_they_are_built_with(tmp_path):
    environment = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL", "CFLAGS")}
    run("make", f"build={tmp_path}", "CFLAGS=-O1", f"{tmp_path}/core/base/version.o", cwd=ROOT, env=environment)
    version = (tmp_path / "version.stamp").read_bytes().strip()
    assert re.match(rb"\d+\.\d+\.\d+", version)
    assert version in (tmp_path / "core/base/version.o").read_bytes()


def test_a_release_says_what_is_new_in_it(tmp_path):
    """What has its version as a heading; else what comes with the next tag, and nothing of what came before."""
    (tmp_path / "deploy").mkdir()
    (tmp_path / ".github").mkdir()
    notes = shutil.copy(ROOT / "deploy/release_notes.sh", tmp_path / "deploy")
    changes = tmp_path / ".github/CHANGELOG.md"
    changes.write_text("# Changes\n\nNewest first.\n\n## Unreleased\n### Added\n- b\n\n## 1.2.3\n### Added\n- a\n")
    assert run(notes, "1.3.0") == "### Added\n- b" and run(notes, "1.2.3") == "### Added\n- a"
    assert run(ROOT / "deploy/release_notes.sh", "9.9.9").startswith("### ")


WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_run_what_there_is(path):
    """Targets of make, and files: nothing else would tell before a tag is pushed."""
    text = re.sub(r"^ *#.*$", "", path.read_text(), flags=re.M)
    commands = [command for line in re.findall(r"run: (.*(?:\n {10,}.*)*)", text) for command in re.split(r"&&|\||\n", line)]
    words = [word for command in commands if re.match(r" *make ", command) for word in command.split()[1:]]
    targets = {word for word in words if re.fullmatch(r"[a-z][a-z0-9-]*", word)}
    assert targets
    declared = {name for line in run("make", "-C", ROOT, "-pn", "--no-print-directory", "help").splitlines()
                if line.startswith(".PHONY:") for name in line.split()[1:]}
    assert targets <= declared, targets - declared
    for name in re.findall(r"(?<![\w/.*])(?:\.ci|\.github|deploy|tests)/[\w/.-]+", "\n".join(commands)):
        assert (ROOT / name).exists(), name
    jobs = re.findall(r"^  ([a-z]+):$", text.split("\njobs:\n")[1], re.M)
    assert jobs and set(re.findall(r"^    needs: (.*)$", text, re.M)) <= set(jobs)
    for job in re.split(r"^  [a-z]+:$", text.split("\njobs:\n")[1], flags=re.M)[1:]:
        assert "runs-on:" in job and "timeout-minutes:" in job and "actions/checkout@" in job


@pytest.mark.parametrize("document", ["README.md", "deploy/README.md", "server/README.md",
                                      "server/page/plain.html"])
def test_commands_of_the_documents_show_problem_documents(document):
    """curl -f drops the body that says what was wrong."""
    hidden = [line for line in (ROOT / document).read_text().splitlines()
              if re.search(r"curl (?:.* )?(?:-[a-zA-Z]*f[a-zA-Z]*|--fail) ", line.split(" | ")[0])]
    assert hidden == []


@pytest.mark.parametrize("ratio, reason", [("5", "demo: the job was refused: .*ratio.*at most 1"),
                                           ("a b&c", "demo: the job was refused: .*ratio.*a b&c")])
def test_the_demo_says_why_a_job_is_refused(tmp_path, ratio, reason):
    (tmp_path / "in.xyz").write_bytes(conftest.SMALL)
    done = subprocess.run([ROOT / "tests/demo/demo.sh", conftest.BUILD, tmp_path / "out", tmp_path / "in.xyz", ratio],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert re.fullmatch(reason + ".*\n", done.stderr), done.stderr


@pytest.mark.skipif(conftest.SANITIZED, reason="sanitizers do what the demo's service forbids its jobs")
def test_the_demo_says_why_a_job_failed_and_what_came_of_one_that_did_not(tmp_path):
    def demo(lines):
        (tmp_path / "in.xyz").write_bytes(lines)
        return subprocess.run([ROOT / "tests/demo/demo.sh", conftest.BUILD, tmp_path / "out", tmp_path / "in.xyz", "1"],
                              capture_output=True, text=True, check=False)

    failed = demo(b"0 0 0\n1 1 1\n2 2 2\n3 3 3\n4 4 4\n")
    assert failed.returncode == 1 and re.fullmatch("demo: the job failed: .*one line.*\n", failed.stderr), failed
    done = demo(conftest.SMALL)
    assert done.returncode == 0 and re.search(r"watertight +true", done.stdout), done
    assert (tmp_path / "out/mesh.ply").stat().st_size > 1000


@needs_dpkg
@pytest.mark.skipif(not RELEASE_BUILD, reason="the sanitizers' libraries are no part of a release")
def test_the_bill_of_materials_names_what_is_linked():
    programs = [conftest.BUILD / name for name in ("whittle", "whittled")]
    text = run("python3", ROOT / "deploy/sbom.py", *programs)
    assert text == run("python3", ROOT / "deploy/sbom.py", *programs)
    bill = json.loads(text)
    assert bill["spdxVersion"] == "SPDX-2.3"
    packages = {p["SPDXID"]: p for p in bill["packages"]}
    names = {p["name"] for p in bill["packages"]}
    assert {"whittle", "libc6", "libmicrohttpd12", "libsqlite3-0", "libflann-dev", "libcgal-dev"} <= names
    ids = set(packages) | {f["SPDXID"] for f in bill["files"]} | {"SPDXRef-DOCUMENT"}
    for relation in bill["relationships"]:
        assert {relation["spdxElementId"], relation["relatedSpdxElement"]} <= ids
    assert all(p["versionInfo"] for p in bill["packages"])
    print(f"{len(names)} packages")


@needs_bash
@pytest.mark.parametrize("program, typed, offered", [
    ("whittle", "--rat", "--ratio"), ("whittle", "--max", "--max-deviation"), ("whittle", "meas", "measure"),
    ("whittled", "--max-q", "--max-queue"), ("whittled", "--dat", "--data")])
def test_the_shell_completes_what_the_program_knows(program, typed, offered):
    script = (f'source {ROOT}/deploy/completion/bash/{program}; COMP_WORDS=("{conftest.BUILD / program}" "{typed}"); '
              f'COMP_CWORD=1; _{program}; printf "%s\\n" "${{COMPREPLY[@]}}"')
    assert offered in run("bash", "-c", script).splitlines()
