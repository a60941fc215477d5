"""Blind scan of recorded signals, and the swing of a joint, on signals that are known."""

import math

import numpy as np
import pytest

from hil.control.angles import ARCSEC
from hil.design.recorded.fit import AngleSection, waves_of_angle
from hil.design.recorded.fixed_lines import without_lines
from hil.design.recorded.order_columns import columns_of, scanned_orders
from hil.design.recorded.scan import order_scan
from hil.design.recorded.slow import degrees_for
from hil.design.recorded.swing import swing_of, swung_waves

ORDERS = scanned_orders()


def sections(turns, samples_per_turn=60):
    angles = [np.linspace(0.0, 2.0 * math.pi * each, int(samples_per_turn * each)) for each in turns]
    return [AngleSection(angle, np.zeros(len(angle)), waves_of_angle(angle)) for angle in angles]


def coloured(random, count, mean_of):
    white = random.normal(size=count + mean_of - 1)
    return np.convolve(white, np.ones(mean_of) / math.sqrt(mean_of), "valid")


@pytest.mark.slow
@pytest.mark.parametrize(("turns", "mean_of"), [((6.0,), 1), ((6.0,), 5), ((4.0, 4.0), 1)])
def test_noise_alone_seldom_reaches_the_false_alarm_level(turns, mean_of):
    random = np.random.default_rng(11)
    made = sections(turns)
    looks = columns_of(made, [max(degrees_for(each, 1)) for each in turns], ORDERS)
    noise = [[coloured(random, len(each.signal), mean_of) for each in made] for _ in range(80)]
    assert sum(bool(order_scan(looks, signals, ORDERS).peaks) for signals in noise) <= 4  # 1 % is stated: above 4 once in 1000


def test_orders_far_above_the_noise_are_found_and_nothing_beside_them():
    random = np.random.default_rng(2)
    [section] = sections((20.0,))
    angle = section.angle_rad
    signal = 9.0 * np.cos(2.0 * angle + 1.0) + 4.0 * np.cos(4.0 * angle) + random.normal(size=len(angle))
    looks = columns_of([section], [8], ORDERS)
    scan = order_scan(looks, [signal], ORDERS)
    assert [round(peak.order, 1) for peak in scan.peaks] == [2.0, 4.0]
    assert scan.highest.amplitude == pytest.approx(9.0, abs=0.3)


def ramp(end_rps=3.0, seconds=20.0, period=0.004):
    time = np.arange(0.0, seconds, period)
    return time, math.pi * end_rps * time**2 / seconds, end_rps * time / seconds


def ringing_waves(angle, speed, resonance_hz=12.0, damping=0.05):
    """Waves as a tip behind an arm shows them: each order mostly while it passes the resonance."""

    def waves(orders):
        columns = []
        for order in orders:
            ratio = order * speed / resonance_hz
            size = ratio**2 / np.hypot(1.0 - ratio**2, 2.0 * damping * ratio)
            columns += [size * np.cos(order * angle), size * np.sin(order * angle)]
        return np.column_stack(columns)

    return waves


@pytest.mark.slow
def test_noise_behind_an_arm_reaches_the_level_no_more_often():
    """An order shows within few of the revolutions, so that its neighbours are few independent ones."""
    random = np.random.default_rng(7)
    _, angle, speed = ramp(end_rps=9.0, seconds=6.0)
    section = AngleSection(angle, np.zeros(len(angle)), ringing_waves(angle, speed))
    [look] = looks = columns_of([section], [8], ORDERS)
    assert np.all(look.turns_seen(ORDERS)[ORDERS > 5.0] < 0.2 * section.turns)
    noise = [random.normal(size=len(look.section.signal)) for _ in range(80)]
    assert sum(bool(order_scan(looks, [each], ORDERS).peaks) for each in noise) <= 4


def swing_seen(noise):
    """The swing of a joint of 15 Hz on a ramp, over the true one, and its standard error."""
    _, angle, speed = ramp()
    true = 1.0 / 15.0**2
    clean = swung_waves(angle, speed, true)((2, 4)) @ (ARCSEC * np.array([3.0, -4.0, 2.0, 1.0]))
    signal = clean + ARCSEC * noise(len(angle))
    swing = swing_of([lambda c: AngleSection(angle, signal, swung_waves(angle, speed, c))], (2, 4), 12.0)
    return swing.per_hz2 / true, swing.error_per_hz2 / true


@pytest.mark.parametrize("seed", range(4))
def test_a_joint_that_swings_wider_as_it_turns_faster_is_told_from_a_larger_error(seed):
    random = np.random.default_rng(seed)
    seen, error = swing_seen(lambda count: random.normal(size=count))
    assert abs(seen - 1.0) < 4.0 * error < 0.25


def test_a_swing_without_noise_is_seen_as_large_as_it_is():
    seen, _ = swing_seen(np.zeros)
    assert seen == pytest.approx(1.0, abs=1e-3)


def test_at_one_speed_the_swing_is_not_told():
    angle = np.linspace(0.0, 60.0, 3000)
    speed = np.full(3000, 2.0)
    random = np.random.default_rng(5)
    signal = waves_of_angle(angle)((2,)) @ np.array([5.0, 0.0]) + random.normal(size=3000)
    swing = swing_of([lambda c: AngleSection(angle, signal, swung_waves(angle, speed, c))], (2,), 4.0)
    assert swing is None or not swing.is_told


@pytest.mark.parametrize("samples", [734 * 2, 734 * 2 + 1, 800 * 2, 800 * 2 - 1, 800 * 3 + 2])
def test_lines_are_looked_for_whatever_is_over_at_the_end_of_a_stretch(samples):
    """Means of a few neighbours leave out what is over; of the mean's length alone nobody can tell how many they were."""
    time_s = np.linspace(0.0, 8.0, samples)
    angle_rad = 2.0 * np.pi * (0.5 * time_s + 0.15 * time_s**2)
    signal = 3.0 * np.cos(6.0 * angle_rad) + np.random.default_rng(3).normal(0.0, 0.3, samples)
    section = AngleSection(angle_rad, signal, waves_of_angle(angle_rad))
    [look] = columns_of([section], [2], ORDERS)
    assert look is not None
    cleaned = without_lines(section, look, ORDERS, time_s)
    assert cleaned.lines == []
    assert len(cleaned.signal) == len(look.section.signal)
