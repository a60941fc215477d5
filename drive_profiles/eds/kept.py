"""Keys of CiA 306 that canopen's exporter does not write.

Only what has a meaning in CiA 306 is kept. What the exporter writes itself, and what the reader has repaired or dropped, stays as
the exporter has it.

Source: CiA 306-1: object description (4.6.3), device commissioning (DCF), modules, tools.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from drive_profiles.eds import device as eds_device
from drive_profiles.eds import values
from drive_profiles.eds.description import Description
from drive_profiles.eds.text import EdsSection, Findings, read, section_id

_EXPORTED = {
    "parametername", "objecttype", "datatype", "accesstype", "defaultvalue", "parametervalue", "pdomapping", "lowlimit",
    "highlimit", "subnumber", "storagelocation", "compactsubobj", "description", "factor", "unit",
}  # fmt: skip
"""Keys of objects that the exporter writes from the dictionary; a compact notation is written out."""
_OF_OBJECTS = {"eds": ("ObjFlags",), "dcf": ("ObjFlags", "UploadFile", "DownloadFile", "Denotation", "ParamRefd")}
_OF_DEVICE = ("ExtendedBootUpMaster", "ExtendedBootUpSlave", "NG_Slave", "NG_Master", "NrOfNG_MonitoredNodes")
_OF_COMMISSIONING = ("NodeName", "NodeRefd", "NetNumber", "NetworkName", "NetRefd", "CANopenManager", "LSS_SerialNumber")
_WHOLE = re.compile(
    r"m\d+(?:moduleinfo|fixedobjects|subextends|subext[0-9a-f]*|comments)|supportedmodules|connectedmodules|dynamicchannels|tools"
    r"|tool\d+"
)
"""Sections that are not part of the dictionary, and are copied unchanged."""
_OBJECT = re.compile(r"([0-9A-F]{4})(?:sub([0-9A-F]+))?")
_OF_FILE = {"fileinfo", "deviceinfo", "comments", "dummyusage", *eds_device.LISTS, *eds_device.COMMISSIONING}
_MOST_NAMED = 3


def with_kept_keys(text: str, description: Description, file_format: Literal["eds", "dcf"]) -> str:
    """Put the keys that the format has into the exporter's text."""
    written = read(text.encode(), Path("exported"), Findings())
    kept: dict[str, dict[str, str]] = {}
    for name, lines in _kept(description, file_format):
        section = written.sections.get(section_id(name))
        present = set() if section is None else set(section.entries)
        if section is None and _OBJECT.fullmatch(section_id(name)):
            continue  # an object that could not be read
        keys = [line.partition("=")[0] for line in lines]
        kept.setdefault(name, {}).update((key, line) for key, line in zip(keys, lines, strict=True) if key.lower() not in present)
    inserted: dict[int, list[str]] = {}
    for name, named in kept.items():
        section = written.sections.get(section_id(name))
        if section is not None:
            inserted.setdefault(section.last, []).extend(named.values())
        elif named:
            inserted.setdefault(len(written.lines), []).extend([f"[{name}]", *named.values(), ""])
    return written.rewritten({}, inserted).decode()


def left_out(description: Description, file_format: Literal["eds", "dcf"]) -> list[str]:
    """List, in words, the keys and sections that a conversion leaves out."""
    strange, foreign, of_dcf = [], [], 0
    for identity, section in description.document.sections.items():
        match = _OBJECT.fullmatch(identity)
        if match is not None and int(match[1], 16) >= 0x1000:
            kept = {key.lower() for key in _OF_OBJECTS["dcf"]} | _EXPORTED
            strange += [f"[{section.name}] {entry.key}" for key, entry in section.entries.items() if key not in kept]
            of_dcf += sum(bool(section.get(key)) for key in _OF_OBJECTS["dcf"][1:])
        elif (
            match is None
            and identity not in _OF_FILE
            and not _WHOLE.fullmatch(identity)
            and not re.match(r"[0-9A-F]{4}", identity)
        ):
            foreign.append(f"[{section.name}]")
        elif identity in eds_device.COMMISSIONING:
            of_dcf += bool(section.entries)
    said = []
    if strange:
        said.append(f"left out, as CiA 306 has no such keys ({len(strange)}): {_named(strange)}")
    if foreign:
        said.append(f"left out, as CiA 306 has no such sections ({len(foreign)}): {_named(foreign)}")
    if of_dcf and file_format == "eds":
        said.append(
            "left out: commissioning, UploadFile, DownloadFile and Denotation; an EDS has none, write a .dcf to keep them"
        )
    return said


def _kept(description: Description, file_format: Literal["eds", "dcf"]) -> Iterator[tuple[str, list[str]]]:
    """Yield sections by name, each with the lines to keep of it."""
    for identity, section in description.document.sections.items():
        match = _OBJECT.fullmatch(identity)
        if match is not None and int(match[1], 16) >= 0x1000:
            yield identity, _lines(section, _OF_OBJECTS[file_format])
        elif identity.endswith("denotation") and file_format == "dcf":
            yield from _denotations(identity, section)
        elif identity == "deviceinfo":
            yield section.name, _lines(section, _OF_DEVICE)
        elif identity == "dummyusage":
            dummies = sorted(index for index in description.dictionary.indices if 7 < index < 0x1000)
            yield section.name, [f"Dummy{index:04X}=1" for index in dummies]
        elif identity in eds_device.COMMISSIONING and file_format == "dcf":
            yield eds_device.DEVICE_COMMISSIONING, _lines(section, _OF_COMMISSIONING)
        elif _WHOLE.fullmatch(identity):
            yield section.name, [f"{entry.key}={_safe(entry.value)}" for entry in section.entries.values()]


def _lines(section: EdsSection, keys: tuple[str, ...]) -> list[str]:
    lines = []
    for key in keys:
        entry = section.get(key)
        if entry is None:
            continue
        text = _safe(entry.value)
        if key in {"ObjFlags", "NetNumber", "LSS_SerialNumber"}:  # one reading only
            number = values.number(entry.value).value
            if not isinstance(number, int):
                continue
            text = f"0x{number:X}" if key != "NetNumber" else str(number)
        lines.append(f"{key}={text}")
    return lines


def _denotations(identity: str, section: EdsSection) -> Iterator[tuple[str, list[str]]]:
    """Return the denotations of a compact notation, written out."""
    for key, entry in section.entries.items():
        if key.isascii() and key.isdigit() and len(key) <= 3 and entry.value:
            yield f"{identity[:4]}sub{int(key):X}", [f"Denotation={_safe(entry.value)}"]


def _safe(text: str) -> str:
    """Replace characters that a file's line or a terminal cannot take."""
    return "".join(c if c.isprintable() or c == "\t" else "\ufffd" for c in text)


def _named(names: list[str]) -> str:
    more = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
