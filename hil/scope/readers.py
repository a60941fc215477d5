"""Readers of signals: frame, place and scale of each number."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drive_profiles.errors import DriveProfileError
from drive_profiles.family.profile import Profile
from drive_profiles.standard.cia402 import Object
from hil.bench.bench import AxisTable, Bench
from hil.logs.log import Stream
from hil.logs.nodes import MappedNumber, Node, Pdo
from hil.master.drive import mapping
from hil.scope.scales import acceleration_scale, scales_of
from hil.scope.signals import Signal, SignalQuantity

Real = NDArray[np.float64]
TARGET = "target"
"""Name of the set-point of a position, from which the following error is made; it has no figure of its own."""
_SPEED, _FOLLOWING_ERROR = 0x606C, 0x60F4


@dataclass(frozen=True)
class FrameReader:
    """A number in the frames of one identifier.

    Attributes:
        can_id: Identifier.
        least: Bytes that a frame must have.
        key: Signal, or the name of a set-point with its axis.
        decode: Its values from the frames.
    """

    can_id: int
    least: int
    key: Signal | tuple[str, str]
    decode: Callable[[Stream], Real]


@dataclass(frozen=True)
class FrameReading:
    """All that is read from the frames of a bus.

    Attributes:
        readers: The numbers.
        expected: Node of each identifier that is awaited with every SYNC.
        axes: Names of the axes.
    """

    readers: tuple[FrameReader, ...]
    expected: Mapping[int, int]
    axes: tuple[str, ...]


def reading_of(nodes: Mapping[int, Node], bench: Bench | None) -> FrameReading:
    """Numbers that can be read, by the nodes as they are known.

    Args:
        nodes: Nodes by node-ID.
        bench: Bench file, which names axes and sensor; without it an axis is called by its node.
    """
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
        (_SPEED, SignalQuantity.SPEED, speed, "rev/s", "counts/s"),
        (_FOLLOWING_ERROR, SignalQuantity.FOLLOWING_ERROR, turns, "rev", "counts"),
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
    scale = acceleration_scale(node)
    for direction, subindex in zip("xyz", (1, 2, 3), strict=True):
        placed = node.pdo_with("tpdo", mapping.ACCELERATION_OBJECT, subindex)
        if placed is not None:
            key = Signal(f"tip {direction}", SignalQuantity.TIP, "counts" if scale is None else "m/s²")
            yield _reader((placed[0], replace(placed[1], is_signed=True)), key, 1.0 if scale is None else scale)
