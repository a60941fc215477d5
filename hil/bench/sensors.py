"""Tables of the bench file for accelerometer and joint encoders."""

import math
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from drive_profiles.family.profile import known_name
from drive_profiles.files.toml import Table
from drive_profiles.standard.object_address import WrittenAddress
from hil.arm.mounting import Mounting
from hil.robot_tables import Positive
from hil.sensor.table import SerialTable

STANDARD_GRAVITY_M_S2 = 9.80665

NodeId = Annotated[int, Field(ge=1, le=127)]
ProfileText = Annotated[str, AfterValidator(known_name)]
"""Name or path of a drive profile; a name that the package does not have is refused."""


class AccelerometerTable(Table):
    """The sensor at the tip.

    A node of the bus, a device on a serial port, or none: then the encoders of the joints replace it.

    Attributes:
        node_id: Node-ID of the sensor; None for a sensor on a serial port.
        profile: Drive profile of the node; None for a sensor on a serial port.
        serial: Port and framing of a serial sensor; None for a node.
        from_load_encoders: True for no sensor: the tip's acceleration comes from the joints' own encoders, on the load side.
        range_m_s2: Largest measurement of the sensor, or None; a run in which a sample reaches it is not judged.
        mounting: Place and orientation on the arm; None if it gives the tip's acceleration in the base frame.
    """

    node_id: NodeId | None = None
    profile: ProfileText = "emulated_accelerometer"
    serial: SerialTable | None = None
    from_load_encoders: bool = False
    range_m_s2: Positive | None = None
    mounting: Mounting | None = None

    @property
    def title(self) -> str:
        """Source of the tip's motion, in words."""
        return "encoder on the joint" if self.from_load_encoders else "accelerometer"

    @property
    def free_range_m_s2(self) -> float | None:
        """Range of a mounted sensor less gravity; None if not known."""
        if self.range_m_s2 is None or self.mounting is None or not self.mounting.gravity:
            return self.range_m_s2
        return max(0.0, self.range_m_s2 - STANDARD_GRAVITY_M_S2)

    @model_validator(mode="after")
    def _one_of_both(self) -> "AccelerometerTable":
        if (self.node_id is not None) + (self.serial is not None) + self.from_load_encoders != 1:
            raise ValueError(
                "the accelerometer needs either a node_id on the bus or a serial table; without a sensor, "
                "state from_load_encoders = true"
            )
        if self.from_load_encoders and (self.range_m_s2 is not None or self.mounting is not None):
            raise ValueError("from_load_encoders = true excludes range_m_s2 and mounting: there is no sensor")
        return self


class LoadEncoderTable(Table):
    """A second encoder of a drive, on the joint: behind the gear.

    Attributes:
        counts_per_rev: Steps per revolution of the joint.
        object: Object that shows its position; None: the drive profile's, or 60E4:1, the first additional encoder (CiA 402).
        is_reversed: True if it counts down while the motor counts up.
    """

    counts_per_rev: Annotated[int, Field(ge=256, le=2**31 - 1)]
    object: WrittenAddress | None = None
    is_reversed: bool = False

    @property
    def rad_per_count(self) -> float:
        """Turn of the joint for a count, with its sign."""
        return (-math.tau if self.is_reversed else math.tau) / self.counts_per_rev
