"""EDS of an emulated node, written from its dictionary (CiA 306-1).

Real numbers: CiA 306-1 does not say how they are spelled, and readers differ. dcf-tools and Lely take bit patterns, so that
``1`` is 1.4E-45 to them; the canopen package takes decimals, drops a bit pattern in a default and reads one in a limit as a
whole number, as npm canopen does in both; gocanopen takes decimals, and refuses the whole file for the default 0x43960000.
Hence the default of a real number is not stated, nor are limits other than 0; the comments, which no tool interprets, say both
in decimals.
"""

from collections.abc import Iterator
from itertools import groupby
from typing import NamedTuple

from drive_profiles.standard.cia301 import Value, encode
from drive_profiles.standard.cia305 import BIT_TIMINGS
from plant_emulator.slave.dictionary import Dictionary, Entry, ObjectType
from plant_emulator.slave.pdo.setup import RPDO_COMMUNICATION, TPDO_COMMUNICATION

GRANULARITY = 1
"""Bits of the smallest thing that a PDO carries; with 1, BOOLEAN may be a dummy too."""
_MANDATORY = (0x1000, 0x1001, 0x1018)
_MANUFACTURER = range(0x2000, 0x6000)
_DUMMIES = range(1, 8)
_IDENTITY = 0x1018


class DeviceInfo(NamedTuple):
    """The names in an EDS; `description` is one line for the head of the file."""

    file_name: str
    vendor_name: str
    product_name: str
    order_code: str = ""
    description: str = ""


def write_eds(dictionary: Dictionary, info: DeviceInfo) -> str:
    """Return the EDS of a dictionary.

    Equal dictionaries give equal text, so the dates are fixed.

    Raises:
        ValueError: A default or a name does not fit into an INI file.
    """
    objects = {index: list(entries) for index, entries in groupby(dictionary, key=lambda entry: int(entry.index))}  # in a range
    lines = [*_file_info(info), *_device_info(dictionary, info)]
    lines += [*_section("DummyUsage", {f"Dummy{i:04X}": 1 for i in _DUMMIES}), *_comments(dictionary)]
    lines += _object_list("MandatoryObjects", [i for i in objects if i in _MANDATORY])
    lines += _object_list("OptionalObjects", [i for i in objects if i not in _MANDATORY and i not in _MANUFACTURER])
    lines += _object_list("ManufacturerObjects", [i for i in objects if i in _MANUFACTURER])
    for index, entries in objects.items():
        lines += _object(index, entries)
    return "\n".join(lines)


def _section(name: str, options: dict[str, str | int]) -> Iterator[str]:
    yield f"[{name}]"
    for key, value in options.items():
        text = str(value)
        if text != text.strip() or " ;" in text or (text and not text.isprintable()):
            raise ValueError(f"[{name}] {key} = {text!r} does not fit into an EDS")
        yield f"{key}={text}"
    yield ""


def _file_info(info: DeviceInfo) -> Iterator[str]:
    date = {"Time": "12:00AM", "Date": "01-01-2025"}
    return _section(
        "FileInfo",
        {
            "FileName": info.file_name,
            "FileVersion": 1,
            "FileRevision": 1,
            "EDSVersion": "4.0",
            "Description": info.description,
            **{"Creation" + key: value for key, value in date.items()},
            "CreatedBy": "plant-emulator",
            **{"Modification" + key: value for key, value in date.items()},
            "ModifiedBy": "plant-emulator",
        },
    )


