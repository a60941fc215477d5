"""Additions to the set-points of a run, in every cycle, from the measured motor angles."""

from collections.abc import Sequence
from typing import Protocol


class SetPointAdder(Protocol):
    """Adds to every axis' set-point, in the order of the motion's axes; drive-closed runs only.

    Attributes:
        uses_torque: True where torque offsets (60B2h) are needed.
    """

    uses_torque: bool

    def step(self, references_rad: Sequence[float], positions_rad: Sequence[float]) -> tuple[Sequence[float], Sequence[float]]:
        """Additions for the next cycle.

        Args:
            references_rad: Motor angles of the motion in the next cycle.
            positions_rad: Measured motor angles of the last cycle.

        Returns:
            Additions to the references, in rad at the motor, and torque offsets in N·m.
        """
        ...
