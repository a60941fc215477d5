"""The power stage of one axis."""

import math
from typing import Any

from drive_profiles.standard.cia402 import Object
from plant_emulator.drive.binding.process_data import DriveData
from plant_emulator.drive.binding.set_points import SetPoints
from plant_emulator.drive.state_machine import Stop
from plant_emulator.motion import record
from plant_emulator.motion.axes import Axes, live

STOP_PATIENCE_S = 0.5
"""Time that a stop may take beyond its ramp before the brake closes on the moving motor, in s."""


class PowerStage:
    """Control of the motor by the state machine and the modes."""

    def __init__(self, axes: Axes, row: int, data: DriveData) -> None:
        """Keep references to the axis; the brake is unchanged."""
        self.axes, self.row, self.data = axes, row, data
        self.targets = SetPoints(axes, row, data)
        self.motion: Any = axes.motion[row]
        self._mode, self._stopped = live(axes.motion, "mode"), live(axes.motion, "stopped")
        self._control_period_s = axes.robot.control_period_s

    @property
    def law_mode(self) -> int:
        """Mode of the drive that acts."""
        mode: int = self._mode[self.row]
        return mode

    def begin(self, mode: int) -> None:
        """Switch to a mode of the law without a jump.

        The motor starts from rest behind the brake, or from its present motion.
        """
        span = max(1, round(self.data.limits.control_periods_per_set_point()))
        if self.law_mode == record.BRAKED:
            self.axes.open_brake(self.row, mode, span)
        else:
            self.axes.change_mode(self.row, mode, span)

    def close_brake(self) -> None:
        """Switch the torque off and close the brake."""
        motion = self.motion
        motion["mode"] = record.BRAKED
        motion["torque_nm"], motion["following_count"] = 0.0, 0

    def stop(self, stop: Stop) -> None:
        """Brake the motor to rest.

        A brake that is closed already stays closed. Without a velocity loop no ramp is possible, so the brake closes at
        once.
        """
        motion, axes = self.motion, self.axes
        has_loop = axes.cascade_config[self.row]["velocity_gain_nm_s_rad"] > 0.0
        if stop is Stop.AT_ONCE or self.law_mode == record.BRAKED or not has_loop:
            motion["stopped"] = 1
            self.close_brake()
            return
        match stop:
            case Stop.FULL_TORQUE:
                deceleration = math.inf
            case Stop.SLOW_DOWN_RAMP:
                deceleration = self.data.limits.acting_si(Object.PROFILE_DECELERATION)
            case _:
                deceleration = self.data.limits.acting_si(Object.QUICK_STOP_DECELERATION)
        axes.stop(self.row, deceleration)

    @property
    def is_stopped(self) -> bool:
        """True if the stop has ended, or its time is over."""
        motion = self.motion
        return bool(motion["stopped"] or motion["stop_periods"] * self._control_period_s > STOP_PATIENCE_S)

    @property
    def is_at_rest(self) -> bool:
        """True if the measured motor speed counts as rest."""
        return abs(self.data.speed_rad_s) < record.STOPPED_RAD_S

    @property
    def is_braked_at_rest(self) -> bool:
        """True if a halt or quick stop is complete.

        The motor is then at rest and held.
        """
        return bool(self._stopped[self.row]) or self.law_mode == record.BRAKED
