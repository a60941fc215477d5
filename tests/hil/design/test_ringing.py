"""The resonance that a ramp shows of its own: the arm's is found at its frequency, and nothing else is taken for it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import fft

from hil.bench.bench import load_bench
from hil.design.ringing import NoResonanceError, Ramp, ringing
from hil.robot_tables import ConstantAccelerationMotion
from plant_emulator.robots.robot import load_robot
from plant_emulator.studies.simulate import simulate

ORDERS = (1, 2, 4)
CONTROLS = {number: axis.control for number, axis in load_bench("reference").axis.items() if axis.control}
PERIOD_S = 0.002


def recorded(*, stiffness=1.0, error=None, acceleration_rps_s=4.0, end_rps=10.0, noise_m_s2=0.02, axis=2, **changes):
    """A ramp of the reference robot, some of whose values are others, and the f_al of its loop."""
    robot = load_robot("reference")
    table = robot.axis[axis]
    ate = table.ate if error is None else table.ate.model_copy(update=error)
    table = table.model_copy(
        update={"ate": ate, "gear_stiffness_nm_rad": stiffness * table.gear_stiffness_nm_rad,
                "gear_damping_nm_s_rad": math.sqrt(stiffness) * table.gear_damping_nm_s_rad, **changes}
    )  # fmt: skip
    motion = ConstantAccelerationMotion(acceleration_rps_s=acceleration_rps_s, end_rps=end_rps)
    robot = robot.model_copy(
        update={"axis": {axis: table}, "geometry": None, "line_motion": None, "constant_acceleration": motion}
    )
    run = simulate(robot, axis, controls=CONTROLS, notches={}, sync_period_s=PERIOD_S)
    turns = 2.0 * math.pi / table.encoder_counts_per_rev
    noise = noise_m_s2 * np.random.default_rng(20261122).standard_normal(len(run.time_s))
    tip = run.tip_acceleration_m_s2[:, 2] + noise
    ramp = Ramp(run.position_counts[:, 0] * turns, run.reference_counts[:, 0] * turns, tip, run.torque_nm[:, 0], PERIOD_S)
    bench_axis = load_bench("reference").axis[axis]
    model = bench_axis.model.model_copy(
        update={"gear_stiffness_nm_rad": table.gear_stiffness_nm_rad, "gear_damping_nm_s_rad": table.gear_damping_nm_s_rad}
    )
    loop = bench_axis.model_copy(update={"model": model}).loop(robot.control_period_s, with_notch=False)
    return ramp, loop.peak_hz()


def on_mounting(ramp, resonance_hz, damping=0.03):
    """The same ramp with a sensor that rings on its mounting."""
    length = 4 * len(ramp.tip_m_s2)
    x = fft.rfftfreq(length, ramp.period_s) / resonance_hz
    answer = (1.0 + 2j * damping * x) / (1.0 + 2j * damping * x - x**2)
    back = np.linspace(ramp.tip_m_s2[-1], ramp.tip_m_s2[0], length - len(ramp.tip_m_s2))
    rung = fft.irfft(fft.rfft(np.concatenate([ramp.tip_m_s2, back])) * answer, length)
    return replace(ramp, tip_m_s2=rung[: len(ramp.tip_m_s2)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "acceleration_rps_s", "axis", "a2_arcsec", "order"),
    [(0.15, 2.0, 2, 20.0, 2), (0.4, 2.0, 2, 5.0, 2), (1.0, 4.0, 2, 5.0, 2), (1.0, 4.0, 3, 10.0, 2), (2.0, 4.0, 2, 5.0, 4)],
)
def test_a_ramp_shows_its_arms_own_frequency_within_its_error(stiffness, acceleration_rps_s, axis, a2_arcsec, order):
    ramp, f_al = recorded(stiffness=stiffness, acceleration_rps_s=acceleration_rps_s, axis=axis, error={"a2_arcsec": a2_arcsec})
    found = ringing(ramp, ORDERS)
    assert found.peak_hz == pytest.approx(f_al, rel=0.03)
    assert abs(found.peak_hz - f_al) < 3.0 * found.standard_error_hz
    assert found.orders[0] == order


def test_an_order_that_is_alone_is_named_alone():
    ramp, f_al = recorded(error={"a2_arcsec": 0.0, "a4_arcsec": 20.0})
    found = ringing(ramp, ORDERS)
    assert found.orders == (4,)
    assert found.peak_hz == pytest.approx(f_al, rel=0.03)


@pytest.mark.ci
def test_a_sensor_that_rings_on_its_mounting_is_not_the_arm():
    """Order 4 meets it at 7 rev/s, in the middle of the ramp; the arm itself hardly rings. The motor does not feel it."""
    ramp, _ = recorded(stiffness=0.15, error={"a2_arcsec": 1.0, "a4_arcsec": 20.0})
    with pytest.raises(NoResonanceError, match="mounting") as refused:
        ringing(on_mounting(ramp, 28.0), ORDERS)
    assert "f_al or the sensor" in str(refused.value), "by the torque alone nobody can blame the sensor"


@pytest.mark.slow
def test_a_tone_of_the_floor_is_not_the_arm():
    ramp, _ = recorded(error={"a2_arcsec": 0.0, "a4_arcsec": 0.0})
    time = PERIOD_S * np.arange(len(ramp.tip_m_s2))
    for frequency in (7.0, 12.0, 20.0):
        with pytest.raises(NoResonanceError):
            ringing(replace(ramp, tip_m_s2=ramp.tip_m_s2 + 0.5 * np.sin(2.0 * math.pi * frequency * time)), ORDERS)


@pytest.mark.parametrize("noise_m_s2", [0.02, 0.5])
def test_a_gear_without_error_shows_nothing(noise_m_s2):
    ramp, _ = recorded(error={"a2_arcsec": 0.0, "a4_arcsec": 0.0}, noise_m_s2=noise_m_s2)
    with pytest.raises(NoResonanceError):
        ringing(ramp, ORDERS)


def test_stick_and_slip_is_not_the_arm():
    ramp, _ = recorded(
        error={"a2_arcsec": 0.0, "a4_arcsec": 0.0},
        coulomb_friction_nm=0.5,
        static_friction_nm=1.2,
        acceleration_rps_s=2.0,
        end_rps=6.0,
    )
    with pytest.raises(NoResonanceError):
        ringing(ramp, ORDERS)


def test_a_swell_up_to_the_ramps_end_is_no_peak():
    """Order 2 would meet f_al at 5.9 rev/s; the ramp ends at 5.5, with no other order in the error."""
    ramp, f_al = recorded(error={"a4_arcsec": 0.0}, end_rps=5.5)
    assert f_al / 2.0 > 5.5
    with pytest.raises(NoResonanceError):
        ringing(ramp, ORDERS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda n: {"reference_rad": np.zeros(n), "motor_angle_rad": np.zeros(n)}, "does not move"),
        (lambda n: {"motor_angle_rad": np.zeros(n)}, "does not speed up"),
        (lambda n: {"reference_rad": np.where(np.arange(n) < n - 540, 0.0, 1.0)}, "too few"),
    ],
)
def test_a_ramp_that_is_none_is_named(change, words):
    ramp, _ = recorded()
    with pytest.raises(NoResonanceError, match=words):
        ringing(replace(ramp, **change(len(ramp.tip_m_s2))), ORDERS)
