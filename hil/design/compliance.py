"""Compliance of a closed loop, by frequency.

Compliance is the motor angle per disturbing torque.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Complex, Real
from hil.design.frequency import Loop

COMPLIANCE_BAND_HZ = (0.1, 30.0)
"""Bound: band of process forces and of the arm's resonances, in which the largest compliance is searched."""
SLOW_HZ = 1.0
"""Bound: frequency that stands for process forces: the integral action still works there."""
POINTS = 600
"""Accuracy: frequencies of the curve, 1 % apart: a peak of ζ = 0.03 is at most 1.2 % too low."""


@dataclass(frozen=True)
class Compliance:
    """Compliance of an axis, in rad/(N·m) at the motor.

    Attributes:
        slow: Compliance at 1 Hz.
        peak: Largest compliance from 0.1 to 30 Hz.
        peak_hz: Frequency of that largest value.
    """

    slow: float
    peak: float
    peak_hz: float


def motor_compliance(loop: Loop, frequency_hz: Real, speed_rps: float = 0.0) -> Complex:
    """Motor angle per disturbing torque with the loop closed, in rad/(N·m).

        θ_m/τ_d(jω) = P/(1 + P C), shape of `frequency_hz`

    τ_d acts beside the motor's own torque.

    P is θ_m/τ of the plant, C the discrete law with its hold and delay (`Loop.controller`). Where |P C| is large this is 1/C, and
    C → K_pp K_vi/s at low frequency: halving all three gains makes the motor four times as compliant there, and about twice where
    K_vp rules.
    """
    plant = loop.plant.motor_angle_per_torque(frequency_hz)
    return np.asarray(plant / (1.0 + plant * loop.controller(frequency_hz, speed_rps)))


def compliance(loop: Loop, speeds_rps: Sequence[float] = (0.0,)) -> Compliance:
    """Find the largest compliance at any of some motor speeds.

    Filters that follow the motor speed act at some of these speeds only.
    """
    grid = np.geomspace(*COMPLIANCE_BAND_HZ, POINTS)
    gains = np.array([np.abs(motor_compliance(loop, grid, speed)) for speed in speeds_rps])
    slow = max(float(np.abs(motor_compliance(loop, np.array([SLOW_HZ]), speed))[0]) for speed in speeds_rps)
    row, column = np.unravel_index(int(np.argmax(gains)), gains.shape)
    return Compliance(slow, float(gains[row, column]), float(grid[column]))


def judged_speeds(loop: Loop, count: int = 9) -> tuple[float, ...]:
    """List the motor speeds at which a loop is judged."""
    inside = [speed for notch in loop.notches for speed in np.linspace(notch.start_rps, notch.end_rps, count).tolist()]
    return (0.0, *inside)
