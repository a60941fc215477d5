"""Reaction of the motion to limit switches.

An active switch blocks motion into it, and permits motion out of it.

CiA 402 leaves the reaction to the family. Here a motion into the switch is braked to rest on the quick-stop ramp (6085h);
the drive stays in Operation enabled and shows bit 11, internal limit active. It follows again as soon as its set-point no
longer leads into the switch. In profile position the set-point is dropped; bit 11 stays set and bit 10 clear until the next
set-point decides. In homing the method handles the switches.
"""

from typing import Any

from drive_profiles.standard.cia402 import Mode, Object
from plant_emulator.drive.inputs import DigitalInputs
from plant_emulator.drive.modes.mode import ModeOfOperation
from plant_emulator.drive.modes.profile_position import ProfilePosition
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.drive.state_machine import Stop
from plant_emulator.motion import record
from plant_emulator.motion.axes import live
from plant_emulator.motion.record import NEGATIVE_SWITCH, POSITIVE_SWITCH

_BITS = {+1: POSITIVE_SWITCH, -1: NEGATIVE_SWITCH}
_LIMITS = NEGATIVE_SWITCH | POSITIVE_SWITCH
_TORQUE_LAWS = (record.TORQUE, record.PROFILE_TORQUE)


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)


class LimitSwitches:
    """Monitor of the limit switches of an axis.

    Attributes:
        blocked: The direction that a switch forbids and the motion was stopped in: +1, -1, or 0; 0 again with another mode.
    """

    def __init__(self, stage: PowerStage, inputs: DigitalInputs) -> None:
        self._stage, self._inputs = stage, inputs
        self._row, self._masks = stage.row, live(stage.axes.motion, "input_mask")
        self.blocked, self._given_up = 0, 0.0

    @property
    def are_there(self) -> bool:
        """True if robot file or test provides a limit switch."""
        present: int = self._masks[self._row]  # asked at every SYNC
        return present & _LIMITS != 0

    def look(self, mode: ModeOfOperation) -> None:
        """Check where the motion leads, after each advance in Operation enabled."""
        if mode.number is Mode.HM or mode.is_halted:
            return
        if self.blocked and self._stage.law_mode == record.STOPPING:
            if self._stage.is_stopped and self._asked(mode) != self.blocked:
                self._end_stop(mode)
            return
        if isinstance(mode, ProfilePosition) and mode.is_given_up:
            return
        self.blocked = 0  # the end of a halt, say, has set the motor going again
        levels = self._inputs.levels
        for direction, bit in _BITS.items():
            if levels & bit and self._leads(mode) == direction:
                self.blocked, self._given_up = direction, float(self._stage.motion["target_counts"])
                self._stage.stop(Stop.QUICK_STOP_RAMP)
                return

    def _leads(self, mode: ModeOfOperation) -> int:
        """Return the direction in which the motor is being moved."""
        motion = self._stage.motion
        if self._stage.law_mode in _TORQUE_LAWS:
            return _sign(self._stage.data.speed_rad_s) if not self._stage.is_at_rest else self._asked(mode)
        return _sign(float(motion["demand_speed_rad_s"]))

    def _asked(self, mode: ModeOfOperation) -> int:
        """Return the direction of the master's latest set-point from the present position."""
        stage, data = self._stage, self._stage.data
        match mode.number:
            case Mode.CSP:
                return _sign(data.cyclic_target_counts() - stage.axes.counts(stage.row))
            case Mode.IP:
                return _sign(stage.targets.interpolated_counts() - stage.axes.counts(stage.row))
            case Mode.CSV:
                offset: Any = data.value(Object.VELOCITY_OFFSET)
                return _sign(stage.targets.speed_rad_s() + data.counting.speed_rad_s(offset))
            case Mode.PV:
                return _sign(stage.targets.speed_rad_s())
            case Mode.TQ:
                return _sign(data.value(Object.TARGET_TORQUE))
            case Mode.CST:
                return _sign(data.value(Object.TARGET_TORQUE) + data.value(Object.TORQUE_OFFSET))
            case _:
                return 0

    def _end_stop(self, mode: ModeOfOperation) -> None:
        """End the stop: the motor is at rest and the way free.

        A set-point that came during the stop counts.
        """
        if isinstance(mode, ProfilePosition) and self._stage.motion["target_counts"] == self._given_up:
            mode.give_up()
        else:
            self.blocked = 0
            self._begin(mode)

    def _begin(self, mode: ModeOfOperation) -> None:
        """Follow again.

        Cyclic targets are those of the master: `start` would overwrite them with the motor's values.
        """
        match mode.number:
            case Mode.PP:
                mode.resume()
            case Mode.PV | Mode.TQ:
                mode.start()
            case Mode.CST:
                self._stage.begin(mode.motion)
                self._stage.motion["target_torque_nm"] = self._stage.targets.torque_nm()
            case _:
                self._stage.begin(mode.motion)
