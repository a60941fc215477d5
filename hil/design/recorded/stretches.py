"""Stretches of a recording in which the motor turns one way."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hil.control.arrays import Real

MOVING = 0.03
"""Speed from which a motor moves, by the quickest that it does; what is slower begins or ends a motion. In four recordings a
factor of 2 changes 0.7, and errors by 51 %."""
ACROSS = 4
"""Accuracy: samples to either side between which a speed is taken: a factor of 2 changes nothing in two recordings."""
QUICK = 95.0
"""Probability: percentile of the speeds that counts as the quickest."""


@dataclass(frozen=True)
class MotionStretch:
    """Rows in which the motor turns one way.

    Attributes:
        direction: +1 forwards, −1 backwards.
        speed_rps: Median of its speed, without a sign.
    """

    rows: slice
    direction: int
    turns: float
    speed_rps: float
    from_s: float
    to_s: float


def speed_of(motor_angle_rad: Real, time_s: Real, across: int = ACROSS) -> Real:
    """Speed of the motor in rev/s; shape (n,)."""
    count = len(time_s)
    row = np.arange(count)
    before, behind = np.maximum(row - across, 0), np.minimum(row + across, count - 1)
    elapsed = np.maximum(time_s[behind] - time_s[before], 1e-9)
    return np.asarray((motor_angle_rad[behind] - motor_angle_rad[before]) / elapsed / (2.0 * math.pi))


def stretches(motor_angle_rad: Real, time_s: Real, least_turns: float = 0.0) -> list[MotionStretch]:
    """Find all stretches of at least so many revolutions, in their order.

    Raises:
        ValueError: The shapes differ.
    """
    if motor_angle_rad.ndim != 1 or motor_angle_rad.shape != time_s.shape:
        raise ValueError(f"motor angle and time have shapes {motor_angle_rad.shape} and {time_s.shape}; both must be (n,)")
    if len(time_s) < 2:
        return []
    speed = speed_of(motor_angle_rad, time_s)
    quick = float(np.percentile(np.abs(speed), QUICK))
    sign = np.where(np.abs(speed) > MOVING * quick, np.sign(speed), 0.0).astype(np.int8)
    edges = np.flatnonzero(np.diff(sign)) + 1
    bounds = [0, *map(int, edges), len(sign)]
    found = []
    for start, stop in pairwise(bounds):
        turns = abs(float(motor_angle_rad[stop - 1] - motor_angle_rad[start])) / (2.0 * math.pi)
        if sign[start] and turns >= least_turns:
            rows = slice(start, stop)
            found.append(_stretch(rows, int(sign[start]), turns, speed, time_s))
    return found


def parts_of(stretch: MotionStretch, motor_angle_rad: Real, time_s: Real, turns: float, most: int) -> list[MotionStretch]:
    """Divide a stretch into equal parts of at least `turns` revolutions.

    A stretch that is too short for two parts stays whole.

    Args:
        motor_angle_rad: Motor angle of the whole recording.
        time_s: Time of the whole recording.
    """
    count = max(1, min(most, int(stretch.turns / turns)))
    angle = stretch.direction * motor_angle_rad[stretch.rows]
    limits = np.linspace(angle[0], angle[-1], count + 1)
    cuts = [0, *(int(np.argmax(angle >= limit)) for limit in limits[1:-1]), len(angle)]
    speed, start = speed_of(motor_angle_rad, time_s), stretch.rows.start
    return [
        _stretch(slice(start + a, start + b), stretch.direction, stretch.turns / count, speed, time_s)
        for a, b in pairwise(cuts)
        if b - a >= 2
    ]


def _stretch(rows: slice, direction: int, turns: float, speed: Real, time_s: Real) -> MotionStretch:
    median = float(np.median(np.abs(speed[rows])))
    return MotionStretch(rows, direction, turns, median, float(time_s[rows.start]), float(time_s[rows.stop - 1]))
