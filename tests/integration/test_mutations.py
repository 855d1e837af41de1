# SPDX-License-Identifier: GPL-3.0-or-later
"""The short form of the campaign with mutated clouds (mutations.py)."""
from mutations import campaign


def test_mutated_clouds_end_as_results_or_refusals(make_daemon):
    daemon = make_daemon()
    assert 0 < campaign(daemon, 150, 1) < 150
    assert daemon.stop() == 0
    status, lines = daemon.check()
    assert status == 0 and len(lines) == 1, lines
