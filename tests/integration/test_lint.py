# SPDX-License-Identifier: GPL-3.0-or-later
"""make lint refuses each fault that is planted in a copy of the tree, and nothing else."""
import pathlib
import shutil
import subprocess
import sys
import tomllib

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
LICENCE = "/* SPDX-License-Identifier: GPL-3.0-or-later */\n"
BASE = "core/base/planted.c"


@pytest.fixture(name="tree", scope="module")
def make_tree(tmp_path_factory):
    tree = tmp_path_factory.mktemp("tree")
    for folder in ("core", "api", "server", "tests/lint"):
        shutil.copytree(ROOT / folder, tree / folder)
    return tree


def lint(tree, *archives):
    """The problems found, without the count in the last line."""
    run = subprocess.run([sys.executable, tree / "tests/lint/layers.py", *archives], cwd=tree, capture_output=True,
                         text=True, check=False)
    assert run.stderr == ""
    *problems, last = run.stdout.splitlines()
    assert last.endswith(f" {len(problems)} problems") and run.returncode == (1 if problems else 0)
    return problems


def planted(tree, path, code):
    """The problems of the tree with a file more, or with lines more in a file that is there."""
    file = tree / path
    before = file.read_text(encoding="utf-8") if file.exists() else None
    file.write_text((LICENCE if before is None else before) + code + "\n", encoding="utf-8")
    try:
        return lint(tree)
    finally:
        file.unlink() if before is None else file.write_text(before, encoding="utf-8")


def test_the_tree_itself_is_taken(tree):
    assert not lint(tree)


CALLS = ("fputs(s, f)", "puts(s)", "fputc(c, f)", "putchar(c)", "dprintf(2, s)", "vfprintf(f, s, a)", "fwrite(s, 1, 1, f)",
         "perror(s)", "syslog(1, s)", "exit(1)", "_exit(1)", "_Exit(1)", "quick_exit(1)", "abort()", "getenv(s)",
         "secure_getenv(s)", "setenv(s, s, 1)", "malloc(1)", "calloc(1, 1)", "realloc(p, 1)", "reallocarray(p, 1, 1)",
         "aligned_alloc(8, 8)", "strdup(s)", "asprintf(&s, s)", "hypot(1, 1)", "strtod(s, NULL)")


def calling(calls):
    """Lines of code, and the names that they call."""
    return "".join(f"void f{i}(void) {{ {call}; }}\n" for i, call in enumerate(calls)), [c.split("(")[0] for c in calls]


def test_core_never_talks_leaves_looks_allocates_or_depends_on_where_it_runs(tree):
    """All at once: a run looks at the whole tree."""
    code, names = calling(CALLS)
    assert sorted(planted(tree, BASE, code)) == sorted(f"{BASE}: core/ never calls {name}" for name in names)


BANNED = ("sprintf(s, s)", "strcpy(s, s)", "strncpy(s, s, 1)", "strcat(s, s)", "strtok(s, s)", "atoi(s)", "atoll(s)",
          "system(s)", "popen(s, s)", "sscanf(s, s)", "fscanf(f, s)")


def test_functions_are_banned_everywhere(tree):
    (code, names), paths = calling(BANNED), ("core/io/planted.c", "api/planted.c", "server/jobs/planted.h")
    for path in paths:
        (tree / path).write_text(f"{LICENCE}{code}", encoding="utf-8")
    found = lint(tree)
    for path in paths:
        (tree / path).unlink()
    assert sorted(found) == sorted(f"{path}: banned function {name}" for path in paths for name in names)


