"""XDD and XDC files, divided into the sections of an EDS.

A warning therefore names the key of the EDS (``[2100sub1] DefaultValue``) and the line of the XML. Data type, access, limits
and values may be at an object, or at the parameter to which its ``uniqueIDRef`` refers; the object's own take precedence.

The file is not trusted: see `drive_profiles.files.xml_tree`, and its size is bounded.

Source: CiA 311; the type names are those of IEC 61131-3.
"""

from pathlib import Path

from drive_profiles.eds.objects import MAX_VARIABLES
from drive_profiles.eds.text import BLANK, MAX_BYTES, MAX_SECTIONS, Document, EdsEntry, EdsSection, Findings, quoted
from drive_profiles.errors import FileError, Problem
from drive_profiles.files.xml_tree import Element, parse

_TYPES = {
    "BOOL": 0x01,
    "SINT": 0x02, "INT": 0x03, "DINT": 0x04, "LINT": 0x15, "USINT": 0x05, "UINT": 0x06, "UDINT": 0x07, "ULINT": 0x1B,
    "BYTE": 0x05, "CHAR": 0x05, "WORD": 0x06, "DWORD": 0x07, "LWORD": 0x1B, "REAL": 0x08, "LREAL": 0x11, "STRING": 0x09,
    "WSTRING": 0x0B, "BITSTRING": 0x0A,
}  # fmt: skip
_ACCESS = {
    "const": "const", "read": "ro", "write": "wo", "readWrite": "rw", "readWriteInput": "rwr", "readWriteOutput": "rww",
    "noAccess": "ro",
}  # fmt: skip
_DEVICE = {"vendorName": "VendorName", "vendorID": "VendorNumber", "productName": "ProductName", "productID": "ProductNumber"}


def read(data: bytes, path: Path, findings: Findings) -> Document:
    """Divide an XDD file into the sections that an EDS would have.

    Raises:
        FileError: The file is too large, unsafe, no XML, or no description of a CANopen device.
    """
    if len(data) > MAX_BYTES:
        raise FileError(path, (Problem(0, "", f"is larger than {MAX_BYTES >> 20} MiB", "a description of a CANopen device"),))
    root = parse(data, path, "an XDD file")
    lists = [element for element in root.walk() if element.tag == "CANopenObjectList"]
    if not lists:
        raise FileError(
            path, (Problem(root.line, "", f"<{root.tag}> has no CANopenObjectList", "an XDD file of a CANopen device"),)
        )
    if len(lists) > 1:
        findings.warn(lists[1].line, "", "", "a further CANopenObjectList ignored", "one list of objects")
    parameters = {element.attributes.get("uniqueID", ""): element for element in root.walk() if element.tag == "parameter"}
    document = Document(path, [], "utf-8", {})
    for section in (_device_info(root), _dummies(root)):
        document.sections[section.name.lower()] = section
    for item in lists[0].children:
        if item.tag == "CANopenObject":
            _object(document, item, parameters, findings)
    return document


def _section(name: str, line: int, values: dict[str, tuple[str | None, int]]) -> EdsSection:
    section = EdsSection(name, line, line)
    for key, (value, at) in values.items():
        if value is not None:
            section.entries[key.lower()] = EdsEntry(key, value.replace("\r", " ").replace("\n", " ").strip(BLANK), at)
    return section


def _device_info(root: Element) -> EdsSection:
    """Return the section ``[DeviceInfo]`` as an EDS would have it."""
    values: dict[str, tuple[str | None, int]] = {}
    line = root.line
    for element in root.walk():
        if element.tag == "DeviceIdentity":
            line = element.line
            for child in element.children:
                if child.tag in _DEVICE:
                    values[_DEVICE[child.tag]] = (child.text.strip(), child.line)
        elif element.tag == "CANopenGeneralFeatures":
            for key, attribute in (("NrOfRXPDO", "nrOfRxPDO"), ("NrOfTXPDO", "nrOfTxPDO"), ("Granularity", "granularity")):
                values[key] = (element.attributes.get(attribute), element.line)
        elif element.tag == "supportedBaudRate":
            rate, _, unit = element.attributes.get("value", "").partition(" ")
            if unit.lower() == "kbps":
                values[f"BaudRate_{rate}"] = ("1", element.line)
    return _section("DeviceInfo", line, values)


def _dummies(root: Element) -> EdsSection:
    values: dict[str, tuple[str | None, int]] = {}
    for element in root.walk():
        if element.tag == "dummy":
            key, _, value = element.attributes.get("entry", "").partition("=")
            values[key.strip()] = (value.strip(), element.line)
    return _section("DummyUsage", root.line, values)


