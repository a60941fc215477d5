"""A maker's drive as a dictionary."""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from drive_profiles.errors import DriveProfileError
from drive_profiles.family.parameter import LIMITS, Parameter
from drive_profiles.standard.cia301 import DataType, SdoAbortCode, Value, decode, encode
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.object_address import ObjectAddress
from drive_profiles.standard.units import Scaling
from plant_emulator.drive.dictionary.additional_encoder import FIRST, load_encoder_entries
from plant_emulator.drive.dictionary.limit_table import MOTION_LIMITS
from plant_emulator.robots.robot import Robot
from plant_emulator.slave.dictionary import Access, Dictionary, Entry

if TYPE_CHECKING:  # slow to load
    from canopen.objectdictionary import ObjectDictionary, ODVariable

ENGINE = frozenset({
    *range(0x1000, 0x1006), *range(0x1007, 0x1012), 0x1014, 0x1016, 0x1018, 0x1029, *range(0x1200, 0x1C00),
    Object.ERROR_CODE, Object.CONTROL_WORD, Object.STATUS_WORD, Object.MODES_OF_OPERATION, Object.MODES_OF_OPERATION_DISPLAY,
    Object.POSITION_DEMAND, Object.POSITION_ACTUAL_INTERNAL, Object.POSITION_ACTUAL, Object.VELOCITY_SENSOR_ACTUAL,
    Object.VELOCITY_DEMAND, Object.VELOCITY_ACTUAL, Object.TARGET_TORQUE, Object.TORQUE_DEMAND, Object.TORQUE_ACTUAL,
    Object.CURRENT_ACTUAL, Object.DC_LINK_VOLTAGE, Object.TARGET_POSITION, Object.POSITION_OFFSET, Object.VELOCITY_OFFSET,
    Object.TORQUE_OFFSET, Object.TOUCH_PROBE_FUNCTION, Object.TOUCH_PROBE_STATUS, Object.TOUCH_PROBE_1_POSITIVE,
    Object.TOUCH_PROBE_1_NEGATIVE, Object.TOUCH_PROBE_2_POSITIVE, Object.TOUCH_PROBE_2_NEGATIVE, Object.INTERPOLATION_DATA,
    Object.SUPPORTED_HOMING_METHODS, Object.FOLLOWING_ERROR_ACTUAL, Object.CONTROL_EFFORT, Object.POSITION_DEMAND_INTERNAL,
    Object.DIGITAL_INPUTS, Object.TARGET_VELOCITY, Object.SUPPORTED_MODES,
})  # fmt: skip
"""Objects that stay the emulator's own where a profile states them too: the slave engine and the state machine work by them."""

OPTION_CODES = frozenset({0x6007, *range(0x605A, 0x605F)})
"""Option codes: reactions to loss of connection, quick stop, shutdown, disable operation, halt and fault (CiA 402-2)."""

_TYPES = frozenset(DataType)


def parameter_entry(name: str, parameter: Parameter, scaling: Scaling, default: Value | None, base: Entry | None = None) -> Entry:
    """Return the entry of a parameter.

    Args:
        scaling: Scaling of the drive, for limits in SI units.
        default: Value when the drive leaves the factory; None: 0, or the nearest that the limits allow.
        base: The emulator's own entry at this address.
    """
    access = Access(parameter.access)
    if base is not None and access is Access.RW and base.access in {Access.RWW, Access.RWR}:
        access = base.access
    low, high = _raw_limits(parameter, scaling)
    if base is not None and parameter.index in OPTION_CODES:
        # a profile that states no limits would let values in that mean nothing to the state machine
        low, high = base.low if low is None else low, base.high if high is None else high
        if isinstance(default, int) and low is not None and high is not None:
            low, high = min(low, default), max(high, default)  # but for the maker's own default
    kind = parameter.type
    value = _nearest(kind, _zero(kind) if default is None else default, low, high)
    mappable = kind.size is not None and (parameter.mappable or (base is not None and base.mappable))
    record = None if base is None else base.record_name
    return Entry(parameter.index, parameter.subindex, name, kind, access, value, low, high, mappable, record)


def stated_default(parameter: Parameter) -> Value | None:
    """Return the factory setting of an object, or None."""
    data = parameter.default_bytes()
    return None if data is None else decode(parameter.type, data)


def _raw_limits(parameter: Parameter, scaling: Scaling) -> tuple[float | None, float | None]:
    """Return the limits as the object holds them; beyond its type None."""
    if parameter.is_bytes or parameter.data_type == "BOOLEAN":
        return None, None
    per_step = parameter.value_per_step(scaling)
    raw: list[float | None] = []
    for bound, sign in ((parameter.minimum, -1), (parameter.maximum, 1)):
        if bound is None or math.isinf(bound):
            raw.append(None)
        elif parameter.type.is_real:
            raw.append(bound / per_step)
        else:
            held = int(bound) if per_step == 1.0 and float(bound).is_integer() else round(bound / per_step)
            edge = LIMITS[parameter.data_type][sign > 0]
            raw.append(held if sign * (edge - held) >= 0 else None)
    return raw[0], raw[1]


