"""Any EDS, DCF or XDD file in, canopen's object dictionary out, with everything that had to be repaired on the way.

Files of vendors have faults, and readers that stop at the first of them, or that pass over them in silence, are of little use
at a bench. Here a fault costs a warning with its line, an object that cannot be read costs that object, and only a file in which
there is nothing to read is refused. What was made of a fault is in each warning; ``strict`` refuses all of them.

Numbers: ``0x`` hexadecimal, leading 0 octal, ``$NODEID`` once in a sum. The bit pattern of a negative number in a signed type is
that number. Said twice, the first counts. Missing access is ``ro``, a missing or unknown data type DOMAIN. Bounds: 4 MiB,
20 000 sections, 200 000 keys, 65 536 entries with compact notations written out, 4 KiB a line, 1 KiB a text.

Source: CiA 306-1 (EDS and DCF), CiA 311 (XDD).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from canopen.objectdictionary import ObjectDictionary

from drive_profiles.cia301 import MAX_NODE_ID
from drive_profiles.eds import device as eds_device
from drive_profiles.eds import rewrite as eds_rewrite
from drive_profiles.eds import xdd
from drive_profiles.eds.objects import Builder, parts_of
from drive_profiles.eds.text import MAX_BYTES, Document, Findings, quoted, read
from drive_profiles.eds.variables import Content
from drive_profiles.errors import FileError, OutOfRangeError, Problem

__all__ = ["MAX_BYTES", "Description", "Kind", "load", "loads"]

Kind = Literal["eds", "dcf", "xdd"]
_SUFFIXES: dict[str, Kind] = {".eds": "eds", ".dcf": "dcf", ".xdd": "xdd", ".xdc": "xdd"}


@dataclass(frozen=True)
class Description:
    """What a file says of a device.

    Attributes:
        path: The file.
        kind: What it is.
        dictionary: Every object that could be read. A default with ``$NODEID`` is marked ``relative``; its value has the node-ID
            in it if that is known, and is the constant part otherwise.
        warnings: What was repaired: line, key such as ``[60C2sub2] DefaultValue``, what was read and what was made of it.
        refused: Objects that were left out, with the reason.
        node_id: As given to `load`, else of the commissioning section, in either spelling of its name.
        bitrate_bit_s: Of the commissioning section.
        vendor_id: As stated, else None; so `product_code` and `revision`.
        vendor_name: Empty if not stated; so `product_name`.
        values: The parameter values, typed, without those that need a node-ID that nobody knows.
    """

    path: Path
    kind: Kind
    dictionary: ObjectDictionary
    warnings: tuple[Problem, ...]
    refused: tuple[Problem, ...]
    node_id: int | None
    bitrate_bit_s: int | None
    vendor_id: int | None
    product_code: int | None
    revision: int | None
    vendor_name: str
    product_name: str
    values: dict[tuple[int, int], Content]
    _places: eds_rewrite.Places | None = field(default=None, repr=False, compare=False)

    def rewrite(self, values: Mapping[tuple[int, int], Content]) -> bytes:
        """Give the file again with these as parameter values; every other byte is as it was.

        The result is read again before it is given, so it says what was asked for, or there is none.

        Args:
            values: By index and sub-index.

        Raises:
            FileError: An object is not in the file, a value is not of its type, or the file is an XDD.
        """
        if self._places is None:
            problem = Problem(0, "", "is an XDD file, which is not rewritten", "a DCF: convert it first")
            raise FileError(self.path, (problem,))
        data = eds_rewrite.rewritten(self.path, self._places, self.dictionary, values)
        again = loads(data, self.path, node_id=self.node_id, kind=self.kind)
        wrong = [key for key, wanted in values.items() if key not in again.values or again.values[key] != wanted]
        if wrong:
            raise FileError(
                self.path,
                tuple(
                    Problem(
                        0,
                        f"{index:04X}:{subindex:02X}",
                        f"{quoted(str(values[index, subindex]))} cannot be kept in this file",
                        "",
                    )
                    for index, subindex in wrong
                ),
            )
        return data


def load(path: str | Path, *, node_id: int | None = None, strict: bool = False) -> Description:
    """Read a file of a device.

    Args:
        path: An EDS, DCF, XDD or XDC file of at most 4 MiB.
        node_id: For ``$NODEID``; it counts before that of the file.
        strict: Refuse a file with any fault.

    Raises:
        FileError: It cannot be read, there is no object in it, or it has faults and `strict` is set; with all problems.
        OutOfRangeError: `node_id` is none.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise FileError(path, (Problem(0, "", f"cannot be read ({reason})", "an EDS, DCF or XDD file"),)) from error
    return loads(data, path, node_id=node_id, strict=strict)


