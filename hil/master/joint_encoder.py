"""Second encoder on a joint in a run: TPDO and position.

Its axis moves, or is only watched.
"""

import math
import struct

from hil.master.drive import mapping
from hil.master.drive.axis import DriveAxis
from hil.master.drive.pdo import PdoSet

_POSITION = struct.Struct("<i")


class JointEncoder:
    """Last position of the second encoder of a drive.

    Args:
        axis: The axis; its table has a load_encoder.

    Attributes:
        axis: The axis.
        can_id: Identifier of its TPDO; 0 before it is mapped.
        counts: Last position, in its counts.
        has_answered: True if the last cycle brought it.
    """

    def __init__(self, axis: DriveAxis) -> None:
        encoder = axis.table.load_encoder
        self.axis = axis
        self.can_id = 0
        self.counts = 0
        self.has_answered = False
        self._rad_per_count = math.nan if encoder is None else encoder.rad_per_count

    def configure(self, pdos: PdoSet, *, with_notch_state: bool) -> None:
        """Map the encoder's position into its TPDO.

        The drive is pre-operational.
        """
        number = mapping.load_tpdo(self.axis.profile, with_notch_state=with_notch_state)
        self.can_id = pdos.tpdo(number, mapping.load_position(self.axis.table, self.axis.profile))

    def take(self, data: bytes) -> bool:
        """Unpack the TPDO; False if its length is wrong."""
        if len(data) != _POSITION.size:
            return False
        (self.counts,) = _POSITION.unpack(data)
        return True

    @property
    def angle_rad(self) -> float:
        """Angle of the joint in the last cycle; NaN without an answer."""
        return self.counts * self._rad_per_count if self.has_answered else math.nan