def _zero(kind: DataType) -> Value:
    if kind is DataType.VISIBLE_STRING:
        return ""
    if kind.size is None:
        return b""
    return decode(kind, bytes(kind.size))


def _nearest(kind: DataType, value: Value, low: float | None, high: float | None) -> Value:
    """Return the value within limits; 0 if its type cannot hold it."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        number: float = value
        if low is not None:
            number = max(number, low)
        if high is not None:
            number = min(number, high)
        value = float(number) if kind.is_real else bool(number) if kind is DataType.BOOLEAN else int(number)
    try:
        return decode(kind, encode(kind, value))
    except ValueError:
        return _zero(kind)


def si_steps(parameters: Iterable[Parameter], scaling: Scaling) -> dict[ObjectAddress, float]:
    """Return SI units per step of CiA 402 limits with other scales."""
    steps = {}
    for parameter in parameters:
        limit = MOTION_LIMITS.get(parameter.index)
        if limit is not None and limit.quantity.unit == parameter.unit and parameter.scale != "per mille":
            steps[parameter.address] = parameter.value_per_step(scaling)
    return steps


def merged(entries: Iterable[Entry], more: Iterable[Entry]) -> list[Entry]:
    """Merge entries; those of `more` replace others at their address."""
    by_address = {(entry.index, entry.subindex): entry for entry in entries}
    by_address |= {(entry.index, entry.subindex): entry for entry in more}
    return list(by_address.values())


def described_entries(dictionary: "ObjectDictionary", present: Mapping[ObjectAddress, Entry]) -> Iterator[Entry]:
    """Yield the objects of an EDS file that are missing.

    As entries they hold what is written to them and have no effect.

    Objects that the emulator has in part are completed, but for those that the engine uses.
    """
    from canopen.objectdictionary import ODVariable  # noqa: PLC0415 - there with a dictionary

    indices = {index for index, _ in present}
    for index, thing in dictionary.items():
        if index < 0x1000 or index in ENGINE:
            continue
        variables = [thing] if isinstance(thing, ODVariable) else list(thing.values())
        for variable in variables:
            address = variable.index, variable.subindex
            # sub-index 0 of a record that is there already counts what is there
            if address not in present and not (variable.subindex == 0 and index in indices) and variable.data_type in _TYPES:
                yield _described(variable, thing.name)


def _described(variable: "ODVariable", record: str) -> Entry:
    kind = DataType(variable.data_type or 0)
    low, high = _holdable(kind, variable.min), _holdable(kind, variable.max)
    if low is not None and high is not None and low > high:
        low = high = None
    default = _zero(kind) if variable.default is None else variable.default
    try:
        access = Access(variable.access_type.lower())
    except ValueError:
        access = Access.RO
    name, record_name = _name(variable.name), None if variable.subindex == 0 else _name(record)
    value = _nearest(kind, default, low, high)
    mappable = bool(variable.pdo_mappable) and kind.size is not None
    return Entry(variable.index, variable.subindex, name, kind, access, value, low, high, mappable, record_name)


def _holdable(kind: DataType, bound: float | None) -> float | None:
    """Return a limit as its type holds it, or None."""
    if bound is None or kind is DataType.BOOLEAN or kind.size is None:
        return None
    try:
        encode(kind, bound)
    except ValueError:
        return None
    return bound


def _name(text: str) -> str:
    """Return words that can serve as a name."""
    clean = "".join(c if c.isprintable() and c != ";" else " " for c in text).strip()
    return clean or "Object"


def axis_dictionary(entries: list[Entry], robot: Robot, number: int, position: ObjectAddress = FIRST) -> Dictionary:
    """Make the dictionary of these and further entries.

    The further ones are those of a second encoder, and those of the axis' EDS file that are not among them.
    """
    path, encoder = robot.axis[number].eds, robot.axis[number].load_encoder
    if encoder is not None:
        entries = merged(entries, load_encoder_entries(encoder, position))
    if path is None:
        return Dictionary(entries)

    from drive_profiles import eds  # noqa: PLC0415 - slow to load

    present = {(entry.index, entry.subindex): entry for entry in entries}
    described = described_entries(eds.load(path, node_id=robot.node_ids[number]).dictionary, present)
    return Dictionary([*entries, *described])


def as_raw(si: float, parameter: Parameter, scaling: Scaling) -> Value | None:
    """Return an object's raw value for an SI value, or None."""
    try:
        return parameter.raw(si, scaling)
    except DriveProfileError:
        return None


def state_abort_code(aborts: Iterable[tuple[int, str]]) -> int:
    """Return the (maker's) abort code of a write to an enabled drive."""
    words = ("device state", "present state", "drive state", "enabled", "operation enable")
    return next((code for code, text in aborts if any(word in text.lower() for word in words)), SdoAbortCode.DEVICE_STATE)
