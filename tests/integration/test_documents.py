# SPDX-License-Identifier: GPL-3.0-or-later
"""`make lint` finds names of files in documents that don't exist, and a table of layers that isn't the code's."""
import pathlib
import shutil
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/lint"))
import layers  # noqa: E402  (its folder is no package)


@pytest.fixture(name="tree")
def make_tree(tmp_path):
    """A tree with the linters, a source in a room, and a README."""
    for name in ("server/http", "api", "deploy", "tests/lint", *layers.ROOMS, *layers.SERVER_ROOMS):
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
    for name in (name for pair in layers.SERVER_EXCEPTIONS for name in pair):
        (tmp_path / name).touch()
    for name in ("layers.py", "documents.py"):
        shutil.copy(ROOT / "tests/lint" / name, tmp_path / "tests/lint")
    (tmp_path / "core/io/read.c").touch()
    (tmp_path / "core/io/read.h").touch()
    (tmp_path / "core/whittle.h").touch()
    (tmp_path / "README.md").write_text("`core/io/read.c`\n")
    (tmp_path / "Makefile").write_text("kernel_src := read.c\n")
    for top in ("core", "server"):
        (tmp_path / top / "README.md").write_text("<!-- layers: make lint compares this table with "
                                                  "tests/lint/layers.py -->\n<!-- end of layers -->\n")
    assert lint(tmp_path, "--update") == ""
    return tmp_path


def lint(tree, *options):
    return subprocess.run([sys.executable, "-B", "tests/lint/documents.py", *options], cwd=tree, text=True,
                          capture_output=True, check=False).stdout


def test_names_that_exist_are_found_wherever_they_are_looked_for(tree):
    (tree / "core/io/README.md").write_text("`read.c`, `core/io/read.{c,h}`, `core/*/read.h`, [up](../../README.md), "
                                            "`out/report.html`, [elsewhere](https://example.org/core/none.c)\n")
    (tree / "server/http/README.md").write_text("`read.h`, `core/io/`\n")
    assert lint(tree) == "lint: 5 documents, 0 problems\n"


@pytest.mark.parametrize("text, missing", [
    ("`core/io/out/write.c`", "core/io/out/write.c"), ("`write.c`", "write.c"), ("`io/read.c`", "io/read.c"),
    ("`core/io/read.{c,cc}`", "core/io/read.cc"), ("`core/oi/`", "core/oi"), ("`core/io/*.cc`", "core/io/*.cc"),
    ("[there](../http/none.md)", "../http/none.md")])
def test_a_name_that_does_not_exist_is_a_problem(tree, text, missing):
    (tree / "server/http/DECISIONS.md").write_text(f"# Title\n{text}\n")
    assert lint(tree) == f"server/http/DECISIONS.md: there is no {missing}\nlint: 4 documents, 1 problems\n"


def test_a_function_that_a_readme_names_is_in_the_source(tree):
    (tree / "core/io/read.c").write_text("static void find_end(void) {}\n")
    (tree / "core/io/README.md").write_text("`find_end`, `find_end()`, `kernel_src`, `NO_NAME`, `read`\n")
    assert lint(tree) == "lint: 4 documents, 0 problems\n"
    (tree / "core/io/README.md").write_text("`find_begin` and `find_end`\n")
    assert lint(tree) == "core/io/README.md: nothing is called find_begin\nlint: 4 documents, 1 problems\n"


def test_a_table_of_layers_that_is_not_the_codes_is_a_problem(tree):
    layers = tree / "tests/lint/layers.py"
    layers.write_text(layers.read_text().replace('"core/math": {"core/base"}', '"core/math": set()'))
    assert lint(tree) == ("core/README.md: the table of layers differs from tests/lint/layers.py; "
                          "tests/lint/documents.py --update writes it\nlint: 3 documents, 1 problems\n")
    lint(tree, "--update")
    assert lint(tree) == "lint: 3 documents, 0 problems\n"
    assert "| `core/math/` | none |" in (tree / "core/README.md").read_text()
