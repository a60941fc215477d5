"""Frames of a log as arrays, by identifier.

The arrays are small enough for an hour of a bus.
"""

import mmap
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.can.frame import CAN_ERR_FLAG

Positions = NDArray[np.uint32]
Integers = NDArray[np.int64]
Words = NDArray[np.uint64]

COLUMNS = np.uint32, np.int64, np.uint8, np.uint64
"""Types of a stream's columns."""
COLUMN_GROWTH, FIRST_ROWS = 1.5, 256
"""Growth of a column that is full, and the least of its rows."""
MAPPED_BYTES = 1 << 20
"""Bytes from which on a column has pages of its own: those that nothing was written to take no memory."""


@dataclass(frozen=True)
class Damage:
    """Parts of a log that could not be read.

    Attributes:
        unreadable: Lines that are not frames.
        first_unreadable: Number of the first of them, from 1; 0 without any.
        flexible: Frames of CAN FD, which are left out.
        elsewhere: Frames of other interfaces, which are left out too.
        backwards: Frames whose stamp is before that of the preceding frame.
        first_backwards: Position of the first of them, from 0; −1 without any.
        furthest_back_ns: The largest of those steps, as a positive number of ns.
        ended: Reason why the reading ended before the end of the file, or "".
    """

    unreadable: int = 0
    first_unreadable: int = 0
    flexible: int = 0
    elsewhere: int = 0
    backwards: int = 0
    first_backwards: int = -1
    furthest_back_ns: int = 0
    ended: str = ""


@dataclass(frozen=True)
class Stream:
    """Frames of one identifier, in their order.

    Attributes:
        position: Position of each in the log; shape (n,).
        stamp_ns: Stamps since the log's first frame, in ns; shape (n,).
        length: Bytes of each; shape (n,).
        data: Their data, the first byte lowest; shape (n,).
    """

    can_id: int
    position: Positions
    stamp_ns: Integers
    length: NDArray[np.uint8]
    data: Words

    def __len__(self) -> int:
        return len(self.position)

    def only(self, rows: NDArray[np.bool_]) -> "Stream":
        """Some of the frames."""
        return Stream(self.can_id, self.position[rows], self.stamp_ns[rows], self.length[rows], self.data[rows])

    def between(self, begin: int, end: int) -> "Stream":
        """The frames from one position in the log to before another."""
        rows = slice(*np.searchsorted(self.position, (begin, end)))
        return Stream(self.can_id, self.position[rows], self.stamp_ns[rows], self.length[rows], self.data[rows])

    def byte(self, number: int) -> NDArray[np.uint8]:
        """Return a byte of each frame, 0 if shorter; shape (n,)."""
        return ((self.data >> np.uint64(8 * number)) & np.uint64(0xFF)).astype(np.uint8)

    def bytes_of(self, row: int) -> bytes:
        """Data of one frame."""
        return int(self.data[row]).to_bytes(8, "little")[: int(self.length[row])]


