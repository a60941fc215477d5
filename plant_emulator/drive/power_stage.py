"""The power stage of one axis."""

import math
from typing import Any

from drive_profiles.standard.cia402 import Object
from plant_emulator.drive.binding.process_data import DriveData
from plant_emulator.drive.dictionary.counting import INT16_MAX, clip
from plant_emulator.drive.state_machine import Stop
from plant_emulator.motion import record
from plant_emulator.motion.axes import Axes, live


class SetPoints:
    """Target entries of one drive: position, speed and torque.

    A mode that begins writes what the motor does now into its target, so that neither a value from before nor one that the
    master repeats makes it jump.
    """

    def __init__(self, axes: Axes, row: int, data: DriveData) -> None:
        self._axes, self._row, self._data = axes, row, data
        self._motion: Any = axes.motion[row]
        cell = data.dictionary.cell
        self._target, self._position_offset = cell(Object.TARGET_POSITION), cell(Object.POSITION_OFFSET)
        self._interpolated = cell(Object.INTERPOLATION_DATA, 1)
        self._speed, self._speed_offset = cell(Object.TARGET_VELOCITY), cell(Object.VELOCITY_OFFSET)
        self._torque, self._torque_offset = cell(Object.TARGET_TORQUE), cell(Object.TORQUE_OFFSET)

    # -- to the axis ---------------------------------------------------------------------------------------------------

    def position_counts(self) -> int:
        """Return 607Ah as a position, in counts of the encoder."""
        return self._data.counting.encoder_counts(self._target.value)

    def relative_counts(self) -> int:
        """Return 607Ah as a distance, in counts of the encoder."""
        return self._data.counting.encoder_counts(self._target.value) - self._data.counting.encoder_counts(0)

    def interpolated_counts(self) -> int:
        """Return 60C1h sub 1 in counts of the encoder."""
        return self._data.counting.encoder_counts(self._interpolated.value)

    def speed_rad_s(self) -> float:
        """Return the target velocity 60FFh, as written; the law adds 60B1h in the cyclic mode."""
        return self._data.counting.speed_rad_s(self._speed.value)

    def torque_nm(self) -> float:
        """Return the target torque 6071h, as written."""
        value: Any = self._torque.value
        return float(self._data.counting.torque_nm(value))

    # -- from the motor ------------------------------------------------------------------------------------------------

    def hold_position(self, *, with_offset: bool = False) -> None:
        """Set 607Ah to the motor's position."""
        offset: Any = self._position_offset.value if with_offset else 0
        self._target.value = clip(self._data.shown_position(self._axes.counts(self._row)) - offset)

    def hold_interpolated(self) -> None:
        """Set 60C1h sub 1 to the motor's position."""
        self._interpolated.value = clip(self._data.shown_position(self._axes.counts(self._row)))

    def hold_speed(self, speed_rad_s: float) -> None:
        """Set 60FFh to a speed less 60B1h, which cyclic velocity adds."""
        offset: Any = self._speed_offset.value
        self._speed.value = clip(self._data.counting.shown_speed(speed_rad_s) - offset)

    def forget_torque(self) -> None:
        """Set 6071h to 0: an earlier torque is not a command."""
        self._torque.value, self._motion["target_torque_nm"] = 0, 0.0

    def hold_torque(self, torque_nm: float) -> None:
        """Set 6071h to a torque less 60B2h, which cyclic torque adds."""
        offset: Any = self._torque_offset.value
        self._torque.value = value = clip(torque_nm / self._data.counting.scaling.torque_quantum_nm - offset, INT16_MAX)
        self._motion["target_torque_nm"] = self._data.counting.torque_nm(value)


STOP_PATIENCE_S = 0.5
"""Time that a stop may take beyond its ramp before the brake closes on the moving motor, in s."""


class PowerStage:
    """Control of the motor by the state machine and the modes."""

    def __init__(self, axes: Axes, row: int, data: DriveData) -> None:
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
        """Switch to a mode of the law without a jump."""
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
        """True if a halt or quick stop holds the motor at rest."""
        return bool(self._stopped[self.row]) or self.law_mode == record.BRAKED
