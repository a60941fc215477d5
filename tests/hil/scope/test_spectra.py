"""Spectra show the amplitudes that are there, at the frequency or the order at which they are."""

import numpy as np
import pytest
import scipy.signal

from hil.scope.spectra import SpectrumError, frequency_spectrum, order_spectrum

TIME_S = np.arange(4000) * 0.001


def test_a_sine_has_its_amplitude_at_its_frequency():
    frequency_hz, amplitude = frequency_spectrum(TIME_S, 5.0 + 0.3 * np.sin(2 * np.pi * 12.5 * TIME_S))
    assert frequency_hz[np.argmax(amplitude)] == pytest.approx(12.5)
    assert np.max(amplitude) == pytest.approx(0.3, rel=1e-3)


def test_it_is_scipys_spectrum_of_the_same_window():
    signal = np.random.default_rng(3).normal(size=4000)
    frequency_hz, amplitude = frequency_spectrum(TIME_S, signal)
    theirs_hz, power = scipy.signal.periodogram(signal, 1000.0, "hann", detrend="constant", scaling="spectrum")
    assert frequency_hz == pytest.approx(theirs_hz)
    assert amplitude[1:-1] == pytest.approx(np.sqrt(2.0 * power[1:-1]))


def test_an_error_of_order_two_is_a_line_at_two_whatever_the_speed():
    angle_rev = 0.5 * 2.0 * TIME_S**2  # a ramp to 8 rev/s
    orders, amplitude = order_spectrum(TIME_S, 0.2 * np.sin(2 * np.pi * 2.0 * angle_rev), angle_rev)
    assert orders[np.nanargmax(amplitude)] == pytest.approx(2.0)
    assert np.nanmax(amplitude) == pytest.approx(0.2, rel=0.05)


def test_a_few_missing_samples_are_filled_and_many_are_refused():
    signal = np.sin(2 * np.pi * 10.0 * TIME_S)
    signal[::50] = np.nan
    assert np.max(frequency_spectrum(TIME_S, signal)[1]) == pytest.approx(1.0, rel=0.01)
    signal[::3] = np.nan
    with pytest.raises(SpectrumError, match="missing"):
        frequency_spectrum(TIME_S, signal)


@pytest.mark.parametrize("time_s", [TIME_S[:5], TIME_S[::-1], np.zeros(100), np.full(100, np.nan)])
def test_what_is_no_window_is_refused(time_s):
    with pytest.raises(SpectrumError):
        frequency_spectrum(time_s, np.zeros(len(time_s)))


def test_a_motor_that_stands_has_no_orders():
    with pytest.raises(SpectrumError):
        order_spectrum(TIME_S, np.sin(TIME_S), np.zeros(len(TIME_S)))
