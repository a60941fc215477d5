"""A ramp that is thinned shows in the band what the whole one shows, and what is simulated beside it too."""

import math

import numpy as np
import pytest

from hil.control.angles import ARCSEC
from hil.design.ate.gear_ramp import BEGINNING, SHARED, Ramp, Setting, moved_ramps, thinned, thinning
from hil.design.ate.model import Sweep
from hil.design.ate.ripple import NO_RIPPLE, Ripple
from tests.hil.design.ate.test_gear_fit import LEVER, ORDERS, RATIO, SOFT, recorded, unknowns

BAND_HZ = (3.6, 25.2)
PERIOD_S = 0.0005
AT = len(SHARED) + 2 * len(ORDERS)


@pytest.fixture(scope="module")
def sweep():
    return recorded(SOFT, 3.0, 1, period_s=PERIOD_S)


@pytest.fixture(scope="module")
def silent():
    """A recording with neither noise nor rounding."""
    return recorded(SOFT, 3.0, 1, period_s=PERIOD_S, counts=2**26, noise=0.0)


def setting(band_hz=BAND_HZ, ripple=NO_RIPPLE, orders=ORDERS):
    return Setting(RATIO, LEVER, orders, band_hz, ripple)


def soft():
    """The unknowns of `recorded`."""
    gear = {
        "resonance": math.log(12.0), "damping": math.log(0.03), "gear_fraction": math.log(4.0), "delay": 0.004,
        "softness": math.log(0.2), "wind_up": math.log(60.0 * ARCSEC), "hysteresis": math.log(6.0 * ARCSEC),
        "hysteresis_torsion": math.log(20.0 * ARCSEC), "cosine": 8.0, "sine": -5.0,
    }  # fmt: skip
    return np.array([gear.get(name, 0.0) for name in SHARED] + unknowns().tolist() + [0.0] * len(BEGINNING))


def test_the_band_sets_how_far_a_recording_is_thinned_and_its_orders_do(sweep):
    assert thinning([sweep], setting()) == 4  # 1 / (3 · 2π · 25.2 Hz · 0.5 ms)
    assert thinning([sweep], setting(orders=(1.0, 40.0))) == 2  # 0.4 / (40 · 6.8/s · 0.5 ms)
    assert thinning([sweep], setting(band_hz=(30.0, 210.0))) == 1


def test_where_the_samples_show_ripple_at_another_frequency_nothing_is_thinned(sweep):
    ripple = Ripple(PERIOD_S, {4.0: np.zeros((2, 2), dtype=complex)})
    assert thinning([sweep], setting(ripple=ripple)) == 1


@pytest.mark.parametrize("every", [1, 2, 4])
def test_the_simulated_arm_moves_as_a_thinned_recording_does_but_for_a_thousandth(silent, every):
    ramp = Ramp(silent, setting(), AT, every)
    for seen, shown in zip(ramp.seen, ramp.shown(moved_ramps([ramp], soft(), SOFT)[0], soft()), strict=True):
        assert np.sum(np.abs(seen - shown) ** 2) < 1e-6 * np.sum(np.abs(seen) ** 2)


def test_what_a_thinned_recording_leaves_is_the_noise_that_the_whole_one_leaves(sweep):
    left = {}
    for every in (1, 4):
        ramp = Ramp(sweep, setting(), AT, every)
        shown = ramp.shown(moved_ramps([ramp], soft(), SOFT)[0], soft())
        left[every] = [float(np.mean(np.abs(a - b) ** 2)) / n for a, b, n in zip(ramp.seen, shown, ramp.counts, strict=True)]
    assert np.allclose(4.0 * np.array(left[4]), left[1], rtol=0.12)


def test_noise_and_rounding_of_a_thinned_recording_are_those_of_what_is_kept(sweep):
    whole, fourth = (Ramp(sweep, setting(), AT, every) for every in (1, 4))
    assert fourth.still == pytest.approx(whole.still / 4.0, rel=0.3)
    for one, other in zip(whole.rounding(soft(), (1.0, 1.0)), fourth.rounding(soft(), (1.0, 1.0)), strict=True):
        assert np.allclose(one[: len(other)] / 4.0, other, rtol=0.02)


def test_a_recording_of_which_each_sample_is_kept_is_the_recording(sweep):
    assert thinned(sweep, 1) is sweep


def test_ramps_side_by_side_move_as_each_does_alone(sweep, silent):
    """They are of different lengths: to the last bit."""
    p = np.concatenate([soft(), [0.3, 1e-5, -1e-5]])
    shorter = Sweep(silent.motor_angle_rad[:-300], silent.signal[:-300], silent.period_s, silent.direction[:-300])
    ramps = [Ramp(each, setting(), AT + len(BEGINNING) * i, 4) for i, each in enumerate((sweep, shorter))]
    for ramp, found in zip(ramps, moved_ramps(ramps, p, SOFT), strict=True):
        assert found.tobytes() == moved_ramps([ramp], p, SOFT)[0].tobytes()
