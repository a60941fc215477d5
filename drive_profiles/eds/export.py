"""Export of a description as a clean EDS, DCF or JSON."""

import copy
import io
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, Literal

from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable
from canopen.objectdictionary.eds import export_eds

from drive_profiles.eds import Description
from drive_profiles.eds import values as eds_values
from drive_profiles.eds.kept import left_out, with_kept_keys
from drive_profiles.eds.variables import Content, assign
from drive_profiles.errors import Problem


def entries(dictionary: ObjectDictionary) -> Iterator[tuple[ODVariable | ODRecord | ODArray, ODVariable]]:
    """Yield each variable with its object, by index and sub-index."""
    for index in sorted(dictionary.indices):
        item = dictionary.indices[index]
        if isinstance(item, ODVariable):
            yield item, item
        else:
            for subindex in sorted(item.subindices):
                yield item, item.subindices[subindex]


def as_text(description: Description, file_format: Literal["eds", "dcf"]) -> str:
    """Write a clean file whose values have one reading only.

    Defaults, values and limits are those that were understood. Every key of CiA 306 stays, and compact notations are written out;
    `lost` lists what does not stay.
    """
    dictionary = copy.deepcopy(description.dictionary)
    for _, variable in entries(dictionary):
        _canonical(variable, description.node_id)
    out = io.StringIO()
    file_info = dict(vars(dictionary).get("__edsFileInfo", {}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # canopen 2.4 asks for utcnow, which Python 3.12 wants to drop
        # A dictionary of its own: the exporter writes into its default argument, so that files would inherit from each other.
        export_eds(dictionary, out, file_info, device_commisioning=file_format == "dcf")  # type: ignore[no-untyped-call]  # canopen
    return with_kept_keys(out.getvalue(), description, file_format)


def as_data(description: Description) -> dict[str, Any]:
    """Return the whole description in JSON's types; bytes are hexadecimal."""
    return {
        **summary(description),
        "objects": [
            {**entry_data(item, variable), "flags": description.flags.get((variable.index, variable.subindex), 0)}
            for item, variable in entries(description.dictionary)
        ],
        "values": {
            f"{index:04X}:{subindex:02X}": plain(value) for (index, subindex), value in sorted(description.values.items())
        },
        **findings_data(description),
    }


def findings_data(description: Description) -> dict[str, list[dict[str, Any]]]:
    """Return the problems of the file by their kind, in JSON's types."""
    kinds = ("warnings", "contradictions", "refused")
    return {kind: [problem._asdict() for problem in getattr(description, kind)] for kind in kinds}


def summary(description: Description) -> dict[str, Any]:
    """Return the facts about the file as a whole, in JSON's types."""
    return {
        "path": str(description.path),
        "kind": description.file_format,
        "vendor_id": description.vendor_id,
        "vendor_name": description.vendor_name,
        "product_code": description.product_code,
        "product_name": description.product_name,
        "revision": description.revision,
        "node_id": description.node_id,
        "bitrate_bit_s": description.bitrate_bit_s,
        "serial_number": description.serial_number,
        "object_count": sum(index >= 0x1000 for index in description.dictionary.indices),
        "entry_count": sum(variable.index >= 0x1000 for _, variable in entries(description.dictionary)),
        "value_count": len(description.values),
    }


def entry_data(item: ODVariable | ODRecord | ODArray, variable: ODVariable) -> dict[str, Any]:
    """Return one variable in JSON's types."""
    return {
        "index": variable.index,
        "subindex": variable.subindex,
        "object": item.name,
        "name": variable.name,
        "type": eds_values.NAMES.get(variable.data_type or 0, "unknown"),
        "access": variable.access_type,
        "default": plain(variable.default),
        "relative": variable.relative,
        "low": variable.min,
        "high": variable.max,
        "mappable": variable.pdo_mappable,
        "value": plain(variable.value),
    }


def plain(value: Content | None) -> int | float | str | None:
    """Return a value in JSON's types."""
    return value.hex().upper() if isinstance(value, bytes) else value


def lost(description: Description, file_format: str) -> tuple[Problem, ...]:
    """List the parts of a description that a conversion loses."""
    problems = []
    if description.refused:
        problems.append(Problem(0, "", f"{len(description.refused)} parts of the file could not be read and are left out", ""))
    if file_format == "eds" and description.values:
        problems.append(Problem(0, "", f"{len(description.values)} parameter values left out: an EDS has none", "a .dcf"))
    if file_format != "json":
        problems += [Problem(0, "", said, "") for said in left_out(description, "eds" if file_format == "eds" else "dcf")]
        problems += _lost_texts(description, with_values=file_format == "dcf")
    return tuple(problems)


def _lost_texts(description: Description, *, with_values: bool) -> list[Problem]:
    """List texts with control characters or outer blanks, which no line holds."""
    problems = []
    for _, variable in entries(description.dictionary):
        for attribute in ("default", "value") if with_values else ("default",):
            content = vars(variable).get(attribute)
            try:
                if content is not None and not variable.relative:
                    eds_values.text_of(content, variable.data_type or eds_values.DOMAIN)
            except ValueError as error:
                key = f"{variable.index:04X}:{variable.subindex:02X}"
                problems.append(Problem(0, key, f"its {attribute} left out: {error}", ""))
    return problems


def _canonical(variable: ODVariable, node_id: int | None) -> None:
    """Write default and value in canonical form; omit missing ones."""
    attributes: Mapping[str, Any] = vars(variable)
    data_type = variable.data_type or eds_values.DOMAIN
    for attribute in ("default", "value"):
        content = attributes.get(attribute)
        raw: str | None = None
        if content is not None and variable.relative and attribute == "default":
            raw = f"$NODEID+0x{content - (node_id or 0):X}"
        elif content is not None:
            try:
                raw = eds_values.text_of(content, data_type)
            except ValueError:  # control characters in a text: they could not be read back
                assign(variable, **{attribute: None})
        assign(variable, **{f"{attribute}_raw": raw})
