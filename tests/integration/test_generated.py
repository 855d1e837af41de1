# SPDX-License-Identifier: GPL-3.0-or-later
"""Clients that generators make of the contract, unedited, call a real service; tests/node/generated/ says how each is
called.  The table of them is printed with -rP."""
import hashlib
import json
import os
import pathlib
import shutil
import subprocess

import pytest

from conftest import SMALL
from tables import CONTRACT_FILE

NODE = pathlib.Path(__file__).parent.parent / "node"
CALLS = ("getInfo", "createJob", "getJob", "getOutput", "createCloud", "createCloudJob", "simplify", "listJobs",
         "createBatch", "getBatch", "a problem", "a token")
TOKEN = "a-token-of-the-test-that-is-long-enough"
REQUIRE = "import { createRequire } from 'module'; const require = createRequire(import.meta.url);"

# The package, and its command; {contract} and {out}, the folder that is its own.
GENERATORS = {
    "openapi-fetch": ["openapi-typescript", "{contract}", "-o", "{generated}/openapi-typescript/api.ts"],
    "oazapfts": ["oazapfts", "{contract}", "{out}/api.ts"],
    "swagger-typescript-api": ["swagger-typescript-api", "generate", "-p", "{contract}", "-o", "{out}", "-n", "api.ts"],
    "hey-api": ["openapi-ts", "-i", "{contract}", "-o", "{out}", "-c", "@hey-api/client-fetch"],
    "orval": ["orval", "--input", "{contract}", "--output", "{out}/api.ts", "--client", "axios-functions"],
    "openapi-typescript-codegen": ["../openapi-typescript-codegen/bin/index.js", "-i", "{contract}", "-o", "{out}"],
}

pytestmark = pytest.mark.skipif(not (NODE / "node_modules/.bin/orval").exists() or not shutil.which("node"),
                                reason="node, or what make test-contract installs into tests/node, is not there")


def run(*command, cwd):
    environment = {**os.environ, "NO_COLOR": "1", "CI": "1", "DO_NOT_TRACK": "1"}
    done = subprocess.run([str(part) for part in command], cwd=cwd, capture_output=True, text=True, check=False,
                          env=environment, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("name", GENERATORS)
def test_a_generated_client_calls_the_service(daemon, make_daemon, tmp_path, name):
    shutil.copytree(NODE / "generated", tmp_path / "generated")
    (tmp_path / "node_modules").symlink_to(NODE / "node_modules")
    (tmp_path / "package.json").write_text('{"private": true}')
    out, generated = tmp_path / "generated-by" / name, tmp_path / "generated-by"
    for folder in (out, generated / "openapi-typescript"):
        folder.mkdir(parents=True, exist_ok=True)
    program, *arguments = GENERATORS[name]
    run(NODE / "node_modules/.bin" / program,
        *(argument.format(contract=CONTRACT_FILE, out=out, generated=generated) for argument in arguments), cwd=tmp_path)
    run(NODE / "node_modules/.bin/esbuild", f"generated/{name}.ts", "--bundle", "--platform=node", "--format=esm",
        f"--banner:js={REQUIRE}", "--outfile=client.mjs", "--log-level=error", cwd=tmp_path)
    (tmp_path / "ball.xyz").write_bytes(SMALL)
    (tmp_path / "tokens").write_text(f"me:submit,read:{hashlib.sha256(TOKEN.encode()).hexdigest()}\n")
    guarded = make_daemon("--tokens-file", tmp_path / "tokens")
    results = json.loads(run("node", "client.mjs", daemon.url, "ball.xyz", guarded.url, TOKEN, cwd=tmp_path))
    for call in CALLS:
        print(f"{name:28} {call:16} {results[call]}")
    assert results == {call: "ok" for call in CALLS}
