"""Acceleration at the tip, and its sensor.

The tip is on the planar chain of shoulder, elbow and wrist, or on the lever of a single axis.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.trajectory import PlanarChain
from plant_emulator.core import CORE
from plant_emulator.robots.robot import Robot

Vector = Sequence[float] | NDArray[np.float64]


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


class MovedTip:
    """The tip that the axes of a robot move.

    Args:
        robot: The robot file.
        numbers: Axis number of each row.

    Attributes:
        shared: The tip in C, a `tip`.
        now: Room for an acceleration, shape (3,).
        now_by: Pointer to it.
    """

    def __init__(self, robot: Robot, numbers: Sequence[int]) -> None:
        self.shared, self.now = CORE.new("tip"), np.zeros(3)
        self.now_by = CORE.pointer(self.now)
        levers, moved = np.array([robot.axis[number].tip_lever_m for number in numbers]), np.zeros((len(numbers), 3))
        self._kept = self.shared.levers_m, self.shared.moved = CORE.pointer(levers), CORE.pointer(moved)
        home = robot.home_joints()
        if robot.geometry is None or home is None:
            return
        chain = robot.geometry.chain()
        self.shared.has_chain = 1
        self.shared.chain_rows = [numbers.index(number) for number in robot.chain_axes]
        self.shared.home_rad = home.tolist()
        self.shared.upper_arm_m, self.shared.tool_m = chain.upper_arm_m, chain.tool_m
        self.shared.forearm_m, self.shared.forearm_offset_m = chain.forearm_m


class TipSensor:
    """Noise and resolution of the accelerometer.

    It is seeded, with one draw of three values per sample.

    Args:
        noise_m_s2: Standard deviation of the white noise of each sample.
        resolution_m_s2: Step of the output; 0 for none.
        range_m_s2: Acceleration at which it saturates.
        generator: The noise's source.

    Attributes:
        shared: The sensor in C, a `tip_sensor`.
    """

    def __init__(self, noise_m_s2: float, resolution_m_s2: float, range_m_s2: float, generator: np.random.Generator) -> None:
        rows = np.zeros(1, CORE.dtype("tip_sensor"))
        rows["noise_m_s2"], rows["resolution_m_s2"], rows["range_m_s2"] = noise_m_s2, resolution_m_s2, range_m_s2
        rows["next"] = CORE.call.NOISE_SAMPLES
        used: Any = rows["next"]
        self._next, self._draws, self._generator = memoryview(used), rows["draws"][0], generator
        self._shown = np.zeros(3)
        self.shared, self._shown_by = CORE.pointer(rows, "tip_sensor"), CORE.pointer(self._shown)

    def draw(self) -> None:
        """Draw the noise of the next samples where all is used.

        A generator's call costs more than its numbers: many are drawn at once.
        """
        if self._next[0] >= len(self._draws):
            self._draws[:] = self._generator.standard_normal(self._draws.shape)
            self._next[0] = 0

    def sample(self, acceleration: Sequence[float]) -> tuple[float, float, float]:
        """The sensor's output for a true acceleration, m/s²."""
        self.draw()
        CORE.call.sample_tip(self.shared, acceleration, self._shown_by)
        x, y, z = self._shown.tolist()
        return x, y, z
