"""The simulation of a ramp: against the closed form at constant speed, and against scipy's integration of the plant."""

import dataclasses
import math

import numpy as np
import pytest
from scipy import integrate

from hil.bench.bench import load_bench
from hil.control.angles import ARCSEC
from hil.control.trajectory import ConstantAcceleration, sample_times
from hil.core.library import CORE
from hil.design.ramp import _harmonics, follow, follow_alike
from hil.design.transmission_error import TransmissionError

BENCH = load_bench("reference")
T = 250e-6


def loop(axis, *, notch=True, period_s=T, delay=0):
    return BENCH.axis[axis].loop(period_s, delay, with_notch=notch)


def error(axis):
    ate = BENCH.axis[axis].model.ate
    return TransmissionError({2: ate.a2_arcsec, 4: ate.a4_arcsec}, {2: ate.phi2_deg, 4: ate.phi4_deg})


def constant_speed(speed_rps, period_s, seconds=7.0):
    t = np.arange(round(seconds / period_s)) * period_s
    ramp = 1.0
    turns = np.where(t < ramp, 0.5 * t * t / ramp, t - 0.5 * ramp)
    return 2.0 * math.pi * speed_rps * turns


@pytest.mark.slow
@pytest.mark.parametrize("axis", [2, 3])
@pytest.mark.parametrize("notch", [False, True])
@pytest.mark.parametrize(("period_s", "delay"), [(T, 0), (T, 3), (1e-3, 0)])
def test_at_constant_speed_the_arm_vibrates_as_g_al_says(axis, notch, period_s, delay):
    closed, speed = loop(axis, notch=notch, period_s=period_s, delay=delay), 5.92
    motion = follow(closed, TransmissionError({2: 5.0}, {2: 30.0}), constant_speed(speed, period_s))
    t = np.arange(len(motion.arm_acceleration_rad_s2)) * motion.period_s
    late = t > 4.0
    wave = np.stack([np.cos(4.0 * math.pi * speed * t[late]), np.sin(4.0 * math.pi * speed * t[late])], axis=1)
    fitted, *_ = np.linalg.lstsq(wave, motion.arm_acceleration_rad_s2[late], rcond=None)
    expected = abs(closed.acceleration_per_transmission_error(np.array([2.0 * speed]), speed)[0]) * 5.0 * ARCSEC
    assert np.hypot(*fitted) == pytest.approx(expected, rel=0.04 if notch else 0.01)


def test_the_plant_is_that_of_the_equations_of_motion():
    """No feedback at all: an initial torsion rings down as scipy integrates it, θ_sync and its slope included."""
    closed = loop(2, notch=False)
    free = dataclasses.replace(closed, cascade=dataclasses.replace(
        closed.cascade, position_gain_per_s=0.0, velocity_gain_nm_s_rad=1e-3, velocity_integral_gain_nm_rad=0.0))  # fmt: skip
    ate, p = error(2), closed.plant
    reference = np.zeros(4000)
    gain, turn = 1e-3, 2.0 * math.pi
    # a constant speed offset is not in `follow`; a reference gain with a ramp makes torque that only depends on θ_m and v̂
    held = dataclasses.replace(free, cascade=dataclasses.replace(free.cascade, position_gain_per_s=4.0, lowpass_hz=1e6))
    reference = turn * 3.0 * np.minimum(np.arange(4000) * T, 0.6)

    def slopes(t, x):
        th, w, tl, wl = x
        ref = turn * 3.0 * min(t, 0.6)
        torque = gain * (4.0 * (ref - th) - w)
        sync = sum(ate.amplitude_arcsec[k] * ARCSEC * math.cos(k * th + math.radians(ate.phase_deg[k])) for k in (2, 4))
        rate = -w * sum(k * ate.amplitude_arcsec[k] * ARCSEC * math.sin(k * th + math.radians(ate.phase_deg[k])) for k in (2, 4))
        n = p.reduction_ratio
        gear = p.gear_stiffness_nm_rad * (th / n + sync - tl) + p.gear_damping_nm_s_rad * (w / n + rate - wl)
        motor = (torque - p.motor_damping_nm_s_rad * w - gear / n) / p.motor_inertia_kg_m2
        return [w, motor, wl, (gear - p.arm_damping_nm_s_rad * wl) / p.arm_inertia_kg_m2]

    start = float(ate.angle_rad(np.zeros(1))[0])
    found = integrate.solve_ivp(
        slopes, (0.0, 1.0), [0.0, 0.0, start, 0.0], max_step=1e-3, rtol=1e-8, atol=1e-12, dense_output=True
    )
    motion = follow(held, ate, reference)
    t = np.arange(len(motion.motor_speed_rps)) * motion.period_s
    speed = found.sol(t)[1] / turn
    assert np.max(np.abs(motion.motor_speed_rps - speed)) < 0.01 * np.max(np.abs(speed))
    arm = np.array([slopes(each, found.sol(each))[3] for each in t])
    assert np.max(np.abs(motion.arm_acceleration_rad_s2 - arm)) < 0.02 * np.max(np.abs(arm))