LAYERS = [
    ("core/base/planted.c", "core/math/vec3.h", "core/base/ may not include core/math/vec3.h"),
    ("core/simplify/planted.c", "core/refine/refine.h", "core/simplify/ may not include core/refine/refine.h"),
    ("core/spatial/knn.h", "core/pipeline/memory.h", "core/spatial/ may not include core/pipeline/memory.h"),
    ("core/surface/planted.c", "core/refine/refine.h", "core/surface/ may not include core/refine/refine.h"),
    ("api/planted.c", "core/io/read.h", "api/ may not include core/io/read.h"),
    ("server/jobs/planted.c", "core/pipeline/pipeline.h", "only server/cli/ may include core/pipeline/pipeline.h"),
    ("server/cli/planted.c", "server/catalog/catalog.h", "server/cli/ may not include server/catalog/catalog.h"),
    ("server/shared/planted.c", "server/cli/options.h", "server/shared/ may not include server/cli/options.h"),
    ("server/runner/job_run.c", "server/handlers/handlers.h", "server/runner/ may not include server/handlers/handlers.h"),
    ("server/webhooks/webhooks.c", "server/handlers/handlers.h",
     "server/webhooks/ may not include server/handlers/handlers.h"),
    ("server/http/precheck.c", "server/handlers/keys.h", "server/http/ may not include server/handlers/keys.h"),
    ("server/jobs/identity.c", "server/runner/supervisor.h", "server/jobs/ may not include server/runner/supervisor.h"),
    ("server/catalog/job.c", "server/jobs/service.h", "server/catalog/ may not include server/jobs/service.h"),
    ("core/cloud/planted.c", "../cloud/cloud.h", "core/cloud/ may not include ../cloud/cloud.h"),
    ("core/cloud/planted.c", "cloud.h", "core/ may not include cloud.h"),
    ("core/cloud/planted.c", "tests/unit/shapes.h", "core/ may not include tests/unit/shapes.h"),
    ("server/jobs/planted.c", "server/jobs/../cli/options.h",
     "server/ may not include server/jobs/../cli/options.h"),
    ("core/cloud/planted.c", "core/cloud/cloud.c", "includes the source core/cloud/cloud.c"),
    ("server/jobs/planted.c", "server/catalog/sqlite/sql.h",
     r"server/catalog/sqlite/sql.h belongs to server/catalog/sqlite/\w+\.[ch]"),
    ("server/handlers/planted.c", "server/catalog/catalog_backend.h",
     r"server/catalog/catalog_backend.h belongs to server/catalog/(\w+/)?\w+\.[ch]"),
    ("server/jobs/planted.c", "sqlite3.h", r"sqlite3.h belongs to server/catalog/sqlite/sql(_faults)?\.c")]


@pytest.fixture(name="found", scope="module")
def plant_includes(tree):
    """The problems of the tree with all of these includes: a run looks at the whole tree."""
    before = {}
    for path, header, _ in LAYERS:
        file = tree / path
        before.setdefault(file, file.read_text(encoding="utf-8") if file.exists() else None)
        quote = "<{}>" if header == "sqlite3.h" else '"{}"'
        text = file.read_text(encoding="utf-8") if file.exists() else LICENCE
        file.write_text(f"{text}#include {quote.format(header)}\n", encoding="utf-8")
    found = lint(tree)
    for file, text in before.items():
        file.unlink() if text is None else file.write_text(text, encoding="utf-8")
    return found


@pytest.mark.parametrize("path, header, problem", LAYERS)
def test_layers_are_kept(found, path, header, problem):
    assert any(line.startswith(f"{path}: ") and problem.removeprefix("core/cloud/ ") in line and header in line
               for line in found), found


def test_nothing_but_what_was_planted_is_told(found):
    assert {line.split(": ")[0] for line in found} == {path for path, *_ in LAYERS}


@pytest.mark.parametrize("path, header, user", [
    ("core/io/prefix.h", "core/io/read.h", "server/"), ("core/pipeline/memory.h", "core/refine/refine.h", "server/"),
    ("core/io/sniff.h", "core/io/build.h", "api/")])
def test_what_a_header_brings_along_counts_as_included(tree, path, header, user):
    """Each of these includes is right for core/ itself."""
    found = planted(tree, path, f'#include "{header}"')
    assert found
    assert all(f": {path} brings " in line for line in found), found
    assert any(line.startswith(user) and f"{path} brings {header} along, which {user}" in line for line in found)


def test_includes_by_macros_are_refused(tree):
    assert planted(tree, "core/cloud/planted.c", "#include HEADER") == [
        "core/cloud/planted.c: includes what a macro names"]


def test_a_file_in_no_room_is_refused(tree):
    (tree / "core/planted").mkdir()
    try:
        assert planted(tree, "core/planted/planted.c", '#include "core/base/status.h"') == [
            "core/planted/planted.c: core/planted/ is no room of the table"]
    finally:
        (tree / "core/planted").rmdir()


def test_static_names_are_unique_in_a_folder(tree):
    named = "static enum status {}(int x) {{ return x; }}"
    there = "core/base/par.c"
    assert "static void wait_for_news(" in (tree / there).read_text(encoding="utf-8")
    assert not planted(tree, BASE, named.format("planted"))
    assert not planted(tree, "core/math/planted.c", named.format("wait_for_news"))
    assert planted(tree, BASE, named.format("wait_for_news")) == ["core/base/planted.c: wait_for_news() is also in par.c"]


