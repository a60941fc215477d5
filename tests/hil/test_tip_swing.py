"""The tip's swing at a resonance, of vibrations that are known."""

import math

import numpy as np
import pytest

from hil.tip_swing import Swing, resonances_hz, spectrum_mm, swing

PERIOD_S, COUNT = 0.002, 1500
TIME_S = PERIOD_S * np.arange(COUNT)
ALL = np.ones(COUNT, dtype=bool)
BAND_HZ = (6.0, 25.0)
LONG, SHORT = np.array([0.03, 0.0, 0.04]), np.array([0.0, 0.01, 0.0])


def moving(hz: float, long=LONG, short=SHORT) -> np.ndarray:
    angle = 2.0 * math.pi * hz * TIME_S[:, np.newaxis]
    return np.cos(angle + 0.7) * long + np.sin(angle + 0.7) * short


@pytest.mark.parametrize("begin", [0, 333])
def test_the_ellipse_of_a_known_motion_is_found_whenever_the_window_begins(begin):
    rows = ALL & (np.arange(COUNT) >= begin)
    found = swing(moving(11.0), PERIOD_S, rows, 11.0)
    long, short = found.half_axes_mm
    np.testing.assert_allclose(np.abs(long), LONG, atol=2e-4)
    np.testing.assert_allclose(np.abs(short), SHORT, atol=2e-4)
    assert abs(long @ short) < 1e-12
    ellipse = found.ellipse_mm(720)
    np.testing.assert_allclose(ellipse[0], ellipse[-1], atol=1e-12)
    assert np.max(np.linalg.norm(ellipse, axis=1)) == pytest.approx(0.05, rel=0.01)
    assert np.min(np.linalg.norm(ellipse, axis=1)) == pytest.approx(0.01, rel=0.03)


def test_half_axes_are_orthogonal_and_the_long_one_is_the_longer_for_any_amplitude():
    generator = np.random.default_rng(1)
    for _ in range(200):
        amplitude = generator.standard_normal(3) + 1j * generator.standard_normal(3)
        long, short = Swing(10.0, amplitude, 0).half_axes_mm
        assert abs(long @ short) < 1e-12
        assert np.linalg.norm(long) >= np.linalg.norm(short)
        assert long @ long + short @ short == pytest.approx(float(np.sum(np.abs(amplitude) ** 2)))


def test_resonances_are_the_clear_peaks_in_the_band_from_the_lowest():
    moved = moving(15.0) + 0.5 * moving(9.0) + 0.05 * moving(21.0) + 2.0 * moving(40.0)
    found = resonances_hz(moved, PERIOD_S, ALL, BAND_HZ)
    np.testing.assert_allclose(found, [9.0, 15.0], atol=0.1)
    assert len(resonances_hz(sum(moving(hz) for hz in (8.0, 11.0, 14.0, 17.0, 20.0)), PERIOD_S, ALL, BAND_HZ)) == 3
    assert resonances_hz(np.zeros((COUNT, 3)), PERIOD_S, ALL, BAND_HZ) == []


def test_the_spectrum_shows_amplitudes_of_all_directions_together():
    frequency, amplitude = spectrum_mm(moving(12.0, short=np.zeros(3)), PERIOD_S, ALL)
    assert frequency[np.argmax(amplitude)] == pytest.approx(12.0, abs=0.05)
    assert np.max(amplitude) == pytest.approx(0.05, rel=1e-3)


def test_the_row_is_where_the_swing_was_largest():
    envelope = np.exp(-(((TIME_S - 2.0) / 0.3) ** 2))[:, np.newaxis]
    assert TIME_S[swing(envelope * moving(10.0), PERIOD_S, ALL, 10.0).row] == pytest.approx(2.0, abs=0.05)
    late = ALL & (TIME_S >= 2.4)
    assert TIME_S[swing(envelope * moving(10.0), PERIOD_S, late, 10.0).row] == pytest.approx(2.5, abs=0.12)


def test_too_few_rows_and_no_frequency_are_a_callers_mistake():
    few = np.arange(COUNT) < 20
    for call in (lambda: spectrum_mm(moving(10.0), PERIOD_S, few), lambda: swing(moving(10.0), PERIOD_S, few, 10.0)):
        with pytest.raises(ValueError, match="20 rows"):
            call()
    with pytest.raises(ValueError, match="above 0"):
        swing(moving(10.0), PERIOD_S, ALL, 0.0)
