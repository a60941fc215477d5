"""The objects of an additional encoder on the load side.

Source: CiA 402-2 (IEC 61800-7-201), 60E4h to 60E6h and 60EBh; sub-index 1 is the first additional encoder.
"""

from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.object_address import ObjectAddress
from plant_emulator.robots.encoders import LoadEncoder
from plant_emulator.slave.dictionary import Access, Entry

_U8, _U32, _I32 = DataType.UNSIGNED8, DataType.UNSIGNED32, DataType.INTEGER32


FIRST: ObjectAddress = (Object.ADDITIONAL_POSITION_ACTUAL, 1)
"""Position of the first additional encoder."""


def load_encoder_entries(encoder: LoadEncoder, position: ObjectAddress = FIRST) -> tuple[Entry, ...]:
    """Return position, velocity and steps per revolution of an additional encoder.

    Args:
        position: Where the drive shows its position; another than the standard's is the only object that it then has.
    """
    if position != FIRST:
        index, sub = position
        count = (Entry(index, 0, "Highest sub-index supported", _U8, Access.CONST, sub),) if sub else ()
        return (*count, Entry(index, sub, "Position of the second encoder", _I32, Access.RO, 0, mappable=True))
    return (
        Entry(Object.ADDITIONAL_POSITION_ACTUAL, 0, "Highest sub-index supported", _U8, Access.CONST, 1),
        Entry(Object.ADDITIONAL_POSITION_ACTUAL, 1, "Additional position actual value 1", _I32, Access.RO, 0, mappable=True),
        Entry(Object.ADDITIONAL_VELOCITY_ACTUAL, 0, "Highest sub-index supported", _U8, Access.CONST, 1),
        Entry(Object.ADDITIONAL_VELOCITY_ACTUAL, 1, "Additional velocity actual value 1", _I32, Access.RO, 0, mappable=True),
        Entry(Object.ADDITIONAL_ENCODER_INCREMENTS, 0, "Highest sub-index supported", _U8, Access.CONST, 1),
        Entry(Object.ADDITIONAL_ENCODER_INCREMENTS, 1, "Encoder increments 1", _U32, Access.CONST, encoder.counts_per_rev),
        Entry(Object.ADDITIONAL_ENCODER_REVOLUTIONS, 0, "Highest sub-index supported", _U8, Access.CONST, 1),
        Entry(Object.ADDITIONAL_ENCODER_REVOLUTIONS, 1, "Encoder revolutions 1", _U32, Access.CONST, 1),
    )
