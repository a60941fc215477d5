"""Learning on drawn robots whose ramps do not reach order 1: what an identification has found of it stays, and is cancelled."""

from pathlib import Path

import pytest

from drive_profiles.files.toml import loads
from hil.bench.bench import Bench
from hil.bench.model import IdentifiedError, load_identified
from hil.experiments.cancellation.learn_run import LearningOutcome, LearnRequest, learn_on_bus
from hil.report.pages.learn import verdict
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.rehearsal.many.one import drawn
from plant_emulator.rehearsal.probes import model_of
from plant_emulator.robots.encoders import MotorEncoder
from plant_emulator.world import World

AXIS = 2
ERRORS = {"a1_arcsec": 0.3, "phi1_deg": 0.1, "a2_arcsec": 3.0, "phi2_deg": 7.0, "a4_arcsec": 0.08, "phi4_deg": 0.5}
"""Standard errors of an identification that knows order 2 badly."""

ENCODER_ERRORS = "A_1 is 2.1 % off with the drawn noise and eccentricity of the encoder: the fit counts its rounding alone"


def learnt_from(
    tmp_path: Path,
    passes: int,
    a1_factor: float = 1.0,
    seed: int = 1,
    reaction: float | None = None,
    *,
    rounds_only: bool = False,
) -> tuple[TransmissionErrorTable, IdentifiedError, LearningOutcome]:
    """True error of the robot as its encoder shows it, the error as it is learnt after some passes, and the learning."""
    robot, text = drawn(seed, "linear")
    if rounds_only:
        axis = robot.axis[AXIS].model_copy(update={"encoder": MotorEncoder()})
        robot = robot.model_copy(update={"axis": {AXIS: axis}})
    bench, true = loads(text, Bench, "blank bench"), robot.axis[AXIS].apparent_ate
    known = model_of(robot, bench, AXIS, true.model_copy(update={"a1_arcsec": a1_factor * true.a1_arcsec}))
    ate = known.axis[AXIS].ate
    assert ate is not None
    changed = {"standard_error": ERRORS, "correlation": None} | ({} if reaction is None else {"gear_reaction": reaction})
    known = known.with_part(AXIS, ate.model_copy(update=changed))
    known.save(tmp_path / "model.toml")
    channel = InProcessChannel(World(robot), bitrate=robot.bus.bitrate, is_logged=False)
    asked = LearnRequest((AXIS,), passes=passes)
    end = learn_on_bus(bench, asked, tmp_path / "out", tmp_path / "learnt.toml", plant=tmp_path / "model.toml", channel=channel)
    assert end.failure is None
    part = load_identified(tmp_path / "learnt.toml").axis[AXIS].ate
    assert isinstance(part, IdentifiedError)
    return true, part, end


@pytest.mark.slow
def test_learning_keeps_the_order_that_its_ramps_do_not_reach(tmp_path: Path) -> None:
    true, part, end = learnt_from(tmp_path, passes=2)
    values = part.values
    assert (values.a1_arcsec, values.phi1_deg) == (true.a1_arcsec, true.phi1_deg)
    assert (part.standard_error["a1_arcsec"], part.standard_error["phi1_deg"]) == (0.3, 0.1)
    assert values.a2_arcsec == pytest.approx(true.a2_arcsec, rel=0.03), "learnt: the passes know it better"
    assert part.standard_error["a2_arcsec"] < 1.0
    assert values.a2_arcsec != true.a2_arcsec
    assert "order 1" in part.note
    assert any("order 1 keeps its known values" in line for line in verdict(end.result).details)
    assert 1 in {verdict.part.order for verdict in end.learnt[AXIS].passes[-1].verdicts}, "the passes cancel it too"
    assert end.learnt[AXIS].reduction_fraction > 0.3


@pytest.mark.ci
@pytest.mark.parametrize("rounds_only", [True, pytest.param(False, marks=pytest.mark.xfail(strict=True, reason=ENCODER_ERRORS))])
def test_learning_goes_on_through_the_order_that_the_motion_meets(tmp_path: Path, *, rounds_only: bool) -> None:
    true, part, end = learnt_from(tmp_path, passes=4, a1_factor=0.95, rounds_only=rounds_only)
    assert part.values.a1_arcsec == pytest.approx(true.a1_arcsec, rel=0.015), "known 5 % too small"
    assert part.values.phi1_deg == pytest.approx(true.phi1_deg, abs=0.5)
    assert not any("order 1 is kept" in line for line in verdict(end.result).details)
    assert end.learnt[AXIS].reduction_fraction > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "true", "believed"), [(701, 1.0, 0.0), (703, 0.0, 1.0)])
def test_learning_mends_a_reaction_of_the_gear_that_was_told_wrongly(
    tmp_path: Path, seed: int, true: float, believed: float
) -> None:
    _, part, _ = learnt_from(tmp_path, passes=3, seed=seed, reaction=believed)
    assert part.gear_reaction == pytest.approx(true, abs=0.1)
