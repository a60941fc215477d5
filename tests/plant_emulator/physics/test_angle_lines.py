"""Orders of the joint and of the motor's cogging: against scipy, and by what tells one from the other."""

import math

import numpy as np
import pytest
from scipy import integrate

from drive_profiles.errors import FileError
from hil.control.angles import ARCSEC
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import TORQUE
from plant_emulator.physics.axis import synchronous_error
from plant_emulator.physics.integration import plant_step
from plant_emulator.robots.angle_lines import CoggingLine, EccentricityLine
from plant_emulator.robots.robot import load_robot
from tests.plant_emulator.many_axes import robot_file
from tests.plant_emulator.physics.flexible_rig import FlexibleArm, Oracle, six_axes

ECCENTRIC = (EccentricityLine(order=1, a_arcsec=60.0, phi_deg=30.0), EccentricityLine(order=2, a_arcsec=20.0, phi_deg=-50.0))
COGGING = (CoggingLine(order=8, torque_nm=0.08, phi_deg=20.0), CoggingLine(order=36, torque_nm=0.03))


def robot(**keys):
    """Axis 2 of the reference robot without friction and gravity, with some keys changed."""
    whole = load_robot("reference")
    free = {"coulomb_friction_nm": 0.0, "static_friction_nm": 0.0, "gravity_moment_nm": 0.0, "gear_reaction": True}
    return whole.model_copy(update={"axis": {2: whole.axis[2].model_copy(update={**free, **keys})}, "geometry": None})


def solved(p, torque_nm, duration_s):
    """End of a run of one axis as scipy finds it: θ_m, θ̇_m, θ_l, θ̇_l."""
    n = p["reduction_ratio"]

    def rates(_, x):
        value, slope, torque = 0.0, 0.0, torque_nm
        for k in (1, 2, 4):
            value += p[f"a{k}_rad"] * math.cos(k * x[0] + p[f"phi{k}_rad"])
            slope -= k * p[f"a{k}_rad"] * math.sin(k * x[0] + p[f"phi{k}_rad"])
        for line in ECCENTRIC:
            q = line.order * x[0] / n + math.radians(line.phi_deg)
            value += line.a_arcsec * ARCSEC * math.cos(q)
            slope -= line.a_arcsec * ARCSEC * line.order / n * math.sin(q)
        for line in COGGING:
            torque += line.torque_nm * math.cos(line.order * x[0] + math.radians(line.phi_deg))
        gear = p["gear_stiffness_nm_rad"] * (x[0] / n + value - x[2]) + p["gear_damping_nm_s_rad"] * (
            x[1] * (1.0 / n + slope) - x[3]
        )
        motor = (torque - p["motor_damping_nm_s_rad"] * x[1] - gear * (1.0 / n + slope)) / p["motor_inertia_kg_m2"]
        return [x[1], motor, x[3], (gear - p["arm_damping_nm_s_rad"] * x[3]) / p["arm_inertia_kg_m2"]]

    start = [0.0, 0.0, synchronous_error(p, 0.0)[0], 0.0]
    return integrate.solve_ivp(rates, (0.0, duration_s), start, "DOP853", rtol=1e-12, atol=1e-15).y[:, -1]


@pytest.mark.ci
def test_an_axis_off_centre_that_cogs_moves_as_scipy_says():
    axes = Axes(robot(eccentricity=ECCENTRIC, cogging=COGGING))
    axes.open_brake(0, TORQUE)
    axes.motion[0]["target_torque_nm"] = 0.4
    axes.advance(2000)
    state, want = axes.plant_state[0], solved(axes.plant[0], 0.4, 0.5)
    got = [float(state[name]) for name in ("motor_angle_rad", "motor_speed_rad_s", "arm_angle_rad", "arm_speed_rad_s")]
    assert got[0] > 2.0
    np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-9)


