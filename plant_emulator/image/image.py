"""Process image of a robot: what a SYNC means for drives that only follow.

`synchronise` of `image.h` does for all of them what their slaves would do frame by frame, to the bit. Whatever is more than that,
a drive that is being enabled or a mapping of other objects, is for the slaves; `look` decides it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from drive_profiles.standard.cia301 import DataType
from hil.can.frame import RECORD, Frame, pack
from plant_emulator.core import CORE
from plant_emulator.drive.drive import Drive
from plant_emulator.motion.axes import Axes
from plant_emulator.physics.tip import TipSensor
from plant_emulator.sensor.accelerometer import AccelerometerNode
from plant_emulator.slave.dictionary import Cell, SharedCell
from plant_emulator.slave.node import Slave
from plant_emulator.slave.pdo.rpdo import Rpdo
from plant_emulator.slave.pdo.tpdo import Tpdo

Node = Drive | AccelerometerNode

TYPES: Mapping[int, DataType] = {
    CORE.call.STATUS_WORD: DataType.UNSIGNED16,
    CORE.call.POSITION_SHOWN: DataType.INTEGER32,
    CORE.call.TORQUE_SHOWN: DataType.INTEGER16,
    CORE.call.FILTER_ACTIVE: DataType.UNSIGNED8,
    CORE.call.FILTER_FREQUENCY: DataType.REAL32,
}
"""Data types of the entries of a drive that the image shows."""


class Mapped(NamedTuple):
    """An entry of a PDO, as `mapped` of `image.h`."""

    entry: int
    row: int
    place: int


class ProcessImage:
    """The process data of all drives and the accelerometer, in C.

    Attributes:
        slaves: The nodes for which it acts: those that listen to SYNC.
        ports: Node-IDs of the senders of the TPDOs, in the order of their identifiers.
        is_in_order: True if a bus sends all TPDOs in the order of their identifiers: these are all different, and those of each
            node rise.
        delay_ns: Time by which the last TPDO leaves later than SYNC.
    """

    def __init__(
        self,
        axes: Axes,
        accelerometer: AccelerometerNode,
        sensor: TipSensor,
        measure: Callable[[], tuple[float, float, float]],
    ) -> None:
        """Lay out what does not change.

        Args:
            axes: The mechanics, and the drives' process data.
            measure: Measurement of the node that the image replaces: by this sensor.
        """
        self.slaves: list[Slave] = []
        self.ports: list[int] = []
        self.is_in_order, self.delay_ns = False, 0
        self._sensor, self._accelerometer, self._measure = sensor, accelerometer, measure
        self._drives: list[Drive] = []
        self._idle: list[Drive] = []
        self._sampled: list[tuple[Tpdo, int]] = []
        self._answer = bytearray()
        self.shared = shared = CORE.new("image")
        self._axes = CORE.pointer(axes.rows, "axis"), CORE.pointer(axes.processes, "process")
        shared.axes, shared.processes = self._axes
        shared.count, shared.period_s, shared.sensed = len(axes.numbers), axes.robot.control_period_s, axes.shared.sensed
        shared.tip, shared.sensor, shared.node = axes.tip.shared, sensor.shared, accelerometer.shared
        self._kept: list[object] = []

    def lay_out(self, nodes: Iterable[Node]) -> bool:
        """Lay out the PDOs of the nodes that listen to SYNC.

        Returns:
            True if all PDOs carry what the image knows, and act at every SYNC; else the slaves have to act.
        """
        self._drives, self._idle, self.slaves = [], [], []
        received: list[tuple[bytes, int, int]] = []
        taken: list[Mapped] = []
        told: list[Mapped] = []
        answers: list[tuple[Tpdo, Node]] = []
        rpdos: list[Rpdo] = []
        for node in nodes:
            pdos = node.slave.plain_pdos
            if pdos is None:
                return False
            self.slaves.append(node.slave)
            rpdos += pdos[0]
            answers += [(tpdo, node) for tpdo in pdos[1]]
            if not isinstance(node, Drive):
                if pdos[0]:
                    return False
                continue
            (self._drives if any(pdos) else self._idle).append(node)
            for rpdo in pdos[0]:
                objects = [(node.takes(cell), cell) for cell in rpdo.cells]
                if any(entry is None for entry, _ in objects) or rpdo.packer.size != sum(_size(cell) for cell in rpdo.cells):
                    return False  # it carries more, be it only gaps
                received.append((pack(Frame(rpdo.can_id, bytes(rpdo.packer.size))), len(taken), len(objects)))
                taken += _placed(((entry, node.row, cell) for entry, cell in objects if entry is not None), 0)
        if len({rpdo.can_id for rpdo in rpdos}) != len(rpdos):
            return False
        self.delay_ns = max((slave.tpdo_delay_ns for slave in self.slaves), default=0)
        in_turn = [(node.node_id, tpdo.can_id) for tpdo, node in answers]
        answers.sort(key=lambda each: each[0].can_id)
        self.ports = [node.node_id for _, node in answers]
        is_rising = all(one[0] != other[0] or one[1] < other[1] for one, other in pairwise(in_turn))
        self.is_in_order = is_rising and len({can_id for _, can_id in in_turn}) == len(in_turn)
        self._sampled.clear()
        for number, (tpdo, node) in enumerate(answers):
            place = number * RECORD.size + CORE.call.DATA_AT
            shown = [(self._shown(node, cell), cell) for cell in tpdo.cells]
            if all(entry is not None for entry, _ in shown):
                told += _placed(((*entry, cell) for entry, cell in shown if entry is not None), place)
            elif any(isinstance(cell, SharedCell) for cell in tpdo.cells):
                return False  # an RPDO of the same SYNC changes it: the slave samples first
            else:
                self._sampled.append((tpdo, place))
        self._answer = bytearray(b"".join(pack(Frame(tpdo.can_id, bytes(tpdo.packer.size))) for tpdo, _ in answers))
        self._share(received, taken, told)
        return True

    def _share(self, received: Sequence[tuple[bytes, int, int]], taken: Sequence[Mapped], told: Sequence[Mapped]) -> None:
        rpdos = np.zeros(max(1, len(received)), CORE.dtype("received"))
        for row, (record, first, count) in zip(rpdos, received, strict=False):
            row["head"], row["first"], row["count"] = np.frombuffer(record, np.uint8), first, count
        rows = np.array([drive.row for drive in self._drives] or [0], np.int64)
        lists = [np.array([*objects] or [Mapped(0, 0, 0)], np.int64) for objects in (taken, told)]
        shared, answer = self.shared, np.frombuffer(self._answer or bytearray(1), np.uint8)
        kept = (
            CORE.pointer(rpdos, "received"), CORE.pointer(rows, "int64_t"), CORE.pointer(answer, "uint8_t"),
            *(CORE.pointer(each.view(CORE.dtype("mapped"))[:, 0], "mapped") for each in lists),
        )  # fmt: skip
        shared.received, shared.rows, shared.answer, shared.taken, shared.told = kept
        shared.rpdos, shared.drives, shared.shown = len(received), len(self._drives), len(told)
        shared.answer_bytes, shared.is_whole = len(self._answer), not self._sampled
        self._kept = [*kept]

    def _shown(self, node: Node, cell: Cell) -> tuple[int, int] | None:
        """Return what an entry of a TPDO shows, and of which row or channel; None if the image does not know it."""
        if not isinstance(node, Drive):
            return (CORE.call.ACCELERATION, node.channels.index(cell)) if cell in node.channels else None
        entry = None if cell.read_hook is None else node.shown.get(cell.read_hook)
        return None if entry is None or cell.entry.data_type is not TYPES[entry] else (entry, node.row)

    def look(self) -> bool:
        """Write the states of the drives.

        Returns:
            True if all drives only follow, and no frame waits for a SYNC.
        """
        is_plain = all(drive.write_process() for drive in self._drives) and all(drive.ignores_sync for drive in self._idle)
        is_own = self._accelerometer.measure == self._measure
        return is_plain and is_own and all(slave.is_settled for slave in self.slaves)

    def synchronise(self, message: bytes, now: int) -> bytes | None:
        """Process the records of RPDOs and of a SYNC behind them.

        Args:
            now: The time of SYNC, in ns.

        Returns:
            Records of the TPDOs in the order of their identifiers. None if a record or a drive needs the slaves; then nothing has
            changed.
        """
        self._sensor.draw()
        if CORE.call.synchronise(self.shared, message, len(message) // RECORD.size) != CORE.call.DONE:
            return None
        return self.answered(now)

    def answered(self, now: int) -> bytes:
        """Return the records of the TPDOs, of which the slaves sample what C does not know, as `synchronise` does."""
        for tpdo, place in self._sampled:
            data = tpdo.sample()
            self._answer[place : place + len(data)] = data
        self.pass_to(now)
        return bytes(self._answer)

    def pass_to(self, now: int) -> None:
        """Let the slaves note the time of a SYNC."""
        for slave in self.slaves:
            slave.pass_to(now)


def _placed(objects: Iterable[tuple[int, int, Cell]], place: int) -> list[Mapped]:
    """Place the entries of a PDO one behind the other, from a place on."""
    placed = []
    for entry, row, cell in objects:
        placed.append(Mapped(entry, row, place))
        place += _size(cell)
    return placed


def _size(cell: Cell) -> int:
    """Return the bytes of an entry in a PDO."""
    return cell.entry.data_type.size or 0
