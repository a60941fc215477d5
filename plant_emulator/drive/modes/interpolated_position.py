"""Interpolated position: 60C1h with every SYNC, enabled by bit 4."""

from drive_profiles.standard.cia402 import ENABLE_INTERPOLATION, INTERPOLATION_ACTIVE, TARGET_REACHED, Mode
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.drive.state_machine import Stop
from plant_emulator.motion import record


class InterpolatedPosition(ModeOfOperation):
    """IP: linear interpolation (60C0h = 0) between set-points.

    Without bit 4 the motor comes to rest on 6084h and is held.
    """

    number, motion = Mode.IP, record.POSITION
    needs_interpolation = True

    def start(self) -> None:
        """Take the motor's position as set-point; ignore earlier targets."""
        super().start()
        self.targets.hold_interpolated()

    @property
    def is_active(self) -> bool:
        """True while the drive follows set-points."""
        return bool(self._word & ENABLE_INTERPOLATION) and self.stage.law_mode == record.POSITION

    def take(self, word: int, rising: int) -> None:
        """Start and stop with bit 4.

        A halt that holds the motor stays in force.
        """
        if self.is_halted:
            return
        if rising & ENABLE_INTERPOLATION:
            if self.stage.law_mode != record.POSITION:
                self.stage.begin(record.POSITION)
        elif not word & ENABLE_INTERPOLATION and self.stage.law_mode == record.POSITION:
            self.stage.stop(Stop.SLOW_DOWN_RAMP)

    def synchronise(self, now: int) -> None:
        """Apply the newest set-point at SYNC, for the next interpolation period."""
        if self.is_active:
            self.stage.axes.set_point(self.row, self.targets.interpolated_counts())

    def status(self) -> int:
        """Return bits 10 and 12 of the status word.

        Bit 10: the motor is at the last set-point or (halted) at rest; bit 12: interpolation is active; bit 13 is reserved.
        """
        if not self.is_active:
            return super().status()
        motion = self.stage.motion
        is_there = motion["elapsed_periods"] >= motion["periods_per_set_point"] or motion["elapsed_periods"] < 0
        is_near = abs(float(motion["following_error_rad"])) <= motion["position_window_rad"]
        return INTERPOLATION_ACTIVE | TARGET_REACHED if is_there and is_near else INTERPOLATION_ACTIVE
