"""Readers of signals: frame, place and scale of each number.

The scales of a node's numbers come from overheard objects or files.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from drive_profiles.errors import DriveProfileError
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia402 import Object
from drive_profiles.standard.units import counts_per_rev
from hil.bench.bench import AxisTable, Bench
from hil.control.arrays import Real
from hil.errors import NodeError
from hil.export.decoded import acceleration_step_m_s2
from hil.logs.log import Stream
from hil.logs.nodes import MappedNumber, Node, Pdo
from hil.master.drive import mapping
from hil.master.drive.needs import Need
from hil.master.drive.scale import OverheardQuestions, read_scaling
from hil.scope.signals import Signal, SignalQuantity

_USER_UNITS = (Object.POLARITY, Object.SI_UNIT_POSITION, Object.SI_UNIT_VELOCITY)


@dataclass(frozen=True)
class Scales:
    """Scales of a drive.

    None if a scale is not known; the numbers are then shown as they are.
    """

    rev_per_count: float | None = None
    rps_per_count: float | None = None
    nm_per_mille: float | None = None


def scales_of(node: Node, number: int, table: AxisTable | None, profile: Profile | None) -> Scales:
    """Scales of a drive."""
    if table is not None and profile is not None:
        try:
            scaling = read_scaling(OverheardQuestions(node), number, table, profile)
        except NodeError:
            return Scales()
        if scaling is not None:
            return Scales(
                1.0 / (2.0 * math.pi * scaling.counts_per_rad) * scaling.position_sign,
                1.0 / (2.0 * math.pi * scaling.speed_units_per_rad_s),
                scaling.torque_nm(1),
            )
    return _by_the_standard(node, table)


def _by_the_standard(node: Node, table: AxisTable | None) -> Scales:
    """Return scales by 608Fh and 6076h, without units of its own."""
    asked = OverheardQuestions(node)

    def said(index: int, subindex: int = 0) -> int | None:
        return asked.number(Need((index, subindex), "", ""), is_optional=True)

    increments, revolutions, feed, rated = said(0x608F, 1), said(0x608F, 2), said(0x6092, 1), said(0x6076)
    counts = None if table is None else table.encoder_counts_per_rev
    if increments and revolutions and not any(said(index) for index in _USER_UNITS):
        try:
            counts = counts_per_rev("608Fh", increments, revolutions)
        except DriveProfileError:
            counts = None
        if feed is not None and feed != counts:  # it may count by it
            counts = None
    torque = None if table is None else table.rated_torque_nm
    torque = rated * 1e-3 if rated else torque
    return Scales(
        None if counts is None else 1.0 / counts,
        None if counts is None else 1.0 / counts,
        None if torque is None else torque * 1e-3,
    )


TARGET = "target"
"""Name of the set-point of a position, from which the following error is made; it has no figure of its own."""


@dataclass(frozen=True)
class FrameReader:
    """A number in the frames of one identifier.

    Attributes:
        least: Bytes that a frame must have.
        key: Signal, or the name of a set-point with its axis.
    """

    can_id: int
    least: int
    key: Signal | tuple[str, str]
    decode: Callable[[Stream], Real]


@dataclass(frozen=True)
class FrameReading:
    """All that is read from the frames of a bus.

    Attributes:
        expected: Node of each identifier that is awaited with every SYNC.
    """

    readers: tuple[FrameReader, ...]
    expected: Mapping[int, int]
    axes: tuple[str, ...]


def reading_of(nodes: Mapping[int, Node], bench: Bench | None) -> FrameReading:
    """Numbers that can be read, by the nodes as they are known."""
    tables = {} if bench is None else {table.node_id: (number, table) for number, table in bench.axis.items()}
    readers: list[FrameReader] = []
    expected: dict[int, int] = {}
    axes = []
    for node in nodes.values():
        number, table = tables.get(node.number, (node.number, None))
        own = list(_of_drive(node, number, table)) + list(_of_sensor(node))
        readers += own
        if any(isinstance(each.key, Signal) and each.key.quantity is SignalQuantity.POSITION for each in own):
            axes.append(_name(number, table))
        expected |= {
            pdo.can_id: node.number for pdo in node.pdos if pdo.direction == "tpdo" and pdo.transmission_type in {None, 1} and own
        }
    return FrameReading(tuple(readers), expected, tuple(axes))


def _name(number: int, table: AxisTable | None) -> str:
    return f"node {number}" if table is None else f"axis {number}"


def _of_drive(node: Node, number: int, table: AxisTable | None) -> Iterable[FrameReader]:
    profile = None if table is None else _profile(table.profile)
    scales, name = scales_of(node, number, table, profile), _name(number, table)
    turns, speed, torque = scales.rev_per_count, scales.rps_per_count, scales.nm_per_mille
    known: tuple[tuple[int, SignalQuantity, float | None, str, str], ...] = (
        (Object.STATUS_WORD, SignalQuantity.STATUS_WORD, 1.0, "", ""),
        (Object.POSITION_ACTUAL, SignalQuantity.POSITION, turns, "rev", "counts"),
        (Object.VELOCITY_ACTUAL, SignalQuantity.SPEED, speed, "rev/s", "counts/s"),
        (Object.FOLLOWING_ERROR_ACTUAL, SignalQuantity.FOLLOWING_ERROR, turns, "rev", "counts"),
        (Object.TORQUE_ACTUAL, SignalQuantity.TORQUE, torque, "N·m", "‰"),
    )
    for index, quantity, factor, unit, raw in known:
        placed = node.pdo_with("tpdo", index)
        if placed is not None:
            key = Signal(name, quantity, raw if factor is None else unit)
            yield _reader(placed, key, 1.0 if factor is None else factor)
    placed = node.pdo_with("rpdo", Object.TARGET_POSITION)
    if placed is not None:
        yield _reader(placed, (TARGET, name), 1.0 if turns is None else turns)
    if profile is not None:
        yield from _of_notch(node, name, profile)


def _profile(name: str) -> Profile | None:
    try:
        return Profile.load(name)
    except DriveProfileError:
        return None


def _reader(placed: tuple[Pdo, MappedNumber], key: Signal | tuple[str, str], factor: float) -> FrameReader:
    pdo, entry = placed
    return FrameReader(pdo.can_id, entry.bytes, key, lambda stream: np.asarray(entry.of(stream) * factor, np.float64))


def _of_notch(node: Node, name: str, profile: Profile) -> Iterable[FrameReader]:
    """Yield the reader for the first filter's zero frequency.

    0 while the filter is off; only if the drive sends both (`hil.master.drive.mapping`).
    """
    state = mapping.notch_state(profile)
    if not state:
        return
    active, frequency = (node.pdo_with("tpdo", each.index, each.subindex) for each in state)
    if active is None or frequency is None or active[0] != frequency[0] or frequency[1].bits != 32:
        return
    is_active, in_hz = active[1], replace(frequency[1], is_real=True)

    def decode(stream: Stream) -> Real:
        found = in_hz.numbers(stream)
        return np.where((is_active.of(stream) != 0) & np.isfinite(found), found, 0.0)

    yield FrameReader(active[0].can_id, max(is_active.bytes, in_hz.bytes), Signal(name, SignalQuantity.NOTCH, "Hz"), decode)


def _of_sensor(node: Node) -> Iterable[FrameReader]:
    scale = acceleration_step_m_s2(node, 1)
    for direction, subindex in zip("xyz", (1, 2, 3), strict=True):
        placed = node.pdo_with("tpdo", mapping.ACCELERATION_OBJECT, subindex)
        if placed is not None:
            key = Signal(f"tip {direction}", SignalQuantity.TIP, "counts" if scale is None else "m/s²")
            yield _reader((placed[0], replace(placed[1], is_signed=True)), key, 1.0 if scale is None else scale)