def loads(
    data: bytes, path: str | Path = "<eds>", *, node_id: int | None = None, strict: bool = False, kind: Kind | None = None
) -> Description:
    """Read the bytes of a file; `load` without the reading.

    Args:
        data: What is in the file.
        path: For messages, and for the kind by its suffix.
        node_id: For ``$NODEID``; it counts before that of the file.
        strict: Refuse a file with any fault.
        kind: What it is; by suffix and content if not given.

    Raises:
        FileError: As `load`.
        OutOfRangeError: `node_id` is none.
    """
    path = Path(path)
    if node_id is not None and not 1 <= node_id <= MAX_NODE_ID:
        raise OutOfRangeError("node-ID", node_id, "", f"not from 1 to {MAX_NODE_ID}")
    findings = Findings()
    is_xml = data[:256].lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n\0").startswith(b"<")
    document = xdd.read(data, path, findings) if is_xml or kind == "xdd" else read(data, path, findings)
    named = kind or _SUFFIXES.get(path.suffix.lower())
    actual = _kind(
        named, is_xml=is_xml or kind == "xdd", is_dcf=any(name in document.sections for name in eds_device.COMMISSIONING)
    )
    if named is not None and named != actual:
        findings.warn(0, "", "", f"is named as {named}, but is read as {actual}", "a name that fits")
    description = _described(document, actual, node_id, findings)
    problems = tuple(sorted((*description.warnings, *description.refused)))
    if strict and problems:
        raise FileError(path, problems)
    return description


def _kind(named: Kind | None, *, is_xml: bool, is_dcf: bool) -> Kind:
    """What a file is: its content says whether it is XML, its name the rest, where it has one."""
    if is_xml:
        return "xdd"
    if named is None or named == "xdd":
        return "dcf" if is_dcf else "eds"
    return named


def _described(document: Document, kind: Kind, node_id: int | None, findings: Findings) -> Description:
    """The description of what has been divided into sections."""
    sections = document.sections
    builder = Builder(findings, node_id)
    file_node_id, bit_rate = eds_device.read_commissioning(sections, builder)
    if builder.node_id is None:
        builder.node_id = file_node_id
    dictionary = builder.dictionary
    eds_device.file_info(sections.get("fileinfo"), dictionary)
    eds_device.read_device_info(sections.get("deviceinfo"), builder)
    eds_device.read_comments(sections.get("comments"), builder)
    eds_device.read_dummies(sections.get("dummyusage"), builder)
    parts = parts_of(sections, findings)
    builder.build(parts)
    if kind != "xdd":
        eds_device.add_compact_pdos(sections.get("deviceinfo"), builder)
        eds_device.check_lists(sections, parts, findings)
        eds_device.note_modules(sections, findings)
    if not any(index >= 0x1000 for index in dictionary.indices):
        problem = Problem(0, "", "describes no object that can be read", "sections such as [1000]")
        raise FileError(document.path, tuple(sorted((problem, *findings.refused[:20]))))
    dictionary.node_id, dictionary.bitrate = builder.node_id, bit_rate
    warnings, refused = findings.closed()
    information = dictionary.device_information
    vendor, product, revision = eds_device.identity(information)
    return Description(
        path=document.path,
        kind=kind,
        dictionary=dictionary,
        warnings=warnings,
        refused=refused,
        node_id=builder.node_id,
        bitrate_bit_s=bit_rate,
        vendor_id=vendor,
        product_code=product,
        revision=revision,
        vendor_name=information.vendor_name or "",
        product_name=information.product_name or "",
        values=builder.values,
        _places=None if kind == "xdd" else eds_rewrite.Places(document, builder.sections, builder.compact),
    )
