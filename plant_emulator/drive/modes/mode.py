"""Common part of all modes of operation."""

from typing import ClassVar

from drive_profiles.standard.cia402 import HALT, TARGET_REACHED, Object
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.drive.state_machine import stop_of_halt
from plant_emulator.motion import record


class ModeOfOperation:
    """A mode of operation, called only in Operation enabled.

    Attributes:
        number: Number of the mode in 6060h and 6061h, one of `Mode`; 0 if none is chosen.
        is_plain: True if SYNC means nothing more to it than that the axis gets its set-point: see `plant_emulator.image`.
        needs_gains: True if it closes a loop, which without gains would let the arm fall.
        needs_interpolation: True if its set-points come with SYNC and are interpolated, for which 60C2h must be fit.
        is_halted: True if the halt bit holds the axis.
        watches: True if `look` is to be called when time has passed.
    """

    number: ClassVar[int]
    motion: ClassVar[int]
    is_plain: ClassVar[bool] = False
    needs_gains: ClassVar[bool] = True
    needs_interpolation: ClassVar[bool] = False

    def __init__(self, stage: PowerStage) -> None:
        self.stage, self.data, self.targets, self.row = stage, stage.data, stage.targets, stage.row
        self.is_halted = self.watches = False
        self._word = 0

    # -- what the drive calls ------------------------------------------------------------------------------------------

    def begin(self, word: int) -> None:
        """Begin to act, from rest or from the present motion.

        Args:
            word: The control word in force: what is set in it already is not a rising edge, but halts.
        """
        self._word = word
        self.is_halted = self.watches = False
        self.start()
        if word & HALT:
            self.is_halted = True
            self.halt()

    def command(self, word: int) -> None:
        """Process a control word that has changed."""
        before, self._word = self._word, word
        if (word ^ before) & HALT:
            self.is_halted = bool(word & HALT)
            if self.is_halted:
                self.halt()
            else:
                self.resume()
        self.take(word, word & ~before)

    def status(self) -> int:
        """Return bits 10, 12 and 13 of the status word."""
        return TARGET_REACHED if self.is_halted and self.stage.is_braked_at_rest else 0

    def synchronise(self, now: int) -> None:
        """Process a SYNC, after the RPDOs have taken effect."""

    def follow(self) -> None:
        """Process a new 60FFh."""

    def look(self) -> None:
        """Check the motion after time has passed."""

    def end(self) -> None:
        """End when another mode, or none, comes into force."""

    # -- what the modes differ in --------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to act, without a jump."""
        self.stage.begin(self.motion)

    def take(self, word: int, rising: int) -> None:
        """Process the mode's own bits."""

    def halt(self) -> None:
        """Brake to rest as 605Dh demands, and stay under torque."""
        self.stage.stop(stop_of_halt(self.data.value(Object.HALT_OPTION)))

    def resume(self) -> None:
        """Continue after a halt."""
        self.start()


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
