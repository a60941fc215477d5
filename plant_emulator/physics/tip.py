"""Acceleration at the tip, and its sensor.

The tip is on the planar chain of shoulder, elbow and wrist, or on the lever of a single axis.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.trajectory import PlanarChain
from plant_emulator.core import CORE

Real = NDArray[np.float64]


class MovedTip:
    """The tip that the axes of a robot move.

    Args:
        levers_m: Lever of the tip about each axis.
        chain: The arm of shoulder, elbow and wrist; None where there is none.
        chain_rows: Their places among the axes.
        home_rad: Their joint angles where the arm angles are zero.

    Attributes:
        shared: The tip in C, a `tip`.
        now: Room for an acceleration, shape (3,).
        now_by: Pointer to it.
    """

    def __init__(
        self,
        levers_m: Sequence[float],
        chain: PlanarChain | None = None,
        chain_rows: Sequence[int] = (),
        home_rad: Sequence[float] = (),
    ) -> None:
        self.shared, self.now = CORE.new("tip"), np.zeros(3)
        self.now_by = CORE.pointer(self.now)
        self._kept = CORE.pointer(np.array(levers_m, np.float64)), CORE.pointer(np.zeros((len(levers_m), 3)))
        self.shared.levers_m, self.shared.moved = self._kept
        if chain is not None:
            self.shared.has_chain, self.shared.chain_rows, self.shared.home_rad = 1, list(chain_rows), list(home_rad)
            self.shared.upper_arm_m, self.shared.tool_m = chain.upper_arm_m, chain.tool_m
            self.shared.forearm_m, self.shared.forearm_offset_m = chain.forearm_m


class TipSensor:
    """Noise and resolution of the accelerometer, seeded, three values per sample.

    Args:
        noise_m_s2: Standard deviation of the white noise of each sample.
        resolution_m_s2: Step of the output; 0 for none.
        generator: The noise's source.
        mixing: What each channel reads of X, Y and Z, shape (3, 3); left out, each reads its own alone.
    """

    def __init__(
        self,
        noise_m_s2: float,
        resolution_m_s2: float,
        range_m_s2: float,
        generator: np.random.Generator,
        mixing: Real | None = None,
    ) -> None:
        rows = np.zeros(1, CORE.dtype("tip_sensor"))
        if mixing is not None and not np.array_equal(mixing, np.eye(3)):
            rows["is_mixed"], rows["mixing"] = 1, mixing
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

    def samples(self, accelerations: Real) -> Real:
        """The sensor's outputs for true accelerations in m/s²; shape (n, 3)."""
        shown, at = np.empty((len(accelerations), 3)), 0
        while at < len(shown):
            self.draw()
            end = min(len(shown), at + len(self._draws) - self._next[0])
            given, taken = (CORE.pointer(each[at:end]) for each in (accelerations, shown))
            CORE.call.sample_tips(self.shared, end - at, given, taken)
            at = end
        return shown
