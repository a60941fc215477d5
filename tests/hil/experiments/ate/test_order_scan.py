"""Orders that ramps show: those that are asked for and out of reach, and others that nobody asked for."""

from functools import cache

import numpy as np
import pytest

from hil.design.ate.model import Arm, Sensing, Sweep, modelled
from hil.design.transmission_error import TransmissionError
from hil.experiments.ate.order_scan import identify_orders, is_passed, is_significant, scan_orders

RATIO, LEVER, PERIOD_S, ARM = 100.0, 0.6, 2e-3, Arm(10.0, 0.035, 1e-3)
PHASES = {0.5: 20.0, 1: 33.0, 2: 222.0, 2.5: 70.0, 3: 140.0, 4: 306.0, 6: 12.0}


@cache
def ramps(end_rps: float, amplitudes: tuple[tuple[float, float], ...], noise: float = 0.02, seed: int = 1) -> Sweep:
    """A ramp forwards and one back at 4 rev/s² to a speed, on an arm of 10 Hz, rounded as by an encoder of 17 bits."""
    ramp_s = end_rps / 4.0
    t = np.arange(0.0, 2.0 * ramp_s + 2.4, PERIOD_S)
    up = np.clip(t - 0.3, 0.0, ramp_s)
    down, back = np.clip(t - 0.3 - ramp_s, 0.0, 0.5), np.clip(t - 1.1 - ramp_s, 0.0, ramp_s)
    last = np.clip(t - 1.1 - 2.0 * ramp_s, 0.0, 0.5)
    speed = 4.0 * up - 2.0 * end_rps * down - 4.0 * back + 2.0 * end_rps * last
    angle = 2.0 * np.pi * np.cumsum(speed) * PERIOD_S
    angle = np.round(angle / (2.0 * np.pi) * 2**17) / 2**17 * 2.0 * np.pi
    direction = np.zeros(len(t), dtype=np.int8)
    direction[(t >= 0.3) & (t < 0.3 + ramp_s)] = 1
    direction[(t >= 1.1 + ramp_s) & (t < 1.1 + 2.0 * ramp_s)] = -1
    error = TransmissionError(dict(amplitudes), PHASES)
    bare = Sweep(angle, np.zeros(len(t)), PERIOD_S, direction)
    signal = modelled(bare, RATIO, Sensing(LEVER), ARM, error)
    return Sweep(angle, signal + np.random.default_rng(seed).normal(0.0, noise, len(t)), PERIOD_S, direction)


TWO = ((2, 10.0), (4, 5.0))


def test_order_1_is_found_beyond_its_resonance_and_below_it():
    for end_rps, fraction in ((12.0, 0.02), (6.8, 0.15)):
        sweep = ramps(end_rps, ((1, 40.0), *TWO))
        found = identify_orders([sweep], RATIO, Sensing(LEVER), None, (1, 2, 4))
        assert is_passed([sweep], found.arm.resonance_hz, 1) is (end_rps > 10.0)
        assert is_significant(found, 1)
        assert found.error.amplitude_arcsec[1] == pytest.approx(40.0, rel=fraction)
        assert abs(found.error.amplitude_arcsec[1] - 40.0) < 4.0 * found.amplitude_error_arcsec[1]
        for order, amplitude in TWO:
            assert abs(found.error.amplitude_arcsec[order] - amplitude) < 4.0 * found.amplitude_error_arcsec[order]


def test_an_order_out_of_reach_that_is_not_there_takes_nothing_from_the_others():
    sweep = ramps(6.8, TWO)
    with_1 = identify_orders([sweep], RATIO, Sensing(LEVER), None, (1, 2, 4))
    without = identify_orders([sweep], RATIO, Sensing(LEVER), None, (2, 4))
    assert not is_significant(with_1, 1)
    for order in (2, 4):
        assert with_1.error.amplitude_arcsec[order] == pytest.approx(without.error.amplitude_arcsec[order], rel=1e-3)
        assert with_1.amplitude_error_arcsec[order] == pytest.approx(without.amplitude_error_arcsec[order], rel=2e-2)


SLOW = pytest.mark.slow


@pytest.mark.parametrize("other", [3, pytest.param(2.5, marks=SLOW), pytest.param(6, marks=SLOW)])
def test_an_order_that_nobody_asked_for_is_seen(other):
    sweep = ramps(6.8, (*TWO, (other, 4.0)))
    scan = scan_orders([sweep], RATIO, Sensing(LEVER), identify_orders([sweep], RATIO, Sensing(LEVER), None, (1, 2, 4)))
    (seen,) = scan.seen
    assert (seen.order, type(seen.order)) == (other, type(other))
    assert seen.amplitude_arcsec == pytest.approx(4.0, rel=0.1)
    assert 0.05 < seen.fraction < 0.2
    assert scan.fractions[2] > scan.fractions[4] > 0.05


@SLOW
def test_an_order_that_leads_the_fit_astray_is_seen_too():
    sweep = ramps(12.0, ((1, 60.0), (2, 3.0), (4, 1.5)))
    estimate = identify_orders([sweep], RATIO, Sensing(LEVER), None, (2, 4))
    assert estimate.explained_by_error < 0.5
    seen = scan_orders([sweep], RATIO, Sensing(LEVER), estimate).seen
    assert seen[0].order == 1
    assert seen[0].fraction > 0.7
    assert seen[0].amplitude_arcsec == pytest.approx(60.0, rel=0.02)


@pytest.mark.parametrize("noise", [pytest.param(0.005, marks=SLOW), 0.4])
def test_noise_is_no_order(noise):
    sweep = ramps(6.8, TWO, noise, seed=2)
    estimate = identify_orders([sweep], RATIO, Sensing(LEVER), None, (1, 2, 4))
    assert scan_orders([sweep], RATIO, Sensing(LEVER), estimate).seen == ()


@SLOW
def test_a_gear_that_is_softer_for_small_vibrations_shows_no_other_order():
    """Order 4 rings at another frequency and damping than order 2; the encoder's steps are in it too."""
    bare = ramps(6.8, TWO)
    strong, weak = TransmissionError({2: 10.0}, PHASES), TransmissionError({4: 5.0}, PHASES)
    soft = Arm(9.4, 0.06, 1e-3)
    signal = modelled(bare, RATIO, Sensing(LEVER), ARM, strong)
    own = modelled(bare, RATIO, Sensing(LEVER), soft, TransmissionError({}, {}))
    signal += modelled(bare, RATIO, Sensing(LEVER), soft, weak) - own
    noisy = signal + np.random.default_rng(3).normal(0.0, 0.01, len(signal))
    sweep = Sweep(bare.motor_angle_rad, noisy, PERIOD_S, bare.direction)
    estimate = identify_orders([sweep], RATIO, Sensing(LEVER), None, (1, 2, 4))
    assert scan_orders([sweep], RATIO, Sensing(LEVER), estimate).seen == ()
    assert abs(estimate.error.amplitude_arcsec[4] - 5.0) < 3.0 * estimate.amplitude_error_arcsec[4]
