"""Process data of a log with names and units.

The units come from the same objects that the master reads, as overheard in the log.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drive_profiles.errors import DriveProfileError
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia301 import DataType
from drive_profiles.standard.object_address import ObjectAddress
from drive_profiles.standard.objects import OBJECTS
from drive_profiles.standard.units import Scaling, counts_per_rev, rated_torque_nm
from hil.bench.bench import AxisTable, Bench
from hil.errors import NodeError
from hil.export.series import Series
from hil.logs.nodes import MAPPING_PARAMETERS, MappedNumber, Node, Pdo
from hil.logs.overheard import OverheardValue
from hil.logs.trace import Trace
from hil.master.drive import mapping
from hil.master.drive.needs import Need
from hil.master.drive.scale import OverheardQuestions, read_scaling
from hil.master.sensor import DIGITS_OBJECT, METRE_PER_SECOND_SQUARED, UNIT_OBJECT

POSITIONS = {0x6062, 0x6064, 0x6065, 0x6067, 0x607A, 0x60F4, 0x60C1}
SPEEDS = {0x606B, 0x606C, 0x60B1, 0x60FF}
TORQUES = {0x6071, 0x6074, 0x6077, 0x60B2}
"""Indices of CiA 402's process data that are counted in units of positions, of speeds, and in per mille of the rated torque."""
AXES_OF_SENSOR = "xyz"


@dataclass(frozen=True)
class WireUnit:
    """Unit of a number on the bus.

    Attributes:
        name: Name of the number, with its unit as in a recording.
        factor: SI value of 1, with its sign.
        unit: WireUnit in words; "" if it is not known, or there is none.
        kind: Data type, if bench file or profile has it.
    """

    name: str
    factor: float = 1.0
    unit: str = ""
    kind: DataType | None = None


class NodeUnits:
    """Units of a node's numbers."""

    def __init__(self, node: Node, bench: Bench | None) -> None:
        """Look for the scales.

        Raises:
            NodeError: The log contradicts the bench file.
        """
        self._node, self._own = node, {}
        self.notes: list[str] = []
        self.prefix = f"node{node.number}"
        found = [each for each in ({} if bench is None else bench.axis).items() if each[1].node_id == node.number]
        self._scaling: Scaling | None = None
        if found:
            number, table = found[0]
            self.prefix = f"axis{number}"
            profile = Profile.load(table.profile)
            asked = OverheardQuestions(node)
            self._scaling = read_scaling(asked, number, table, profile)
            self._own = _own_of(table, profile)
            if self._scaling is None:
                lacking = ", ".join(need.name for need in asked.missing)
                self.notes.append(f"axis {number}: the log has no scale ({lacking}); the numbers stay as on the bus")
        elif bench is not None and bench.accelerometer.node_id == node.number:
            self.prefix = "tip"
        elif node.pdo_with("tpdo", 0x6064) is not None or node.pdo_with("rpdo", 0x607A) is not None:
            self._scaling = self._standard()

    def _standard(self) -> Scaling | None:
        """Return the scale by 608Fh and 6076h, if nothing else is known."""
        asked = OverheardQuestions(self._node)
        needs = (((0x608F, 1), "608Fh:1"), ((0x608F, 2), "608Fh:2"), ((0x6076, 0), "6076h"))
        values = [asked.number(Need(address, name, "")) for address, name in needs]
        feed = asked.number(Need((0x6092, 1), "feed", ""), is_optional=True)
        name = f"node {self._node.number}"
        increments, turns, torque = values
        if increments is None or turns is None or torque is None:
            lacking = ", ".join(need.name for need in asked.missing)
            self.notes.append(f"{name}: {lacking} not in the log; the numbers stay as on the bus; give --bench for the scale")
            return None
        if feed is not None and feed != increments // max(turns, 1):
            self.notes.append(
                f"{name} may count by its feed constant (6092h); the numbers stay as on the bus; give --bench for the scale"
            )
            return None
        polarity = asked.number(Need((0x607E, 0), "polarity", ""), is_optional=True)
        if polarity is None:
            self.notes.append(f"{name}: 607Eh is not in the log; the signs stay as on the bus")
        try:
            return Scaling(counts_per_rev("608Fh", increments, turns), rated_torque_nm(torque), polarity=polarity or 0)
        except DriveProfileError as error:
            raise NodeError(self._node.number, f"its units are invalid: {error}") from error

    def of(self, address: ObjectAddress) -> WireUnit:
        """Unit of an object."""
        if address in self._own:
            return self._own[address]
        index, subindex = address
        known = OBJECTS.get(address)
        name = f"object_{index:04x}_{subindex:x}" if known is None else known[0]
        if index == mapping.ACCELERATION_OBJECT and 1 <= subindex <= len(AXES_OF_SENSOR):
            name, step = AXES_OF_SENSOR[subindex - 1], acceleration_step_m_s2(self._node, subindex)
            return WireUnit(name) if step is None else WireUnit(f"{name}_m_s2", step, "m/s^2")
        if self._scaling is not None and index in POSITIONS:
            return WireUnit(f"{name}_rad", self._scaling.position_rad(1), "rad")
        if self._scaling is not None and index in SPEEDS:
            return WireUnit(f"{name}_rad_s", self._scaling.speed_rad_s(1), "rad/s")
        if self._scaling is not None and index in TORQUES:
            return WireUnit(f"{name}_nm", self._scaling.torque_nm(1), "Nm")
        return WireUnit(name)


def acceleration_step_m_s2(node: Node, subindex: int) -> float | None:
    """Return m/s² per step of an accelerometer's axis; None if that is not known."""
    asked = OverheardQuestions(node)
    unit = asked.number(Need((UNIT_OBJECT, subindex), "unit", ""), is_optional=True)
    digits = asked.number(Need((DIGITS_OBJECT, subindex), "digits", ""), is_optional=True)
    return 10.0**-digits if digits is not None and unit == METRE_PER_SECOND_SQUARED else None


def _own_of(table: AxisTable, profile: Profile) -> dict[ObjectAddress, WireUnit]:
    """Objects of a drive that the bench file or its profile knows."""
    found = {}
    for entry, name in zip(mapping.notch_state(profile), mapping.NOTCH_STATE, strict=False):
        unit = WireUnit(name.replace(".", "_"), 1.0, "Hz" if name.endswith("_hz") else "", entry.kind)
        found[entry.index, entry.subindex] = unit
    for entry in mapping.load_position(table, profile):
        if table.load_encoder is not None:
            found[entry.index, entry.subindex] = WireUnit("load_rad", table.load_encoder.rad_per_count, "rad", entry.kind)
    return found


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
        name: Name: `axis2_tpdo1`.
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
    """Return the frames of a PDO under its own mapping; shape (n,)."""
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
