"""Late samples of a motor angle: they are found, moved back, and nothing else is."""

import math

import numpy as np
import pytest

from hil.design.ate.model import Sweep
from hil.design.late_samples import on_time
from hil.experiments.ate.sweeps import late_words

LATE_S = 250e-6


def angle_at(time, *, acceleration_rps_s=4.0, end_rps=9.0):
    """A ramp with the ripple that a gear makes of the orders 1, 2 and 4 at the motor, and a resonance that it passes."""
    ramp_s = end_rps / acceleration_rps_s
    ramp = np.minimum(time, ramp_s)
    turned = 2.0 * math.pi * (0.5 * acceleration_rps_s * ramp**2 + end_rps * np.maximum(time - ramp_s, 0.0))
    speed_hz = acceleration_rps_s * ramp
    gain = 1.0 / np.hypot(1.0 - (2.0 * speed_hz / 12.0) ** 2, 0.08 * 2.0 * speed_hz / 12.0)
    ripple = 2e-3 * np.sin(turned) + 1e-3 * gain * np.sin(2.0 * turned + 0.4) + 1e-3 * np.sin(4.0 * turned)
    return turned + ripple


def sampled(seed, period_s, bits, late_fraction):
    """Samples of which some runs of 1 to 4 are late; and the true ones, and which are late."""
    generator = np.random.default_rng(seed)
    time = np.arange(round(4.0 / period_s)) * period_s
    late = np.zeros(len(time), dtype=bool)
    for start in generator.integers(400, len(time) - 10, round(late_fraction * len(time) / 2.5)):
        late[start : start + generator.integers(1, 5)] = True
    step = 2.0 * math.pi / 2**bits
    true, seen = (np.round(angle_at(each) / step) * step for each in (time, time + LATE_S * late))
    return seen, true, late, step


@pytest.mark.parametrize("late_fraction", [0.002, 0.02, 0.07])
@pytest.mark.parametrize("bits", [13, 17])
@pytest.mark.parametrize("seed", range(3))
def test_late_samples_are_found_and_moved_back(seed, bits, late_fraction):
    seen, true, late, step = sampled(seed, 1e-3, bits, late_fraction)
    found = on_time(seen, 1e-3, step, 4)
    assert 0.8 * np.sum(late) <= found.count <= 1.05 * np.sum(late)  # slow ones are off by less than the noise
    assert found.delay_s == pytest.approx(LATE_S, rel=0.2)
    left, before = found.angle_rad - true, seen - true
    assert np.sqrt(np.mean(left**2)) < 0.25 * np.sqrt(np.mean(before**2))
    assert np.max(np.abs(left[~late])) <= max(2.0 * step, 0.1 * np.max(before)), "no sample that is on time is moved far"
    assert np.allclose(found.angle_rad / step, np.round(found.angle_rad / step), atol=1e-6), "whole counts"


@pytest.mark.parametrize("period_s", [0.25e-3, 1e-3, 2e-3, 4e-3, 8e-3])
@pytest.mark.parametrize("bits", [13, 17, 20])
def test_an_angle_that_is_on_time_stays_as_it_is(bits, period_s):
    for seed in range(3):
        seen, true, _, step = sampled(seed, period_s, bits, 0.0)
        found = on_time(seen, period_s, step, 4)
        assert found.count == 0
        assert found.angle_rad is seen
        assert np.array_equal(seen, true)


def test_a_ripple_too_fast_for_the_samples_is_not_taken_for_late_ones():
    seen, _, _, step = sampled(1, 8e-3, 17, 0.05)
    assert on_time(seen, 8e-3, step, 4).angle_rad is seen


def test_a_few_samples_stay_as_they_are():
    few = np.linspace(0.0, 1.0, 50)
    assert on_time(few, 1e-3, 0.0, 4).angle_rad is few


def test_an_angle_without_steps_is_moved_by_what_it_is_off():
    time = np.arange(4000) * 1e-3
    late = np.arange(4000) % 50 == 49
    seen = angle_at(time + LATE_S * late)
    found = on_time(seen, 1e-3, 0.0, 4)
    assert np.max(np.abs(found.angle_rad - angle_at(time))[500:]) < 1e-4


def test_the_engineer_reads_how_many_and_how_late():
    still = np.zeros(500)
    direction = np.zeros(500, dtype=np.int8)
    assert late_words([Sweep(still, still, 1e-3, direction)]) == []
    [words] = late_words([Sweep(still, still, 1e-3, direction, late=7, late_s=0.2e-3), Sweep(still, still, 1e-3, direction)])
    assert "7 of 1000 motor angles were sampled late, by about 0.20 ms" in words