def test_without_a_transmission_error_a_slow_motion_leaves_the_arm_quiet():
    ramp = ConstantAcceleration(4.0, 8.0, 4.0, 0.1, 0.0)
    motion = follow(loop(2), TransmissionError({2: 0.0}, {2: 0.0}), ramp.motor_angle(sample_times(ramp.duration_s, T)))
    speed = motion.motor_speed_rps
    assert np.max(speed) == pytest.approx(8.0, rel=0.05)
    steady = (speed > 2.0) & (speed < 7.0) & (np.arange(len(speed)) < np.argmax(speed))
    expected = 2.0 * math.pi * 4.0 / BENCH.axis[2].reduction_ratio
    np.testing.assert_allclose(motion.arm_acceleration_rad_s2[steady], expected, rtol=0.1)


def test_two_runs_are_the_same_to_the_last_bit():
    reference = constant_speed(6.0, T, 2.0)
    one, two = (follow(loop(3), error(3), reference) for _ in range(2))
    assert np.array_equal(one.arm_acceleration_rad_s2, two.arm_acceleration_rad_s2)


@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.filterwarnings("ignore:overflow encountered", "ignore:invalid value")
def test_axes_side_by_side_move_as_each_does_alone(delay):
    """Other filters, plants and errors, more than go together at once, and one that diverges: to the last bit."""
    reference, loops, errors = constant_speed(6.0, T, 2.0), [], []
    for i in range(11):
        one = loop(2 + i % 2, notch=i % 3 > 0, delay=delay)
        gain = 5e3 if i == 7 else one.cascade.velocity_gain_nm_s_rad * (1.0 - 0.02 * i)
        loops.append(dataclasses.replace(one, cascade=dataclasses.replace(one.cascade, velocity_gain_nm_s_rad=gain)))
        errors.append(error(2 + i // 4 % 2))
    together = follow_alike(loops, errors, reference, load_nm=(0.1, 0.2))
    for one, its_error, *found in zip(loops, errors, together.motor_speed_rps, together.arm_acceleration_rad_s2, strict=True):
        alone = follow(one, its_error, reference, load_nm=(0.1, 0.2))
        expected = alone.motor_speed_rps, alone.arm_acceleration_rad_s2
        assert [each.tobytes() for each in found] == [each.tobytes() for each in expected]
    assert np.all(np.isfinite(together.motor_speed_rps), axis=1).tolist() == [i != 7 for i in range(11)]


@pytest.mark.parametrize("orders", [(1, 2, 4), (2,), (0.5, 2, 3.25), (1, 2, 4.0 / 3.0), (math.sqrt(2.0), 2), (1, 97), ()])
def test_the_error_of_any_orders_is_the_sum_of_its_sines(orders):
    """Fractions, what is none, and what is far apart."""
    rng = np.random.default_rng(4)
    some = TransmissionError({k: rng.uniform(1.0, 60.0) for k in orders}, {k: rng.uniform(-180.0, 180.0) for k in orders})
    rows, near, found = _harmonics(some), np.zeros(1, CORE.dtype("waves")), np.empty(2)
    given = CORE.pointer(rows, "harmonic"), len(rows)
    CORE.call.begin_waves(*given, CORE.pointer(near, "waves"))
    for angle in rng.uniform(-400.0, 400.0, 50):
        phase = [k * angle + math.radians(some.phase_deg[k]) for k in orders]
        size = [some.amplitude_arcsec[k] * ARCSEC for k in orders]
        expected = sum(a * math.cos(p) for a, p in zip(size, phase, strict=True))
        slope = -sum(k * a * math.sin(p) for k, a, p in zip(orders, size, phase, strict=True))
        CORE.call.wave_sums(*given, float(angle), CORE.pointer(near, "waves"), CORE.pointer(found))
        assert tuple(found) == pytest.approx((expected, slope), abs=1e-11)
