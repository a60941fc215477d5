"""The bench of the reference arm says where its joints are, and nothing of what only measuring tells."""

import numpy as np
import pytest

from hil.bench.bench import SHIPPED, load_bench
from hil.experiments.motions import line_motion
from plant_emulator.robots.robot import SHIPPED as ROBOTS
from plant_emulator.robots.robot import load_robot

BENCH, ROBOT = load_bench("reference-arm"), load_robot("reference-arm")


def test_bench_and_robot_agree_on_the_joints_and_the_tip():
    arm, truth = BENCH.arm, ROBOT.arm
    bare = [link.model_copy(update={"body": None}) for link in truth.link]
    assert list(arm.link) == bare
    assert (arm.home_deg, arm.tip_m, arm.tip_rpy_deg) == (truth.home_deg, truth.tip_m, truth.tip_rpy_deg)
    for number, axis in BENCH.axis.items():
        assert axis.reduction_ratio == ROBOT.axis[number].reduction_ratio
        assert axis.limits.torque_nm == ROBOT.axis[number].torque_limit_nm
        assert axis.tip_lever_m == pytest.approx(ROBOT.axis[number].tip_lever_m, abs=1e-12)


def test_it_knows_no_masses_no_plants_and_no_errors():
    assert BENCH.arm.payload is None
    assert all(axis.model is None for axis in BENCH.axis.values())


@pytest.mark.ci
def test_its_line_is_that_of_the_reference_bench():
    reference = load_bench("reference")
    ours, theirs = line_motion(BENCH, 0.002), line_motion(reference, 0.002)
    assert ours.axes == theirs.axes == (2, 3, 5)
    np.testing.assert_allclose(ours.motor_angle_rad, theirs.motor_angle_rad, atol=1e-4)


def test_bench_and_robot_come_along_by_the_same_names():
    assert set(SHIPPED) == set(ROBOTS)