def test_an_arm_off_centre_that_cogs_moves_as_scipy_and_pinocchio_say():
    keys = {"static_friction_nm": 0.0, "coulomb_friction_nm": 0.0, "eccentricity": ECCENTRIC, "cogging": COGGING}
    arm = FlexibleArm(six_axes(**keys))
    start, torques = arm.state, [0.05, 0.1, 0.1, 0.02, 0.02, 0.02]
    want = Oracle(six_axes(**keys)).run(start, torques, 0.1)
    np.testing.assert_allclose(arm.run(torques, 400)[:, :4], want[:, :4], rtol=2e-5, atol=1e-8)


def test_the_eccentricity_comes_once_a_revolution_of_the_joint():
    axes = Axes(robot(eccentricity=ECCENTRIC[:1]))
    p, turn = axes.plant[0], 2.0 * math.pi * 120.0  # whole turns of motor and joint
    quarter = [synchronous_error(p, turn * k / 4.0)[0] - synchronous_error(p, 0.0)[0] for k in (1, 2, 4)]
    want = [60.0 * ARCSEC * (math.cos(math.radians(30.0 + 90.0 * k)) - math.cos(math.radians(30.0))) for k in (1, 2, 4)]
    np.testing.assert_allclose(quarter, want, atol=1e-4 * ARCSEC)


@pytest.mark.slow
def test_cogging_is_a_torque_and_no_error_of_the_gear():
    """A motor at rest on its own magnets: K_c = j T_j against its inertia, and θ_sync as without."""
    keys = {"cogging": (CoggingLine(order=8, torque_nm=0.1, phi_deg=90.0),), "arm_damping_nm_s_rad": 0.0}
    axes, plain = Axes(robot(**keys, motor_damping_nm_s_rad=0.0, gear_damping_nm_s_rad=0.0)), Axes(robot())
    assert [synchronous_error(axes.plant[0], x) for x in (0.0, 1.0)] == [synchronous_error(plain.plant[0], x) for x in (0.0, 1.0)]
    p, s = axes.plant[0], axes.plant_state[0]
    p["gear_stiffness_nm_rad"] = 1e-3  # the gear lets it go
    s["motor_angle_rad"] = 0.01
    seen = []
    for _ in range(4000):
        plant_step(p, s, 0.0, False, 250e-6, 4)
        seen.append(float(s["motor_angle_rad"]))
    rising = np.flatnonzero((np.array(seen[:-1]) < 0.0) & (np.array(seen[1:]) >= 0.0))
    period_s = (rising[-1] - rising[0]) / (len(rising) - 1) * 250e-6
    assert 1.0 / period_s == pytest.approx(math.sqrt(8 * 0.1 / 2.6e-4) / (2.0 * math.pi), rel=2e-3)


def test_lines_of_nothing_leave_every_bit():
    nothing = {
        "eccentricity": (EccentricityLine(order=1, a_arcsec=0.0),),
        "cogging": (CoggingLine(order=8, torque_nm=0.0),),
    }
    ends = []
    for keys in ({}, nothing):
        axes = Axes(robot(**keys))
        axes.open_brake(0, TORQUE)
        axes.motion[0]["target_torque_nm"] = 0.4
        axes.advance(1000)
        ends.append(axes.plant_state.tobytes())
    assert ends[0] == ends[1]


REFUSED = {
    "[[axis.2.cogging]]\norder = 8\ntorque_nm = 3.8": "cogging: 3.8 N·m in total exceed the motor's torque limit of 3.8 N·m",
    "[[axis.2.cogging]]\norder = 8\ntorque_nm = 0.1\n[[axis.2.cogging]]\norder = 8\ntorque_nm = 0.1": "cogging: order 8 is given",
    "[[axis.2.eccentricity]]\norder = 1\na_arcsec = 1.0\n[[axis.2.eccentricity]]\norder = 1\na_arcsec = 2.0": "order 1 is given",
    "[[axis.2.eccentricity]]\norder = 0\na_arcsec = 1.0": "order",
}


@pytest.mark.parametrize("lines", REFUSED)
def test_orders_twice_and_a_motor_that_cannot_turn_are_refused(tmp_path, lines):
    (tmp_path / "robot.toml").write_text(robot_file([2], more=lines + "\n"))
    with pytest.raises(FileError) as refused:
        load_robot(tmp_path / "robot.toml")
    assert REFUSED[lines] in str(refused.value)
