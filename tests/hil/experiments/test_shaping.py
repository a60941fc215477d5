"""Shapers of a bench's motions: the modes that they are for, what they cost, and what is refused."""

import math
from pathlib import Path

import numpy as np
import pytest

from hil.arm.kinematics import Kinematics
from hil.bench.bench import AS_FOUND, load_bench
from hil.bench.model import Identified, IdentifiedMode, IdentifiedPlant
from hil.control.shapers import NAMES
from hil.design.modes.ring_down import modes_of
from hil.errors import NotPossibleError
from hil.experiments.comparison.plan import ComparisonRequest
from hil.experiments.motions import line_motion, point_to_point
from hil.experiments.plan import Experiment
from hil.experiments.runner import run_experiments
from hil.experiments.shaping import check_stop, fitted_shaper, rates_of, shaped_motion, tip_m
from hil.experiments.treatment import Knowledge
from hil.robot_tables import PlantTable, PointToPointMotion

BENCH, ARM = load_bench("reference"), load_bench("reference-arm")
PERIOD = 0.002
STOP = "point-to-point"


def arm_model():
    """What `hil identify plant --axis 2` finds of the emulated reference arm: three modes; the third barely moves the tip."""
    modes = ((10.49, 12.18, 0.0313, 4.81, 0.92), (14.71, 22.36, 0.0425, 3.17, 0.13), (36.0, 36.2, 0.046, 0.022, -0.06))
    plant = IdentifiedPlant(
        values=PlantTable(
            motor_inertia_kg_m2=2.6e-4, motor_damping_nm_s_rad=1.5e-3, arm_inertia_kg_m2=4.81, arm_damping_nm_s_rad=0.0,
            gear_stiffness_nm_rad=20885.0, gear_damping_nm_s_rad=19.9,
        ),
        antiresonance_hz=10.49, resonance_hz=15.86, damping=0.0313,
        modes=tuple(
            IdentifiedMode(antiresonance_hz=dip, resonance_hz=peak, damping=zeta, inertia_kg_m2=inertia, tip_part=part)
            for dip, peak, zeta, inertia, part in modes
        ),
    )  # fmt: skip
    return Identified(robot=ARM.name).with_part(2, plant)


def test_a_shaper_is_fitted_to_what_rings_in_the_closed_loop():
    [mode] = fitted_shaper("zv", BENCH, (2,), None).modes
    assert mode == modes_of(rates_of(BENCH, 2, None))[0]
    assert mode.frequency_hz == pytest.approx(11.63, abs=0.01)


def test_an_arm_with_several_modes_is_shaped_for_its_two_lowest():
    from hil.bench.model import with_identified  # noqa: PLC0415

    model = arm_model()
    known = with_identified(ARM, model)
    rates = rates_of(known, 2, model)
    assert len(modes_of(rates)) == 3
    made = fitted_shaper("zvd", known, (2,), model)
    assert [round(mode.frequency_hz) for mode in made.modes] == [10, 14]
    assert made.remaining(1.0) < 1e-9
    assert made.shaper.duration_s == pytest.approx(sum(mode.period_s for mode in made.modes))


def test_a_wide_shaper_takes_the_other_axis_mode_along():
    """The planar arm's axes ring at 11.2 and 11.6 Hz: what leaves 5 % at most of both needs one shaper alone."""
    for name in NAMES:
        made = fitted_shaper(name, BENCH, (2, 3, 5), None)
        assert made.left == ()
        assert len(made.modes) == 1
        assert float(made.shaper.remaining(11.63, 0.129)) < 0.05


