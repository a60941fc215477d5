"""The demo's last part claims what was judged, and nothing else; where it ends early its pages say so."""

import json
from pathlib import Path

import pytest

from hil import arm_tour
from hil.analysis import DirectionMetrics
from hil.arm_tour import GOAL_MM, claims
from hil.bench.bench import load_bench
from hil.experiments.motions import LINE_MOTION
from hil.report.pages.demo import ARM_FOLDER
from hil.report.writer import write_report_of
from hil.results.base import MeasuredBench
from hil.results.runs import ExperimentsResult, RunEntry

LIMIT_MM = 0.05


def entry(treatment: str, x: float, y: float, z: float, worst: float, **other: object) -> RunEntry:
    peaks = {"x": x, "y": y, "z": z, "worst": worst}
    found = {name: DirectionMetrics((1.0, 0.0, 0.0), peak, peak / 2, 1.0, 10.0, 0.5) for name, peak in peaks.items()}
    values: dict[str, object] = {
        "experiment": LINE_MOTION, "axis": None, "treatment": treatment, "loop": "drive", "sync_period_s": 0.002,
        "control_period_s": 250e-6, "order": None, "tip_peak_mm": worst, "tip_rms_mm": worst / 2, "spectrum_peak_m_s2": 1.0,
        "spectrum_peak_hz": 10.0, "spectrum_area": 0.5, "within_spec": worst <= LIMIT_MM, "cycles": 1500, "missed_cycles": 0,
        "wall_s": 1.0, "motion_s": 3.0, "recording": f"{treatment}.csv", "noise_mm": 0.003, "directions": found,
    }  # fmt: skip
    return RunEntry.model_validate({**values, **other})


BEFORE = entry("none", 0.061, 0.003, 0.060, 0.077)
AFTER = entry("cancellation-learnt", 0.009, 0.003, 0.004, 0.0098)


def verdicts(*entries: RunEntry) -> list[bool | None]:
    return [claim.holds for claim in claims(list(entries), LIMIT_MM)]


def test_every_direction_of_the_judged_runs_stands_beside_what_is_asked():
    made = claims([BEFORE, AFTER], LIMIT_MM)
    assert [claim.found for claim in made] == pytest.approx([0.077, 0.009, 0.003, 0.004, 0.0098, 0.0, 0.009])
    assert [claim.asked for claim in made] == [LIMIT_MM] * 5 + [0.003, GOAL_MM]
    assert verdicts(BEFORE, AFTER) == [True] * 7


def test_nothing_is_claimed_of_runs_that_were_not_made_or_not_judged():
    assert verdicts() == [None] * 7
    assert verdicts(BEFORE) == [True] + [None] * 6
    refused = AFTER.model_copy(update={"invalid": "the trial refused it"})
    assert verdicts(BEFORE, refused) == [True] + [None] * 6
    no_vector = AFTER.model_copy(update={"directions": None})
    assert verdicts(BEFORE, no_vector) == [True] + [None] * 6


@pytest.mark.parametrize(
    ("after", "broken"),
    [
        (entry("cancellation-learnt", 0.051, 0.003, 0.004, 0.0515), [1, 4, 6]),
        (entry("cancellation-learnt", 0.009, 0.007, 0.004, 0.012), [5]),  # sideways 0.004 mm more than without, 0.003 is noise
        (entry("cancellation-learnt", 0.011, 0.003, 0.004, 0.012), [6]),
    ],
)
def test_a_number_beyond_what_is_asked_is_no_claim_that_holds(after: RunEntry, broken: list[int]):
    assert [number for number, holds in enumerate(verdicts(BEFORE, after)) if holds is False] == broken


def test_an_arm_that_keeps_the_specification_by_itself_shows_nothing():
    assert verdicts(entry("none", 0.02, 0.003, 0.02, 0.03), AFTER)[0] is False


@pytest.mark.slow
def test_an_arm_that_is_not_there_is_said_on_its_own_page_and_on_the_demos(tmp_path: Path):
    bench = load_bench("reference-arm")
    described = MeasuredBench(
        name=bench.name,
        bus="local:/tmp/robot.sock",
        clock="lock-step",
        started_utc="2025-01-01T12:00:00Z",
        versions={},
        file=bench,
    )
    ExperimentsResult(bench=described, emulated=True).write(tmp_path / "result.json")
    assert "whole-arm" not in write_report_of(tmp_path).read_text()
    done = arm_tour.run("local:/nowhere/robot.sock", tmp_path / ARM_FOLDER)
    assert done.failure is not None
    assert done.comparison is None
    kept = json.loads((tmp_path / ARM_FOLDER / "result.json").read_text())["tour"]
    assert kept["failure"] == str(done.failure)
    assert [(step["name"], step["holds"]) for step in kept["steps"]] == [("learn on the line itself", False)]
    own = write_report_of(tmp_path / ARM_FOLDER).read_text()
    assert "The comparison is not complete" in own
    assert "A whole arm: bench “reference arm”" in own
    page = write_report_of(tmp_path).read_text()
    assert 'id="whole-arm-table"' in page
    assert "It ended early" in page
