"""The documented path on robots that nobody has seen while this was built: it reaches the numbers that must be reached."""

import pytest

from plant_emulator.rehearsal.many.claims import claims_of
from plant_emulator.rehearsal.many.one import BOTH, run_seed
from plant_emulator.rehearsal.many.reading import accepted, is_quiet, of_kind
from plant_emulator.rehearsal.many.rows import crashed
from plant_emulator.trials.executors import LocalProcesses
from plant_emulator.trials.running import run_all
from plant_emulator.trials.table import csv_text
from tests.plant_emulator.rehearsal.made import page_of

FIRST, ROBOTS = 10_041, 40
"""Seeds from here on are not used for anything else: a robot that was looked at is no test any more."""

PROBED_EVERY = 5
"""Wrong corrections are tried on every fifth: they cost as much as the path."""

HOLD = ("wrong_refused", "whole")
"""Claims that these robots keep without an exception; the first is of those that are probed."""
NEAR = {"never_worse": 0.1, "quiet_linear": 0.9, "quiet_real": 0.85}
"""Claims that chance decides on forty robots (docs/rehearsal-results.md has the figures): what must hold of them all the same.

The fraction that is worse at most, and those that are quiet at least. A change that costs more than chance does is seen by this.
"""

FEW = range(10_046, 10_048)
"""Seeds of the short variant, on the same path: a robot of each kind, neither of them probed."""
ALL = range(FIRST, FIRST + ROBOTS)


@pytest.mark.timeout(5400)  # the longest of all begins first
@pytest.mark.parametrize(
    "seeds",
    [
        pytest.param(FEW, marks=[pytest.mark.ci, pytest.mark.part], id="few"),
        pytest.param(ALL, marks=pytest.mark.slow, id="all"),
    ],
)
def test_robots_that_nobody_has_seen_reach_the_numbers(tmp_path, seeds):
    """One test, since the robots are walked once; table and page of them lie in its folder."""
    rows = []
    with LocalProcesses(1) as executors:  # beside a worker that waits for it: two would be one too many for its processor
        run_all(seeds, run_seed, (BOTH, False, None, PROBED_EVERY), executors, rows.append, crashed)
    rows.sort(key=lambda row: row["seed"])
    (tmp_path / "robots.csv").write_text(csv_text(rows), encoding="utf-8")
    page_of(tmp_path / "report.html", rows)
    claims = {each.key: each for each in claims_of(rows)}
    missed = [
        f"{claims[key].words}: asked {claims[key].asked}, measured {claims[key].measured}"
        for key in (HOLD if any(seed % PROBED_EVERY == 0 for seed in seeds) else HOLD[1:])
        if not claims[key].holds
    ]
    assert missed == []
    treated = [row for row in rows if accepted(row)]
    assert sum(bool(row["worse"]) for row in treated) <= NEAR["never_worse"] * len(treated), claims["never_worse"].measured
    for kind in ("linear", "real"):
        own = of_kind(rows, kind)
        assert sum(map(is_quiet, own)) >= NEAR[f"quiet_{kind}"] * len(own), claims[f"quiet_{kind}"].measured
