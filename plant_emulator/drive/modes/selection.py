"""Modes of operation of a drive, by number, and their choice by 6060h and 6061h."""

from collections.abc import Callable, Mapping
from typing import Any

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Object, State
from plant_emulator.drive.binding.limits import LONGEST_INTERPOLATION
from plant_emulator.drive.family.base import DriveFamily
from plant_emulator.drive.faults import NO_GAINS, NO_INTERPOLATION, NO_MODE, DriveFaults
from plant_emulator.drive.inputs import DigitalInputs
from plant_emulator.drive.modes.cyclic import CyclicPosition, CyclicTorque, CyclicVelocity, MakersPosition
from plant_emulator.drive.modes.homing_mode import HomingMode
from plant_emulator.drive.modes.limit_switches import LimitSwitches
from plant_emulator.drive.modes.mode import ModeOfOperation, NoMode
from plant_emulator.drive.modes.profile_position import ProfilePosition
from plant_emulator.drive.modes.simple import InterpolatedPosition, ProfileTorque, ProfileVelocity
from plant_emulator.drive.power_stage import PowerStage
from plant_emulator.drive.state_machine import Power
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.slave.node import Slave


def modes_of(stage: PowerStage, inputs: DigitalInputs, behaviour: Behaviour, family: DriveFamily) -> dict[int, ModeOfOperation]:
    """Return one drive's modes: its family's, its maker's own, and 0, none."""
    modes: list[ModeOfOperation] = [
        ProfilePosition(stage, behaviour.pp_handshake_cycles),
        ProfileVelocity(stage),
        ProfileTorque(stage),
        HomingMode(stage, inputs),
        InterpolatedPosition(stage),
        CyclicPosition(stage),
        CyclicVelocity(stage),
        CyclicTorque(stage),
    ]
    modes = [mode for mode in modes if mode.number in family.modes]
    if family.position_mode is not None:
        modes.append(MakersPosition(stage, *family.position_mode))
    if not behaviour.needs_mode_to_enable:
        modes.append(NoMode(stage))
    return {mode.number: mode for mode in modes}


class ModeSelection:
    """Selection of the acting mode, or none.

    In Operation enabled another mode comes into force at once, without a jump, and 0 (no mode) changes nothing; in the other
    states 6060h is what will act with the next enabling: with 0 the motor is held until a mode is chosen.

    Attributes:
        acting: The mode that acts, or acted until the stop that is under way; None while there is no torque.
    """

    def __init__(
        self,
        slave: Slave,
        stage: PowerStage,
        modes: Mapping[int, ModeOfOperation],
        faults: DriveFaults,
        limit_switches: LimitSwitches,
        *,
        power: Callable[[], Power],
        halt_blocks: bool,
    ) -> None:
        """Bind the objects.

        Args:
            modes: The modes that the drive has, by number; at 0, the one that acts if none is chosen, or nothing.
            faults: Faults of the drive, which report what a mode lacks.
            limit_switches: Limit switches, which forget what they have stopped when another mode acts.
            halt_blocks: True if another mode has to wait until the halt bit is clear.
        """
        self.acting: ModeOfOperation | None = None
        self._slave, self._stage, self._modes, self._faults = slave, stage, modes, faults
        self._limit_switches, self._power, self._halt_blocks = limit_switches, power, halt_blocks
        self._wanted: Any = slave.dictionary.cell(Object.MODES_OF_OPERATION)
        self._velocity = slave.dictionary.cell(Object.TARGET_VELOCITY)
        slave.dictionary.on_read(
            Object.MODES_OF_OPERATION_DISPLAY, 0, lambda: int(self._wanted.value if self.acting is None else self.acting.number)
        )
        slave.dictionary.on_write(Object.MODES_OF_OPERATION, 0, self._write)
        slave.dictionary.on_write(Object.TARGET_VELOCITY, 0, self._write_velocity)

    def _write(self, value: int) -> SdoAbortCode | None:
        acting = self.acting
        if acting is not None and value == acting.number:
            return None
        if value and value not in self._modes:
            return SdoAbortCode.INVALID_VALUE
        power = self._power()
        if not value or acting is None or power.state is not State.OPERATION_ENABLED or power.leaving is not None:
            return None
        if acting.is_halted and self._halt_blocks:
            return None
        if not self.is_ready(value):
            return SdoAbortCode.DEVICE_STATE
        self._change(self._modes[value])
        return None

    def _write_velocity(self, value: int) -> None:
        self._velocity.value = value
        if self.acting is not None:
            self.acting.follow()

    def command(self, word: int) -> None:
        """Pass a control word to the acting mode.

        After a halt, a mode that has waited for its end begins to act.
        """
        if self.acting is not None:
            self.acting.command(word)
            if self._halt_blocks and self._wanted.value:
                self._write(self._wanted.value)

    def is_ready(self, number: int | None = None) -> bool:
        """Return True if a mode exists and can act.

        Without a number it is the mode of 6060h. What it lacks is reported.

        A mode that closes a loop needs gains, since otherwise the arm falls when the brake opens. A mode whose set-points
        come with SYNC needs an interpolation period (60C2h) of whole control periods. No mode (0) counts as a mode, except
        in drives that need one.
        """
        wanted: Any = self._wanted.value if number is None else number
        if wanted not in self._modes:
            self._faults.report_lack(NO_MODE)
            return False
        mode, span = self._modes[wanted], self._stage.data.limits.control_periods_per_set_point()
        gains = self._stage.axes.cascade_config[self._stage.row]
        lack = None
        if mode.needs_interpolation and not (1.0 - 1e-9 < span < LONGEST_INTERPOLATION and abs(span - round(span)) < 1e-6):
            lack = NO_INTERPOLATION
        elif mode.needs_gains and not (gains["position_gain_per_s"] > 0.0 and gains["velocity_gain_nm_s_rad"] > 0.0):
            lack = NO_GAINS
        self._faults.report_lack(lack)
        return lack is None

    def begin(self) -> None:
        """Let the mode of 6060h act."""
        self._change(self._modes[self._wanted.value])

    def _change(self, mode: ModeOfOperation) -> None:
        self.end()
        self.acting = mode
        self._slave.on_sync = mode.synchronise
        mode.begin(self._power().control_word)

    def end(self) -> None:
        """End the acting mode; 6061h shows it until the torque is off."""
        if self.acting is not None:
            self.acting.end()
        self._limit_switches.blocked = 0
        self._slave.on_sync = _nothing

    def release(self) -> None:
        """Clear the acting mode: there is no torque."""
        self.end()
        self.acting = None


def _nothing(_: object) -> None:
    """Replace the mode's SYNC hook if no mode acts."""
