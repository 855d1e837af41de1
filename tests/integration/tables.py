# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract, as it is built, and its tables: routes and problems."""
import json
import subprocess

from conftest import BUILD

_TABLES = json.loads(subprocess.run([BUILD / "tests/tools/tables"], capture_output=True, check=True).stdout)
ROUTES = _TABLES["routes"]  # each with method, path, operation, scope
PROBLEMS = _TABLES["problems"]  # each with slug, status, title
CONTRACT_FILE = BUILD.resolve() / "api/openapi/openapi.json"
CONTRACT = json.loads(CONTRACT_FILE.read_text())
