"""Input shapers: their impulses and what they leave, beside the published formulae and a damped oscillator that is simulated."""

import itertools
import math

import numpy as np
import pytest
from scipy import linalg

from hil.control.shapers import EI_TOLERANCE, NAMES, Shaper, SwingingMode, shaper, shaper_for
from hil.control.trajectory import PointToPoint, sample_times

MODES = [SwingingMode(11.63, 0.129), SwingingMode(10.0, 0.0), SwingingMode(4.2, 0.02), SwingingMode(30.0, 0.25)]


def simulated(made, frequency_hz, damping):
    """Amplitude with which a damped oscillator rings after the impulses, over that after one impulse at 0, both at the last.

    The state (x, ẋ) goes from impulse to impulse by the matrix exponential; the amplitude of a decaying wave is constant in the
    coordinates in which it is a spiral: |x + (ẋ + ζω x)/(j ω_d)|.
    """
    omega = 2.0 * math.pi * frequency_hz
    a = np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]])

    def after(amplitudes, times, end):
        state, now = np.zeros(2), 0.0
        for weight, time in zip(amplitudes, times, strict=True):
            state = linalg.expm(a * (time - now)) @ state + np.array([0.0, weight])
            now = time
        x, v = linalg.expm(a * (end - now)) @ state
        damped = omega * math.sqrt(1.0 - damping**2)
        return math.hypot(x, (v + damping * omega * x) / damped)

    one = after([1.0], [0.0], 0.0)
    return after(made.amplitudes, made.times_s, made.duration_s) / one


@pytest.mark.parametrize("mode", MODES, ids=str)
@pytest.mark.parametrize("name", NAMES)
def test_what_is_left_is_what_a_simulated_oscillator_rings_with(name, mode):
    made = shaper(name, mode)
    for factor in (0.6, 0.9, 1.0, 1.1, 1.37):
        left = float(made.remaining(factor * mode.frequency_hz, mode.damping))
        assert left == pytest.approx(simulated(made, factor * mode.frequency_hz, mode.damping), abs=1e-9)


@pytest.mark.parametrize("mode", MODES, ids=str)
def test_zv_and_zvd_have_the_impulses_of_singer_and_seering(mode):
    k = math.exp(-mode.damping * math.pi / math.sqrt(1.0 - mode.damping**2))
    half = 0.5 / (mode.frequency_hz * math.sqrt(1.0 - mode.damping**2))
    zv, zvd = shaper("zv", mode), shaper("zvd", mode)
    assert zv.amplitudes == pytest.approx((1.0 / (1.0 + k), k / (1.0 + k)), abs=1e-12)
    assert zv.times_s == pytest.approx((0.0, half), abs=1e-12)
    whole = 1.0 + 2.0 * k + k**2
    assert zvd.amplitudes == pytest.approx((1.0 / whole, 2.0 * k / whole, k**2 / whole), abs=1e-12)
    assert zvd.times_s == pytest.approx((0.0, half, 2.0 * half), abs=1e-12)


def test_the_residual_curves_of_an_undamped_mode_are_the_published_ones():
    """With x = f/f_0: |cos(πx/2)| of ZV, its square of ZVD, (1+V)/2 cos πx + (1−V)/2 of EI, and so on."""
    x, mode, v = np.linspace(0.3, 1.9, 321), SwingingMode(10.0, 0.0), EI_TOLERANCE
    left = {name: shaper(name, mode).remaining(10.0 * x, 0.0) for name in NAMES}
    assert np.max(np.abs(left["zv"] - np.abs(np.cos(0.5 * np.pi * x)))) < 1e-9
    assert np.max(np.abs(left["zvd"] - np.cos(0.5 * np.pi * x) ** 2)) < 1e-9
    assert np.max(np.abs(left["ei"] - np.abs(0.5 * (1.0 + v) * np.cos(np.pi * x) + 0.5 * (1.0 - v)))) < 1e-9
    root = (v**2 * (math.sqrt(1.0 - v**2) + 1.0)) ** (1.0 / 3.0)
    outer = (3.0 * root**2 + 2.0 * root + 3.0 * v**2) / (16.0 * root)
    humps = np.abs(2.0 * outer * np.cos(1.5 * np.pi * x) + (1.0 - 2.0 * outer) * np.cos(0.5 * np.pi * x))
    assert np.max(np.abs(left["two-hump-ei"] - humps)) < 1e-9
    middle = math.sqrt(2.0) - 1.0
    assert np.max(np.abs(left["mzv"] - np.abs((2.0 - math.sqrt(2.0)) * np.cos(0.75 * np.pi * x) + middle))) < 1e-9


