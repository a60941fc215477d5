"""Robots that nobody tuned for: what an identification without any option finds of them, and what it says where it cannot."""

import math
from typing import Any

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.experiments.plant.checks import PlantNotIdentifiedError
from hil.experiments.plant.evaluation import PlantEvaluation
from hil.experiments.plant.identify import PlantIdentification
from hil.experiments.plant.motion import PlantRequest
from plant_emulator.robots.blank_bench import blank_bench
from plant_emulator.robots.fleet import draw
from plant_emulator.robots.robot import Robot
from tests.hil.experiments.plant.drawn import AXIS, axis_of, bench_of, robot_of, truth_of
from tests.hil.experiments.plant.plant_rig import FakeSession

ROOM = {"position_min_rev": -22.0, "position_max_rev": 22.0}
HONEST = 4.5
"""Standard errors within which every value of every robot here lies."""


def identification(robot: Robot, sync_s: float, **options: Any) -> PlantIdentification:
    session = FakeSession(bench_of(robot, sync_s, **ROOM), AXIS, robot=robot, **options)
    return PlantIdentification(session, PlantRequest(AXIS))  # type: ignore[arg-type]


def scores(evaluated: PlantEvaluation, robot: Robot, *names: str) -> dict[str, float]:
    truth, found = truth_of(robot.axis[AXIS]), evaluated.estimate.parameters
    return {name: (found[name].value - truth[name]) / found[name].standard_error for name in names}


LINEAR = (
    "motor_inertia_kg_m2", "arm_inertia_kg_m2", "gear_stiffness_nm_rad", "antiresonance_hz", "resonance_hz", "damping"
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [1e-4, 5e-4])
def test_the_lag_of_the_current_loop_does_not_become_motor_inertia(lag_s: float) -> None:
    robot = robot_of(axis_of(100.0, 12.0, 2.0, 2.6e-4, current_time_constant_s=lag_s))
    evaluated = identification(robot, 0.004).perform()
    parameters = evaluated.estimate.parameters
    assert parameters["motor_inertia_kg_m2"].value == pytest.approx(2.6e-4, rel=0.02)
    assert parameters["torque_lag_s"].value == pytest.approx(lag_s, abs=5e-5)
    assert max(map(abs, scores(evaluated, robot, *LINEAR).values())) < HONEST


@pytest.mark.slow
def test_a_sync_of_eight_milliseconds_and_thirteen_bits_will_do() -> None:
    robot = robot_of(axis_of(100.0, 10.0, 1.5, 1e-4, encoder_counts_per_rev=2**13), delay_s=0.006)
    evaluated = identification(robot, 0.008).perform()
    assert evaluated.estimate.response.frequency_hz[-1] <= 0.4 / 0.008
    assert max(map(abs, scores(evaluated, robot, *LINEAR).values())) < HONEST
    assert evaluated.estimate.parameters["torque_age_s"].value >= 0.0
    assert evaluated.estimate.plant.arm_damping_nm_s_rad >= 0.0


@pytest.mark.slow
def test_hysteresis_is_said_with_the_amplitudes_that_its_values_hold_for() -> None:
    robot = robot_of(axis_of(100.0, 12.0, 2.0, 2.6e-4, hysteresis_torque_nm=2.0))
    evaluated = identification(robot, 0.004).perform()
    remark = next(line for line in evaluated.remarks if "depends on the amplitude" in line)
    assert remark.count("at a torsion of") == 2
    assert any("hold for a torsion of" in line for line in evaluated.cannot_tell)
    assert evaluated.estimate.plant.motor_inertia_kg_m2 == pytest.approx(2.6e-4, rel=0.1)
    assert max(map(abs, scores(evaluated, robot, *LINEAR).values())) < HONEST


