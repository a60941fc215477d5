"""Late samples of a motor angle, moved back in time.

A frame in progress delays SYNC by up to its length, and a drive that samples in its own control period then samples up to one
period late. At speed v such a sample is off by v δ: on the reference robot with δ = 250 µs and 50 rad/s by 26″ behind the gear,
which is more than its transmission error.

A spline through all other samples tells where the motor was: a late sample is ahead by far more than the scatter around it, and
by less than the motor turns in a SYNC period. Robust weights (Tukey's biweight) find the spline. Nothing makes a sample early, so
a sample behind the spline keeps its weight.

Source: J. W. Tukey, in Robustness in Statistics, Academic Press 1979, chapter 8.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy
from numpy.typing import NDArray

from hil.control.arrays import Real
from hil.design.estimation import SEARCHED_SIGMAS

RESOLVED = 0.1
"""Accuracy: largest frequency of a ripple, in units of the sampling rate: at half of it the spline leaves 9 % of the ripple, at
it all, which counts as scatter."""
KNOT_SAMPLES, KNOT_DEGREE = 8, 5
"""Accuracy: samples between the spline's knots, and its degree: of 48 late samples at 13 to 20 bits, a factor of 2 leaves 3 %
more."""
WINDOW_SAMPLES = 101
"""Accuracy: samples of which the scatter is the median: a factor of 2 changes nothing of these 48."""
LEAST_PERIODS, MOST_PERIODS = 0.02, 1.1
"""Bound: delays of a late sample in SYNC periods; shorter ones do not matter, and longer ones are no delay of SYNC."""
REWEIGHTINGS, SETTLED, LEAST_WEIGHT = 5, 0.05, 1e-4
"""Accuracy: rounds of reweighting, change of a weight below which one is the last, and a late sample's weight, not 0 for the
spline: a factor of 2 changes nothing of these 48."""


@dataclass(frozen=True)
class OnTime:
    """A motor angle as it was at equally spaced instants.

    Attributes:
        angle_rad: The angle; late samples are moved by whole counts.
        delay_s: Delay of the one that is off most.
    """

    angle_rad: Real
    count: int = 0
    delay_s: float = 0.0


def on_time(angle_rad: Real, period_s: float, resolution_rad: float, order: float) -> OnTime:
    """Move the late samples of a motor angle back in time.

    The angle stays as it is if the gear's ripple is too fast to be told from late samples.

    Args:
        angle_rad: θ_m at each SYNC; shape (n,).
        resolution_rad: Step of the encoder; 0 for none.
        order: Highest order k of the gear's ripple.
    """
    count = len(angle_rad)
    if count < WINDOW_SAMPLES:
        return OnTime(angle_rad)
    speed = np.gradient(angle_rad)
    forwards, turn = np.sign(speed), np.abs(speed)
    if order * float(np.max(np.abs(speed))) / (2.0 * np.pi) > RESOLVED:
        return OnTime(angle_rad)
    ahead = np.zeros(count)
    near, far = angle_rad[1:-3] + angle_rad[3:-1], angle_rad[:-4] + angle_rad[4:]
    cubic = (4.0 * near - far) / 6.0  # through the four neighbours
    ahead[2:-2] = forwards[2:-2] * (angle_rad[2:-2] - cubic)
    scatter = _scatter(ahead, resolution_rad)
    if not np.any(_is_late(ahead, scatter, turn)):
        return OnTime(angle_rad)
    weight = _weight(ahead, scatter)
    place = np.arange(count, dtype=np.float64)
    inner = place[KNOT_SAMPLES : count - KNOT_SAMPLES : KNOT_SAMPLES]
    knots = np.concatenate([np.zeros(KNOT_DEGREE + 1), inner, np.full(KNOT_DEGREE + 1, count - 1.0)])
    for _ in range(REWEIGHTINGS):
        spline = scipy.interpolate.make_lsq_spline(place, angle_rad, knots, KNOT_DEGREE, weight)(place)
        ahead, before = forwards * (angle_rad - spline), weight
        scatter = _scatter(ahead, resolution_rad)
        weight = _weight(ahead, scatter)
        if np.max(np.abs(weight - before)) < SETTLED:
            break
    late = _is_late(ahead, scatter, turn)
    if not np.any(late):
        return OnTime(angle_rad)
    moved = ahead if resolution_rad == 0.0 else resolution_rad * np.round(ahead / resolution_rad)
    most = int(np.argmax(np.where(late, ahead, 0.0)))
    delay_s = period_s * float(ahead[most] / turn[most])
    return OnTime(np.where(late, angle_rad - forwards * moved, angle_rad), int(np.sum(late)), delay_s)


def _scatter(ahead: Real, resolution_rad: float) -> Real:
    """Standard deviation of most samples around each, at least that of rounding."""
    median = scipy.ndimage.median_filter(np.abs(ahead), WINDOW_SAMPLES)
    return np.asarray(np.maximum(median / NormalDist().inv_cdf(0.75), max(resolution_rad / np.sqrt(12.0), np.finfo(float).tiny)))


def _is_late(ahead: Real, scatter: Real, turn: Real) -> NDArray[np.bool_]:
    """True for a sample that a delay explains, and noise does not."""
    return np.asarray((ahead > SEARCHED_SIGMAS * scatter) & (ahead > LEAST_PERIODS * turn) & (ahead < MOST_PERIODS * turn))


def _weight(ahead: Real, scatter: Real) -> Real:
    """Tukey's biweight of each sample that is ahead; the least beyond `SEARCHED_SIGMAS`."""
    return np.maximum((1.0 - np.clip(ahead / (SEARCHED_SIGMAS * scatter), 0.0, 1.0) ** 2) ** 2, LEAST_WEIGHT)
