"""Instants at which a motor's angle was sampled.

They are those of the time stamps, or even ones if only the stamps jitter.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.control.arrays import Real


@dataclass(frozen=True)
class SampledInstants:
    """Instants of samples.

    Attributes:
        time_s: The instants; shape (n,).
        kind: `stamps`, or `even` where an angle over even instants is smoother than over the stamps.
        uncertain_s: Root of the mean square of the time that the angle is still off a smooth motion.
    """

    time_s: Real
    kind: Literal["stamps", "even"]
    uncertain_s: float

    @property
    def words(self) -> str:
        """The clock in words."""
        name = "the stamps" if self.kind == "stamps" else "even sampling, only the stamps jitter"
        return f"{name}; the motor angle shows the instants to {1e3 * self.uncertain_s:.2g} ms"


def clock_of(stamps_s: Real, motor_angle_rad: Real) -> SampledInstants:
    """Instants over which a motor's angle is smoothest.

    Args:
        stamps_s: Time stamps; shape (n,).
        motor_angle_rad: Motor angle; shape (n,).
    """
    count = len(stamps_s)
    slope, start = np.polyfit(np.arange(count), stamps_s, 1)
    even = start + slope * np.arange(count)
    sorted_stamps = np.maximum.accumulate(stamps_s + 1e-9 * np.arange(count))
    off_even, off_stamps = _roughness_s(even, motor_angle_rad), _roughness_s(sorted_stamps, motor_angle_rad)
    if off_even <= off_stamps:
        return SampledInstants(even, "even", off_even)
    return SampledInstants(sorted_stamps, "stamps", off_stamps)


def _roughness_s(time_s: Real, angle_rad: Real) -> float:
    """Rms time by which samples miss a cubic through their neighbours."""
    t = [time_s[i : len(time_s) - 4 + i] for i in range(5)]
    a = [angle_rad[i : len(angle_rad) - 4 + i] for i in range(5)]
    others = (0, 1, 3, 4)
    predicted = np.zeros(len(t[0]))
    for i in others:
        weight = np.ones(len(t[0]))
        for j in others:
            if j != i:
                weight *= (t[2] - t[j]) / np.where(np.abs(t[i] - t[j]) > 1e-9, t[i] - t[j], 1e-9)
        predicted += weight * a[i]
    speed = np.abs(a[4] - a[0]) / np.maximum(t[4] - t[0], 1e-9)
    moving = speed > 0.1 * float(np.max(speed, initial=0.0))
    off = np.abs(predicted - a[2])[moving] / np.maximum(speed[moving], 1e-9)
    return float(np.sqrt(np.mean(np.minimum(off, np.percentile(off, 99.0)) ** 2))) if len(off) else 0.0
