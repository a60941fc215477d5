"""The simulated arm moves as a general solver says, and as a linear gear does in closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy

from hil.control.angles import ARCSEC
from hil.design.ate.gear import BaseMotion, GearLaw, follow_alike

SOFT = {"softness": 0.3, "wind_up_rad": 60.0 * ARCSEC}
LOSSY = {"hysteresis_rad": 15.0 * ARCSEC, "hysteresis_torsion_rad": 20.0 * ARCSEC}
LAWS = {
    "linear": GearLaw(12.0, 0.03),
    "soft": GearLaw(12.0, 0.03, **SOFT),
    "lossy": GearLaw(12.0, 0.03, **LOSSY),
    "all": GearLaw(12.0, 0.03, **SOFT, **LOSSY, gravity_rad_s2=(12.0, -5.0)),
}
SECONDS, RATIO, ORDERS = 2.0, 100.0, (1.0, 2.0, 4.0)
UNKNOWNS = np.array([10.0, 5.0, 40.0, -20.0, 6.0, 3.0]) * ARCSEC


def angle_of(time):
    """A motor that speeds up from rest to 6 rev/s, through all resonances."""
    return math.pi * 3.0 * time**2


def base_of(law, time):
    theta, speed = angle_of(time), 6.0 * math.pi * time
    base, rate = theta / RATIO, speed / RATIO
    for k, c, s in zip(ORDERS, UNKNOWNS[::2], UNKNOWNS[1::2], strict=True):
        base = base + c * np.cos(k * theta) - s * np.sin(k * theta)
        rate = rate - k * speed * (c * np.sin(k * theta) + s * np.cos(k * theta))
    return base, rate


def solved(law, times, ahead_rad=0j):
    """The arm's acceleration by a general solver, z as a state of its own."""
    stiffness = (2.0 * math.pi * law.resonance_hz) ** 2
    gear = 2.0 * law.gear_fraction * law.damping * math.sqrt(stiffness)
    arm = 2.0 * (1.0 - law.gear_fraction) * law.damping * math.sqrt(stiffness)
    g_c, g_s = law.gravity_rad_s2

    def parts(time, state):
        x, v, z = state
        base, rate = base_of(law, time)
        psi = base - x
        soft = 1.0 - law.softness * np.exp(-((psi / law.wind_up_rad) ** 2))
        a = stiffness * psi * soft + z + gear * (rate - v) - arm * v - g_c * np.cos(x) - g_s * np.sin(x)
        turning = rate - v
        dz = turning / law.hysteresis_torsion_rad * (stiffness * law.hysteresis_rad - np.sign(turning) * z)
        return v, a, dz

    base, rate = base_of(law, 0.0)
    x = base
    for _ in range(100):
        psi = base - x
        pull = stiffness * psi * (1.0 - law.softness * math.exp(-((psi / law.wind_up_rad) ** 2)))
        x += (pull - g_c * math.cos(x) - g_s * math.sin(x)) / stiffness
    start = x + ahead_rad.real, rate - math.sqrt(stiffness) * ahead_rad.imag, 0.0
    found = scipy.integrate.solve_ivp(parts, (0.0, SECONDS), start, t_eval=times, rtol=1e-8, atol=1e-11, max_step=1e-3)
    return np.array([parts(t, state)[1] for t, state in zip(times, found.y.T, strict=True)])


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("ahead_rad", [0j, (30.0 - 50.0j) * ARCSEC], ids=["from rest", "ringing"])
def test_a_general_solver_gives_the_same_acceleration(name, ahead_rad):
    law, period_s = LAWS[name], 0.002
    times = period_s * np.arange(round(SECONDS / period_s) + 1)
    motion = BaseMotion.of(angle_of(times), period_s, RATIO, ORDERS, 60.0)
    halves = np.arange(motion.rigid.shape[1]) * 0.5 * motion.step_s
    base, rate = base_of(law, halves)
    got = law.follow(base, rate, motion.step_s, ahead_rad=ahead_rad)[:: motion.per_sample]
    expected = solved(law, times, ahead_rad)
    # friction turns round within a step: the closed form begins there from the step's end
    allowed = 2e-3 if law.hysteresis_rad else 1e-4
    assert np.abs(got - expected).max() < allowed * np.abs(expected).max()


