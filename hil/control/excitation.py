"""Periodic excitation: multisine and chirp, with a low peak.

The bias speed keeps the vibration of a turning motor out of the excited lines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Real

Lines = NDArray[np.int64]

_ROUNDS = 200
"""Rounds of clipping; the crest factor of 100 lines falls from 1.7 (Schroeder) to 1.4, and hardly any further."""


@dataclass(frozen=True)
class Excitation:
    """One period of a periodic signal.

    Attributes:
        wave: The samples of one period; shape (n,).
        lines: Excited bins of the discrete Fourier transform; bin k is at k/period; shape (m,).
    """

    wave: Real
    sample_s: float
    lines: Lines

    @property
    def period_s(self) -> float:
        """Duration of one period."""
        return len(self.wave) * self.sample_s

    @property
    def frequency_hz(self) -> Real:
        """Frequencies of the excited lines; shape of `lines`."""
        return self.lines / self.period_s

    @property
    def crest_factor(self) -> float:
        """Peak over root mean square."""
        return crest_factor(self.wave)


def crest_factor(wave: Real) -> float:
    """Return peak over root mean square; infinite for a zero signal."""
    power = float(np.mean(np.square(wave)))
    return float(np.max(np.abs(wave))) / math.sqrt(power) if power > 0.0 else math.inf


def band_lines(low_hz: float, high_hz: float, period_s: float, sample_s: float) -> Lines:
    """Return the bins of a period within a band; shape (m,).

    Both ends are included; all bins are below half the sampling rate.

    Raises:
        ValueError: No bin lies in the band, or its ends are in the wrong order.
    """
    if not 0.0 < low_hz < high_hz:
        raise ValueError(f"the band {low_hz:g} … {high_hz:g} Hz; expected a lower end above 0 and a higher upper end")
    if not high_hz < 0.5 / sample_s:
        raise ValueError(f"{high_hz:g} Hz is not below half the sampling rate, {0.5 / sample_s:g} Hz")
    lines = np.arange(math.ceil(low_hz * period_s - 1e-9), math.floor(high_hz * period_s + 1e-9) + 1, dtype=np.int64)
    if lines.size == 0:
        raise ValueError(f"no multiple of 1/({period_s:g} s) lies within {low_hz:g} … {high_hz:g} Hz; widen the band")
    return lines


def multisine(lines: Lines, amplitude: Real, count: int, sample_s: float, number: int = 0) -> Excitation:
    """Return a multisine of low peak, scaled to a peak of 1.

    Phases start as Schroeder's, φ_k = −2π Σ_{j<k} (k − j) p_j with p_j the fraction of the power in line j, and are improved by
    clipping: the wave is clipped, its phases are kept, its amplitudes are put back.

    Args:
        lines: Excited bins; shape (m,).
        amplitude: Relative amplitude of each; shape (m,).
        number: Number of the wave: each but the first, 0, starts from phases of its own instead of Schroeder's.

    Raises:
        ValueError: Shapes that differ, or a line at or above half the sampling rate.

    Source: M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970), 85–89; E. van der Ouderaa, J. Schoukens, J. Renneboog, IEEE
    Trans. Instrum. Meas. 37 (1988), 145–147.
    """
    _check(lines, amplitude, count)
    power = amplitude**2 / np.sum(amplitude**2)
    before = np.concatenate([[0.0], np.cumsum(power)[:-1]])
    phase = -2.0 * math.pi * np.concatenate([[0.0], np.cumsum(before[1:] * np.diff(lines))])
    if number:
        phase = 2.0 * math.pi * np.random.default_rng(number).random(len(lines))
    best, best_crest, level = np.zeros(count), math.inf, 0.75
    spectrum = np.zeros(count // 2 + 1, dtype=np.complex128)
    for round_ in range(_ROUNDS):
        spectrum[lines] = amplitude * np.exp(1j * phase)
        wave = np.fft.irfft(spectrum, count)
        crest = crest_factor(wave)
        if crest < best_crest:
            best, best_crest = wave, crest
        peak = (level + (0.97 - level) * round_ / _ROUNDS) * float(np.max(np.abs(wave)))
        phase = np.angle(np.fft.rfft(np.clip(wave, -peak, peak))[lines])
    return Excitation(best / np.max(np.abs(best)), sample_s, lines)


def _check(lines: Lines, amplitude: Real, count: int) -> None:
    if lines.shape != amplitude.shape or lines.ndim != 1:
        raise ValueError(f"lines and amplitudes have shapes {lines.shape} and {amplitude.shape}; both must be (m,)")
    if lines.size == 0 or lines.min() < 1 or 2 * lines.max() >= count:
        raise ValueError(f"lines must lie between 1 and {(count - 1) // 2}")


def chirp(lines: Lines, amplitude: Real, count: int, sample_s: float) -> Excitation:
    """Return a sweep through the band once in a period.

    It rises from low to high, and is scaled to a peak of 1.

    The time spent at a frequency is in proportion to the power wanted there, the instantaneous amplitude is constant: a flat
    amplitude gives the linear sweep.

    Args:
        lines: Excited bins, contiguous; shape (m,).
        amplitude: Relative amplitude of each; shape (m,).

    Raises:
        ValueError: The shapes differ, or a line is at or above half the sampling rate.
    """
    _check(lines, amplitude, count)
    edges = np.concatenate([lines - 0.5, [lines[-1] + 0.5]])
    reached = np.concatenate([[0.0], np.cumsum(amplitude**2)])
    time = (np.arange(count) + 0.5) / count
    cycles_per_period = np.interp(time * reached[-1], reached, edges)
    phase = np.concatenate([[0.0], np.cumsum(cycles_per_period)]) / count
    phase *= round(phase[-1]) / phase[-1]  # a whole number of turns, so that the wave goes on where it began
    wave = np.sin(2.0 * math.pi * phase[:-1])
    return Excitation(wave / np.max(np.abs(wave)), sample_s, lines)


def quiet_bias_rps(wanted_rps: float, period_s: float, periods: int, orders: Sequence[int] = (1, 2, 4)) -> float:
    """Return the motor speed nearest to the wanted one without leakage.

    At it the vibration of a turning motor cancels over all periods.

    Vibration of order k at f_m has k f_m T turns in a period T. With f_m T = n + 1/P its phase advances by k/P from each of P
    periods to the next, so that the sum over the P periods vanishes on every line, with all that it mixes with the excitation,
    unless P divides k.

    Args:
        wanted_rps: Wanted speed.
        period_s: Period T of the excitation.
        periods: Number of periods P.
        orders: Orders k of the vibration.

    Raises:
        ValueError: P divides one of the orders, so that no such speed exists.
    """
    if periods < 2 or any(order % periods == 0 for order in orders):
        raise ValueError(f"vibration of orders {', '.join(map(str, orders))} does not average out over {periods} periods")
    turns = max(0, round(wanted_rps * period_s - 1.0 / periods))
    return (turns + 1.0 / periods) / period_s
