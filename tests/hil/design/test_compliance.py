"""Compliance of a closed loop: against the formula, and what gains and filters change in it."""

from dataclasses import replace

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.control.cascade import Cascade
from hil.design.compliance import compliance, judged_speeds, motor_compliance


@pytest.fixture(scope="module")
def loop():
    return load_bench("reference").axis[2].loop(250e-6, with_notch=False)


def halved(loop):
    own = loop.cascade
    gains = (own.position_gain_per_s, own.velocity_gain_nm_s_rad, own.velocity_integral_gain_nm_rad)
    return replace(loop, cascade=Cascade(*(0.5 * gain for gain in gains), own.lowpass_hz))


def test_it_is_the_plant_over_one_plus_the_open_loop(loop):
    frequency = np.array([0.3, 3.0, 12.0, 25.0])
    expected = loop.plant.motor_angle_per_torque(frequency) / (1.0 + loop.open_loop(frequency))
    np.testing.assert_allclose(motor_compliance(loop, frequency), expected, rtol=1e-12)


def test_without_gains_the_motor_gives_way_as_it_does_alone(loop):
    free = replace(loop, cascade=Cascade(0.0, 0.0, 0.0, 300.0))
    frequency = np.array([2.0, 12.0])
    np.testing.assert_allclose(motor_compliance(free, frequency), loop.plant.motor_angle_per_torque(frequency), rtol=1e-12)


def test_at_low_frequency_half_of_all_gains_is_four_times_as_compliant(loop):
    slow = np.array([0.01])
    ratio = np.abs(motor_compliance(halved(loop), slow) / motor_compliance(loop, slow))
    assert ratio[0] == pytest.approx(4.0, rel=0.01)
    own = loop.cascade
    stiff = own.position_gain_per_s * own.velocity_integral_gain_nm_rad
    assert np.abs(motor_compliance(loop, slow))[0] == pytest.approx(2.0 * np.pi * 0.01 / stiff, rel=0.01)


def test_lower_gains_cost_compliance_everywhere_it_is_looked_at(loop):
    before, after = compliance(loop), compliance(halved(loop))
    assert 3.0 < after.slow / before.slow < 4.0
    assert 2.0 < after.peak / before.peak < 4.0
    assert 0.1 <= before.peak_hz <= 30.0


def test_a_filter_that_follows_the_speed_costs_at_its_own_frequency_and_nothing_at_1_hz(loop):
    filtered = load_bench("reference").axis[2].loop(250e-6)
    speeds = judged_speeds(filtered)
    assert speeds[0] == 0.0
    assert (min(speeds[1:]), max(speeds)) == (4.0, 9.0)
    before, after = compliance(loop), compliance(filtered, speeds)
    assert after.slow == pytest.approx(before.slow, rel=0.01)
    assert after.peak > 2.0 * before.peak
    assert compliance(filtered, (0.0,)) == before
    assert judged_speeds(loop) == (0.0,)
