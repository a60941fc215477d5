"""Process data of a log with names and units."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drive_profiles.standard.cia301 import DataType
from hil.bench.bench import Bench
from hil.export.scale import NodeUnits, WireUnit
from hil.export.series import Series
from hil.logs.nodes import MAPPING_PARAMETERS, MappedNumber, Pdo
from hil.logs.overheard import OverheardValue
from hil.logs.trace import Trace

MOST_OTHERS = 0.1
"""Fraction of a PDO's frames that may have come under another mapping: it is one, whatever the few others were."""


@dataclass(frozen=True)
class NamedNumber:
    """A number in a PDO."""

    entry: MappedNumber
    unit: WireUnit


@dataclass(frozen=True)
class NamedPdo:
    """A PDO whose mapping is known.

    Attributes:
        pdo: The PDO.
        name: Name: `axis2_tpdo1`.
        prefix: Name of the axis.
        numbers: Its numbers.
        rows: Frames that came under this mapping, of those that are long enough; shape (n,).
    """

    pdo: Pdo
    name: str
    prefix: str
    numbers: tuple[NamedNumber, ...]
    rows: NDArray[np.bool_]


@dataclass(frozen=True)
class Decoded:
    """Meaning of a log's process data."""

    trace: Trace
    pdos: tuple[NamedPdo, ...]
    notes: tuple[str, ...]


def decoded(trace: Trace, bench: Bench | None) -> Decoded:
    """Name the process data of a log.

    Args:
        trace: The log.
        bench: Bench file of the run; None if there is none.

    Raises:
        NodeError: The log contradicts the bench file.
    """
    pdos: list[NamedPdo] = []
    notes: list[str] = []
    for node in trace.nodes.values():
        units = NodeUnits(node, bench)
        notes += units.notes
        for pdo in node.pdos:
            if not pdo.entries:
                notes.append(f"{pdo.name}: its mapping is not in the log, so it is left out; give --description FILE:NODE")
                continue
            rows = _mapped_rows(trace, pdo)
            others = int(np.count_nonzero(~rows))
            if others > MOST_OTHERS * len(rows):
                notes.append(
                    f"{pdo.name} had another mapping in {others} of {len(rows)} frames, so it is left out: cut the log "
                    "between the runs"
                )
                continue
            if others:
                notes.append(f"{pdo.name}: {others} of {len(rows)} frames came under another mapping, before or after the run")
            numbers = tuple(_named(entry, units) for entry in pdo.entries)
            pdos.append(NamedPdo(pdo, f"{units.prefix}_{pdo.direction}{pdo.number}", units.prefix, numbers, rows))
    return Decoded(trace, tuple(pdos), tuple(notes))


def _named(entry: MappedNumber, units: NodeUnits) -> NamedNumber:
    unit = units.of(entry.address)
    if unit.kind is not None and unit.kind.size == entry.bits // 8:
        is_real = unit.kind in {DataType.REAL32, DataType.REAL64}
        is_signed = unit.kind in {DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32, DataType.INTEGER64}
        entry = replace(entry, is_real=is_real, is_signed=is_signed)
    return NamedNumber(entry, unit)


def _mapped_rows(trace: Trace, pdo: Pdo) -> NDArray[np.bool_]:
    """Return the frames of a PDO under its mapping; shape (n,).

    Others came under an earlier or later mapping.
    """
    index = MAPPING_PARAMETERS[pdo.direction] + pdo.number - 1
    own = tuple(entry.value for entry in pdo.entries)
    stream = trace.of(pdo)
    rows = np.ones(len(stream), bool)
    now: dict[int, int] = {}
    for event in trace.events:
        if not isinstance(event, OverheardValue) or event.node != pdo.node or event.address[0] != index:
            continue
        now[event.address[1]] = int.from_bytes(event.data, "little")
        if event.address[1] == 0 and now[0] and all(place in now for place in range(1, now[0] + 1)):
            begin = int(np.searchsorted(stream.stamp_ns, event.stamp_ns))
            rows[begin:] = tuple(now[place] for place in range(1, now[0] + 1)) == own
    return rows


def series_of(what: Decoded) -> Iterator[Series]:
    """Numbers of each PDO against time, from the log's first frame."""
    for named in what.pdos:
        stream = what.trace.of(named.pdo).only(named.rows)
        if not len(stream):
            continue
        columns = {f"{named.prefix}_{each.unit.name}": each.entry.numbers(stream) * each.unit.factor for each in named.numbers}
        yield Series(named.name, stream.stamp_ns.astype(np.float64) * 1e-9, columns)
