"""A gear whose error changes, against scipy's integrator with the same equations, which holds nothing over a period."""

import math

import numpy as np
import pytest
from scipy import integrate

from hil.control.angles import ARCSEC
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import BRAKED, TORQUE
from plant_emulator.physics.axis import SMOOTHING_S, TURNING_RAD_S
from plant_emulator.robots.gear_change import ErrorChange, GearTemperature
from plant_emulator.robots.robot import load_robot
from tests.plant_emulator.physics.flexible_rig import FlexibleArm, Oracle, six_axes

T = 250e-6
STATES = ("motor_angle_rad", "motor_speed_rad_s", "arm_angle_rad", "arm_speed_rad_s")
PAST = ("load_nm", "direction", "temperature_c")
NEW = {"wind_up_softness": 0.2, "hysteresis_torque_nm": 0.0, "gear_reaction": True, "coulomb_friction_nm": 0.05}


def robot(*changes, number=2, temperature=None, **keys):
    """One axis of the reference robot, its error ten times as large, on a line of its own."""
    whole = load_robot("reference")
    axis = whole.axis[number]
    ate = axis.ate.model_copy(update={"a2_arcsec": 100.0, "a4_arcsec": 50.0})
    update = {"ate": ate, "ate_change": changes, "torque_limit_nm": 100.0, "static_friction_nm": 0.05, **NEW, **keys}
    if temperature is not None:
        update["temperature"] = temperature
    one = {number: axis.model_copy(update=update)}
    return whole.model_copy(update={"axis": one, "geometry": None, "line_motion": None})


class Turning:
    """An axis under a constant torque."""

    def __init__(self, of, torque_nm=0.7, braked=False):
        self.axes = Axes(of)
        self.axes.open_brake(0, BRAKED if braked else TORQUE)
        self.axes.motion[0]["target_torque_nm"] = torque_nm

    def run(self, duration_s):
        self.axes.advance(round(duration_s / T))
        return self

    def state(self):
        return np.array([float(self.axes.plant_state[0][name]) for name in STATES])

    def past(self, name):
        return float(self.axes.rows["past"][0][name])