@pytest.mark.parametrize("has_one_motion", [True, False])
def test_arms_side_by_side_move_as_each_does_alone(has_one_motion):
    """More than go together at once, an odd number of all kinds of gears: to the last bit."""
    laws = [*(replace(LAWS[each], damping=0.03 + 0.002 * i) for i in range(3) for each in LAWS), LAWS["all"]]
    halves = np.arange(0.0, 1.0, 1e-3)[:-1]
    motions = np.array([base_of(law, halves) for law in laws[: 1 if has_one_motion else None]])
    motions *= np.linspace(1.0, 1.2, len(motions))[:, np.newaxis, np.newaxis]
    together = follow_alike(np.concatenate([law.record(0.3, 1e-4j) for law in laws]), motions, 2e-3)
    for i, (law, found) in enumerate(zip(laws, together, strict=True)):
        base, rate = motions[0 if has_one_motion else i]
        assert found.tobytes() == law.follow(base, rate, 2e-3, 0.3, 1e-4j).tobytes()


@pytest.mark.parametrize("wind_up_arcsec", [0.5, 5.0, 60.0, 600.0])
def test_a_gear_is_stiff_where_no_bit_shows_its_softness(wind_up_arcsec):
    """A run along which the exponential may be left out is, to the last bit, the one with it in Python."""
    law = GearLaw(12.0, 0.03, softness=0.3, wind_up_rad=wind_up_arcsec * ARCSEC)
    base, rate = base_of(law, 1e-3 * np.arange(2001))
    stiffness, gear, arm = (float(law.record()[name][0]) for name in ("stiffness", "gear_damping", "arm_damping"))
    step, per_wind_up, expected = 2e-3, 1.0 / law.wind_up_rad, []

    def pushed(x, v, i):
        ratio = (base[i] - x) * per_wind_up
        spring = stiffness * (1.0 - law.softness * math.exp(-ratio * ratio)) * (base[i] - x)
        return spring + gear * (rate[i] - v) - arm * v

    x, v = base[0], rate[0]
    for i in range(0, 2000, 2):
        a1 = pushed(x, v, i)
        v2 = v + 0.5 * step * a1
        a2 = pushed(x + 0.5 * step * v, v2, i + 1)
        v3 = v + 0.5 * step * a2
        a3 = pushed(x + 0.5 * step * v2, v3, i + 1)
        v4 = v + step * a3
        a4 = pushed(x + step * v3, v4, i + 2)
        expected.append(a1)
        x += step / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        v += step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    assert law.follow(base, rate, step)[:-1].tolist() == expected


def test_the_spline_through_samples_moves_the_gear_as_the_motor_did():
    period_s = 0.004
    times = period_s * np.arange(round(SECONDS / period_s) + 1)
    motion = BaseMotion.of(angle_of(times), period_s, RATIO, ORDERS, 30.0)
    base, rate = motion.with_error(UNKNOWNS)
    halves = np.arange(len(base)) * 0.5 * motion.step_s
    expected, expected_rate = base_of(LAWS["linear"], halves)
    # a recording begins and ends at rest; the motor of the test speeds up from its first sample to its last
    inner = slice(40 * motion.per_sample, -40 * motion.per_sample)
    assert np.abs(base - expected)[inner].max() < 1e-3 * ARCSEC
    assert np.abs(rate - expected_rate)[inner].max() < 1e-4 * np.abs(expected_rate).max()


def test_a_motion_without_half_steps_is_refused():
    with pytest.raises(ValueError, match=r"\(4,\).*2 n \+ 1"):
        LAWS["linear"].follow(np.zeros(4), np.zeros(4), 1e-3)
