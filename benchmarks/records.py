"""C declarations of numpy records: a header that the compiler itself holds against the dtypes."""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hil.control.cascade import CASCADE_CONFIG, CASCADE_STATE
from hil.control.notch import NOTCH_CONFIG, NOTCH_OFF, NOTCH_STATE, NOTCHES, START_LOWPASS_HZ
from hil.control.servo import LAW
from plant_emulator.motion.record import AXIS, FOLLOWING, LIMITED_TORQUE, MOTION, OUT_OF_RANGE, OVERSPEED, POSITION
from plant_emulator.physics.angle_grid import ARM_GRID_RAD, MOTOR_GRID_RAD
from plant_emulator.physics.axis import FRICTION_WIDTH_RAD_S, PLANT, PLANT_STATE
from plant_emulator.physics.changing import CHANGE, PAST

Record = np.dtype[Any]

RECORDS: dict[str, Record] = {
    "Plant": PLANT,
    "PlantState": PLANT_STATE,
    "Motion": MOTION,
    "CascadeConfig": CASCADE_CONFIG,
    "CascadeState": CASCADE_STATE,
    "NotchConfig": NOTCH_CONFIG,
    "NotchState": NOTCH_STATE,
    "Law": LAW,
    "Change": CHANGE,
    "Past": PAST,
    "Axis": AXIS,
}
"""What the compiled control period works on, by its name in C; a record inside another stands before it."""

CONSTANTS: dict[str, float] = {
    "NOTCHES": NOTCHES,
    "NOTCH_OFF": NOTCH_OFF,
    "START_LOWPASS_HZ": START_LOWPASS_HZ,
    "POSITION": POSITION,
    "FOLLOWING": FOLLOWING,
    "OVERSPEED": OVERSPEED,
    "OUT_OF_RANGE": OUT_OF_RANGE,
    "LIMITED_TORQUE": LIMITED_TORQUE,
    "FRICTION_WIDTH_RAD_S": FRICTION_WIDTH_RAD_S,
    "MOTOR_GRID_RAD": MOTOR_GRID_RAD,
    "ARM_GRID_RAD": ARM_GRID_RAD,
}
"""Numbers that both sides must share."""

_IDENTIFIER = re.compile(r"[A-Za-z_]\w*\Z", re.ASCII)
_GAP = "gap_at_"


class _Field(NamedTuple):
    name: str
    offset: int
    base: Record
    shape: tuple[int, ...]

    @property
    def end(self) -> int:
        return self.offset + self.base.itemsize * int(np.prod(self.shape, dtype=np.int64))


def header(records: Mapping[str, Record] = RECORDS, constants: Mapping[str, float] = CONSTANTS) -> str:
    """The header: constants, a structure per record, and an assertion for its size and for each field's place and size.

    Args:
        records: Dtypes with fields, by the name that they get in C; of fields that are records only those that stand before.
        constants: Whole numbers become an enumeration, others doubles with all their digits.

    Raises:
        ValueError: A dtype without fields or with fields that overlap, a kind of number that C has not got, a byte order that is
            not this machine's, or a name that is none in C.
    """
    lines = ["/* Made from the numpy dtypes. */", "#pragma once", "#include <stddef.h>", "#include <stdint.h>", ""]
    lines += [_constant(_named(name), value) for name, value in constants.items()]
    known: dict[Record, str] = {}
    for name, dtype in records.items():
        lines += ["", *_structure(_named(name), dtype, known)]
        known[dtype] = name
    return "\n".join(lines) + "\n"


def _named(name: str) -> str:
    if not _IDENTIFIER.match(name):
        raise ValueError(f"{name!r} is no name in C")
    return name


def _constant(name: str, value: float) -> str:
    if isinstance(value, int):
        return f"enum {{ {name} = {value} }};"
    return f"#define {name} {float(value).hex()} /* {value!r} */"


def _fields(record: str, dtype: Record) -> list[_Field]:
    if not dtype.fields:
        raise ValueError(f"{record} is a dtype without fields: {dtype}")
    found = []
    for name, (kind, offset, *_) in dtype.fields.items():
        base, shape = kind.subdtype or (kind, ())
        found.append(_Field(_named(name), offset, base, shape))
    return sorted(found, key=lambda field: field.offset)


def _c_type(record: str, field: _Field, known: Mapping[Record, str]) -> str:
    if field.base in known:
        return known[field.base]
    size = 8 * field.base.itemsize
    if field.base.isnative:
        if field.base.kind in "iu" and size in {8, 16, 32, 64}:
            return f"{'u' if field.base.kind == 'u' else ''}int{size}_t"
        if field.base.kind == "f" and size in {32, 64}:
            return "float" if size == 32 else "double"
        if field.base.kind == "b":
            return "uint8_t"
    raise ValueError(f"{record}.{field.name}: C has no number like numpy's {field.base.str}")


def _structure(record: str, dtype: Record, known: Mapping[Record, str]) -> list[str]:
    """Packed, with every gap spelled out, so that the places are numpy's and not the compiler's choice."""
    members, assertions, at = [], [_assertion(f"sizeof({record})", dtype.itemsize)], 0
    for field in _fields(record, dtype):
        if field.offset < at:
            raise ValueError(f"{record}.{field.name} begins at byte {field.offset}, within the field before it")
        members += _gap(at, field.offset)
        at = field.end
        members.append(f"    {_c_type(record, field, known)} {field.name}{''.join(f'[{length}]' for length in field.shape)};")
        assertions.append(_assertion(f"offsetof({record}, {field.name})", field.offset))
        assertions.append(_assertion(f"sizeof((({record} *)0)->{field.name})", at - field.offset))
    members += _gap(at, dtype.itemsize)
    return ["#pragma pack(push, 1)", "typedef struct {", *members, f"}} {record};", "#pragma pack(pop)", *assertions]


def _gap(begin: int, end: int) -> list[str]:
    return [f"    uint8_t {_GAP}{begin}[{end - begin}];"] if end > begin else []


def _assertion(what: str, value: int) -> str:
    return f'_Static_assert({what} == {value}, "{what} is not {value}");'
