"""Rewriting of a file with other parameter values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from canopen.objectdictionary import ObjectDictionary, ODVariable

from drive_profiles.eds import values as eds_values
from drive_profiles.eds.device import COMMISSIONING, DEVICE_COMMISSIONING
from drive_profiles.eds.objects import Builder, ObjectSections
from drive_profiles.eds.text import Document, EdsSection, Replacement
from drive_profiles.eds.variables import Content
from drive_profiles.errors import FileError, Problem


@dataclass(slots=True)
class _Changes:
    replace: dict[int, Replacement] = field(default_factory=dict)
    insert: dict[int, list[str]] = field(default_factory=dict)


def rewritten(
    document: Document,
    builder: Builder,
    values: Mapping[tuple[int, int], Content],
    commissioning: Mapping[str, str],
    comments: Sequence[str],
) -> bytes:
    """Return the bytes of the file with other parameter values in it.

    Raises:
        FileError: Some values cannot be written; the error has all of them.
    """
    changes = _Changes()
    problems: list[Problem] = []
    compact: dict[int, dict[int, Replacement]] = {}
    for (index, subindex), value in sorted(values.items()):
        key = f"{index:04X}:{subindex:02X}"
        variable = _variable(builder.dictionary, index, subindex)
        section = builder.sections.get((index, subindex))
        if variable is None or (section is None and (index not in builder.compact or subindex == 0)):
            problems.append(Problem(0, key, "is not an object with a section in this file", "an object that can be written"))
            continue
        data_type = variable.data_type or eds_values.DOMAIN
        try:
            written = Replacement(eds_values.text_of(value, data_type), eds_values.limits_of(data_type) is not None)
        except ValueError as error:
            line = section.line if section is not None else 0
            problems.append(Problem(line, key, str(error), eds_values.expected_of(data_type)))
            continue
        if section is not None:
            default = section.entries.get("defaultvalue")  # a value that is not there yet is inserted behind it
            _set(changes, section, "ParameterValue", written, section.last if default is None else default.line)
        else:
            compact.setdefault(index, {})[subindex] = written
    for index, contents in compact.items():
        _set_compact(changes, builder.compact[index], contents)
    _commission(changes, document, commissioning, comments)
    if problems:
        raise FileError(document.path, tuple(problems))
    try:
        return document.rewritten(changes.replace, changes.insert)
    except UnicodeEncodeError as error:
        problem = Problem(
            0, "", f"has no {error.object[error.start]!r} in its encoding, {error.encoding}", "characters that it has"
        )
        raise FileError(document.path, (problem,)) from error


def _variable(dictionary: ObjectDictionary, index: int, subindex: int) -> ODVariable | None:
    """Return the variable at an address; canopen's arrays would invent one."""
    item = dictionary.indices.get(index)
    if item is None or isinstance(item, ODVariable):
        return item if subindex == 0 else None
    member: ODVariable | None = item.subindices.get(subindex)
    return member


def _set(changes: _Changes, section: EdsSection, key: str, new: Replacement, after: int) -> None:
    entry = section.entries.get(key.lower())
    if entry is not None:
        changes.replace[entry.line] = new
    else:
        changes.insert.setdefault(after, []).append(f"{key}={new.value}")


def _set_compact(changes: _Changes, parts: ObjectSections, contents: dict[int, Replacement]) -> None:
    """Write values into the ``[xxxxValue]`` section of a compact notation."""
    section = parts.lists.get("value")
    if section is None:
        lines = ["", f"[{parts.index:04X}Value]", f"NrOfEntries={len(contents)}"]
        lines += [f"{subindex}={new.value}" for subindex, new in contents.items()]
        after = parts.head.last if parts.head is not None else 0
        changes.insert.setdefault(after, []).extend(lines)
        return
    present = {int(key): entry for key, entry in section.entries.items() if key.isascii() and key.isdigit() and len(key) <= 3}
    added = 0
    for subindex, new in contents.items():
        if subindex in present:
            changes.replace[present[subindex].line] = new
        else:
            added += 1
            changes.insert.setdefault(section.last, []).append(f"{subindex}={new.value}")
    if added:
        count = sum(1 for subindex in present if 1 <= subindex <= 0xFE) + added
        _set(changes, section, "NrOfEntries", Replacement(str(count), keeps_comment=True), section.line)


def _commission(changes: _Changes, document: Document, keys: Mapping[str, str], comments: Sequence[str]) -> None:
    """Write keys of the commissioning section, which is added if missing."""
    lines = [f"; {comment}" for comment in comments]
    section = next((document.sections[name] for name in COMMISSIONING if name in document.sections), None)
    if section is not None:
        for key, value in keys.items():
            _set(changes, section, key, Replacement(value, keeps_comment=True), section.last)
        changes.insert.setdefault(section.last, []).extend(lines)
    elif keys or lines:
        device = document.sections.get("deviceinfo")
        after = device.last if device is not None else len(document.lines)
        new = ["", f"[{DEVICE_COMMISSIONING}]", *(f"{key}={value}" for key, value in keys.items()), *lines]
        changes.insert.setdefault(after, []).extend(new)
