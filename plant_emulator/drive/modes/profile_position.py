"""Profile position: set-points, one acting, one waiting; bits 4 and 12."""

import math

from drive_profiles.standard.cia402 import (
    CHANGE_ON_SET_POINT,
    CHANGE_SET_IMMEDIATELY,
    FOLLOWING_ERROR,
    NEW_SET_POINT,
    RELATIVE,
    SET_POINT_ACKNOWLEDGE,
    TARGET_REACHED,
    Mode,
    Object,
)
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.drive.state_machine import Stop, stop_of_halt
from plant_emulator.motion import record

FROM_TARGET, FROM_DEMAND, FROM_ACTUAL = 0, 1, 2
"""60F2h, bits 0 and 1: a relative set-point counts from the last target, the demand or the actual position."""


class ProfilePosition(ModeOfOperation):
    """PP: 607Ah on the rising edge of bit 4.

    The ramps are 6083h and 6084h, the speed is 6081h.

    A set-point that arrives during another's execution replaces it at once with bit 5; otherwise it waits for the end, and
    bit 12 stays set until it is in execution. With bit 9 the motor does not stop between the two, if both lie in the same
    direction. A set-point outside 607Dh is a fault, as in cyclic position. Speed and ramps take effect when written, even
    for the set-point in execution. A limit switch drops the set-point in execution and the waiting one: the motor is held at
    its position, and bit 10 stays 0 until the next set-point.

    Attributes:
        is_given_up: True if a limit switch has ended the last set-point.
    """

    number, motion = Mode.PP, record.PROFILE

    def __init__(self, stage: PowerStage, handshake_syncs: int = 0) -> None:
        super().__init__(stage)
        self._handshake_syncs = handshake_syncs
        self._syncs_left = 0
        self._is_acknowledged = self._is_executing = self._is_blended = False
        self.is_given_up = False
        self._waiting: int | None = None
        self._passed = self._last_target = 0

    def start(self) -> None:
        """Brake to rest, or stay at rest behind the brake."""
        is_braked = self.stage.law_mode == record.BRAKED
        super().start()
        self._forget()
        if is_braked:
            self.stage.motion["reached"] = record.IN_POSITION  # the target is where the motor stands
        self._is_acknowledged = bool(self._word & NEW_SET_POINT)
        self._last_target = round(float(self.stage.motion["target_counts"]))
        self.targets.hold_position()

    def _forget(self) -> None:
        self._syncs_left = 0
        self._is_executing = self._is_blended = self.is_given_up = self.watches = False
        self._waiting = None
        self.data.limits.halt_profile(False)

    def give_up(self) -> None:
        """Hold the motor where a limit switch has stopped it; 607Ah stays."""
        self.stage.begin(self.motion)
        self._forget()
        self._last_target = round(float(self.stage.motion["target_counts"]))
        self.is_given_up = True

    # -- set-points ----------------------------------------------------------------------------------------------------

    def take(self, word: int, rising: int) -> None:
        """Process the handshake of bit 4.

        The rising edge brings a set-point, the falling one makes room for the next.
        """
        if not word & NEW_SET_POINT:
            self._is_acknowledged = False
        elif rising & NEW_SET_POINT and (self._waiting is None or word & CHANGE_SET_IMMEDIATELY):
            self._is_acknowledged, self._syncs_left = True, self._handshake_syncs
            self._set_point(self._target(word), word)

    def _target(self, word: int) -> int:
        if not word & RELATIVE:
            return self.targets.position_counts()
        option = self.data.value(Object.POSITIONING_OPTION)
        if option == FROM_DEMAND:
            origin = round(float(self.stage.motion["demand_rad"] * self.stage.motion["counts_per_rad"]))
        elif option == FROM_ACTUAL:
            origin = self.stage.axes.counts(self.row)
        else:
            origin = self._last_target
        return origin + self.targets.relative_counts()

    def _set_point(self, target: int, word: int) -> None:
        motion = self.stage.motion
        if not motion["low_counts"] <= target <= motion["high_counts"]:
            motion["trip"] = int(motion["trip"]) | record.SET_POINT_RANGE
            return
        self._look_for_the_end()
        last, self._last_target = self._last_target, target
        if self._is_executing and not word & CHANGE_SET_IMMEDIATELY:
            self._waiting, self.watches = target, True
            left_counts = motion["target_counts"] - motion["reference_rad"] * motion["counts_per_rad"]
            if word & CHANGE_ON_SET_POINT and (target - last) * left_counts > 0.0:
                # both lie the same way: to go for the second at once passes the first at the profile's speed
                self._is_blended, self._passed = True, last
                self._go(target)
        else:
            self._waiting, self._is_blended, self.watches = None, False, False
            self._go(target)

    def _go(self, target: int) -> None:
        motion = self.stage.motion
        motion["target_counts"] = target
        motion["reached"], motion["position_window_count"] = 0, 0
        self._is_executing, self.is_given_up = True, False

    def _look_for_the_end(self) -> None:
        if self._is_executing and not self.is_halted and self.data.is_target_reached:
            self._is_executing = False

    def look(self) -> None:
        """Start the waiting set-point when the present one has ended."""
        if self._waiting is None or self.is_halted:
            return
        motion = self.stage.motion
        if self._is_blended:
            left_counts = motion["target_counts"] - self._passed
            if (motion["reference_rad"] * motion["counts_per_rad"] - self._passed) * math.copysign(1.0, left_counts) < 0.0:
                return
            self._is_blended = False
        else:
            self._look_for_the_end()
            if self._is_executing:
                return
            self._go(self._waiting)
        self._waiting, self.watches = None, False

    def synchronise(self, now: int) -> None:
        """Count the SYNCs of the acknowledgement."""
        if self._syncs_left > 0:
            self._syncs_left -= 1

    # -- halt ----------------------------------------------------------------------------------------------------------

    def halt(self) -> None:
        """Brake to rest on the profile's ramp, or as 605Dh demands."""
        stop = stop_of_halt(self.data.value(Object.HALT_OPTION))
        if stop is Stop.SLOW_DOWN_RAMP:
            self.data.limits.halt_profile(True)
        else:
            self.stage.stop(stop)

    def resume(self) -> None:
        """Continue to the set-point in execution."""
        if self.data.limits.is_profile_halted:
            self.data.limits.halt_profile(False)
            return
        target = self.stage.motion["target_counts"] if self._is_executing else None
        self.stage.begin(self.motion)
        if target is not None:
            self._go(round(float(target)))

    def status(self) -> int:
        """Return bits 10, 12 and 13 of the status word.

        Bit 10: target reached or (halted) at rest; bit 12: no room for a set-point; bit 13: following error.
        """
        motion, word = self.stage.motion, 0
        if self.is_halted and not self.data.limits.is_profile_halted:
            word |= TARGET_REACHED if self.stage.is_braked_at_rest else 0
        elif self.data.is_target_reached and (self.data.limits.is_profile_halted or not self.is_given_up):
            word |= TARGET_REACHED
        if (self._is_acknowledged and not self._syncs_left) or self._waiting is not None:
            word |= SET_POINT_ACKNOWLEDGE
        return word | FOLLOWING_ERROR if motion["following_count"] > 0 else word
