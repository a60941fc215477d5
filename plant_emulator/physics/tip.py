"""Acceleration at the tip, and its sensor.

The tip is on the planar chain of shoulder, elbow and wrist, or on the lever of a single axis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import floor

import numpy as np
from numpy.typing import NDArray

from hil.control.trajectory import PlanarChain

Vector = Sequence[float] | NDArray[np.float64]

_BLOCK = 256
"""Noise samples that are drawn at once: a generator's call costs more than its numbers."""


def lever_acceleration(lever_m: float, arm_speed: float, arm_acceleration: float) -> tuple[float, float, float]:
    """Return the acceleration at a lever: radial, sideways, tangential.

    (−L θ̇², 0, L θ̈) in m/s².
    """
    return -lever_m * arm_speed * arm_speed, 0.0, lever_m * arm_acceleration


def chain_acceleration(chain: PlanarChain, angles: Vector, speeds: Vector, accelerations: Vector) -> tuple[float, float, float]:
    """Return the acceleration (X, Y, Z) of the tip in m/s².

    Gravity is left out; Y is 0 in a planar chain.

    With the links' angles α_i above the horizontal and their vectors r_i: a = Σ (α̈_i ŷ×r_i − α̇_i² r_i).

    Args:
        chain: The arm.
        angles: Joint angles q₂, q₃, q₅ in rad, arm side; shape (3,).
        speeds: Their speeds in rad/s; shape (3,).
        accelerations: Their accelerations in rad/s²; shape (3,).
    """
    # link by link, written out: a loop costs three times as much, and this is asked at every SYNC
    (q2, q3, q5), (w2, w3, w5), (a2, a3, a5) = angles, speeds, accelerations
    alpha, rate, change = 0.5 * math.pi - q2, -w2, -a2
    length = chain.upper_arm_m
    link_x, link_z = length * math.cos(alpha), length * math.sin(alpha)
    x = -change * link_z - rate * rate * link_x
    z = change * link_x - rate * rate * link_z
    alpha, rate, change = alpha + q3, rate + w3, change + a3
    cos, sin = math.cos(alpha), math.sin(alpha)
    length, width = chain.forearm_m
    link_x, link_z = length * cos - width * sin, length * sin + width * cos
    x += -change * link_z - rate * rate * link_x
    z += change * link_x - rate * rate * link_z
    alpha, rate, change = alpha + q5, rate + w5, change + a5
    length = chain.tool_m
    link_x, link_z = length * math.cos(alpha), length * math.sin(alpha)
    x += -change * link_z - rate * rate * link_x
    z += change * link_x - rate * rate * link_z
    return x, 0.0, z


@dataclass
class TipSensor:
    """Noise and resolution of the accelerometer.

    It is seeded, with one draw of three values per sample.

    Attributes:
        noise_m_s2: Standard deviation of the white noise of each sample.
        resolution_m_s2: Step of the output; 0 for none.
        range_m_s2: Acceleration at which it saturates.
        generator: The noise's source.
    """

    noise_m_s2: float
    resolution_m_s2: float
    range_m_s2: float
    generator: np.random.Generator
    _noise: list[list[float]] = field(default_factory=list, repr=False)

    def sample(self, acceleration: tuple[float, float, float]) -> tuple[float, float, float]:
        """The sensor's output for a true acceleration, m/s²."""
        if not self._noise:
            self._noise = self.generator.standard_normal((_BLOCK, 3)).tolist()[::-1]
        (x, y, z), (draw_x, draw_y, draw_z) = acceleration, self._noise.pop()
        noise, step, reach = self.noise_m_s2, self.resolution_m_s2, self.range_m_s2
        x, y, z = x + noise * draw_x, y + noise * draw_y, z + noise * draw_z
        if step > 0.0:
            x, y, z = step * floor(x / step + 0.5), step * floor(y / step + 0.5), step * floor(z / step + 0.5)
        if -reach <= x <= reach and -reach <= y <= reach and -reach <= z <= reach:
            return x, y, z
        return min(reach, max(-reach, x)), min(reach, max(-reach, y)), min(reach, max(-reach, z))