def _device_info(dictionary: Dictionary, info: DeviceInfo) -> Iterator[str]:
    vendor, product, revision = (
        dictionary.get_int(_IDENTITY, subindex) if (_IDENTITY, subindex) in dictionary else 0 for subindex in (1, 2, 3)
    )
    return _section(
        "DeviceInfo",
        {
            "VendorName": info.vendor_name,
            "VendorNumber": f"0x{vendor:08X}",
            "ProductName": info.product_name,
            "ProductNumber": f"0x{product:08X}",
            "RevisionNumber": f"0x{revision:08X}",
            "OrderCode": info.order_code,
            **{f"BaudRate_{rate // 1000}": 1 for rate in sorted(BIT_TIMINGS.values())},
            "SimpleBootUpMaster": 0,
            "SimpleBootUpSlave": 1,
            "Granularity": GRANULARITY,
            "DynamicChannelsSupported": 0,
            "GroupMessaging": 0,
            "NrOfRXPDO": _count(dictionary, RPDO_COMMUNICATION),
            "NrOfTXPDO": _count(dictionary, TPDO_COMMUNICATION),
            "LSS_Supported": 1,
            "CompactPDO": 0,
        },
    )


def _count(dictionary: Dictionary, first: int) -> int:
    return sum(first <= entry.index < first + 0x200 and entry.subindex == 1 for entry in dictionary)


def _comments(dictionary: Dictionary) -> Iterator[str]:
    reals = [entry for entry in dictionary if entry.data_type.is_real]
    lines = ["Defaults of real numbers are only here, because tools format them differently:"] if reals else []
    lines += [f"{_section_name(entry)} {entry.name}: {_in_words(entry)}" for entry in reals]
    return _section("Comments", {"Lines": len(lines), **{f"Line{number}": line for number, line in enumerate(lines, 1)}})


def _in_words(entry: Entry) -> str:
    words = _decimal(entry, entry.default)
    words += "" if entry.low is None else f", at least {_decimal(entry, entry.low)}"
    return words + ("" if entry.high is None else f", at most {_decimal(entry, entry.high)}")


def _section_name(entry: Entry) -> str:
    return f"{entry.index:04X}sub{entry.subindex:X}" if entry.subindex or entry.record_name else f"{entry.index:04X}"


def _object_list(name: str, indices: list[int]) -> Iterator[str]:
    numbered = {str(number): f"0x{index:04X}" for number, index in enumerate(indices, 1)}
    return _section(name, {"SupportedObjects": len(indices), **numbered})


def _object(index: int, entries: list[Entry]) -> Iterator[str]:
    first, last = entries[0], entries[-1]
    if last.subindex == 0 and first.record_name is None:
        yield from _entry(f"{index:04X}", first)
        return
    object_type = next((entry.object_type for entry in entries if entry.object_type), ObjectType.RECORD)
    name = next((entry.record_name for entry in entries if entry.record_name), f"Object {index:04X}h")
    yield from _section(f"{index:04X}", {"ParameterName": name, "ObjectType": f"0x{object_type:X}", "SubNumber": len(entries)})
    for entry in entries:
        yield from _entry(f"{index:04X}sub{entry.subindex:X}", entry)


def _entry(section: str, entry: Entry) -> Iterator[str]:
    options: dict[str, str | int] = {
        "ParameterName": entry.name,
        "ObjectType": f"0x{ObjectType.VAR:X}",
        "DataType": f"0x{entry.data_type:04X}",
        "AccessType": entry.access.value,
    }
    for key, limit in (("LowLimit", entry.low), ("HighLimit", entry.high)):
        if limit is not None and (limit == 0 or not entry.data_type.is_real):
            options[key] = int(limit)
    if not entry.data_type.is_real:
        options["DefaultValue"] = _default(entry)
    options["PDOMapping"] = int(entry.mappable)
    return _section(section, options)


def _default(entry: Entry) -> str:
    value: Value = entry.default
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, str):
        return value
    digits = 2 * (entry.data_type.size or 0)
    text = str(int(value)) if value < 0 else f"0x{int(value):0{digits}X}"
    return f"$NODEID+{text}" if entry.node_relative else text


def _decimal(entry: Entry, value: Value) -> str:
    """Return the shortest text that reads back as the same value."""
    exact, number = encode(entry.data_type, value), float(value)
    texts = (f"{number:.{digits}g}" for digits in range(1, 17))
    short = next((float(text) for text in texts if encode(entry.data_type, float(text)) == exact), number)
    return f"{short:.17g}" if short != float(f"{short:.15g}") else f"{short:.15g}"
