"""One variable from the keys of its section.

A missing or wrong key is noted, and the variable gets the least harmful substitute: an unreadable number is left out,
missing access is read-only, an unknown type is bytes.

Source: CiA 306-1, object description (4.6.3).
"""

from collections.abc import Callable
from enum import IntFlag

from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from drive_profiles.eds import values
from drive_profiles.eds.text import EdsEntry, EdsSection, Findings, quoted

DOMAIN_OBJECT = 0x2
Content = int | float | str | bytes
"""Value of a variable, in Python."""
_ACCESS = "ro, wo, rw, rwr, rww or const"


class ObjectFlag(IntFlag):
    """Bits of ``ObjFlags``: objects that bulk transfers must leave out."""

    REFUSES_WRITE_ON_DOWNLOAD = 1
    REFUSES_READ_ON_SCAN = 2


def assign(item: ODVariable | ODRecord | ODArray, **attributes: object) -> None:
    """Set attributes of canopen's types, bypassing their narrow annotations."""
    vars(item).update(attributes)


def made_variable(name: str, index: int, subindex: int, data_type: int, access: str, default: int | None = None) -> ODVariable:
    """Make a variable that the file does not describe itself."""
    variable = ODVariable(name, index, subindex)
    variable.data_type, variable.access_type = data_type, access
    if default is not None:
        assign(variable, default=default, default_raw=str(default))
    return variable


