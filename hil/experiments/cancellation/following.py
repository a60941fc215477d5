"""Motor motion of a cancellation: its factor and delay.

The module also decides which delay learning uses.

A ramp's own start, friction and the gear's pull on the motor are in the band too, the more so the lower f_al is. So a delay
counts only beyond its standard error, where the motor has made the motion, and as long as the next pass vibrates less with it.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hil.analysis import band_passed, motor_speed_rps
from hil.design.transmission_error import TransmissionError
from hil.experiments.ate.motion import Ramps
from hil.experiments.cancellation.effect import TOP_FRACTION
from hil.recording import Recording

LEAST_DELAY_S = 1e-4
"""Least delay of the motor that is not the gear's effect on it: 0.03 ms on the reference robot, and 0.4° at 12 Hz."""
LEAST_PERIODS = 0.1
"""Least delay of it in SYNC periods: the angle is known once in a period, and what it does in between is not."""
DELAY_SIGMAS = 3.0
"""Standard errors from which a delay counts."""
LEAST_FACTOR = 0.1
"""Factor up to which the motor has not moved as it was asked to."""
MADE = (0.8, 1.25)
"""Factors between which the motor has made the motion, so that its delay means something."""
REST = 0.5
"""A remaining delay below this fraction of the last helpful correction counts as its remainder; it falls from pass to pass."""
LOWEST = 2.0
"""Order whose resonance every ramp passes; a lower one's where the limits allow."""
EDGE_PERIODS = 1.8
"""Beginning and end of a ramp that say nothing on how the motor follows, in periods of the band's lower edge: there the motion
itself is in the band."""
LEAST_INDEPENDENT = 12.0
"""Independent values of the motion from which a delay has a standard error."""


class Following(NamedTuple):
    """Factor and delay of the motor's motion over the intended one.

    Attributes:
        factor: Factor of the motion; 1 where the motor follows.
        late_s: Delay of it.
        late_error_s: Standard error of the delay.
        least_s: Least delay that is one.
    """

    factor: float
    late_s: float
    late_error_s: float
    least_s: float = LEAST_DELAY_S

    def is_significant(self, helped_s: float) -> bool:
        """True if the delay is significant and the motor follows.

        Args:
            helped_s: Delay that has helped in this pass: the rest of it may be smaller.
        """
        least = LEAST_DELAY_S if abs(self.late_s) < REST * helped_s else self.least_s
        return MADE[0] <= self.factor <= MADE[1] and abs(self.late_s) > max(least, DELAY_SIGMAS * self.late_error_s)


@dataclass
class DelaySearch:
    """Search of the set-points' delay from pass to pass.

    Attributes:
        delay_s: Delay with which the next pass is made.
    """

    delay_s: float = 0.0
    _before: tuple[float, float] | None = None
    _is_over: bool = False

    def take(self, following: Following | None, vibration_m_s2: float, *, is_last: bool) -> float | None:
        """Take the result of a pass into account.

        If the tip did not vibrate less with a delay, that delay is taken back.

        Args:
            following: Motor's motion in the pass; None if it was not measured.
            vibration_m_s2: Vibration of the tip in it.
            is_last: True after the last pass: a delay that no pass will try counts only as the rest of one that has helped.

        Returns:
            Factor of the motor's motion; None if it was not measured.
        """
        helped_s = 0.0
        if self._before is not None:
            if vibration_m_s2 < self._before[1]:
                helped_s = abs(self.delay_s - self._before[0])
            else:
                self.delay_s, self._is_over = self._before[0], True
        self._before = None
        is_significant = following is not None and following.is_significant(helped_s) and not self._is_over
        if following is not None and is_significant and (not is_last or abs(following.late_s) < REST * helped_s):
            self._before = self.delay_s, vibration_m_s2
            self.delay_s += following.late_s
        return None if following is None else following.factor


def motor_following(
    recording: Recording,
    motion: Ramps,
    axis: int,
    reduction_ratio: float,
    error: TransmissionError,
    band_hz: tuple[float, float],
) -> Following | None:
    """Measure factor and delay of a motor's motion.

    The intended motion is Δθ_m = −N θ_sync(θ_m).

    Least squares of the measured angle on the intended motion and its derivative, g Δθ_m − g δ Δθ̇_m, both band-passed around
    f_al. What they leave is not noise, and as wide as the band: it has two independent values for each hertz and second.

    Args:
        recording: Recording of a pass with the whole cancellation.
        motion: Ramps of the pass.
        axis: Axis number.
        reduction_ratio: N.
        error: Error that was cancelled.
        band_hz: Band of the vibration.

    Returns:
        Factor and delay; None if the ramps are too short to show them.
    """
    period, angle = recording.period_s, recording.axis(axis, "position_rad")
    intended = -reduction_ratio * error.angle_rad(angle)
    low, high = band_hz[0], min(band_hz[1], TOP_FRACTION / period)
    measured, wanted, rate = band_passed(np.stack([angle, intended, np.gradient(intended, period)]), period, (low, high))
    edge_s = EDGE_PERIODS / low
    rows = motion.direction(min(edge_s / motion.trajectory.ramp_s, 1.0)) != 0
    rows &= np.roll(rows, -round(edge_s / period))  # the end of a ramp says nothing either
    # an order below 2 comes into the band at a higher speed; below it, it is filtered off on both sides
    lowest = min(max(order, LOWEST) for order in error.amplitude_arcsec)
    rows &= np.abs(motor_speed_rps(recording, axis)) > low / lowest
    count = int(np.count_nonzero(rows))
    independent = 2.0 * (high - low) * count * period
    if independent < LEAST_INDEPENDENT:
        return None
    columns = np.stack([wanted[rows], rate[rows]], axis=1)
    solution = np.linalg.lstsq(columns, measured[rows], rcond=None)[0]
    gain = float(solution[0])
    if gain <= LEAST_FACTOR:
        return Following(gain, 0.0, math.inf)
    left, late_s = measured[rows] - columns @ solution, -float(solution[1]) / gain
    variance = float(np.linalg.pinv(columns.T @ columns)[1, 1]) * float(left @ left) / (independent - 2.0)
    # a motor cannot lead its set-points: reject the estimate
    late_error_s = math.sqrt(variance) / gain if late_s > -period else math.inf
    return Following(gain, late_s, late_error_s, max(LEAST_DELAY_S, LEAST_PERIODS * period))
