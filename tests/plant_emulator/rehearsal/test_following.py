"""A cancellation that follows, on emulated robots: the numbers that it must reach, and where it must not make anything worse."""

import csv
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.bench.bench import load_bench
from plant_emulator.cli.main import app
from plant_emulator.rehearsal.following.rig import Assumed, Rig
from plant_emulator.rehearsal.following.study import LAWS, constant, law_of, ramp, rig_of
from plant_emulator.robots.robot import load_robot

OFF = Assumed(1.01, 1.0, 1.01, 1.15, 0.5e-3)
"""Off as an identification leaves it."""
STEP_S = 5.0


def reference(off: Assumed = OFF) -> Rig:
    return Rig(load_robot("reference"), off, 2, load_bench("reference"))


def peak(run, begin_s: float, end_s: float) -> float:
    inside = (run.time_s >= begin_s) & (run.time_s < end_s)
    return float(np.max(np.abs(run.tip_mm[inside])))


@pytest.mark.slow
def test_a_step_of_thirty_degrees_at_resonance_is_followed_within_five_revolutions():
    rig = reference()
    run = rig.run(constant(rig), rig.follower(), lambda now: 30.0 if now >= STEP_S else 0.0, only=2)
    revolution, before = 2.0 / rig.f_al_hz, peak(run, STEP_S - 1.5, STEP_S)
    assert before < 0.003
    assert peak(run, STEP_S + 4.0 * revolution, STEP_S + 8.0 * revolution) <= 1.3 * before
    # the arm alone needs as long as this to ring down from half of the vibration
    assert 1.0 < math.log(0.04 / (1.3 * before)) * rig.resonance.ring_down_s / revolution < 5.0


def test_where_nothing_is_wrong_nothing_is_added():
    rig = reference(Assumed())
    for motion in (ramp(rig), constant(rig)):
        alone, follows = rig.run(motion, None), rig.run(motion, rig.follower())
        assert abs(np.max(np.abs(follows.tip_mm)) - np.max(np.abs(alone.tip_mm))) < 1e-6
        assert all(np.all(factor == 1.0) for factor in follows.factors.values())


@pytest.mark.slow
def test_a_drift_never_leaves_more_than_a_tenth():
    rig = reference(Assumed())
    motion = constant(rig, revolutions=330.0)
    drift = lambda now: 10.0 / 60.0 * now  # noqa: E731
    nothing, follows = rig.run(motion, None, drift, cancels=False), rig.run(motion, rig.follower(), drift)
    assert follows.time_s[-1] > 55.0
    assert peak(follows, 2.0, 60.0) < 0.1 * peak(nothing, 2.0, 60.0)
    assert peak(rig.run(motion, None, drift), 50.0, 60.0) > 0.1 * peak(nothing, 50.0, 60.0)


def test_a_model_that_is_thirty_degrees_off_is_put_right_on_a_ramp():
    rig = reference(Assumed(turn_deg=-30.0))
    alone, follows = (rig.run(ramp(rig), follower) for follower in (None, rig.follower()))
    assert math.degrees(np.angle(follows.factors[2][-1])) == pytest.approx(30.0, abs=5.0)
    rows = (alone.speed_rps > 4.5) & (alone.speed_rps < 7.5)
    assert np.max(np.abs(follows.tip_mm[rows])) < 0.6 * np.max(np.abs(alone.tip_mm[rows]))


@pytest.mark.slow
def test_the_laws_it_is_compared_with_follow_a_step_as_well():
    rig = rig_of(5, Assumed())
    for name in LAWS:
        run = rig.run(constant(rig), law_of(name, rig), lambda now: 30.0 if now >= 3.0 else 0.0, only=2)
        assert math.degrees(np.angle(run.factors[2][-1])) == pytest.approx(30.0, abs=12.0)


@pytest.mark.slow
def test_the_command_compares_and_keeps_a_table(tmp_path):
    out = tmp_path / "following.csv"
    done = CliRunner().invoke(app, ["following", "--seed", "5", "--robots", "1", "--law", "observer", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "constant speed" in done.output
    with out.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["law"] for row in rows] == ["observer"] * 5
    assert float(rows[-1]["following_mm"]) < 0.5 * float(rows[-1]["alone_mm"])


def test_a_law_that_nobody_knows_is_refused():
    done = CliRunner().invoke(app, ["following", "--law", "guess"])
    assert done.exit_code == 2
    assert "filtered-x LMS" in done.output