@dataclass(frozen=True)
class Log:
    """Frames of a log.

    Attributes:
        damage: Parts that could not be read.
        began_s: Stamp of the first frame as in the file, in s.
        duration_ns: Time from the first frame to the last.
    """

    path: Path
    streams: Mapping[int, Stream]
    damage: Damage = field(default_factory=Damage)
    began_s: float = 0.0
    duration_ns: int = 0

    def __len__(self) -> int:
        return sum(map(len, self.streams.values()))

    def __contains__(self, can_id: int) -> bool:
        """True if there is a frame of an identifier."""
        return can_id in self.streams

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last."""
        return self.duration_ns * 1e-9

    def count(self, can_id: int) -> int:
        """Number of frames of an identifier."""
        return len(self.streams[can_id]) if can_id in self.streams else 0

    def of(self, can_id: int) -> Stream:
        """Frames of an identifier."""
        if can_id in self.streams:
            return self.streams[can_id]
        return Stream(can_id, np.empty(0, np.uint32), np.empty(0, np.int64), np.empty(0, np.uint8), np.empty(0, np.uint64))

    def near(self, base: int, nodes: range = range(1, 128)) -> list[Stream]:
        """Return the frames of all nodes with one base, by node."""
        return [self.streams[base + node] for node in nodes if base + node in self.streams]

    def between(self, begin: int, end: int) -> "Log":
        """The frames of some positions, with the stamps of the whole log."""
        parts = {can_id: stream.between(begin, end) for can_id, stream in self.streams.items()}
        streams = {can_id: part for can_id, part in parts.items() if len(part)}
        last_ns = max((int(part.stamp_ns[-1]) for part in streams.values()), default=0)
        return replace(self, streams=streams, duration_ns=last_ns)

    def errors(self) -> list[Stream]:
        """Error frames, by their classes."""
        return [stream for can_id, stream in sorted(self.streams.items()) if can_id & CAN_ERR_FLAG]


class _Growing:
    """Columns of one identifier that grow in place.

    Many small pieces would need twice the memory while they are joined.
    """

    def __init__(self) -> None:
        self.count = 0
        self._columns: list[NDArray[Any]] = [np.empty(0, kind) for kind in COLUMNS]

    def add(self, pieces: tuple[Positions, Integers, NDArray[np.uint8], Words]) -> None:
        """Append a piece of each column."""
        end = self.count + len(pieces[0])
        for number, (column, piece) in enumerate(zip(self._columns, pieces, strict=True)):
            if end > len(column):
                self._columns[number] = _longer(column, self.count, max(end, int(COLUMN_GROWTH * len(column)), FIRST_ROWS))
            self._columns[number][self.count : end] = piece
        self.count = end

    def columns(self) -> tuple[Positions, Integers, NDArray[np.uint8], Words]:
        """Return the columns, cut to their used length.

        A column with equal numbers takes no memory.
        """
        position, stamp_ns, length, data = (column[: self.count] for column in self._columns)
        return position, stamp_ns, _thin(length), _thin(data)


def _longer(column: NDArray[Any], count: int, rows: int) -> NDArray[Any]:
    """Return a longer copy of a column with the same first rows."""
    size = rows * column.itemsize
    longer = np.empty(rows, column.dtype) if size < MAPPED_BYTES else np.frombuffer(mmap.mmap(-1, size), column.dtype)
    longer[:count] = column[:count]
    return longer


def _thin(column: NDArray[Any]) -> NDArray[Any]:
    """The column itself, or one number for all rows."""
    if len(column) < FIRST_ROWS or np.any(column != column[0]):
        return column
    return np.broadcast_to(column[0].copy(), column.shape)


class LogBuilder:
    """Builder of a log from chunks of frames, sorted by identifier."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parts: dict[int, _Growing] = {}
        self._began_ns, self._last_ns = 0, 0
        self.frames = 0
        self.backwards, self.first_backwards, self.furthest_back_ns = 0, -1, 0

    def add(self, stamp_ns: Integers, can_id: NDArray[np.uint32], length: NDArray[np.uint8], data: Words) -> None:
        """Add frames.

        A stamp that runs backwards counts as that of the frame before it; all columns have the shape (n,).
        """
        if not len(stamp_ns):
            return
        if not self.frames:
            self._began_ns = int(stamp_ns[0])
        stamps = stamp_ns - self._began_ns
        steps = np.diff(stamps, prepend=self._last_ns)
        back = np.flatnonzero(steps < 0)
        if len(back):
            self.first_backwards = self.frames + int(back[0]) if self.first_backwards < 0 else self.first_backwards
            self.backwards += len(back)
            self.furthest_back_ns = max(self.furthest_back_ns, -int(np.min(steps)))
            stamps = np.maximum(np.maximum.accumulate(stamps), self._last_ns)
        self._last_ns = int(stamps[-1])
        order = np.argsort(can_id, kind="stable")
        position = (self.frames + order).astype(np.uint32)
        columns = position, stamps[order], length[order], data[order]
        ids, starts = np.unique(can_id[order], return_index=True)
        for each, rows in zip(ids.tolist(), np.split(np.arange(len(order)), starts[1:]), strict=True):
            piece = slice(int(rows[0]), int(rows[-1]) + 1)
            self._parts.setdefault(each, _Growing()).add(
                (columns[0][piece], columns[1][piece], columns[2][piece], columns[3][piece])
            )
        self.frames += len(stamps)

    def log(self, damage: Damage) -> Log:
        """The log; the builder holds nothing any more."""
        streams = {}
        for can_id in sorted(self._parts):
            streams[can_id] = Stream(can_id, *self._parts.pop(can_id).columns())
        return Log(self._path, streams, damage, self._began_ns * 1e-9, self._last_ns)