def test_ei_leaves_what_it_may_at_the_mode_and_two_hump_ei_at_both_sides_of_it():
    ei, two = shaper("ei", SwingingMode(10.0, 0.0)), shaper("two-hump-ei", SwingingMode(10.0, 0.0))
    assert float(ei.remaining(10.0, 0.0)) == pytest.approx(EI_TOLERANCE, abs=1e-12)
    curve = two.remaining(np.linspace(7.2, 12.8, 2001), 0.0)
    assert np.max(curve) == pytest.approx(EI_TOLERANCE, rel=1e-4), "both humps, and no more between"
    assert float(two.remaining(10.0, 0.0)) < 1e-12


@pytest.mark.parametrize(("name", "mode"), list(itertools.product(NAMES, MODES)), ids=str)
def test_impulses_are_positive_and_their_sum_is_1(name, mode):
    made = shaper(name, mode)
    assert min(made.amplitudes) > 0.0
    assert math.fsum(made.amplitudes) == pytest.approx(1.0, abs=1e-12)
    assert made.times_s[0] == 0.0
    assert list(made.times_s) == sorted(made.times_s)
    assert 0.0 < made.delay_s < made.duration_s


def test_for_two_modes_both_are_left_silent():
    first, second = SwingingMode(10.1, 0.08), SwingingMode(14.3, 0.05)
    made = shaper_for("zv", (first, second))
    assert len(made.times_s) == 4
    assert math.fsum(made.amplitudes) == pytest.approx(1.0)
    assert [float(made.remaining(mode.frequency_hz, mode.damping)) for mode in (first, second)] == pytest.approx(
        [0.0, 0.0], abs=1e-12
    )
    assert made.duration_s == pytest.approx(0.5 * (first.period_s + second.period_s))


@pytest.mark.parametrize("name", NAMES)
def test_a_shaped_motion_is_the_convolution_and_keeps_every_limit(name):
    period, mode = 0.002, SwingingMode(11.63, 0.129)
    move = PointToPoint(-3.0, 1.5, 60.0, 0.2, 0.5)
    times = sample_times(move.duration_s, period)
    plain = move.motor_angle(times)
    made = shaper(name, mode)
    shaped = made.shaped(plain, period)
    assert len(shaped) == len(plain) + math.ceil(made.duration_s / period)
    later = period * np.arange(len(shaped))
    oracle = [
        math.fsum(a * float(np.interp(t - u, times, plain)) for a, u in zip(made.amplitudes, made.times_s, strict=True))
        for t in later
    ]
    assert np.max(np.abs(shaped - oracle)) < 1e-9
    assert (shaped[0], shaped[-1]) == pytest.approx((plain[0], plain[-1]))
    assert shaped.min() >= plain.min() - 1e-12
    assert shaped.max() <= plain.max() + 1e-12
    for degree in (1, 2):
        assert np.max(np.abs(np.diff(shaped, degree))) <= np.max(np.abs(np.diff(plain, degree))) + 1e-12


def test_several_axes_are_shaped_alike_from_where_each_stands():
    rows = np.column_stack([np.linspace(5.0, 6.0, 40), np.linspace(-1.0, 2.0, 40)])
    made = Shaper((0.5, 0.5), (0.0, 0.0031))
    both = made.shaped(rows, 0.002)
    assert both.shape == (42, 2)
    assert both[:, 1] == pytest.approx(made.shaped(rows[:, 1], 0.002))
    assert both[0] == pytest.approx(rows[0])


@pytest.mark.parametrize(("hz", "damping"), [(0.0, 0.1), (math.nan, 0.1), (10.0, -0.1), (10.0, 0.5), (math.inf, 0.0)])
def test_what_does_not_ring_is_no_mode(hz, damping):
    with pytest.raises(ValueError, match="a mode"):
        SwingingMode(hz, damping)


def test_without_a_mode_there_is_no_shaper():
    with pytest.raises(ValueError, match="no mode given; expected at least one"):
        shaper_for("ei", ())
