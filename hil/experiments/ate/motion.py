"""Motion of a pass from which the transmission error is identified: a ramp forwards, and one back."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.bench.bench import Bench
from hil.control.arrays import Real
from hil.control.trajectory import ConstantAcceleration, Smooth, sample_times
from hil.experiments.ate.ramp import Ramp
from hil.experiments.motions import MARGIN_REV
from hil.master.motion import Motion, RunResult
from hil.master.run import APPROACH_RAMP_S

DWELL_S, TAIL_S = 0.3, 0.5
"""Bound: rest before each ramp, and behind it, in which the arm rings down: in both, at 12 Hz and ζ = 0.05, to 1/20."""


@dataclass(frozen=True)
class Ramps:
    """One pass: a ramp in either direction.

    Attributes:
        trajectory: The ramp forwards.
        motion: Motion of the robot, the approach to the ramp's beginning included.
    """

    ramp: Ramp
    trajectory: ConstantAcceleration
    motion: Motion
    forward: slice
    backward: slice
    low_rev: float
    high_rev: float

    def direction(self, skip: float = 0.0) -> NDArray[np.int8]:
        """Direction of each row of a rising speed; shape (n,).

        It is +1 and −1 in the rows of the ramps without their first fraction `skip`, else 0.
        """
        signs = np.zeros(len(self.motion.time_s), dtype=np.int8)
        period, ramp = self.motion.period_s, self.trajectory.ramp_s
        for rows, sign in ((self.forward, 1), (self.backward, -1)):
            time = np.arange(rows.stop - rows.start) * period - self.trajectory.dwell_s
            signs[rows] = sign * ((time >= skip * ramp) & (time <= ramp))
        return signs


PassKeeper = Callable[[int, RunResult, Ramps], object]
"""What keeps a pass, counted from 1, with the ramps that were requested; it may have been stopped."""


def ramps(bench: Bench, start_rev: float, ramp: Ramp, centre_rev: float | None = None) -> Ramps:
    """Lay out one pass from the present position.

    The motor moves to the ramp's beginning, then forwards and back. The ramp is centred as far as the limits allow.

    On an arm it ends where it began, so that the next one, and those of other axes, find it in the same posture.

    The centre is the present position unless it is given.
    """
    axis, travel, braking = ramp.limits.axis, ramp.travel_rev, ramp.limits.braking_rps_s
    limits, period_s = bench.axis[axis].limits, bench.bus.sync_period_s
    trajectory = ConstantAcceleration(ramp.acceleration_rps_s, ramp.end_rps, braking, DWELL_S, TAIL_S)
    lowest = limits.position_min_rev + MARGIN_REV
    centre_rev = start_rev if centre_rev is None else centre_rev
    low = min(max(centre_rev - 0.5 * travel, lowest), limits.position_max_rev - MARGIN_REV - travel)
    turn = 2.0 * math.pi
    away = turn * (low - start_rev)
    there = _approach(away, bench.approach_rps, limits.acceleration_rps_s, period_s)
    up = trajectory.motor_angle(sample_times(trajectory.duration_s, period_s))
    home = away - there[1:] if bench.arm is not None else np.zeros(0)
    angle = np.concatenate([there, away + up, away + up[-1] - up, home])
    first, second = len(there), len(there) + len(up)
    times = np.arange(len(angle), dtype=np.float64) * period_s
    motion = Motion((axis,), times, angle[:, np.newaxis], starts_at_home=False)
    return Ramps(ramp, trajectory, motion, slice(first, second), slice(second, second + len(up)), low, low + travel)


def _approach(away_rad: float, speed_rps: float, most_rps_s: float | None, period_s: float) -> Real:
    distance = abs(away_rad) / (2.0 * math.pi)
    if distance < 1e-3:
        return np.full(1, away_rad)
    smooth = Smooth.way(distance, speed_rps, APPROACH_RAMP_S, most_rps_s)
    return np.asarray(away_rad * smooth.position(sample_times(smooth.duration_s, period_s)))