class VariableReader:
    """Reader that makes variables and collects types and parameter values.

    Attributes:
        types: Data types beyond those of CiA 301, each with the type that it is made of.
        values: The parameter values, by index and sub-index.
        flags: The ``ObjFlags`` other than 0, by index and sub-index; those of a head are those of all its sub-objects.
    """

    def __init__(self, findings: Findings, node_id: int | None) -> None:
        self.findings = findings
        self.remark = findings.remark
        self.node_id = node_id
        self.types: dict[int, int] = {}
        self.values: dict[tuple[int, int], Content] = {}
        self.flags: dict[tuple[int, int], int] = {}

    def variable(self, section: EdsSection, index: int, subindex: int) -> ODVariable:
        """Make a variable from the keys of its section."""
        variable = ODVariable(self.name(section, section.name), index, subindex)
        variable.data_type = self._data_type(section)
        variable.access_type = self._access(section)
        variable.pdo_mappable = bool(self.number(section, "PDOMapping", values.flag))
        assign(variable, storage_location=section.text("StorageLocation") or None)
        self._default(variable, section)
        self._limits(variable, section)
        for key, attribute in (("Description", "description"), ("Unit", "unit")):
            if section.get(key):
                setattr(variable, attribute, self.text(section, key))
        factor = section.get("Factor")
        if factor is not None:
            reading = values.value(factor.value, 0x11)
            if isinstance(reading.value, float) and reading.value:
                variable.factor = reading.value
            else:
                self.remark(section, factor, reading.remark or "not a factor; dropped", "a number other than 0")
        self.add_flags(section, index, subindex)
        return variable

    def add_flags(self, section: EdsSection, index: int, *subindices: int) -> None:
        """Add the ``ObjFlags`` of a section to those of its entries."""
        flags = self.number(section, "ObjFlags")
        for subindex in subindices if flags and flags > 0 else ():
            self.flags[index, subindex] = self.flags.get((index, subindex), 0) | (flags or 0)

    def name(self, section: EdsSection, substitute: str) -> str:
        """Return the name of an object."""
        name = self.text(section, "ParameterName")
        if name:
            return name
        self.findings.warn(section.line, section.name, "ParameterName", f"missing; named {quoted(substitute)}", "a name")
        return substitute

    def text(self, section: EdsSection, key: str) -> str:
        """Return a text that is safe to show: bounded, without control characters."""
        entry = section.get(key)
        if entry is None:
            return ""
        text = entry.value
        if not text.isprintable():
            text = "".join(c if c.isprintable() else "\ufffd" for c in text)
            self.remark(section, entry, f"control characters replaced, read as {quoted(text)}", "printable characters")
        if len(text) > values.MAX_STRING:
            self.remark(section, entry, "cut", f"at most {values.MAX_STRING} characters")
        return text[: values.MAX_STRING]

    def number(self, section: EdsSection, key: str, read: Callable[[str], values.ValueReading] = values.number) -> int | None:
        """Return the number of a key, None if it has none."""
        entry = section.get(key)
        if entry is None:
            return None
        reading = read(entry.value)
        if reading.remark:
            self.remark(section, entry, reading.remark, "0 or 1" if read is values.flag else "a whole number")
        return reading.value if isinstance(reading.value, int) else None

    def parameter_value(self, variable: ODVariable, section: EdsSection, entry: EdsEntry | None) -> None:
        """Add a ParameterValue to the values, typed."""
        if entry is None or not entry.value or variable.data_type is None:
            return
        reading = values.value(entry.value, variable.data_type, self.node_id)
        if reading.remark:
            self.remark(section, entry, reading.remark, values.expected_of(variable.data_type))
        if reading.value is None:
            return
        assign(variable, value_raw=entry.value)
        if reading.relative and self.node_id is None:
            self.remark(section, entry, "left out: the node-ID is not known", "a node-ID, in the file or given")
            return
        assign(variable, value=reading.value)
        self.values[variable.index, variable.subindex] = reading.value

    def _data_type(self, section: EdsSection) -> int:
        entry = section.get("DataType")
        domain = self.number(section, "ObjectType") == DOMAIN_OBJECT if section.get("ObjectType") else False
        if entry is None:
            if not domain:
                self.findings.warn(
                    section.line, section.name, "DataType", "missing; taken as DOMAIN, bytes of any number", "a data type"
                )
            return values.DOMAIN
        data_type = self.number(section, "DataType")
        if data_type in values.NAMES:
            return data_type
        known = self.types.get(data_type, values.DOMAIN) if data_type is not None else values.DOMAIN
        size = "bytes of any number" if known == values.DOMAIN else "from its definition"
        self.remark(section, entry, f"not a type of CiA 301; taken as {values.NAMES[known]}, {size}", "a data type of CiA 301")
        return known

    def _access(self, section: EdsSection) -> str:
        entry = section.get("AccessType")
        if entry is None:
            self.findings.warn(
                section.line, section.name, "AccessType", "missing; taken as ro, so that no tool writes it", _ACCESS
            )
            return "ro"
        reading = values.access(entry.value)
        if reading.value is None:
            self.remark(section, entry, f"{reading.remark}; taken as ro", _ACCESS)
            return "ro"
        if reading.remark:
            self.remark(section, entry, reading.remark, _ACCESS)
        return str(reading.value)

    def _default(self, variable: ODVariable, section: EdsSection) -> None:
        entry = section.get("DefaultValue")
        if entry is None or variable.data_type is None:
            return
        reading = values.value(entry.value, variable.data_type, self.node_id)
        if reading.remark:
            self.remark(section, entry, reading.remark, values.expected_of(variable.data_type))
        if reading.value is not None:
            assign(variable, default=reading.value, default_raw=entry.value, relative=reading.relative)

    def _limits(self, variable: ODVariable, section: EdsSection) -> None:
        """Set the limits, drop contradictory ones, warn of a default outside."""
        data_type = variable.data_type
        low, high = (self._limit(section, key, data_type or 0) for key in ("LowLimit", "HighLimit"))
        if low is not None and high is not None and low > high:
            entry = section.entries["lowlimit"]
            self.remark(section, entry, f"is above the HighLimit, {high}; both dropped", "LowLimit at most HighLimit")
            low = high = None
        assign(variable, min=low, max=high)
        default = variable.default
        if isinstance(default, int | float) and not variable.relative:
            outside = (low is not None and default < low) or (high is not None and default > high)
            if outside:
                entry = section.entries["defaultvalue"]
                self.remark(
                    section, entry, "is outside its own limits; value and limits are kept", f"a value from {low} to {high}"
                )

    def _limit(self, section: EdsSection, key: str, data_type: int) -> int | float | None:
        entry = section.get(key)
        if entry is None:
            return None
        if values.limits_of(data_type) is None and data_type not in values.REALS:
            reading = values.number(entry.value)  # a string has no limits; editors write 0 and FF..FF there
            if reading.value != 0:
                self.remark(section, entry, f"has no meaning for {values.NAMES[data_type]}; dropped", "no limit")
            return None
        reading = values.value(entry.value, data_type, self.node_id)
        if reading.remark:
            self.remark(section, entry, reading.remark, values.expected_of(data_type))
        return reading.value if isinstance(reading.value, int | float) else None
