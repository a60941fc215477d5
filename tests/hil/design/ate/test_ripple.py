"""The ripple of a motor beyond half of the sampling rate is found in its samples, and moves the arm where it belongs."""

import math

import numpy as np
import pytest

from hil.control.angles import ARCSEC
from hil.design.ate.gear import BaseMotion
from hil.design.ate.model import Sweep
from hil.design.ate.ripple import NO_RIPPLE, SPLINED, Ripple

PERIOD_S, RATIO, ORDERS, RESONANCE_HZ, STEP_RAD = 0.008, 100.0, (1.0, 2.0, 4.0), 22.0, math.tau / 2**14
FINE = 40
"""Samples of the truth in one of the recording."""
FAST = 4.0
FORWARDS, BACKWARDS = 900.0 * ARCSEC * np.exp(2.0j), 900.0 * ARCSEC * np.exp(-1.1j)
"""Ripple of order 4 at f_k, which falls with the speed."""


def speed_of(time_s, top_rps):
    """Up to a speed in 4 s, down again in 2 s, and the same backwards, with rests."""
    return np.interp(time_s, (0.5, 4.5, 6.5, 7.5, 11.5, 13.5), (0.0, top_rps, 0.0, 0.0, -top_rps, 0.0))


def turned(top_rps):
    """Time, angle and speed of a motor whose own ripples act on it, at every fine step."""
    time = PERIOD_S / FINE * np.arange(round(14.0 / PERIOD_S) * FINE + 1)
    speed = speed_of(time, top_rps)
    smooth = np.cumsum(speed) * math.tau * PERIOD_S / FINE
    smooth -= smooth[0]
    slow = np.maximum(np.abs(speed), 1.0)
    angle = smooth
    for _ in range(4):
        fast = np.where(speed > 0.0, FORWARDS, BACKWARDS) * np.minimum(SPLINED / (FAST * PERIOD_S * slow), 4.0) * (speed != 0.0)
        ring = 3000.0 * ARCSEC / (1.0 - (slow / RESONANCE_HZ) ** 2 + 0.1j * slow / RESONANCE_HZ) * (slow / RESONANCE_HZ) ** 2
        angle = smooth + (fast * np.exp(1j * FAST * angle) + ring * np.exp(1j * angle)).real
    return time, angle, speed


def recorded(top_rps):
    time, angle, speed = turned(top_rps)
    shown = np.round(angle[::FINE] / STEP_RAD) * STEP_RAD
    return Sweep(shown, np.zeros(len(shown)), PERIOD_S, np.sign(speed[::FINE]).astype(np.int8)), time, angle, speed


def test_the_ripple_is_found_in_both_directions_and_replaces_what_the_samples_show():
    sweep, time, angle, speed = recorded(27.0)
    ripple = Ripple.of([sweep], ORDERS, RESONANCE_HZ, 46.0)
    assert list(ripple.waves) == [FAST]
    for found, true in zip(ripple.waves[FAST], (FORWARDS, BACKWARDS), strict=True):
        for slowness in (0.75, 0.35):
            there = found[0] * slowness + found[1] * slowness**2
            assert abs(there - true * slowness) < 0.1 * abs(true * slowness)

    def missed(used):
        motion = BaseMotion.of(sweep.motor_angle_rad, PERIOD_S, RATIO, ORDERS, 46.0, used)
        halves = PERIOD_S / (2 * motion.per_sample) * np.arange(motion.rigid.shape[1])
        wrong = RATIO * motion.rigid[0] - np.interp(halves, time, angle)
        is_fast = np.abs(np.interp(halves, time, speed)) > 17.0
        return float(np.std(wrong[is_fast]))

    assert missed(ripple) < 0.25 * missed(NO_RIPPLE)


def test_where_no_image_is_in_the_band_there_is_no_ripple():
    sweep, *_ = recorded(18.0)
    assert not Ripple.of([sweep], ORDERS, RESONANCE_HZ, 46.0).waves


def test_the_ripple_ends_where_the_samples_show_it_as_it_is():
    ripple = Ripple(PERIOD_S, {FAST: np.full((2, 2), 1e-3 + 0j)})
    kept_rps = SPLINED / (FAST * PERIOD_S)
    angle, rate = ripple.angle(np.ones(3), np.array([0.0, 0.99 * kept_rps, -kept_rps]))
    assert angle == pytest.approx(0.0)
    assert rate == pytest.approx(0.0)
