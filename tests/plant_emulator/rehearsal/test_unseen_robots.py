"""The documented path on robots that were kept back while it was built: it goes on to reach what it reached on them."""

import pytest

from plant_emulator.rehearsal.many.claims import claims_of
from plant_emulator.rehearsal.many.one import BOTH, run_seed
from plant_emulator.rehearsal.many.reading import accepted, is_quiet
from plant_emulator.rehearsal.many.rows import crashed
from plant_emulator.trials.executors import LocalProcesses, run_all
from plant_emulator.trials.rows import csv_text
from tests.plant_emulator.rehearsal.made import page_of

FIRST = 50_201
"""Robots from here on were kept back until the path was finished; docs/rehearsal-results.md has what two hundred of them gave."""

PROBED_EVERY = 5
"""Wrong corrections are tried on every fifth: they cost as much as the path."""

HOLD = ("wrong_refused", "whole")
"""Claims that these robots keep without an exception."""
BEYOND = frozenset({50203, 50229, 50247, 50254, 50262})
"""Robots that stay beyond the goal with their true transmission error cancelled, at 0.0103, 0.0106, 0.0225, 0.0142 and 0.0186 mm:
the first by its speed limit, the others by a SYNC of 8 ms. A change that costs another robot is seen."""


@pytest.mark.timeout(5400)  # the longest of all begins first
@pytest.mark.parametrize(
    "count",
    [
        pytest.param(20, marks=[pytest.mark.ci, pytest.mark.part], id="twenty"),
        pytest.param(100, marks=pytest.mark.slow, id="hundred"),
    ],
)
def test_robots_that_were_kept_back_reach_the_numbers(tmp_path, count):
    """One test, since the robots are walked once; table and page of them lie in its folder."""
    rows = []
    with LocalProcesses(1) as executors:  # beside a worker that waits for it: two would be one too many for its processor
        run_all(range(FIRST, FIRST + count), run_seed, (BOTH, False, None, PROBED_EVERY), executors, rows.append, crashed)
    rows.sort(key=lambda row: row["seed"])
    (tmp_path / "robots.csv").write_text(csv_text(rows), encoding="utf-8")
    page_of(tmp_path / "report.html", rows)
    claims = {each.key: each for each in claims_of(rows)}
    missed = [
        f"{claims[key].words}: asked {claims[key].asked}, measured {claims[key].measured}"
        for key in HOLD
        if not claims[key].holds
    ]
    assert missed == []
    assert [row["seed"] for row in rows if accepted(row) and row["worse"]] == []
    assert [row["seed"] for row in rows if not is_quiet(row) and row["seed"] not in BEYOND] == []