def _object(document: Document, item: Element, parameters: dict[str, Element], findings: Findings) -> None:
    """Add the section of an object and those of its sub-objects."""
    index = _hexadecimal(item.attributes.get("index", ""), 0xFFFF)
    if index is None or index < 0x1000:
        seen = quoted(item.attributes.get("index", ""))
        findings.refuse(item.line, "CANopenObject", "index", f"{seen} is not an index; the object is left out", "1000 to FFFF")
        return
    subs = [child for child in item.children if child.tag == "CANopenSubObject"]
    name = f"{index:04X}"
    if not _add(document, name, _values(item, parameters, has_subs=bool(subs)), item, findings):
        return
    for sub in subs:
        subindex = _hexadecimal(sub.attributes.get("subIndex", ""), 0xFF)
        if subindex is None:
            seen = quoted(sub.attributes.get("subIndex", ""))
            findings.refuse(sub.line, name, "subIndex", f"{seen} is not a sub-index; left out", "00 to FF")
            continue
        _add(document, f"{name}sub{subindex:X}", _values(sub, parameters, has_subs=False), sub, findings)


def _add(document: Document, name: str, values: dict[str, tuple[str | None, int]], item: Element, findings: Findings) -> bool:
    first = document.sections.get(name)
    if first is not None:
        findings.refuse(item.line, name, "", f"described already in line {first.line}; left out", "each object once")
        return False
    if len(document.sections) >= MAX_SECTIONS + MAX_VARIABLES:
        raise FileError(document.path, (Problem(item.line, "", "too many objects", f"at most {MAX_VARIABLES}"),))
    document.sections[name] = _section(name, item.line, values)
    return True


def _values(item: Element, parameters: dict[str, Element], *, has_subs: bool) -> dict[str, tuple[str | None, int]]:
    """Return an EDS's keys from an object's attributes and its parameter."""
    own, line = item.attributes, item.line
    parameter = parameters.get(own.get("uniqueIDRef", ""))
    mapping = own.get("PDOmapping", "no")
    values: dict[str, tuple[str | None, int]] = {
        "ParameterName": (own.get("name"), line),
        "ObjectType": (own.get("objectType"), line),
        "SubNumber": (own.get("subNumber"), line),
        "ObjFlags": (_of_hexadecimal(own.get("objFlags")), line),
        "Denotation": (own.get("denotation"), line),
    }
    if has_subs:
        return values
    values["DataType"] = (_of_hexadecimal(own.get("dataType")), line)
    values["AccessType"] = (own.get("accessType"), line)
    values["LowLimit"], values["HighLimit"] = (own.get("lowLimit"), line), (own.get("highLimit"), line)
    values["DefaultValue"], values["ParameterValue"] = (own.get("defaultValue"), line), (own.get("actualValue"), line)
    values["PDOMapping"] = ("0" if mapping == "no" else "1", line)
    for key, found in (_of_parameter(parameter) if parameter is not None else {}).items():
        if values[key][0] is None:
            values[key] = found
    if values["AccessType"][0] == "rw" and mapping in {"TPDO", "RPDO"}:
        values["AccessType"] = ("rwr" if mapping == "TPDO" else "rww", values["AccessType"][1])  # as an EDS says it
    return values


def _of_parameter(parameter: Element) -> dict[str, tuple[str | None, int]]:
    """Return an EDS's keys from a parameter of the application process."""
    access = parameter.attributes.get("access", "read")  # the default in the schema
    values: dict[str, tuple[str | None, int]] = {"AccessType": (_ACCESS.get(access, access), parameter.line)}
    for child in parameter.children:
        value = child.attributes.get("value")
        if child.tag in _TYPES:
            values["DataType"] = (f"0x{_TYPES[child.tag]:04X}", child.line)
        elif child.tag == "defaultValue":
            values["DefaultValue"] = (value, child.line)
        elif child.tag == "actualValue":
            values["ParameterValue"] = (value, child.line)
        elif child.tag == "allowedValues":
            values.update(_range(child))
    return values


def _range(allowed: Element) -> dict[str, tuple[str | None, int]]:
    """Return the limits of a parameter with one range."""
    ranges = [child for child in allowed.children if child.tag == "range"]
    if len(ranges) != 1:
        return {}
    ends = {"LowLimit": ranges[0].child("minValue"), "HighLimit": ranges[0].child("maxValue")}
    return {key: (end.attributes.get("value"), end.line) for key, end in ends.items() if end is not None}


def _of_hexadecimal(text: str | None) -> str | None:
    """Add the ``0x`` that an EDS needs to a hexadecimal number."""
    return text if text is None or text.lower().startswith("0x") else f"0x{text}"


def _hexadecimal(text: str, highest: int) -> int | None:
    text = text.strip().lower().removeprefix("0x")
    if not text or len(text) > 8 or any(character not in "0123456789abcdef" for character in text):
        return None
    number = int(text, 16)
    return number if number <= highest else None