@pytest.mark.slow
def test_static_friction_that_falls_off_is_not_taken_for_coulomb_friction() -> None:
    robot = robot_of(axis_of(100.0, 12.0, 2.0, 2.6e-4, rise=0.6, stribeck_velocity_rad_s=2.0))
    friction = identification(robot, 0.004).perform().friction.coulomb_nm
    assert friction.value == pytest.approx(robot.axis[AXIS].coulomb_friction_nm, rel=0.04)
    assert abs(friction.value - robot.axis[AXIS].coulomb_friction_nm) < HONEST * friction.standard_error


# -- what must not be found at full travel -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        ({}, {"counts_backwards": True}, r"torque pushed against the motion.*encoder counts backwards"),
        ({}, {"is_braked": True}, r"the brake is open, the arm free"),
        ({"arm_inertia_kg_m2": 1e6}, {}, r"acted against a spring of .* N·m/rad.*the arm is held"),
    ],
)
def test_bad_hardware_is_named_after_a_third_of_a_turn(changes: dict[str, float], options: dict[str, Any], words: str) -> None:
    robot = robot_of(axis_of(100.0, 12.0, 2.0, 2.6e-4, **changes))
    identified = identification(robot, 0.004, **options)
    with pytest.raises(PlantNotIdentifiedError, match=words):
        identified.perform()
    motions = identified.session.motions  # type: ignore[attr-defined]
    assert len(motions) == 1
    assert np.ptp(motions[0].motor_angle_rad) < 0.5 * 2.0 * math.pi


def test_the_weight_of_an_arm_on_the_slope_of_its_transmission_error_is_no_brace() -> None:
    """A torque of 1.2 N·m at the motor, with an error of 118″ altogether, is a spring of 0.1 N·m/rad there."""
    error = {"a1_arcsec": 33.0, "a2_arcsec": 23.0, "a4_arcsec": 15.0}
    axis = axis_of(100.0, 12.0, 2.0, 2.6e-4, friction=0.3, ate=error, gear_reaction=True)
    heavy = axis.model_copy(update={"gravity_moment_nm": 0.2 * axis.torque_limit_nm * axis.reduction_ratio})
    identified = identification(robot_of(heavy), 0.004)
    identified._probe()
    assert "probe" in identified.recordings


def test_an_arm_that_never_resonates_is_said_before_the_long_runs() -> None:
    robot = robot_of(axis_of(100.0, 400.0, 2.0, 2.6e-4))
    identified = identification(robot, 0.004)
    with pytest.raises(
        PlantNotIdentifiedError, match=r"one inertia of .* there is no resonance of the arm in this band; a SYNC period of 4 ms"
    ):
        identified.perform()
    assert set(identified.recordings) == {"probe", "pilot"}


@pytest.mark.slow
def test_a_dead_accelerometer_is_said_and_left_out() -> None:
    robot = robot_of(axis_of(100.0, 12.0, 2.0, 2.6e-4), noise_m_s2=0.0)
    evaluated = identification(robot, 0.004, tip_gain=0.0).perform()
    assert evaluated.estimate.tip is None
    assert any("the accelerometer shows 0 m/s² only" in remark for remark in evaluated.remarks)


# -- the fleet --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 6, 8, 12, 14, 18, 20, 27])
def test_linear_robots_of_the_stable_are_identified_with_honest_errors(seed: int, tmp_path: Any) -> None:
    robot = draw(seed, kind="linear")
    file = tmp_path / "bench.toml"
    file.write_text(blank_bench(robot, "local:/tmp/none.sock"), encoding="utf-8")
    session = FakeSession(load_bench(file), AXIS, seed=seed, robot=robot, sensor_range=robot.accelerometer.range_m_s2)
    evaluated = PlantIdentification(session, PlantRequest(AXIS)).perform()  # type: ignore[arg-type]
    found = scores(evaluated, robot, *LINEAR)
    assert max(map(abs, found.values())) < HONEST, found
    assert evaluated.estimate.plant.antiresonance_hz == pytest.approx(truth_of(robot.axis[AXIS])["antiresonance_hz"], rel=2e-3)
