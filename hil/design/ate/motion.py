"""Motor's own motion in the accelerometer's signal.

Its factor is 1 if lever and reduction ratio are right.

Below the resonance the arm follows its motor, whatever the gear is like: neither soft wind-up nor hysteresis bends the motion
there. So the factor is fitted to beginnings and ends of the ramps in a band far below the resonance, over the whole recording.
Its regressor is the measured motor angle, whose rounding to counts draws a least-squares factor towards 0: the variance of the
rounding, q²/12, is known, and is taken out of the normal equations (errors in variables).
"""

import math
from collections.abc import Sequence

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.design.ate.model import Arm, Sensing, Sweep, levelled, resolution_rad
from hil.design.transmission_error import acceleration_spectrum, shown_waves

BELOW_RESONANCE = (0.08, 0.35)
"""Accuracy: band of the fit by the arm's frequency; at its end a gear that is 30 % softer than thought is felt with 6 %."""
BLOCK_PERIODS = 2.0
"""Accuracy: the same of the factor's standard error, in periods of the band's lower edge: a factor of 2 changes nothing."""


def motion_factor(
    sweeps: Sequence[Sweep], reduction_ratio: float, sensing: Sensing, orders: Sequence[float], arm: Arm
) -> tuple[float, float]:
    """Estimate the factor of the motor's motion and its standard error.

    Least squares of the signal on g H(s) e^{−sΔ} θ̈_m/N and the columns of every order, all in a band below the resonance, less
    the encoder's noise. The standard error comes from the scatter between n blocks of time, since the residual is not white.
    Only n − 1 blocks are independent, since their gradients add up to 0. A single block shows no scatter: the error is then 1.
    """
    count = 1 + 2 * len(orders)
    square, wanted, noise, blocks = np.zeros((count, count)), np.zeros(count), 0.0, []
    for sweep in sweeps:
        matrix, values, variance, every = _below(sweep, reduction_ratio, sensing, orders, arm)
        square += matrix.T @ matrix
        wanted += matrix.T @ values
        noise += variance * len(values)
        length = max(1, round(BLOCK_PERIODS / (BELOW_RESONANCE[0] * arm.resonance_hz) / (sweep.period_s * every)))
        blocks += [(matrix[i : i + length], values[i : i + length]) for i in range(0, len(values), length)]
    square[0, 0] -= noise
    inverse = np.linalg.pinv(square, hermitian=True)
    factors = inverse @ wanted
    scores = np.array([rows.T @ (values - rows @ factors) for rows, values in blocks])
    spread = inverse @ (scores.T @ scores) @ inverse
    if len(blocks) < 2:
        return float(factors[0]), 1.0
    return float(factors[0]), math.sqrt(len(blocks) / (len(blocks) - 1) * max(0.0, float(spread[0, 0])))


def _below(
    sweep: Sweep, reduction_ratio: float, sensing: Sensing, orders: Sequence[float], arm: Arm
) -> tuple[Real, Real, float, int]:
    """Columns and signal in the band below the resonance.

    Returns every n-th sample of both, the noise variance of the first column, and n.
    """
    angle, period_s = sweep.motor_angle_rad, sweep.period_s
    band_hz = (BELOW_RESONANCE[0] * arm.resonance_hz, BELOW_RESONANCE[1] * arm.resonance_hz)
    every = max(1, int(0.5 / period_s / (4.0 * band_hz[1])))
    length = int(scipy.fft.next_fast_len(-(-(len(angle) + round(2.0 / band_hz[0] / period_s)) // every), real=True))
    full = length * every
    waves = np.vstack([angle / reduction_ratio, shown_waves(angle, period_s, orders)])
    frequency, spectra = acceleration_spectrum(waves, period_s, full)
    band = scipy.signal.butter(2, band_hz, "bandpass", fs=1.0 / period_s, output="sos")
    gain = np.abs(scipy.signal.sosfreqz(band, frequency, fs=1.0 / period_s)[1]) ** 2
    shape = sensing.gain * gain * arm.response(frequency)
    spectra = spectra * shape
    own = sensing.motor_inertia_kg_m2 * reduction_ratio * gain * np.exp(-2j * math.pi * frequency * arm.delay_s)
    known = own * acceleration_spectrum(angle[np.newaxis] / reduction_ratio, period_s, full)[1][0]
    seen = gain * scipy.fft.rfft(levelled(sweep.signal), full) - known
    inside = slice(0, length // 2)
    rows = scipy.fft.irfft(np.vstack([spectra[:, inside], seen[inside]]), length, axis=-1)[:, : len(angle[::every])] / every
    # a rounded angle carries white noise of q²/12, which is twice differentiated and filtered like the angle
    step = resolution_rad(angle) / reduction_ratio
    passed = np.abs(shape * (2.0 * math.pi * frequency) ** 2) ** 2
    variance = step**2 / 12.0 * float(np.mean(passed))
    return np.asarray(rows[:-1].T), np.asarray(rows[-1]), variance, every
