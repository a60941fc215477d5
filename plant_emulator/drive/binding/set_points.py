"""Targets of the modes."""

from typing import Any

from drive_profiles.standard.cia402 import Object
from plant_emulator.drive.binding.process_data import DriveData
from plant_emulator.drive.dictionary.counting import INT16_MAX, clip
from plant_emulator.motion.axes import Axes


class SetPoints:
    """Target entries of one drive: position, speed and torque.

    A mode that begins writes what the motor does now into its target, so that neither a value from before nor one that the
    master repeats makes it jump.
    """

    def __init__(self, axes: Axes, row: int, data: DriveData) -> None:
        """Keep references to the entries."""
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
        """Return the target velocity 60FFh, as written."""
        return self._data.cyclic_target_speed_rad_s()

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