def test_the_tip_of_a_shaped_line_leaves_it_by_what_is_said():
    plain = line_motion(BENCH, PERIOD)
    shaped, entry = shaped_motion(BENCH, "shaper-two-hump-ei", plain, None)
    chain = BENCH.geometry.chain()
    ratios = [BENCH.axis[axis].reduction_ratio for axis in plain.axes]
    start = chain.joints(np.array([[0.5, 0.45]]))[0]
    tip = chain.tip(start + shaped.motor_angle_rad / ratios)
    assert 1e3 * np.max(np.abs(tip[:, 1] - 0.45)) == pytest.approx(entry.path_error_mm, rel=1e-3), "the line is level"
    assert 0.005 < entry.path_error_mm < 0.2
    assert len(shaped.time_s) == len(plain.time_s) + math.ceil(entry.duration_s / PERIOD)


def test_an_arm_s_line_is_followed_by_its_own_kinematics():
    plain = line_motion(ARM, PERIOD)
    points = tip_m(ARM, plain)
    assert points[0] == pytest.approx(Kinematics.of(ARM.arm).pose(ARM.arm.home_rad())[0], abs=1e-9)
    assert np.max(np.abs(points[:, 1:] - [0.0, 0.45])) < 1e-5


def test_a_single_axis_keeps_its_path():
    _, entry = shaped_motion(BENCH, "shaper-zv", point_to_point(BENCH, 2, PERIOD), None)
    assert entry.path_error_mm is None
    assert shaped_motion(BENCH, "notch", point_to_point(BENCH, 2, PERIOD), None)[1] is None


def test_without_a_model_or_gains_nobody_knows_what_rings():
    bare = BENCH.axis[2].model_copy(update={"model": None})
    found = BENCH.axis[2].model_copy(update={"control": AS_FOUND})
    for table in (bare, found):
        bench = BENCH.model_copy(update={"axis": {**BENCH.axis, 2: table}})
        with pytest.raises(NotPossibleError, match=r"axis 2 has no model or no gains.*hil identify plant"):
            fitted_shaper("zv", bench, (2,), None)


@pytest.mark.parametrize("name", ["notch", "cancellation", "low-gains", "fixed-notch", "cancellation-inside"])
def test_what_acts_while_a_motor_turns_is_refused_for_a_stop(name):
    with pytest.raises(NotPossibleError, match=f"{name} acts only while a motor turns"):
        check_stop(is_stop=True, name=name, loop="drive")
    check_stop(is_stop=False, name=name, loop="drive")


def test_a_stop_is_judged_in_the_drives_loop():
    with pytest.raises(NotPossibleError, match="--loop drive"):
        check_stop(is_stop=True, name="none", loop="host")
    with pytest.raises(NotPossibleError, match="is fitted to a loop that the drive closes"):
        run_experiments(BENCH, [Experiment("line-motion", None, "shaper-zv", "host")], Path("nowhere"), knowledge=Knowledge())


def test_a_bench_without_the_move_says_what_it_needs():
    bench = BENCH.model_copy(update={"point_to_point": None})
    with pytest.raises(NotPossibleError, match="no point_to_point table: distance_rev"):
        point_to_point(bench, 2, PERIOD)
    with pytest.raises(NotPossibleError, match="no axis 9"):
        point_to_point(BENCH, 9, PERIOD)


def test_a_move_to_nowhere_is_none():
    with pytest.raises(ValueError, match="is too short"):
        PointToPointMotion(distance_rev=0.001, speed_rps=1.0, acceleration_rps_s=10.0)


def test_all_shapers_are_compared_at_a_stop_and_none_elsewhere_unless_named():
    stop = ComparisonRequest((STOP,), (2,)).wanted(BENCH)
    assert [each.treatment for each in stop] == ["none", *(f"shaper-{name}" for name in NAMES)]
    other = ComparisonRequest(("constant-acceleration",), (2,)).wanted(BENCH)
    assert not [each for each in other if "shaper" in each.treatment]
    named = ComparisonRequest(("line-motion",), (), ("none", "shaper-ei"), frozenset({"shaper-ei"})).wanted(BENCH)
    assert [each.treatment for each in named] == ["none", "shaper-ei"]
