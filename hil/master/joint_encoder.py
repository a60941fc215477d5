"""Second encoder on a joint in a run: TPDO and position."""

import math
from typing import Any

from hil.master.drive import mapping
from hil.master.drive.axis import DriveAxis
from hil.master.drive.pdo import PdoSet


class JointEncoder:
    """Last position of the second encoder of a drive.

    Attributes:
        can_id: Identifier of its TPDO; 0 before it is mapped.
    """

    def __init__(self, axis: DriveAxis, records: Any, row: int) -> None:
        encoder = axis.table.load_encoder
        self.axis = axis
        self.can_id = 0
        self._records, self.data = records, records[row]  # a record does not keep its array
        self.data.rad_per_count = math.nan if encoder is None else encoder.rad_per_count

    def configure(self, pdos: PdoSet, *, with_notch_state: bool) -> None:
        """Map the encoder's position into its TPDO; the drive is pre-operational."""
        number = mapping.load_tpdo(self.axis.profile, with_notch_state=with_notch_state)
        self.can_id = pdos.tpdo(number, mapping.load_position(self.axis.table, self.axis.profile))

    @property
    def has_answered(self) -> bool:
        """True if the last cycle brought it."""
        return bool(self.data.has_answered)

    @property
    def angle_rad(self) -> float:
        """Angle of the joint in the last cycle; NaN without an answer."""
        return float(self.data.counts * self.data.rad_per_count) if self.data.has_answered else math.nan
