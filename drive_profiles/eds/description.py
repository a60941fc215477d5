"""A tolerant reader of EDS, DCF and XDD files.

It returns canopen's object dictionary and lists every repair.

Makers' files have faults. A fault costs a warning with its line, and an object that cannot be read is left out. Only a file
without any readable object is refused. Each warning says how the fault was repaired; ``strict`` refuses a file with any
fault.

Numbers: ``0x`` hexadecimal, leading 0 octal, ``$NODEID`` once in a sum. The bit pattern of a negative number in a signed type is
that number. Of repeated keys the first counts. Missing access is ``ro``, a missing or unknown data type DOMAIN. Bounds: 4 MiB,
20 000 sections, 200 000 keys, 65 536 entries with compact notations written out, 4 KiB a line, 1 KiB a text.

Source: CiA 306-1 (EDS and DCF), CiA 311 (XDD).
"""

import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord

from drive_profiles.eds import device as eds_device
from drive_profiles.eds import rewrite as eds_rewrite
from drive_profiles.eds import xdd
from drive_profiles.eds.contradictions import found
from drive_profiles.eds.objects import Builder, parts_of
from drive_profiles.eds.text import MAX_BYTES, Document, Findings, quoted, read
from drive_profiles.eds.variables import Content
from drive_profiles.errors import FileError, OutOfRangeError, Problem
from drive_profiles.files.reading import read_file
from drive_profiles.standard.cia301 import MAX_NODE_ID

__all__ = ["MAX_BYTES", "Description", "FileFormat", "load", "loads"]

FileFormat = Literal["eds", "dcf", "xdd"]
_SUFFIXES: dict[str, FileFormat] = {".eds": "eds", ".dcf": "dcf", ".xdd": "xdd", ".xdc": "xdd"}


@dataclass(frozen=True)
class Description:
    """A device as its file describes it.

    Attributes:
        dictionary: Every object that could be read. A default with ``$NODEID`` is marked ``relative``; its value has the node-ID
            in it if that is known, and is the constant part otherwise.
        warnings: Repairs: line, key such as ``[60C2sub2] DefaultValue``, the text in the file and the value taken for it.
        refused: Objects that were left out, with the reason.
        node_id: Node-ID as given to `load`, else that of the commissioning section (either spelling of its name).
        own_node_id: Node-ID of the commissioning section, whatever was given to `load`.
        bitrate_bit_s: Bit rate in the commissioning section.
        vendor_id: None, as product code and revision, if the file does not state it; the names are then empty.
        values: The parameter values, typed, by index and sub-index. Those that need an unknown node-ID are missing.
        contradictions: Contradictions of the file with itself or with the standard; both sides are kept.
        flags: The ``ObjFlags`` other than 0, by index and sub-index: see `variables.ObjectFlag`.
        serial_number: ``LSS_SerialNumber`` in the commissioning section, None if there is none.
    """

    path: Path
    file_format: FileFormat
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
    contradictions: tuple[Problem, ...] = ()
    flags: dict[tuple[int, int], int] = field(default_factory=dict)
    serial_number: int | None = None
    own_node_id: int | None = None
    _builder: Builder | None = field(default=None, repr=False, compare=False)
    _document: Document | None = field(default=None, repr=False, compare=False)

    @property
    def vendor_ids(self) -> tuple[int, ...]:
        """Vendor-IDs in ``[DeviceInfo]`` and 1018h:1, two if they contradict each other."""
        return self._stated(self.vendor_id, 1)

    @property
    def product_codes(self) -> tuple[int, ...]:
        """Product codes in ``[DeviceInfo]`` and in the default of 1018h:2."""
        return self._stated(self.product_code, 2)

    def _stated(self, number: int | None, subindex: int) -> tuple[int, ...]:
        item = self.dictionary.indices.get(0x1018)
        member = item.subindices.get(subindex) if isinstance(item, ODRecord | ODArray) else None
        default = member.default if member is not None else None
        also = default if isinstance(default, int) and number else None  # a default alone is a guess of the file's
        return tuple(dict.fromkeys(each for each in (number, also) if each))

    @property
    def problems(self) -> tuple[Problem, ...]:
        """All repairs, contradictions and refusals, by line."""
        return tuple(sorted((*self.warnings, *self.contradictions, *self.refused)))

    @property
    def document(self) -> Document:
        """The text of the file, divided into sections."""
        return self._document or Document(self.path, [], "utf-8", {})

    def rewrite(
        self,
        values: Mapping[tuple[int, int], Content],
        commissioning: Mapping[str, str] = types.MappingProxyType({}),
        comments: Sequence[str] = (),
    ) -> bytes:
        """Return the file with other parameter values; other bytes stay.

        The result is read again before it is returned, to prove that it holds the values. `commissioning` has keys of that
        section (CiA 306: ``NodeID``, ``LSS_SerialNumber`` …) with their values, `comments` lines beside them.

        Raises:
            FileError: An object is not in the file, a value is not of its type, or the file is an XDD.
        """
        if self._builder is None:
            problem = Problem(0, "", "is an XDD file, which is not rewritten", "a DCF: convert it first")
            raise FileError(self.path, (problem,))
        data = eds_rewrite.rewritten(self.document, self._builder, values, commissioning, comments)
        again = loads(data, self.path, node_id=self.node_id, file_format=self.file_format)
        wrong = [key for key, wanted in values.items() if key not in again.values or again.values[key] != wanted]
        if wrong:
            problems = (
                Problem(0, f"{index:04X}:{sub:02X}", f"{quoted(str(values[index, sub]))} cannot be kept in this file", "")
                for index, sub in wrong
            )
            raise FileError(self.path, tuple(problems))
        return data


