"""The documented path on robots that were kept back while it was built: it goes on to reach what it reached on them."""

import pytest

from plant_emulator.rehearsal.many.claims import claims_of
from plant_emulator.rehearsal.many.one import BOTH, run_seed
from plant_emulator.rehearsal.many.reading import accepted, is_quiet, of_kind
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
TWENTY, HUNDRED = (0, {"linear": 9, "real": 10}), (0, {"linear": 48, "real": 47})
"""Robots with an accepted treatment that makes the tip worse, at most, and of each kind within the goal, at least.

It is what their first run gave, but for the one robot that it made worse, and for 50288: with its true transmission error
cancelled its tip is 0.0103 mm at 8 ms, and that it was 0.0099 mm in that run was chance. A change that costs a robot is seen."""


@pytest.mark.timeout(5400)  # the longest of all begins first
@pytest.mark.parametrize(
    ("count", "worse", "quiet"),
    [
        pytest.param(20, *TWENTY, marks=[pytest.mark.ci, pytest.mark.part], id="twenty"),
        pytest.param(100, *HUNDRED, marks=pytest.mark.slow, id="hundred"),
    ],
)
def test_robots_that_were_kept_back_reach_the_numbers(tmp_path, count, worse, quiet):
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
    assert sum(bool(row["worse"]) for row in rows if accepted(row)) <= worse, claims["never_worse"].measured
    for kind, least in quiet.items():
        assert sum(map(is_quiet, of_kind(rows, kind))) >= least, claims[f"quiet_{kind}"].measured
