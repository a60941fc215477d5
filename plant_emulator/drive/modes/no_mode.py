"""The drive under torque with no mode of operation chosen: it holds its position until there is one."""

from typing import ClassVar

from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.motion import record


class NoMode(ModeOfOperation):
    """6060h = 0 when the drive is enabled: the motor is held where it stands, and no set-point is listened to.

    Masters exist that enable first and choose the mode afterwards (Motor402 of ros2_canopen). CiA 402 leaves open what a drive
    does meanwhile. The targets keep what the master has written; the mode that comes begins as it does from rest. Position limits
    do not act: nothing is commanded that they could stop, and homing is a way back from outside of them.
    """

    number: ClassVar[int] = 0
    motion = record.PROFILE

    def start(self) -> None:
        """Stand."""
        super().start()
        self.data.limits.switch_position_limits(on=False)

    def end(self) -> None:
        """Give the position limits back."""
        self.data.limits.switch_position_limits(on=True)
