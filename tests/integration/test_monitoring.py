# SPDX-License-Identifier: GPL-3.0-or-later
"""deploy/monitoring: rules that promtool accepts and whose alerts come when they should, dashboards whose queries parse,
and no metric or label in any of them that the daemon does not show."""
import json
import pathlib
import re
import shutil
import subprocess

import pytest

from conftest import SMALL

FOLDER = pathlib.Path(__file__).resolve().parents[2] / "deploy" / "monitoring"
DASHBOARDS = sorted(FOLDER.glob("grafana-*.json"))
needs_promtool = pytest.mark.skipif(not shutil.which("promtool"), reason="promtool (package prometheus) is absent")
RECORDED = set(re.findall(r"- record: (\S+)", (FOLDER / "rules.yml").read_text()))


def promtool(*arguments):
    done = subprocess.run(["promtool", *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def queries():
    """Every query of the dashboards, its variables filled in."""
    found = []

    def walk(value):
        if isinstance(value, dict):
            found.extend([value["expr"]] if "expr" in value else [])
            for inner in value.values():
                walk(inner)
        elif isinstance(value, list):
            for inner in value:
                walk(inner)
    for dashboard in DASHBOARDS:
        walk(json.loads(dashboard.read_text()))
    return [q.replace("$instance", ".*") for q in found]


def without_labels(text):
    return re.sub(r"\{[^}]*\}", "", re.sub(r'"[^"]*"', "", text))


def test_every_metric_in_rules_and_dashboard_is_one_that_the_daemon_shows(daemon):
    daemon.ended(daemon.submit(SMALL))
    shown = set(re.findall(r"^(whittled_\w+?)(?:\{.*\})? \S+$", daemon.curl("/metrics").body.decode(), re.M))
    assert len(shown) > 20
    adapter = re.findall(r"metricsQuery: (.*)", (FOLDER / "adapter.yml").read_text())
    assert adapter
    for text in [(FOLDER / "rules.yml").read_text(), *queries(), *adapter]:
        expressions = re.findall(r"expr: (?:\|\n)?((?:.+\n)(?:          .+\n)*)", text) or [text]
        for expression in map(without_labels, expressions):
            used = set(re.findall(r"whittled[_:][\w:]+", expression))
            assert used <= shown | RECORDED, used - shown - RECORDED


def test_every_label_in_the_dashboards_is_one_that_its_metric_has(daemon):
    daemon.ended(daemon.submit(SMALL))
    labels = {}
    for name, text in re.findall(r"^(whittled_\w+?)(?:\{(.*)\})? \S+$", daemon.curl("/metrics").body.decode(), re.M):
        labels.setdefault(name, {"instance", "job"}).update(re.findall(r'(\w+)="', text))
    matchers = [pair for query in queries() for pair in re.findall(r"(whittled_\w+)\{([^}]*)\}", query)]
    assert len(matchers) > 20
    for name, text in matchers:
        assert set(re.findall(r"(\w+)(?:=~|!~|!=|=)", text)) <= labels[name], (name, text)
    grouped = [(g, name) for query in queries()
               for g, name in re.findall(r"by \(([\w, ]+)\) \((?:rate\()?(whittled_\w+)", query)]
    assert len(grouped) > 5
    for group, name in grouped:
        assert set(group.split(", ")) <= labels[name], (group, name)


@needs_promtool
def test_the_rules_and_the_configuration_are_accepted():
    assert "SUCCESS" in promtool("check", "rules", "--lint-fatal", FOLDER / "rules.yml")
    promtool("check", "config", FOLDER / "prometheus.yml")


@needs_promtool
def test_the_alerts_come_when_they_should():
    assert "SUCCESS" in promtool("test", "rules", FOLDER / "rules_test.yml")
    tested = set(re.findall(r"alertname: (\S+)", (FOLDER / "rules_test.yml").read_text()))
    assert tested == set(re.findall(r"- alert: (\S+)", (FOLDER / "rules.yml").read_text()))


@needs_promtool
def test_the_metrics_are_in_good_form(daemon):
    done = subprocess.run(["promtool", "check", "metrics"], input=daemon.curl("/metrics").body, capture_output=True,
                          check=False)
    assert done.returncode in (0, 3), done.stderr  # 3: advice on names


@needs_promtool
def test_the_queries_of_the_dashboard_parse(tmp_path):
    rules = {"groups": [{"name": "dashboard", "rules": [{"record": f"q{i}", "expr": q} for i, q in enumerate(queries())]}]}
    (tmp_path / "queries.yml").write_text(json.dumps(rules))
    assert f"{len(queries())} rules found" in promtool("check", "rules", "--lint=none", tmp_path / "queries.yml")


@pytest.mark.parametrize("dashboard", DASHBOARDS, ids=lambda path: path.stem)
def test_the_panels_do_not_overlap(dashboard):
    taken = set()
    for panel in json.loads(dashboard.read_text())["panels"]:
        at = panel["gridPos"]
        cells = {(x, y) for x in range(at["x"], at["x"] + at["w"]) for y in range(at["y"], at["y"] + at["h"])}
        assert not cells & taken and at["x"] + at["w"] <= 24, panel["title"]
        taken |= cells
