# SPDX-License-Identifier: GPL-3.0-or-later
"""api/javascript/whittle.js against a real service, in Node; its types, where typescript is installed."""
import pathlib
import shutil
import subprocess

import pytest

from conftest import SMALL

NODE = pathlib.Path(__file__).resolve().parent.parent / "node"
TSC = NODE / "node_modules/typescript/bin/tsc"


def has_fetch():
    """Node 18 or newer."""
    node = shutil.which("node")
    return node and subprocess.run([node, "-e", "fetch"], capture_output=True, check=False).returncode == 0


@pytest.mark.skipif(not has_fetch(), reason="node isn't installed, or is older than 18")
def test_the_client_uploads_waits_and_reads_arrays(daemon, tmp_path):
    (tmp_path / "ball.xyz").write_bytes(SMALL)
    done = subprocess.run(["node", NODE / "javascript_client.mjs", daemon.url, tmp_path], capture_output=True, text=True,
                          check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("\n") == 11


@pytest.mark.skipif(not TSC.exists() or not has_fetch(), reason="typescript isn't installed: npm ci in tests/node")
def test_the_types_allow_what_there_is_and_no_more(tmp_path):
    done = subprocess.run(["node", TSC, "--noEmit", "--strict", "--target", "es2022", "--module", "nodenext",
                           "--moduleResolution", "nodenext", "--lib", "es2022,dom",
                           NODE / "javascript_client.ts"], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout
