"""Stops of emulated robots, judged by the master: what rings without a shaper, with one, and with one for another robot."""

import math
from pathlib import Path

import pytest

from hil.bench.bench import load_bench
from hil.bench.model import Identified, IdentifiedError, load_identified
from hil.control.treatments import TreatmentName
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.report.writer import write_report_of
from hil.results.runs import RunEntry
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World
from tests.hil.experiments.test_shaping import arm_model

SHAPERS: tuple[TreatmentName, ...] = ("shaper-zv", "shaper-zvd", "shaper-mzv", "shaper-ei", "shaper-two-hump-ei")


def stops(
    tmp_path: Path, name: str, axis: int, treatments: tuple[TreatmentName, ...], knowledge: Knowledge
) -> dict[str, RunEntry]:
    """Entries of a stop without anything and with each treatment."""
    robot = load_robot(name)
    experiments = [Experiment("point-to-point", axis, each) for each in ("none", *treatments)]
    channel = InProcessChannel(World(robot), bitrate=robot.bus.bitrate, is_logged=False)
    outcome = run_experiments(load_bench(name), experiments, tmp_path, knowledge=knowledge, channel=channel)
    assert outcome.failure is None
    return {run.treatment: run for run in outcome.result.runs}


def decibel(runs: dict[str, RunEntry]) -> dict[str, float]:
    """Change by each treatment."""
    before = runs["none"].tip_peak_mm
    assert before is not None
    return {name: 20.0 * math.log10((run.tip_peak_mm or 0.0) / before) for name, run in runs.items() if name != "none"}


@pytest.mark.ci
@pytest.mark.parametrize("axis", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_stop_of_the_reference_robot_rings_25_db_less(tmp_path: Path, axis: int, without_pictures: None) -> None:
    runs = stops(tmp_path, "reference", axis, SHAPERS, Knowledge())
    assert runs["none"].within_spec is False
    assert all(runs[name].within_spec for name in SHAPERS)
    assert max(decibel(runs).values()) < -25.0, decibel(runs)
    page = write_report_of(tmp_path).read_text(encoding="utf-8")
    assert "Remaining vibration and cost of shapers" in page
    assert "two-hump EI shaper" in page


@pytest.mark.ci
def test_a_stop_of_the_reference_arm_rings_25_db_less(tmp_path: Path) -> None:
    model = tmp_path / "model.toml"
    arm_model().save(model)
    runs = stops(
        tmp_path, "reference-arm", 2, ("shaper-zv", "shaper-zvd", "shaper-mzv"), Knowledge(identified=load_identified(model))
    )
    ringing = runs["none"].ringing
    assert ringing is not None
    assert [round(mode.frequency_hz) for mode in ringing] == [10, 14, 36]
    assert max(decibel(runs).values()) < -25.0, decibel(runs)


@pytest.mark.slow
def test_a_shaper_for_another_frequency_leaves_what_its_curve_says(tmp_path: Path) -> None:
    """An arm with a third more inertia than believed rings a seventh lower: ZV leaves a part, two-hump EI far less."""
    robot, bench = load_robot("reference"), load_bench("reference")
    heavy = robot.axis[2].model_copy(update={"arm_inertia_kg_m2": 1.3 * robot.axis[2].arm_inertia_kg_m2})
    channel = InProcessChannel(
        World(robot.model_copy(update={"axis": {**robot.axis, 2: heavy}})), bitrate=robot.bus.bitrate, is_logged=False
    )
    treatments: tuple[TreatmentName, ...] = ("none", "shaper-zv", "shaper-two-hump-ei")
    outcome = run_experiments(bench, [Experiment("point-to-point", 2, each) for each in treatments], tmp_path, channel=channel)
    before, zv, wide = (run.tip_peak_mm or 0.0 for run in outcome.result.runs)
    assert zv / before > 0.08
    assert wide < 0.5 * zv


def hard_stop(tmp_path: Path, name: str, knowledge: Knowledge, treatments: tuple[TreatmentName, ...]) -> dict[str, RunEntry]:
    """Entries of stops of axis 2 from 2.5 rev/s, where order 4 meets the resonance of the reference arm."""
    robot, bench = load_robot(name), load_bench(name)
    table = bench.point_to_point
    assert table is not None
    fast = table.model_copy(update={"speed_rps": 2.5, "distance_rev": 4.0})
    channel = InProcessChannel(World(robot), bitrate=robot.bus.bitrate, is_logged=False)
    experiments = [Experiment("point-to-point", 2, each) for each in ("none", *treatments)]
    outcome = run_experiments(
        bench.model_copy(update={"point_to_point": fast}), experiments, tmp_path, knowledge=knowledge, channel=channel
    )
    assert outcome.failure is None, outcome.failure
    return {run.treatment: run for run in outcome.result.runs}


def knowing(phi4_deg: float, phi2_deg: float = 222.3) -> Knowledge:
    """What was identified of the reference arm's axis 2, with these phases."""
    values = TransmissionErrorTable(a2_arcsec=4.98, phi2_deg=phi2_deg, a4_arcsec=2.97, phi4_deg=phi4_deg)
    errors = {"a2_arcsec": 0.04, "phi2_deg": 0.2, "a4_arcsec": 0.03, "phi4_deg": 0.4}
    part = IdentifiedError(values=values, standard_error=errors, arm_hz=10.49, damping=0.03, learnt_by="identify")
    known: Identified = arm_model().with_part(2, part)
    return Knowledge(identified=known)


@pytest.mark.slow
def test_a_stop_from_where_an_order_rings_is_25_db_quieter_by_a_shaper_beside_a_cancellation(tmp_path: Path) -> None:
    """Alone the shaper leaves what the transmission error has set swinging on the way: −22 dB."""
    runs = hard_stop(tmp_path, "reference-arm", knowing(126.1), ("shaper-ei", "cancellation+shaper-ei"))
    found = decibel(runs)
    assert found["shaper-ei"] > -25.0 > found["cancellation+shaper-ei"]
    both = runs["cancellation+shaper-ei"]
    assert both.within_spec
    assert both.trial is not None
    assert both.trial.is_good
    assert both.shaper is not None


@pytest.mark.slow
def test_a_cancellation_that_fails_its_trial_leaves_the_shaper_alone_and_is_no_success(tmp_path: Path) -> None:
    """Phases off by half a turn would shake the arm twice as much."""
    name: TreatmentName = "cancellation+shaper-ei"
    runs = hard_stop(tmp_path, "reference-arm", knowing(306.1, 42.3), ("shaper-ei", name))
    assert runs[name].within_spec is None
    assert "passes its trial; the shaper remains" in (runs[name].invalid or "")
    assert runs[name].tip_peak_mm == pytest.approx(runs["shaper-ei"].tip_peak_mm, rel=0.1)
