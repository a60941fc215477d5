"""Cyclic synchronous position, velocity and torque: a set-point with every SYNC, and nothing planned by the drive."""

from typing import Any

from drive_profiles.standard.cia402 import FOLLOWING_ERROR, FOLLOWS_COMMAND, Mode
from drive_profiles.standard.object_address import ObjectAddress
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.motion import record
from plant_emulator.motion.axes import live


class Cyclic(ModeOfOperation):
    """The common part of the three: bit 12 tells whether the drive follows; while halted or braking it does not."""

    def __init__(self, stage: PowerStage) -> None:
        """Take hold of what every SYNC reads."""
        super().__init__(stage)
        self._axes = stage.axes
        self._mode: Any = live(stage.axes.motion, "mode")
        self._following_count: Any = live(stage.axes.motion, "following_count")

    def status(self) -> int:
        """Bit 12; bit 13 is reserved, and so is bit 10 but for a halt."""
        return FOLLOWS_COMMAND if self._mode[self.row] == self.motion else super().status()


class CyclicPosition(Cyclic):
    """CSP: 607Ah + 60B0h, with 60B1h and 60B2h beside it."""

    number, motion = Mode.CSP, record.POSITION
    needs_interpolation = True

    def start(self) -> None:
        """The set-point is where the motor stands, whatever was written before."""
        super().start()
        # less the offset, which the mode adds: else a 60B0h that is there already would make the motor jump
        self.targets.hold_position(with_offset=True)

    def synchronise(self, now: int) -> None:
        """With SYNC the newest set-point comes into force: the drive goes there in one interpolation period."""
        if self._mode[self.row] == record.POSITION:
            self._axes.set_point(self.row, self.data.cyclic_target_counts())

    def status(self) -> int:
        """Bit 12 and, while 6065h is exceeded, bit 13."""
        word = FOLLOWS_COMMAND if self._mode[self.row] == record.POSITION else super().status()
        return word | FOLLOWING_ERROR if self._following_count[self.row] > 0 else word


class MakersPosition(CyclicPosition):
    """A position mode of the drive's maker: its own target with every SYNC; here interpolated, as in CSP.

    Args:
        stage: The power stage.
        number: Its number in 6060h.
        target: Object of its target.
    """

    def __init__(self, stage: PowerStage, number: int, target: ObjectAddress) -> None:
        super().__init__(stage)
        self.number = number  # type: ignore[misc, assignment]  # the maker's own
        self._own = self.data.dictionary.cell(*target)

    def start(self) -> None:
        """The set-point is where the motor stands, whatever was written before."""
        super().start()
        self._own.value = self.data.shown_position(self._axes.counts(self.row))

    def synchronise(self, now: int) -> None:
        """With SYNC the newest set-point comes into force."""
        if self._mode[self.row] == record.POSITION:
            target: Any = self._own.value
            self._axes.set_point(self.row, self.data.counting.encoder_counts(target))


class CyclicVelocity(Cyclic):
    """CSV: 60FFh + 60B1h, with 60B2h beside it; the position loop is open."""

    number, motion = Mode.CSV, record.VELOCITY
    needs_interpolation = True

    def start(self) -> None:
        """The set-point is the speed that the motor has: 0, where it comes from behind the brake."""
        is_braked = self.stage.law_mode == record.BRAKED
        super().start()
        self.targets.hold_speed(0.0 if is_braked else self.data.speed_rad_s)

    def synchronise(self, now: int) -> None:
        """With SYNC the newest set-point comes into force: its speed is reached in one interpolation period."""
        if self._mode[self.row] == record.VELOCITY:
            self._axes.set_speed(self.row, self.targets.speed_rad_s())


class CyclicTorque(Cyclic):
    """CST: 6071h + 60B2h, at once; SYNC tells that the master is still there."""

    number, motion = Mode.CST, record.TORQUE
    needs_gains = False

    def __init__(self, stage: PowerStage) -> None:
        """Take hold of what every SYNC writes."""
        super().__init__(stage)
        self._elapsed_periods: Any = live(stage.axes.motion, "elapsed_periods")

    def synchronise(self, now: int) -> None:
        """With SYNC the set-point is on time: the law counts from it how long the next one fails to come."""
        if self._mode[self.row] == record.TORQUE:
            self._elapsed_periods[self.row] = 0

    def start(self) -> None:
        """The set-point is the torque that the motor has; 6071h is 0, where it comes from behind the brake."""
        is_braked = self.stage.law_mode == record.BRAKED
        super().start()
        if is_braked:
            self.targets.forget_torque()
        else:
            self.targets.hold_torque(float(self.stage.motion["torque_nm"]))
