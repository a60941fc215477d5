"""Learning on a motion itself: probing runs on the emulated robot, what is kept of them, and what is refused."""

import json
import math
from pathlib import Path

import pytest

from hil.arm.straight_line import LineError
from hil.bench.bench import Bench, load_bench
from hil.bench.model import load_identified
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.experiments.cancellation.probing.learning import MotionNotLearntError
from hil.experiments.cancellation.probing.on_bus import MotionLearnRequest, learn_motion_on_bus
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.experiments.treatment import Knowledge
from hil.report.pages.learn_motion import cards
from hil.report.writer import write_report_of
from hil.results.files import load_result
from hil.results.learning import MotionLearningResult
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World

INERTIAS = {2: 2.6e-4, 3: 1.2e-4, 5: 2.5e-5}
NO_ERROR = TransmissionErrorTable.of({}, {})


def ramp_bench() -> Bench:
    """The reference bench, which knows its plants and no transmission error."""
    bench = load_bench("reference")
    axes = {}
    for number, table in bench.axis.items():
        model = None if table.model is None else table.model.model_copy(update={"ate": NO_ERROR})
        axes[number] = table.model_copy(update={"model": model})
    return bench.model_copy(update={"axis": axes, "bus": bench.bus.model_copy(update={"sync_period_s": 0.002})})


def without_error(robot: Robot, *axes: int) -> Robot:
    changed = {number: robot.axis[number].model_copy(update={"ate": NO_ERROR}) for number in axes}
    return robot.model_copy(update={"axis": {**robot.axis, **changed}})


RAMP = MotionLearnRequest(CONSTANT_ACCELERATION, 3, orders=(2,), note="no load")


@pytest.mark.slow
def test_a_ramp_is_learnt_on_itself_and_the_tip_is_quieter_with_it(tmp_path: Path) -> None:
    robot, model = load_robot("reference"), tmp_path / "learnt.toml"
    outcome = learn_motion_on_bus(ramp_bench(), RAMP, tmp_path, model, channel=InProcessChannel(World(robot), is_logged=False))
    assert outcome.failure is None
    part = load_identified(model).axis[3].ate
    assert part is not None
    true = robot.axis[3].ate
    assert part.values.amplitudes_arcsec() == {2: pytest.approx(true.a2_arcsec, abs=3.0 * part.standard_error["a2_arcsec"])}
    assert part.values.phi2_deg == pytest.approx(true.phi2_deg, abs=3.0 * part.standard_error["phi2_deg"])
    assert part.standard_error["a2_arcsec"] < 1.0
    assert (part.learnt_by, part.note.split("; ", 1)[1]) == (
        "probing",
        f"{len(outcome.result.runs)} runs of {RAMP.motion}; no load",
    )
    result = load_result(tmp_path, MotionLearningResult, "")
    kept = [run for run in result.runs if run.is_kept]
    assert [run.what for run in kept] == ["applied"]
    assert kept[0].tip_rms_mm is not None
    assert result.base_rms_mm is not None
    assert kept[0].tip_rms_mm < 0.75 * result.base_rms_mm  # order 4 stays: it was not asked for
    assert [run.what for run in result.runs].count("base") == 3
    assert len(cards(result)) == 1


@pytest.mark.slow
def test_where_there_is_no_error_nothing_is_kept(tmp_path: Path) -> None:
    robot, model = without_error(load_robot("reference"), 3), tmp_path / "learnt.toml"
    outcome = learn_motion_on_bus(ramp_bench(), RAMP, tmp_path, model, channel=InProcessChannel(World(robot), is_logged=False))
    assert isinstance(outcome.failure, MotionNotLearntError)
    assert not model.exists()
    assert json.loads((tmp_path / "result.json").read_text())["not_learnt"] == str(outcome.failure)


def test_a_motor_inertia_that_nobody_knows_is_asked_for_before_anything_moves(tmp_path: Path) -> None:
    bench, channel = load_bench("reference-arm"), InProcessChannel(World(load_robot("reference-arm")), is_logged=False)
    unknown = {number: table.model_copy(update={"motor_inertia_kg_m2": None}) for number, table in bench.axis.items()}
    bench = bench.model_copy(update={"axis": unknown})
    request = MotionLearnRequest(LINE_MOTION, motor_inertias_kg_m2={2: 2.6e-4, 3: 1.2e-4})
    with pytest.raises(NotPossibleError, match="the motor inertia of axis 5 is not known"):
        learn_motion_on_bus(bench, request, tmp_path / "out", tmp_path / "m.toml", channel=channel)
    assert not (tmp_path / "out").exists()


def test_a_line_without_a_band_is_refused_before_anything_moves(tmp_path: Path) -> None:
    bench, channel = load_bench("reference-arm"), InProcessChannel(World(load_robot("reference-arm")), is_logged=False)
    bench = bench.model_copy(update={"specification": bench.specification.model_copy(update={"band_hz": None})})
    request = MotionLearnRequest(LINE_MOTION, motor_inertias_kg_m2=INERTIAS)
    with pytest.raises(NotPossibleError, match="band_hz"):
        learn_motion_on_bus(bench, request, tmp_path / "out", tmp_path / "m.toml", channel=channel)
    assert not (tmp_path / "out").exists()


