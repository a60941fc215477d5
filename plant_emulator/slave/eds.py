"""The electronic data sheet of an emulated node, written from its dictionary (CiA 306-1)."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

from drive_profiles.cia301 import Value, encode
from plant_emulator.slave.dictionary import Dictionary, Entry, ObjectType
from plant_emulator.slave.pdo_setup import RPDO_COMMUNICATION, TPDO_COMMUNICATION

_BIT_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)
_MANDATORY = (0x1000, 0x1001, 0x1018)
_MANUFACTURER = range(0x2000, 0x6000)
_DUMMIES = range(1, 8)
_IDENTITY = 0x1018


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """What an EDS says of a device beyond its objects.

    Attributes:
        file_name: Name that the file will have.
        vendor_name: Maker.
        product_name: Product.
        order_code: Code by which it is ordered.
        description: One line for the head of the file.
    """

    file_name: str
    vendor_name: str
    product_name: str
    order_code: str = ""
    description: str = ""


def write_eds(dictionary: Dictionary, info: DeviceInfo) -> str:
    """Give the EDS of a dictionary: equal text for an equal dictionary, so its dates are fixed.

    Raises:
        ValueError: A default or a name cannot stand in an INI file.
    """
    objects = {index: list(entries) for index, entries in groupby(dictionary, key=lambda entry: entry.index)}
    lines = [*_file_info(info), *_device_info(dictionary, info), *_dummy_usage(), *_section("Comments", {"Lines": 0})]
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
            raise ValueError(f"[{name}] {key} = {text!r} cannot stand in an EDS")
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
            **{f"BaudRate_{rate}": 1 for rate in _BIT_RATES},
            "SimpleBootUpMaster": 0,
            "SimpleBootUpSlave": 1,
            "Granularity": 1,
            "DynamicChannelsSupported": 0,
            "GroupMessaging": 0,
            "NrOfRXPDO": _count(dictionary, RPDO_COMMUNICATION),
            "NrOfTXPDO": _count(dictionary, TPDO_COMMUNICATION),
            "LSS_Supported": 1,
        },
    )


def _count(dictionary: Dictionary, first: int) -> int:
    return sum(first <= entry.index < first + 0x200 and entry.subindex == 1 for entry in dictionary)


def _dummy_usage() -> Iterator[str]:
    return _section("DummyUsage", {f"Dummy{i:04X}": 1 for i in _DUMMIES})


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
    if entry.low is not None:
        options["LowLimit"] = _number(entry, entry.low)
    if entry.high is not None:
        options["HighLimit"] = _number(entry, entry.high)
    options["DefaultValue"] = _default(entry)
    options["PDOMapping"] = int(entry.mappable)
    return _section(section, options)


def _default(entry: Entry) -> str:
    value: Value = entry.default
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float):
        return _number(entry, value)
    if isinstance(value, str):
        return value
    digits = 2 * (entry.data_type.size or 0)
    text = str(int(value)) if value < 0 else f"0x{int(value):0{digits}X}"
    return f"$NODEID+{text}" if entry.node_relative else text


def _number(entry: Entry, value: float) -> str:
    """Give the shortest text that reads back as the same value of the entry's type."""
    if isinstance(value, int):
        return str(value)
    texts = (f"{value:.{digits}g}" for digits in range(1, 17))
    exact = encode(entry.data_type, value)
    return next((text for text in texts if encode(entry.data_type, float(text)) == exact), repr(value))