def test_licences_and_long_lines(tree):
    assert planted(tree, BASE, "/* " + "x" * 120 + " */")[0].startswith(f"{BASE}: over 120 columns")
    file = tree / BASE
    file.write_text("int f(void);\n", encoding="utf-8")
    try:
        assert lint(tree) == [f"{BASE}: no SPDX line"]
    finally:
        file.unlink()


def test_comments_and_texts_are_no_calls(tree):
    assert not planted(tree, BASE, '/* malloc(1) */ // exit(1)\nconst char *text = "printf(s)"; int x(void);')


def test_what_a_comment_names_exists(tree):
    for name in ("Makefile", "tests/unit"):
        (shutil.copytree if (ROOT / name).is_dir() else shutil.copy2)(ROOT / name, tree / name)
    there, script = tree / "core/base/par.c", tree / "tests/lint/comments.py"
    before = there.read_text(encoding="utf-8")

    def told(comment):
        there.write_text(f"{before}/* {comment} */\n", encoding="utf-8")
        run = subprocess.run([sys.executable, script], cwd=tree, capture_output=True, text=True, check=False)
        assert run.stderr == ""
        return [line for line in run.stdout.splitlines() if line.startswith("core/base/par.c:")]
    line = before.count("\n") + 1
    try:
        assert not told("wait_for_news, n_p and kappa_q, test_points, no_new_privs.")
        assert told("wait_for_olds, that is.") == [
            f"core/base/par.c:{line}: nothing is called wait_for_olds, which this comment names"]
    finally:
        there.write_text(before, encoding="utf-8")
        for name in ("Makefile", "tests/unit"):
            (shutil.rmtree if (tree / name).is_dir() else pathlib.Path.unlink)(tree / name)


ARCHIVED = [
    ("int counter;", "keeps state in counter"),
    ("static int last = 3; int f(int x) { int y = last; last = x; return y; }", "keeps state in last"),
    ("int f(void) { static int calls; return ++calls; }", "keeps state in calls.0"),
    ("static _Thread_local int depth; int f(void) { return ++depth; }", "keeps state in depth"),
    ("#include <stdio.h>\n#define SAY fputs\nint f(const char *s) { return (SAY)(s, stderr); }", "links fputs"),
    ("#include <stdlib.h>\nvoid *(*const get)(size_t) = malloc;", "links malloc"),
    ("#include <stdlib.h>\nvoid (*const leave)(int) = _Exit;", "links _Exit"),
    ("extern char **environ; char *f(void) { return environ[0]; }", "links environ"),
    ("#include <stdarg.h>\nint json_object(void); int f(void) { return json_object(); }", "json_object")]


@pytest.mark.parametrize("code, problem", ARCHIVED)
def test_no_macro_or_pointer_hides_anything(tree, tmp_path, code, problem):
    (tmp_path / "planted.c").write_text(code, encoding="utf-8")
    subprocess.run(["cc", "-O1", "-c", "planted.c"], cwd=tmp_path, check=True)
    subprocess.run(["ar", "rcs", "planted.a", "planted.o"], cwd=tmp_path, check=True)
    found = lint(tree, tmp_path / "planted.a")
    assert any(problem in line for line in found) and all("planted" in line for line in found), found


def test_what_an_archive_may_hold(tree, tmp_path):
    (tmp_path / "planted.c").write_text("static const int table[] = {1, 2}; int f(int i) { return table[i]; }",
                                        encoding="utf-8")
    subprocess.run(["cc", "-O1", "-c", "planted.c"], cwd=tmp_path, check=True)
    subprocess.run(["ar", "rcs", "planted.a", "planted.o"], cwd=tmp_path, check=True)
    assert not lint(tree, tmp_path / "planted.a")


def test_each_fault_to_be_planted_has_its_place():
    """What `make mutants` replaces is there exactly once; its test's file is there, too."""
    table = tomllib.loads((ROOT / "tests/mutants/mutants.toml").read_text(encoding="utf-8"))["mutant"]
    assert len({mutant["name"] for mutant in table}) == len(table) > 50
    for mutant in table:
        kind, name = mutant["test"].split()[:2]
        assert (ROOT / mutant["file"]).read_text(encoding="utf-8").count(mutant["old"]) == 1, mutant["name"]
        assert (ROOT / ("tests/unit/" + name + ".c" if kind == "unit" else "tests/integration/" + name)).is_file(), name
