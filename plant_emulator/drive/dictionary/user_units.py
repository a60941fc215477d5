"""Objects that choose the units of a drive.

They are 607Eh, 6091h, 6092h and 60A8h to 60AAh, and determine its scaling.

They may be written while there is no torque. Other objects keep their numbers, which then mean other quantities, as in real
drives. The encoder is fixed: 608Fh and 6090h accept no other value than theirs.

Source: CiA 402-2, factor group.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drive_profiles.errors import OutOfRangeError
from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.object_address import ObjectAddress
from drive_profiles.standard.units import Scaling
from plant_emulator.slave.dictionary import Dictionary

FIELDS: dict[ObjectAddress, str] = {
    (Object.GEAR_RATIO, 1): "gear_motor_revs",
    (Object.GEAR_RATIO, 2): "gear_shaft_revs",
    (Object.FEED_CONSTANT, 1): "feed",
    (Object.FEED_CONSTANT, 2): "feed_shaft_revs",
    (Object.POLARITY, 0): "polarity",
    (Object.SI_UNIT_POSITION, 0): "position_unit",
    (Object.SI_UNIT_VELOCITY, 0): "velocity_unit",
    (Object.SI_UNIT_ACCELERATION, 0): "acceleration_unit",
}
"""Field of `Scaling` that each of these objects holds."""

FIXED = (
    (Object.ENCODER_RESOLUTION, 1),
    (Object.ENCODER_RESOLUTION, 2),
    (Object.VELOCITY_ENCODER_RESOLUTION, 1),
    (Object.VELOCITY_ENCODER_RESOLUTION, 2),
)


def only(value: Any) -> Callable[[Any], SdoAbortCode | None]:
    """Return a write hook that accepts this value only."""
    return lambda wanted: None if wanted == value else SdoAbortCode.INVALID_VALUE


class UserUnits:
    """Binding of these objects to the scaling of a drive."""

    def __init__(
        self,
        dictionary: Dictionary,
        is_powered: Callable[[], bool],
        scaling: Callable[[], Scaling],
        use: Callable[[Scaling], None],
    ) -> None:
        self._dictionary, self._is_powered = dictionary, is_powered
        self._scaling, self._use = scaling, use
        for (index, sub), name in FIELDS.items():
            dictionary.on_write(index, sub, self._writer(name))
        for index, sub in FIXED:
            dictionary.on_write(index, sub, only(dictionary.cell(index, sub).entry.default))

    def apply(self) -> None:
        """Apply the objects' values, after a reset.

        A stored combination was checked when it was written.
        """
        self._use(replace(self._scaling(), **{name: self._dictionary.get_int(*address) for address, name in FIELDS.items()}))

    def _writer(self, name: str) -> Callable[[int], SdoAbortCode | None]:
        def write(value: int) -> SdoAbortCode | None:
            if self._is_powered():
                return SdoAbortCode.DEVICE_STATE
            try:
                scaling = replace(self._scaling(), **{name: value})
            except OutOfRangeError:
                return SdoAbortCode.INVALID_VALUE
            self._use(scaling)
            return None

        return write


def hold_units(dictionary: Dictionary, stated: set[ObjectAddress]) -> None:
    """Fix the units of a drive whose units are not emulated.

    Objects that its profile does not state accept no other value than their default.
    """
    for address in (*FIELDS, *FIXED):
        if address in dictionary and address not in stated and dictionary.cell(*address).write_hook is None:
            dictionary.on_write(*address, only(dictionary.cell(*address).entry.default))
