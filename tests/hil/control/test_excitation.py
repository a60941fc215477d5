import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.control.excitation import band_lines, chirp, crest_factor, multisine, quiet_bias_rps

SYNC = 0.002
LINES = band_lines(3.0, 60.0, 2.0, SYNC)
FLAT = np.ones(len(LINES))


def test_the_lines_of_a_band_include_both_ends() -> None:
    assert LINES[0] == 6
    assert LINES[-1] == 120


@pytest.mark.parametrize(("low", "high"), [(0.0, 10.0), (10.0, 5.0), (3.0, 250.0), (3.1, 3.2)])
def test_a_band_that_is_none_is_refused(low: float, high: float) -> None:
    with pytest.raises(ValueError, match="Hz"):
        band_lines(low, high, 2.0, SYNC)


@pytest.mark.parametrize(("make", "crest"), [(multisine, 1.55), (chirp, 1.45)])
def test_much_power_for_little_peak(make: object, crest: float) -> None:
    excitation = make(LINES, FLAT, 1000, SYNC)  # type: ignore[operator]
    assert np.max(np.abs(excitation.wave)) == pytest.approx(1.0)
    assert excitation.crest_factor < crest
    assert excitation.period_s == pytest.approx(2.0)
    assert excitation.frequency_hz[0] == pytest.approx(3.0)


def test_a_multisine_has_its_amplitudes_on_its_lines_and_nothing_between() -> None:
    amplitude = 1.0 / np.sqrt(LINES)
    spectrum = np.abs(np.fft.rfft(multisine(LINES, amplitude, 1000, SYNC).wave))
    on = spectrum[LINES] / amplitude
    assert np.allclose(on, on[0])
    assert np.delete(spectrum, LINES).max() < 1e-9 * on[0]


def test_another_wave_has_the_same_lines_and_little_peak_but_other_phases() -> None:
    spectra = []
    for number in range(4):
        found = multisine(LINES, FLAT, 1000, SYNC, number)
        assert found.crest_factor < 1.6
        line = np.fft.rfft(found.wave)[LINES]
        assert np.allclose(np.abs(line), np.abs(line[0]))
        spectra.append(line / np.abs(line))
    for one in range(4):
        for other in range(one):
            assert abs(np.mean(spectra[one] * spectra[other].conj())) < 4.0 / math.sqrt(len(LINES))


def test_a_chirp_fills_its_band_and_goes_on_where_it_began() -> None:
    wave = chirp(LINES, FLAT, 1000, SYNC).wave
    spectrum = np.abs(np.fft.rfft(wave))
    inside = spectrum[LINES[3:-3]]
    assert inside.min() > 0.3 * np.median(inside)
    assert np.sum(spectrum[LINES] ** 2) > 0.97 * np.sum(spectrum**2)
    assert abs(wave[0] - wave[-1]) < 2.0 * math.pi * 60.0 * SYNC


def test_a_chirp_stays_longer_where_more_power_is_wanted() -> None:
    amplitude = np.where(LINES < 60, 2.0, 1.0)
    spectrum = np.abs(np.fft.rfft(chirp(LINES, amplitude, 1000, SYNC).wave))
    assert np.median(spectrum[10:55]) > 1.6 * np.median(spectrum[65:115])


@pytest.mark.parametrize("make", [multisine, chirp])
@pytest.mark.parametrize("lines", [np.array([0, 1]), np.array([499, 500]), np.array([], dtype=np.int64)])
def test_lines_that_a_period_does_not_have_are_refused(make: object, lines: np.ndarray) -> None:
    with pytest.raises(ValueError, match="lines must lie"):
        make(lines, np.ones(len(lines)), 1000, SYNC)  # type: ignore[operator]


@given(st.floats(0.3, 6.0), st.sampled_from([1.0, 2.0, 4.0]), st.sampled_from([3, 5, 6, 7, 8, 9]))
def test_vibration_of_a_turning_motor_adds_up_to_nothing_at_the_quiet_speed(wanted: float, period: float, periods: int) -> None:
    speed = quiet_bias_rps(wanted, period, periods)
    assert abs(speed - wanted) <= 0.5 / period + 1e-9 or speed == pytest.approx(1.0 / periods / period)
    for order in (1, 2, 4):
        turns = order * speed * period * np.arange(periods)
        assert abs(np.sum(np.exp(2j * math.pi * turns))) < 1e-6


@pytest.mark.parametrize("periods", [1, 2, 4])
def test_a_number_of_periods_that_divides_an_order_is_refused(periods: int) -> None:
    with pytest.raises(ValueError, match="does not average out"):
        quiet_bias_rps(2.0, 2.0, periods)


def test_nothing_has_an_infinite_crest_factor() -> None:
    assert crest_factor(np.zeros(4)) == math.inf
