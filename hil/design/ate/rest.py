"""Noise of a sensor while the motors stand."""

import math

import numpy as np
import scipy

from hil.control.arrays import Real
from hil.design.ate.ripple import stretches

STANDING = 1e-3
"""Accuracy: speed over the largest one below which the motor stands: a factor of 2 changes 0.1 at most, errors by 5 %."""
STILL_ROOM = 2.0
"""Probability: the sensor's variance over that while the motor stands, which of 30 samples is right to 26 %: 4 standard
errors."""


def variance_at_rest(signal: Real, speed: Real) -> float:
    """Least variance of a signal over the rests; infinite if there is none.

    The speed is that of the motor, or of several; shape (n,) or (motors, n).
    """
    turning = np.abs(np.atleast_2d(speed))
    is_still = np.all(turning <= STANDING * np.max(turning, initial=0.0), axis=0)
    return min((float(np.var(scipy.signal.detrend(signal[rows]), ddof=2)) for rows in stretches(is_still)), default=math.inf)
