"""The drive under torque without a mode of operation.

It holds its position until a mode is chosen.
"""

from typing import ClassVar

from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.motion import record


class NoMode(ModeOfOperation):
    """Enabled drive with 6060h = 0.

    The motor is held at its position, and set-points are ignored.

    Some masters enable first and choose the mode afterwards (Motor402 of ros2_canopen). CiA 402 leaves open what a drive
    does meanwhile. The targets keep the master's values; the next mode begins as from rest. Position limits do not act: no
    commanded motion exists that they could stop, and homing leads back from outside them.
    """

    number: ClassVar[int] = 0
    motion = record.PROFILE

    def start(self) -> None:
        """Hold the motor at its position."""
        super().start()
        self.data.limits.switch_position_limits(on=False)

    def end(self) -> None:
        """Reactivate the position limits."""
        self.data.limits.switch_position_limits(on=True)
