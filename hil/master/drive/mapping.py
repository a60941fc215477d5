"""Contents of the PDOs of a run: the same lists for the master, which maps them, and for the plan, which counts their bits."""

from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.cia402 import Mode, Object
from drive_profiles.standard.object_address import object_address
from hil.bench.bench import AxisTable
from hil.master.drive.pdo import MappedObject

U16, I16, I32 = DataType.UNSIGNED16, DataType.INTEGER16, DataType.INTEGER32
ACCELERATION_OBJECT = 0x7130
NOTCH_STATE = ("notch_1.active", "notch_1.frequency_hz")

FIRST_ADDITIONAL = "60E4:1"
"""Position of the first additional encoder by CiA 402, where the profile names no object."""

FEEDBACK = (
    MappedObject(Object.STATUS_WORD, 0, U16),
    MappedObject(Object.POSITION_ACTUAL, 0, I32),
    MappedObject(Object.TORQUE_ACTUAL, 0, I16),
)
"""TPDO1 of a drive."""
ACCELERATION = tuple(MappedObject(ACCELERATION_OBJECT, sub, I16) for sub in (1, 2, 3))
"""TPDO1 of the accelerometer."""


def command(mode: Mode, *, with_torque_offset: bool = False) -> tuple[MappedObject, ...]:
    """RPDO1 of a drive: control word and set-point, in CSP with a torque offset where it is wanted."""
    control_word = MappedObject(Object.CONTROL_WORD, 0, U16)
    if mode is not Mode.CSP:
        return control_word, MappedObject(Object.TARGET_TORQUE, 0, I16)
    offset = (MappedObject(Object.TORQUE_OFFSET, 0, I16),) if with_torque_offset else ()
    return control_word, MappedObject(Object.TARGET_POSITION, 0, I32), *offset


def notch_state(profile: Profile) -> tuple[MappedObject, ...]:
    """TPDO2 of a drive whose profile knows the state of its filter; else empty."""
    if not all(name in profile.parameters for name in NOTCH_STATE):
        return ()
    parameters = [profile.parameters[name] for name in NOTCH_STATE]
    return tuple(MappedObject(entry.index, entry.subindex, DataType[entry.data_type]) for entry in parameters)


def load_position(table: AxisTable, profile: Profile) -> tuple[MappedObject, ...]:
    """TPDO of a drive's second encoder; empty where the bench file has none."""
    if table.load_encoder is None:
        return ()
    stated = None if profile.load_encoder is None else profile.load_encoder.position
    return (MappedObject(*object_address(table.load_encoder.object or stated or FIRST_ADDITIONAL), I32),)


def load_tpdo(profile: Profile, *, with_notch_state: bool) -> int:
    """Number of that TPDO: the second, or the third where the second has the state of the filter."""
    return 3 if with_notch_state and notch_state(profile) else 2


def length(objects: tuple[MappedObject, ...]) -> int:
    """Number of bytes in a PDO."""
    return sum(int(entry.kind.size or 0) for entry in objects)
