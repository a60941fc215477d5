"""Spectra of a window by frequency, and by motor order."""

import numpy as np

from hil.analysis import amplitude_spectrum
from hil.control.arrays import Real
from hil.design.order_map import order_map

LEAST_WINDOW, MOST_WINDOW = 16, 400_000
MISSING_FRACTION_BORNE = 0.05
"""Fraction of the samples that may be missing; they are filled by straight lines."""
SHOWN_ORDERS = np.arange(0.1, 20.05, 0.1)
"""Orders that are shown."""


class SpectrumError(ValueError):
    """A window without a spectrum; the message has the reason."""


def frequency_spectrum(time_s: Real, values: Real) -> tuple[Real, Real]:
    """Compute the amplitude spectrum of a signal by frequency.

    Without its mean, in a Hann window. Times rise; the signal has NaN for a missing sample; shapes (n,).

    Returns:
        Frequencies in Hz and amplitudes in the signal's unit; shape (n // 2 + 1,).

    Raises:
        SpectrumError: There are too few samples, or too many are missing.
    """
    period_s, (signal,) = _even(time_s, values)
    return amplitude_spectrum(signal - np.mean(signal), period_s, "hann")


def order_spectrum(time_s: Real, values: Real, angle_rev: Real) -> tuple[Real, Real]:
    """Compute the amplitude spectrum of a signal by order.

    Amplitude at k θ_m: the mean over windows of two turns of the motor (`hil.design.order_map`). Times rise; all of shape (n,).

    Returns:
        Orders that the samples show, and amplitudes in the signal's unit.

    Raises:
        SpectrumError: There are too few samples, too many are missing, or the motor does not turn far enough.
    """
    period_s, (signal, turns) = _even(time_s, values, angle_rev)
    try:
        found = order_map(2.0 * np.pi * turns, signal, period_s, SHOWN_ORDERS)
    except ValueError as error:
        raise SpectrumError(str(error)) from error
    shown = np.any(~np.isnan(found.amplitude), axis=0)
    if not shown.any():
        raise SpectrumError("the motor turns too fast for these samples: no order has four samples per cycle")
    return found.orders[shown], np.nanmean(found.amplitude[:, shown], axis=0)


def _even(time_s: Real, *signals: Real) -> tuple[float, list[Real]]:
    """Period, and signals at even times, missing samples filled."""
    if not LEAST_WINDOW <= len(time_s) <= MOST_WINDOW or any(len(each) != len(time_s) for each in signals):
        raise SpectrumError(f"{len(time_s)} samples; expected {LEAST_WINDOW} to {MOST_WINDOW}")
    steps = np.diff(time_s)
    if not np.all(np.isfinite(time_s)) or np.any(steps <= 0.0):
        raise SpectrumError("the times do not increase")
    period_s = float(np.median(steps))
    count = round((time_s[-1] - time_s[0]) / period_s) + 1
    if count > MOST_WINDOW:
        raise SpectrumError("the times have gaps that are longer than the window")
    even = time_s[0] + period_s * np.arange(count)
    filled = []
    for signal in signals:
        there = np.isfinite(signal)
        if np.count_nonzero(there) < (1.0 - MISSING_FRACTION_BORNE) * count:
            raise SpectrumError(f"{count - np.count_nonzero(there)} of {count} samples are missing")
        filled.append(np.interp(even, time_s[there], signal[there]))
    return period_s, filled