def test_a_probe_beyond_a_limit_is_refused_with_what_to_do(tmp_path: Path) -> None:
    bench = ramp_bench()
    table = bench.axis[3]
    axis = table.model_copy(update={"limits": table.limits.model_copy(update={"cancellation_rev": 1e-4})})
    bench = bench.model_copy(update={"axis": {**bench.axis, 3: axis}})
    outcome = learn_motion_on_bus(
        bench, RAMP, tmp_path, tmp_path / "m.toml", channel=InProcessChannel(World(load_robot("reference")), is_logged=False)
    )
    assert isinstance(outcome.failure, UnsafeRequestError)
    assert "a probe" in str(outcome.failure)
    assert "--probe-arcsec" in str(outcome.failure)
    assert [run.what for run in outcome.result.runs] == ["base"]
    assert not (tmp_path / "m.toml").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pace", "error", "words"),
    [
        (0.5, LineError, "duration_s"),
        (
            0.78,
            UnsafeRequestError,
            r"the rest of the limit is kept for vibration; choose --pace 0\.8\d",
        ),  # it can be followed, but without any room
    ],
)
def test_a_pace_without_room_is_refused_before_anything_moves(
    tmp_path: Path, pace: float, error: type[Exception], words: str
) -> None:
    bench, channel = load_bench("reference-arm"), InProcessChannel(World(load_robot("reference-arm")), is_logged=False)
    with pytest.raises(error, match=words):
        learn_motion_on_bus(bench, MotionLearnRequest(LINE_MOTION, pace=pace), tmp_path / "o", tmp_path / "m", channel=channel)
    assert not (tmp_path / "o").exists()


@pytest.mark.slow  # two dozen runs of an arm, and a page
def test_an_arm_of_which_nothing_but_its_motors_is_known_learns_its_line(tmp_path: Path) -> None:
    """Quiet along x, y and z, with errors as large as said; what is kept passes the trial of a run afterwards."""
    robot, bench, model = load_robot("reference-arm"), load_bench("reference-arm"), tmp_path / "learnt.toml"
    channel = InProcessChannel(World(robot), is_logged=False)
    request = MotionLearnRequest(LINE_MOTION, motor_inertias_kg_m2=INERTIAS, orders=(2, 4), pace=0.85)
    outcome = learn_motion_on_bus(bench, request, tmp_path / "learn", model, channel=channel)
    assert outcome.failure is None
    learnt = {(part.axis, part.order): part for part in outcome.result.parts if part.outcome == "learnt"}
    assert learnt.keys() >= {(2, 2), (2, 4), (3, 2), (3, 4)}
    for part in learnt.values():
        true = robot.axis[part.axis].ate
        off = (part.a_arcsec or 0.0) - true.amplitudes_arcsec()[part.order]
        turned = math.remainder((part.phi_deg or 0.0) - true.phases_deg()[part.order], 360.0)
        assert abs(off) < 3.0 * (part.a_error_arcsec or 0.0), part.words
        assert abs(turned) < 3.0 * (part.phi_error_deg or 0.0), part.words
        if part.axis in {2, 3}:  # axis 5 turns slowly, and hardly shows at its own pace
            assert 3.0 * (part.a_error_arcsec or 0.0) < 0.5, part.words
            assert 3.0 * (part.phi_error_deg or 0.0) < 9.0, part.words
    assert all(entry.ate.gear_reaction == 0.0 for entry in outcome.result.learnt)  # its gears do not
    runs = outcome.result.runs
    assert [run.number for run in runs] == list(range(1, len(runs) + 1))
    paces = [run.pace for run in runs]
    assert 0.85 in paces
    assert paces == [1.0] * paces.index(0.85) + [0.85] * paces.count(0.85) + [1.0] * (
        len(paces) - paces.index(0.85) - paces.count(0.85)
    )
    assert all((tmp_path / "learn" / run.recording).exists() for run in runs)
    assert "probing, 0.85 × the time" in write_report_of(tmp_path / "learn").read_text(encoding="utf-8")
    assert "Learning on the line motion" in write_report_of(tmp_path / "learn").read_text(encoding="utf-8")
    experiments = [Experiment(LINE_MOTION, None, "none"), Experiment(LINE_MOTION, None, "cancellation-learnt")]
    knowledge = Knowledge(learnt=load_identified(model))
    before, after = run_experiments(bench, experiments, tmp_path / "run", knowledge=knowledge, channel=channel).result.runs
    assert before.tip_peak_mm is not None
    assert after.trial is not None
    assert not after.trial.refused
    assert before.tip_peak_mm > 0.07
    assert (after.tip_peak_mm or 1.0) < 0.008  # noise and the motion itself make 0.003 to 0.006 mm of it
