"""What a run adds to its set-points in every cycle, from what the motors are measured to do."""

from collections.abc import Sequence
from typing import Protocol


class Corrector(Protocol):
    """Gives a correction of every axis' set-point, in the order of the motion's axes; drive-closed runs only.

    Attributes:
        uses_torque: Whether torque offsets (60B2h) are to be mapped.
    """

    uses_torque: bool

    def step(self, references_rad: Sequence[float], positions_rad: Sequence[float]) -> tuple[Sequence[float], Sequence[float]]:
        """The corrections to be sent with the next cycle.

        Args:
            references_rad: Where the motion wants the motors in the next cycle.
            positions_rad: Where they were measured in the last one.

        Returns:
            What is added to the references, in rad at the motor, and the torque offsets in N·m.
        """
        ...