class Continuous:
    """The same axis for scipy: states, smoothed load and direction, temperature, all in one set of equations."""

    def __init__(self, of, torque_nm=0.7):
        self.axes, self.torque_nm = Axes(of), torque_nm
        self.p, self.c = self.axes.plant[0], self.axes.rows["change"][0]
        self.start = np.array(
            [float(self.axes.plant_state[0][n]) for n in STATES] + [float(self.axes.rows["past"][0][n]) for n in PAST] + [0.0]
        )

    def error(self, t, x):
        """θ_sync and its slope."""
        c, value, slope = self.c, 0.0, 0.0
        load, way, warm, turned = x[4], x[5], x[6] - c["reference_c"], x[7]
        for i, k in enumerate((1, 2, 4)):
            size = 1.0 + c["growth_per_s"][i] * t + c["growth_per_rad"][i] * turned + c["load_per_nm"][i] * load
            size += c["direction_part"][i] * way + c["warmth_per_k"][i] * warm
            phase = c["phi_rad"][i] + c["drift_rad_s"][i] * t + c["load_rad_nm"][i] * load + c["direction_rad"][i] * way
            phase += c["warmth_rad_k"][i] * warm + (c["step_rad"][i] if t >= c["step_s"][i] else 0.0)
            value += c["a_rad"][i] * size * math.cos(k * x[0] + phase)
            slope -= k * c["a_rad"][i] * size * math.sin(k * x[0] + phase)
        return value, slope

    def rates(self, t, x):
        p, c = self.p, self.c
        value, slope = self.error(t, x)
        torsion = x[0] / p["reduction_ratio"] + value - x[2]
        rate = x[1] * (1.0 / p["reduction_ratio"] + slope) - x[3]
        soft = 1.0 - p["wind_up_softness"] * math.exp(-((torsion / p["wind_up_torsion_rad"]) ** 2))
        spring = p["gear_stiffness_nm_rad"] * soft * torsion
        gear = spring + p["gear_damping_nm_s_rad"] * rate
        lost = p["motor_damping_nm_s_rad"] * x[1] + p["coulomb_friction_nm"] * math.tanh(x[1] / 0.05)
        gravity = p["gravity_moment_nm"] * math.cos(x[2] + p["home_angle_rad"])
        motor = (self.torque_nm - lost - gear * (1.0 / p["reduction_ratio"] + slope)) / p["motor_inertia_kg_m2"]
        arm = (gear - p["arm_damping_nm_s_rad"] * x[3] - gravity) / p["arm_inertia_kg_m2"]
        way = x[1] / math.hypot(x[1], TURNING_RAD_S)
        warm = c["ambient_c"] + c["resistance_k_w"] * lost * x[1]
        return [
            x[1], motor, x[3], arm,
            (spring - x[4]) / SMOOTHING_S, (way - x[5]) / SMOOTHING_S, (warm - x[6]) / c["thermal_constant_s"], abs(x[1]),
        ]  # fmt: skip

    def run(self, duration_s, until=()):
        state, begin = self.start, 0.0
        for end in (*until, duration_s):  # a jump is the end of one integration
            state = integrate.solve_ivp(self.rates, (begin, end - 1e-12), state, "DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
            begin = end
        return state


CASES = {
    "step": ({"phase_step_deg": 90.0, "phase_step_s": 0.5}, (0.5,)),
    "drift": ({"phase_drift_deg_min": 6000.0}, ()),
    "growth": ({"growth_percent_h": 360000.0}, ()),
    "wear": ({"growth_percent_mrev": 2e7}, ()),
    "load": ({"load_percent_nm": 0.005, "load_deg_nm": 1.0}, ()),
    "direction": ({"direction_percent": 30.0, "direction_deg": 40.0}, ()),
    "temperature": ({"temperature_percent_k": 3.0, "temperature_deg_k": 5.0}, ()),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_changing_error_moves_the_arm_as_scipy_says(case):
    """Held values are half a control period late: what that leaves is far below what the change does."""
    keys, jumps = CASES[case]
    heat = GearTemperature(resistance_k_w=20.0, time_constant_s=0.5)
    of = robot(ErrorChange(**keys), temperature=heat)
    axis = Turning(of).run(1.0)
    want = Continuous(of).run(1.0, jumps)
    same = Turning(robot()).run(1.0)
    effect, wrong = np.abs(axis.state() - same.state()), np.abs(axis.state() - want[:4])
    assert axis.state()[0] > 20.0  # it has turned
    assert effect[2] > 1.0 * ARCSEC
    assert np.all(wrong < 4e-3 * effect + 1e-9)
    assert axis.past("load_nm") == pytest.approx(want[4], abs=1.0)  # of some 100 N·m that swing
    got = [axis.past("direction"), axis.past("temperature_c"), axis.past("turned_rad")]
    np.testing.assert_allclose(got, want[5:], rtol=2e-3)
    assert axis.past("operating_s") == pytest.approx(1.0)


def test_changes_of_nothing_leave_every_bit():
    still, changing = Turning(robot()).run(0.5), Turning(robot(ErrorChange())).run(0.5)
    assert changing.axes.rows["change"][0]["is_changing"] == 1.0
    assert still.axes.rows["change"][0]["is_changing"] == 0.0
    assert still.axes.plant_state.tobytes() == changing.axes.plant_state.tobytes()


def test_a_motion_in_pieces_gives_the_bits_of_one_in_one():
    of = robot(ErrorChange(phase_drift_deg_min=600.0, load_deg_nm=0.3, growth_percent_mrev=1e6))
    whole, pieces = Turning(of).run(0.2), Turning(of)
    for _ in range(100):
        pieces.run(0.002)
    assert whole.state().tobytes() == pieces.state().tobytes()


def test_nothing_wears_and_no_time_counts_behind_a_closed_brake():
    axis = Turning(robot(ErrorChange(phase_step_deg=30.0, phase_step_s=0.01, growth_percent_h=100.0)), braked=True).run(0.2)
    assert axis.past("operating_s") == axis.past("turned_rad") == 0.0
    assert axis.axes.plant[0]["phi2_rad"] == pytest.approx(math.radians(222.0))


def test_a_line_of_an_order_is_that_order_s_and_the_line_without_is_all_others():
    of = robot(ErrorChange(order=2, phase_step_deg=30.0, phase_step_s=0.1), ErrorChange(phase_step_deg=-10.0, phase_step_s=0.2))
    axis = Turning(of)
    seen = [np.degrees([axis.run(0.1).axes.plant[0][f"phi{k}_rad"] for k in (2, 4)][-2:]) for _ in range(3)]
    before = [222.0, 126.0]
    np.testing.assert_allclose(np.degrees([Axes(of).plant[0][f"phi{k}_rad"] for k in (2, 4)]), before)
    np.testing.assert_allclose(seen[-1] - before, [30.0, -10.0])


def test_a_warm_start_has_the_error_of_its_temperature_before_anything_moves():
    line = ErrorChange(order=2, temperature_percent_k=2.0, temperature_deg_k=1.0)
    axes = Axes(robot(line, temperature=GearTemperature(start_c=30.0)))
    assert axes.plant[0]["a2_rad"] == pytest.approx(120.0 * ARCSEC)
    assert math.degrees(axes.plant[0]["phi2_rad"]) == pytest.approx(232.0)
    torsion = axes.plant[0]["a2_rad"] * math.cos(axes.plant[0]["phi2_rad"])
    assert axes.plant_state[0]["arm_angle_rad"] < torsion  # it hangs below its own, warm, error


class ChangingOracle(Oracle):
    """The equations of an arm whose phases drift, all at one rate."""

    def __init__(self, of, drift_rad_s):
        super().__init__(of)
        self.drift_rad_s, self.first = drift_rad_s, {k: self.p[f"phi{k}_rad"].copy() for k in (1, 2, 4)}

    def moving(self, torques, t, x):
        for k, phase in self.first.items():
            self.p[f"phi{k}_rad"] = phase + self.drift_rad_s * t
        return self.rates(torques, x)

    def run_for(self, state, torques, duration_s):
        torques = np.asarray(torques)
        solved = integrate.solve_ivp(
            lambda t, x: self.moving(torques, t, x), (0.0, duration_s), state.ravel(), "DOP853", rtol=1e-11, atol=1e-14
        )
        return solved.y[:, -1].reshape(-1, 6)


def test_the_gears_of_an_arm_drift_as_scipy_and_pinocchio_say():
    keys = {"ate_change": (ErrorChange(phase_drift_deg_min=6000.0),), "static_friction_nm": 0.0, "coulomb_friction_nm": 0.0}
    of, still = six_axes(**keys), six_axes(**{**keys, "ate_change": ()})
    torques = [0.05, 0.1, 0.1, 0.02, 0.02, 0.02]
    arm, same = FlexibleArm(of), FlexibleArm(still)
    start = arm.state
    got, without = arm.run(torques, 800), same.run(torques, 800)
    want = ChangingOracle(still, math.radians(100.0)).run_for(start, torques, 0.2)
    effect = np.max(np.abs(got - without)[:, 2])
    assert effect > 1.0 * ARCSEC
    assert np.max(np.abs(got - want)[:, 2]) < 4e-3 * effect
