"""The documented path on robots that nobody has seen while this was built: it reaches the numbers that must be reached."""

import pytest

from plant_emulator.rehearsal.many.claims import claims_of
from plant_emulator.rehearsal.many.one import BOTH, walk_seed
from plant_emulator.rehearsal.many.page import write_page
from plant_emulator.rehearsal.many.table import csv_text
from plant_emulator.rehearsal.many.walkers import LocalProcesses
from plant_emulator.rehearsal.many.walking import walk_all

FIRST, ROBOTS = 10_001, 40
"""Seeds from here on are not used for anything else: a robot that was looked at is no test any more."""

PROBED_EVERY = 5
"""Wrong corrections are tried on every fifth: they cost as much as the path."""

JUDGED = ("never_worse", "wrong_refused", "quiet_linear", "quiet_real", "true_cause", "rms_z", "far_together", "whole")
"""Claims that these robots must keep; the thresholds are those of `claims`. Not processor time: the machine has other work."""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


def test_robots_that_nobody_has_seen_reach_the_numbers(tmp_path):
    """One test, since the robots are walked once; table and page of them lie in its folder."""
    rows = []
    with LocalProcesses(2) as walkers:
        walk_all(range(FIRST, FIRST + ROBOTS), walk_seed, (BOTH, False, None, PROBED_EVERY), walkers, rows.append)
    rows.sort(key=lambda row: row["seed"])
    (tmp_path / "robots.csv").write_text(csv_text(rows), encoding="utf-8")
    write_page(tmp_path / "report.html", rows)
    claims = {each.key: each for each in claims_of(rows)}
    assert set(claims) >= set(JUDGED)
    judged = [each for each in claims.values() if each.key in JUDGED]
    missed = [f"{each.words}: asked {each.asked}, measured {each.measured}" for each in judged if each.holds is False]
    assert missed == []
