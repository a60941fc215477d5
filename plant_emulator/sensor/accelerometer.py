"""The emulated accelerometer, a CiA 404 node."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from drive_profiles.standard.cia301 import DataType
from plant_emulator.core import CORE
from plant_emulator.drive.dictionary.manufacturer_objects import REVISION, VENDOR_ID, cycle_period_entry
from plant_emulator.slave.dictionary import Access, Dictionary, Entry, ObjectType
from plant_emulator.slave.node import Slave, SlaveNode
from plant_emulator.slave.objects import PdoDefault, communication_entries, pdo_entries

PRODUCT_CODE = 0x00000404
DEVICE_TYPE = 0x00020194
"""1000h: profile 404, measuring device, with analogue inputs."""

PROCESS_VALUE, PHYSICAL_UNIT, DECIMAL_DIGITS, STATUS = 0x7130, 0x6131, 0x6132, 0x6150
METRE_PER_SECOND_SQUARED = 0x00015700
"""CiA 303-2: prefix 00h, numerator metre 01h, denominator second squared 57h."""
DIGITS = 3
"""Values are in mm/s²: 3 decimal digits of m/s²."""

_CHANNELS = ("X", "Y", "Z")


def accelerometer_entries(serial_number: int = 1) -> list[Entry]:
    """Return the accelerometer's entries: CiA 404 inputs 1–3, X to Z."""
    identity = {"vendor_id": VENDOR_ID, "product_code": PRODUCT_CODE, "revision": REVISION, "serial_number": serial_number}
    entries = communication_entries(device_type=DEVICE_TYPE, name="Emulated accelerometer", **identity)
    entries.append(cycle_period_entry())
    mapped = tuple((PROCESS_VALUE, sub, 16) for sub in (1, 2, 3))
    entries += pdo_entries(tpdos=(PdoDefault(mapped, transmission_type=1),))
    for sub, axis in enumerate(_CHANNELS, start=1):
        array = partial(Entry, subindex=sub, object_type=ObjectType.ARRAY)
        entries += (
            array(PROCESS_VALUE, name=f"Acceleration {axis}", data_type=DataType.INTEGER16, access=Access.RO, default=0,
                  mappable=True, record_name="AI input process value"),
            array(PHYSICAL_UNIT, name=f"Unit {axis}", data_type=DataType.UNSIGNED32, access=Access.CONST,
                  default=METRE_PER_SECOND_SQUARED, record_name="AI physical unit process value"),
            array(DECIMAL_DIGITS, name=f"Digits {axis}", data_type=DataType.UNSIGNED8, access=Access.CONST,
                  default=DIGITS, record_name="AI decimal digits process value"),
            array(STATUS, name=f"Status {axis}", data_type=DataType.UNSIGNED8, access=Access.RO, default=0,
                  mappable=True, record_name="AI status"),
        )  # fmt: skip
    return entries


class AccelerometerNode(SlaveNode):
    """The node at the tip, sans IO.

    A sample is drawn once per SYNC, before the TPDOs are sampled, so that the noise is the same whatever else is asked.

    Args:
        measure: Gives the sensor's output (X, Y, Z) in m/s² at this instant.
        range_m_s2: Beyond it the status of the channel is "not valid".

    Attributes:
        shared: What the node shows, in C: a `tip_node`.
        channels: Process values of X, Y and Z.
        measure: Gives the sensor's output of this instant.
    """

    def __init__(
        self, node_id: int, measure: Callable[[], tuple[float, float, float]], range_m_s2: float, **options: Any
    ) -> None:
        """Make the node; it measures nothing before the first SYNC."""
        self.measure = measure
        rows = np.zeros(1, CORE.dtype("tip_node"))
        rows["range_m_s2"], rows["steps_per_m_s2"] = range_m_s2, 10.0**DIGITS
        self.shared = CORE.pointer(rows, "tip_node")
        dictionary = Dictionary(accelerometer_entries(node_id))
        for index, field in ((PROCESS_VALUE, "shown"), (STATUS, "status")):
            values = memoryview(rows[0][field])
            for channel in range(len(_CHANNELS)):
                dictionary.share(index, channel + 1, values, channel)
        self.channels = [dictionary.cell(PROCESS_VALUE, channel + 1) for channel in range(len(_CHANNELS))]
        self.slave = Slave(node_id, dictionary, **options)

    def sample(self) -> None:
        """Measure all channels.

        CiA 404 status bit 0 is "not valid", here a channel at the end of its range.
        """
        CORE.call.show_sample(self.shared, self.measure())
