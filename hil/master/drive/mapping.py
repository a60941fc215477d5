"""PDO contents of a run, for the master and the plan's bits."""

from typing import Final, NamedTuple

from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.cia402 import ENABLE_INTERPOLATION, Mode, Object
from drive_profiles.standard.object_address import object_address
from hil.bench.bench import AxisTable
from hil.control.treatments import LoopName
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
"""TPDO1 of a drive that reports a torque."""
ACCELERATION = tuple(MappedObject(ACCELERATION_OBJECT, sub, I16) for sub in (1, 2, 3))
"""TPDO1 of the accelerometer."""


class CyclicMode(NamedTuple):
    """A mode with a set-point at every SYNC.

    Attributes:
        number: Its number in 6060h.
        enabling: Bits of the control word that let it follow set-points, beside those of operation.
        loss: Disadvantage against CSP, as a sentence; empty without one.
    """

    number: int
    name: str
    target: MappedObject
    enabling: int = 0
    loss: str = ""


CSP: Final = CyclicMode(Mode.CSP, "CSP", MappedObject(Object.TARGET_POSITION, 0, I32))
CST: Final = CyclicMode(Mode.CST, "CST", MappedObject(Object.TARGET_TORQUE, 0, I16))
IP: Final = CyclicMode(
    Mode.IP,
    "IP",
    MappedObject(Object.INTERPOLATION_DATA, 1, I32),
    ENABLE_INTERPOLATION,
    "the drive may buffer its set-points and follow them periods later, and it takes no torque offset",
)


def mode_of(loop: LoopName, profile: Profile) -> CyclicMode | None:
    """Return the mode of a drive in a run, or None."""
    has = profile.supported_modes
    if loop == "host":
        return CST if Mode.CST in has else None
    own = profile.position_mode
    if own is not None and Mode.CSP not in has:
        target = MappedObject(*object_address(own.target), I32)
        return CyclicMode(own.number, own.name, target, loss="the drive does not interpolate between its set-points")
    return next((mode for mode in (CSP, IP) if mode.number in has), None)


def command(mode: CyclicMode, *, with_torque_offset: bool = False) -> tuple[MappedObject, ...]:
    """Return RPDO1 of a drive: control word and set-point."""
    offset = (MappedObject(Object.TORQUE_OFFSET, 0, I16),) if with_torque_offset and mode.number == Mode.CSP else ()
    return MappedObject(Object.CONTROL_WORD, 0, U16), mode.target, *offset


def feedback(profile: Profile) -> tuple[MappedObject, ...]:
    """Return TPDO1 of a drive: status word, position and torque.

    The current replaces the torque of a drive that reports none.
    """
    torque = profile.torque
    if torque is None or torque.current is None or torque.actual is not None:
        return FEEDBACK
    return *FEEDBACK[:2], MappedObject(*object_address(torque.current), I16)


def notch_state(profile: Profile) -> tuple[MappedObject, ...]:
    """Return TPDO2 of a drive: the state of its filter."""
    if not all(name in profile.parameters for name in NOTCH_STATE):
        return ()
    parameters = [profile.parameters[name] for name in NOTCH_STATE]
    return tuple(MappedObject(entry.index, entry.subindex, DataType[entry.data_type]) for entry in parameters)


def load_position(table: AxisTable, profile: Profile) -> tuple[MappedObject, ...]:
    """Return the TPDO of a drive's second encoder."""
    if table.load_encoder is None:
        return ()
    stated = None if profile.load_encoder is None else profile.load_encoder.position
    return (MappedObject(*object_address(table.load_encoder.object or stated or FIRST_ADDITIONAL), I32),)


def load_tpdo(profile: Profile, *, with_notch_state: bool) -> int:
    """Return the number of the second encoder's TPDO."""
    return 3 if with_notch_state and notch_state(profile) else 2


def length(objects: tuple[MappedObject, ...]) -> int:
    """Number of bytes in a PDO."""
    return sum(int(entry.kind.size or 0) for entry in objects)
