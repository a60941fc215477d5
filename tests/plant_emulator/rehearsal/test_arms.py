"""Rehearsals of arms: the conditions in which what was learnt is looked at, and what counts as quiet and as worse."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.bench.model import Identified, IdentifiedError
from hil.errors import InterruptedRunError
from hil.experiments.motions import line_motion
from hil.master.session import Session
from plant_emulator.cli.main import app
from plant_emulator.rehearsal.arms.conditions import NAMES, conditions_of, with_payload
from plant_emulator.rehearsal.arms.path import REFERENCE_SEED, LineTip, TrueLine, arm_of, run_arm_seed, true_line
from plant_emulator.rehearsal.arms.summary import arm_claims, arm_tips
from plant_emulator.rehearsal.many.rows import WALKED
from plant_emulator.trials.rows import Row


@pytest.mark.slow
@pytest.mark.parametrize("seed", [REFERENCE_SEED, 4])
def test_an_arm_can_follow_the_lines_on_which_it_is_looked_at(seed: int) -> None:
    robot, bench = arm_of(seed)
    found = conditions_of(robot, bench)
    assert tuple(each.name for each in found) == NAMES
    lines = {each.name: each.bench.line_motion for each in found}
    own = lines["line"]
    assert own is not None
    for each in found:
        line = each.bench.line_motion
        assert line is not None
        motion = line_motion(each.bench, each.bench.bus.sync_period_s)
        assert motion.time_s[-1] == pytest.approx(line.dwell_s + line.duration_s + line.tail_s, abs=0.01)
    assert lines["beside"].start_m != own.start_m != lines["elsewhere"].end_m
    assert lines["elsewhere"].start_m == own.start_m
    assert (lines["quick"].duration_s, lines["slow"].duration_s) == pytest.approx((0.8 * own.duration_s, 1.4 * own.duration_s))


def test_a_payload_loses_mass_and_inertia_alike() -> None:
    robot, _ = arm_of(REFERENCE_SEED)
    whole, half = robot.arm.payload, with_payload(robot, 0.5).arm.payload
    assert whole is not None
    assert half is not None
    assert (half.mass_kg, half.inertia_kg_m2.zz) == (0.5 * whole.mass_kg, 0.5 * whole.inertia_kg_m2.zz)
    assert half.centre_m == whole.centre_m
    assert with_payload(robot, 0.0).arm.payload is None


def tip(x: float, y: float = 0.0, z: float = 0.0) -> LineTip:
    return LineTip(x, y, z, math.hypot(x, y, z))


def test_each_direction_has_to_be_quiet_and_none_may_be_worse() -> None:
    assert TrueLine(tip(0.08), tip(0.0099), tip(0.004)).is_quiet
    assert not TrueLine(tip(0.08), tip(0.004, z=0.011), tip(0.004)).is_quiet
    assert TrueLine(tip(0.08), tip(0.025), tip(0.02)).is_quiet  # the motion itself makes 0.02 mm of it
    assert not TrueLine(tip(0.08), None, tip(0.004)).is_quiet
    assert TrueLine(tip(0.08, y=0.001), tip(0.01, y=0.004), tip(0.004)).is_worse
    assert not TrueLine(tip(0.08, y=0.001), tip(0.01, y=0.0025), tip(0.004)).is_worse
    assert not TrueLine(tip(0.08), None, tip(0.004)).is_worse


def row(seed: int, learnt: float, *, is_quiet: bool, worse: str = "") -> Row:
    cells: dict[str, float] = {}
    for name in NAMES:
        values = {"none": 0.4, "learnt": learnt, "floor": 0.004}
        cells |= {f"tip_{name}_{treatment}_worst_mm": value for treatment, value in values.items()}
    names = {f"{name}_is_quiet": is_quiet for name in NAMES}
    ends = {"line_quiet": is_quiet, "is_quiet": is_quiet, "is_worse": bool(worse), "worse": worse}
    return {"seed": seed, "kind": "arm", "walk": WALKED, **cells, **names, **ends}


def test_claims_and_table_count_arms_that_are_quiet_and_worse() -> None:
    rows = [row(1, 0.006, is_quiet=True), row(2, 0.008, is_quiet=True), row(3, 0.5, is_quiet=False, worse="beside, slow")]
    holds = {each.key: each.holds for each in arm_claims(rows)}
    assert holds == {"never_worse": False, "quiet_line": False, "quiet_all": False, "whole": True}
    assert all(each.holds for each in arm_claims(rows[:2]))
    shown = {str(cells[0]): [str(cell) for cell in cells[1:]] for cells in arm_tips(rows).rows}
    assert shown["a line beside the learnt one"] == ["0.4000", "0.0080", "0.5000", "0.0040", "2 of 3", "1"]
    assert shown["without the payload"][-1] == "0"
    assert "a line beside the learnt one" in arm_tips(rows).markdown()


@pytest.mark.slow
def test_a_signal_ends_the_walk_of_an_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    """And is no refusal of a step."""

    def stopped(*_: object, **_more: object) -> None:
        raise InterruptedRunError("interrupted by SIGTERM")

    monkeypatch.setattr(Session, "run", stopped)
    with pytest.raises(KeyboardInterrupt):
        run_arm_seed(REFERENCE_SEED)


@pytest.mark.slow  # three runs of an arm, and what they need
def test_with_its_true_errors_a_drawn_arm_is_as_quiet_on_another_line_as_without() -> None:
    """What limits learning is what it knows: motors, gears that react, and set-points leave nothing."""
    robot, bench = arm_of(5)
    model = Identified(robot=bench.name)
    for number, axis in robot.axis.items():
        known = IdentifiedError(
            values=axis.ate, arm_hz=11.0, damping=0.03, motor_inertia_kg_m2=axis.motor_inertia_kg_m2, learnt_by="probing",
            gear_reaction=float(axis.gear_reaction), motor_friction_nm=axis.coulomb_friction_nm,
        )  # fmt: skip
        model = model.with_part(number, known)
    beside = next(each for each in conditions_of(robot, bench) if each.name == "beside")
    found = true_line(beside, model, ())
    assert found.is_quiet
    assert not found.is_worse
    assert found.none.worst > 5.0 * found.floor.worst
    assert np.all(np.isfinite(found.none))


@pytest.mark.slow  # the documented path of an arm: seventy runs
def test_the_reference_arm_is_quiet_where_it_learnt_and_elsewhere(tmp_path: Path) -> None:
    """Along x, y and z, nothing known but the motors: on its line, and unchanged on others, with other payloads and paces."""
    command = ["rehearse", "--arms", "--seeds", str(REFERENCE_SEED), "--jobs", "1", "--out", str(tmp_path), "--json"]
    ended = CliRunner().invoke(app, command)
    assert ended.exit_code == 0, ended.output
    kept = json.loads((tmp_path / "robots" / f"seed-{REFERENCE_SEED}.json").read_text())
    assert (kept["learn_ended"], kept["run_ended"], kept["left_out"]) == ("done", "done", "")
    assert (kept["line_quiet"], kept["worse"]) == (True, "")
    assert kept["is_quiet"], {name: kept[f"tip_{name}_learnt_worst_mm"] for name in NAMES}
    assert kept["tip_line_none_worst_mm"] > 0.07
    assert max(kept[f"tip_line_learnt_{way}_mm"] for way in "xyz") <= 0.010
