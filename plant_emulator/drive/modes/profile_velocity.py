"""Profile velocity: 60FFh on the ramps of 6083h and 6084h."""

from drive_profiles.standard.cia402 import MAX_SLIPPAGE_ERROR, SPEED_IS_ZERO, TARGET_REACHED, Mode, Object
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.motion import record


class ProfileVelocity(ModeOfOperation):
    """PV: a target velocity takes effect when written, or when enabled."""

    number, motion = Mode.PV, record.PROFILE_VELOCITY

    def start(self) -> None:
        """Continue from the present demand to 60FFh."""
        super().start()
        self.follow()

    def follow(self) -> None:
        """Apply a new 60FFh.

        A value in force already, repeated by a cyclic RPDO, is not a new target for 606Eh.
        """
        motion, wanted = self.stage.motion, self.targets.speed_rad_s()
        if motion["mode"] == record.PROFILE_VELOCITY and wanted != motion["target_speed_rad_s"]:
            motion["target_speed_rad_s"] = wanted
            motion["reached"], motion["velocity_window_count"] = int(motion["reached"]) & ~record.IN_SPEED, 0

    def status(self) -> int:
        """Return bits 10, 12 and 13 of the status word.

        Bit 10: within 606Dh for 606Eh, or (halted) at rest; bit 12: speed below 606Fh; bit 13: slippage above 60F8h.
        """
        motion = self.stage.motion
        reached = int(motion["reached"])
        word = super().status()
        if not self.is_halted and reached & record.IN_SPEED:
            word |= TARGET_REACHED
        if not reached & record.MOVING:
            word |= SPEED_IS_ZERO
        slippage = abs(self.data.counting.shown_speed(float(motion["demand_speed_rad_s"]) - self.data.speed_rad_s))
        return word | MAX_SLIPPAGE_ERROR if slippage > self.data.value(Object.MAX_SLIPPAGE) else word
