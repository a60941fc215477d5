"""Modes on ramps and between set-points: profile velocity, profile torque, interpolated position."""

from drive_profiles.standard.cia402 import (
    ENABLE_INTERPOLATION,
    INTERPOLATION_ACTIVE,
    MAX_SLIPPAGE_ERROR,
    SPEED_IS_ZERO,
    TARGET_REACHED,
    Mode,
    Object,
)
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.drive.state_machine import Stop
from plant_emulator.motion import record


class ProfileVelocity(ModeOfOperation):
    """PV: 60FFh on the ramps of 6083h and 6084h, when written or when enabled."""

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


class ProfileTorque(ModeOfOperation):
    """TQ: 6071h on the slope of 6087h, when written or when enabled."""

    number, motion = Mode.TQ, record.PROFILE_TORQUE
    needs_gains = False

    def start(self) -> None:
        """Continue from the present torque to 6071h."""
        super().start()
        self.stage.motion["target_torque_nm"] = self.targets.torque_nm()

    def status(self) -> int:
        """Return bit 10; bits 12 and 13 are reserved.

        Bit 10: the torque is at its target, or (halted) the motor is at rest.
        """
        if self.is_halted:
            return super().status()
        motion = self.stage.motion
        missing = abs(float(motion["torque_demand_nm"]) - float(motion["target_torque_nm"]))
        return TARGET_REACHED if missing <= 0.5 * self.data.counting.scaling.torque_quantum_nm else 0


class InterpolatedPosition(ModeOfOperation):
    """IP: linear interpolation (60C0h = 0) between set-points.

    60C1h counts with every SYNC. Without bit 4 the motor comes to rest on 6084h and is held.
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
