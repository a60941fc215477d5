"""The targets of the modes: from the dictionary to the axis and, where a mode begins, from the motor into the dictionary."""

from typing import Any

from drive_profiles.cia402 import Object
from plant_emulator.axes import Axes
from plant_emulator.drive_data import DriveData, clip

_INT16 = 2**15 - 1


class SetPoints:
    """The entries that say where to, how fast and with what torque, of one drive.

    A mode that begins writes what the motor does now into its target, so that neither a value from before nor one that the
    master repeats makes it jump.
    """

    def __init__(self, axes: Axes, row: int, data: DriveData) -> None:
        """Take hold of the entries."""
        self._axes, self._row, self._data = axes, row, data
        self._motion: Any = axes.motion[row]
        cell = data.dictionary.cell
        self._target, self._position_offset = cell(Object.TARGET_POSITION), cell(Object.POSITION_OFFSET)
        self._interpolated = cell(Object.INTERPOLATION_DATA, 1)
        self._speed, self._speed_offset = cell(Object.TARGET_VELOCITY), cell(Object.VELOCITY_OFFSET)
        self._torque, self._torque_offset = cell(Object.TARGET_TORQUE), cell(Object.TORQUE_OFFSET)

    # -- to the axis ---------------------------------------------------------------------------------------------------

    def position_counts(self) -> int:
        """607Ah as a place, in counts of the encoder."""
        return self._data.encoder_counts(self._target.value)

    def relative_counts(self) -> int:
        """607Ah as a way, in counts of the encoder."""
        return self._data.encoder_counts(self._target.value) - self._data.encoder_counts(0)

    def interpolated_counts(self) -> int:
        """60C1h sub 1 in counts of the encoder."""
        return self._data.encoder_counts(self._interpolated.value)

    def speed_rad_s(self) -> float:
        """60FFh."""
        return self._data.cyclic_target_speed_rad_s()

    def torque_nm(self) -> float:
        """6071h."""
        value: Any = self._torque.value
        return float(value * self._data.scaling.torque_quantum_nm)

    # -- from the motor ------------------------------------------------------------------------------------------------

    def hold_position(self, *, with_offset: bool = False) -> None:
        """607Ah is where the motor stands, less 60B0h where the mode adds that."""
        offset: Any = self._position_offset.value if with_offset else 0
        self._target.value = clip(self._data.shown_position(self._axes.counts(self._row)) - offset)

    def hold_interpolated(self) -> None:
        """60C1h sub 1 is where the motor stands."""
        self._interpolated.value = clip(self._data.shown_position(self._axes.counts(self._row)))

    def hold_speed(self, speed_rad_s: float) -> None:
        """60FFh is this speed less 60B1h, which cyclic velocity adds."""
        offset: Any = self._speed_offset.value
        self._speed.value = clip(self._data.shown_speed(speed_rad_s) - offset)

    def forget_torque(self) -> None:
        """6071h is 0: a torque from before is no command."""
        self._torque.value, self._motion["target_torque_nm"] = 0, 0.0

    def hold_torque(self, torque_nm: float) -> None:
        """6071h is this torque less 60B2h, which cyclic torque adds."""
        offset: Any = self._torque_offset.value
        self._torque.value = value = clip(torque_nm / self._data.scaling.torque_quantum_nm - offset, _INT16)
        self._motion["target_torque_nm"] = value * self._data.scaling.torque_quantum_nm
