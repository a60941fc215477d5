"""Cyclic synchronous position, velocity and torque: set-points by SYNC, nothing planned."""

from typing import Any

from drive_profiles.standard.cia402 import FOLLOWING_ERROR, FOLLOWS_COMMAND, Mode
from drive_profiles.standard.object_address import ObjectAddress
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.motion import record
from plant_emulator.motion.axes import live


class Cyclic(ModeOfOperation):
    """Common part of the cyclic modes; bit 12: set-points are followed."""

    def __init__(self, stage: PowerStage) -> None:
        super().__init__(stage)
        self._axes = stage.axes
        self._mode: Any = live(stage.axes.motion, "mode")
        self._following_count: Any = live(stage.axes.motion, "following_count")

    def status(self) -> int:
        """Return bit 12 of the status word.

        Bit 13 is reserved, and so is bit 10 except during a halt.
        """
        return FOLLOWS_COMMAND if self._mode[self.row] == self.motion else super().status()


class CyclicPosition(Cyclic):
    """CSP: 607Ah + 60B0h, with offsets 60B1h and 60B2h."""

    number, motion, is_plain = Mode.CSP, record.POSITION, True
    needs_interpolation = True

    def start(self) -> None:
        """Take the motor's position as set-point; ignore earlier targets."""
        super().start()
        # less the offset, which the mode adds: else a 60B0h that is there already would make the motor jump
        self.targets.hold_position(with_offset=True)

    def synchronise(self, now: int) -> None:
        """Apply the newest set-point at SYNC, for the next interpolation period."""
        if self._mode[self.row] == record.POSITION:
            self._axes.set_point(self.row, self.data.cyclic_target_counts())

    def status(self) -> int:
        """Return bit 12, and bit 13 while 6065h is exceeded."""
        word = FOLLOWS_COMMAND if self._mode[self.row] == record.POSITION else super().status()
        return word | FOLLOWING_ERROR if self._following_count[self.row] > 0 else word


class MakersPosition(CyclicPosition):
    """A position mode of the drive's maker.

    It takes its own target with every SYNC; the emulator interpolates it as in CSP.
    """

    is_plain = False

    def __init__(self, stage: PowerStage, number: int, target: ObjectAddress) -> None:
        super().__init__(stage)
        self.number = number  # type: ignore[misc, assignment]  # the maker's own
        self._own = self.data.dictionary.cell(*target)

    def start(self) -> None:
        """Take the motor's position as set-point; ignore earlier targets."""
        super().start()
        self._own.value = self.data.shown_position(self._axes.counts(self.row))

    def synchronise(self, now: int) -> None:
        """Apply the newest set-point at SYNC."""
        if self._mode[self.row] == record.POSITION:
            target: Any = self._own.value
            self._axes.set_point(self.row, self.data.counting.encoder_counts(target))


class CyclicVelocity(Cyclic):
    """CSV: 60FFh + 60B1h, torque offset 60B2h; the position loop is open."""

    number, motion = Mode.CSV, record.VELOCITY
    needs_interpolation = True

    def start(self) -> None:
        """Take the motor speed as set-point, 0 after the brake."""
        is_braked = self.stage.law_mode == record.BRAKED
        super().start()
        self.targets.hold_speed(0.0 if is_braked else self.data.speed_rad_s)

    def synchronise(self, now: int) -> None:
        """Apply the newest set-point at SYNC, for the next interpolation period."""
        if self._mode[self.row] == record.VELOCITY:
            self._axes.set_speed(self.row, self.targets.speed_rad_s())


class CyclicTorque(Cyclic):
    """CST: 6071h + 60B2h, effective at once.

    SYNC shows that the master is still there.
    """

    number, motion, is_plain = Mode.CST, record.TORQUE, True
    needs_gains = False

    def __init__(self, stage: PowerStage) -> None:
        super().__init__(stage)
        self._elapsed_periods: Any = live(stage.axes.motion, "elapsed_periods")

    def synchronise(self, now: int) -> None:
        """Note at SYNC that the set-point is on time.

        From there the law counts how long the next one is overdue.
        """
        if self._mode[self.row] == record.TORQUE:
            self._elapsed_periods[self.row] = 0

    def start(self) -> None:
        """Take the motor torque as set-point, 0 after the brake."""
        is_braked = self.stage.law_mode == record.BRAKED
        super().start()
        if is_braked:
            self.targets.forget_torque()
        else:
            self.targets.hold_torque(float(self.stage.motion["torque_nm"]))