def load(path: str | Path, *, node_id: int | None = None, strict: bool = False) -> Description:
    """Read the description of a device from a file.

    It is an EDS, DCF, XDD or XDC file of at most 4 MiB. `node_id` is preferred to that of the file for ``$NODEID``; `strict`
    refuses a file with any fault.

    Raises:
        FileError: The file cannot be read, has no object, or has faults and `strict` is set; with all problems.
        OutOfRangeError: `node_id` is not from 1 to 127.
    """
    path = Path(path)
    data = read_file(path, "an EDS, DCF or XDD file", max_bytes=MAX_BYTES)
    return loads(data, path, node_id=node_id, strict=strict)


def loads(
    data: bytes,
    path: str | Path = "<eds>",
    *,
    node_id: int | None = None,
    strict: bool = False,
    file_format: FileFormat | None = None,
) -> Description:
    """Read the description from a file's bytes, as `load` does.

    The suffix of `path` names the format, unless `file_format` or the content does.

    Raises:
        FileError: As for `load`.
        OutOfRangeError: `node_id` is not from 1 to 127.
    """
    path = Path(path)
    if node_id is not None and not 1 <= node_id <= MAX_NODE_ID:
        raise OutOfRangeError("node-ID", node_id, "", f"not from 1 to {MAX_NODE_ID}")
    findings = Findings()
    is_xml = data[:256].lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n\0").startswith(b"<")
    named = file_format or _SUFFIXES.get(path.suffix.lower())
    actual: FileFormat  # XML by the content, else by the name
    if is_xml or file_format == "xdd":
        document, actual = xdd.read(data, path, findings), "xdd"
    else:
        document = read(data, path, findings)
        is_dcf = any(name in document.sections for name in eds_device.COMMISSIONING)
        actual = named if named in {"eds", "dcf"} else "dcf" if is_dcf else "eds"
    if named is not None and named != actual:
        findings.warn(0, "", "", f"is named as {named}, but is read as {actual}", "a name that fits")
    description = _described(document, actual, node_id, findings)
    if strict and description.problems:
        raise FileError(path, description.problems)
    return description


def _described(document: Document, file_format: FileFormat, node_id: int | None, findings: Findings) -> Description:
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
    if file_format != "xdd":
        eds_device.add_compact_pdos(sections.get("deviceinfo"), builder)
        eds_device.check_lists(sections, parts, findings)
        eds_device.note_modules(sections, findings)
    if not any(index >= 0x1000 for index in dictionary.indices):
        problem = Problem(0, "", "describes no object that can be read", "sections such as [1000]")
        raise FileError(document.path, tuple(sorted((problem, *findings.refused[:20]))))
    dictionary.node_id, dictionary.bitrate = builder.node_id, bit_rate
    serial_number = eds_device.read_serial_number(sections, builder)
    warnings, refused = findings.closed()
    information = dictionary.device_information
    return Description(
        path=document.path,
        file_format=file_format,
        dictionary=dictionary,
        warnings=warnings,
        refused=refused,
        node_id=builder.node_id,
        bitrate_bit_s=bit_rate,
        vendor_id=information.vendor_number,
        product_code=information.product_number,
        revision=information.revision_number,
        vendor_name=information.vendor_name or "",
        product_name=information.product_name or "",
        values=builder.values,
        contradictions=tuple(sorted(found(sections, builder))),
        flags=builder.flags,
        serial_number=serial_number,
        own_node_id=file_node_id,
        _document=document,
        _builder=None if file_format == "xdd" else builder,
    )
