"""Recordings as bus logs: candump, BLF and ASC.

A device description (EDS, DCF, XDD) or a DBC file decodes them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drive_profiles.eds.description import Description, load
from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK
from hil.control.arrays import Real
from hil.errors import LogError, MissingPackageError, RecordingFileError
from hil.logs.log import Log, Stream
from hil.logs.nodes import MappedNumber, described_node
from hil.logs.opening import open_log
from hil.recordings.source import MOST_ROWS, at_stamps

STAMPS = "time_s"
"""Name under which the frames' own time is offered."""
BLF_SIZE = slice(16, 24)
"""Bytes of a BLF file's head that say how long it is."""


@dataclass(frozen=True)
class FrameSignal:
    """A number in a frame.

    Attributes:
        name: Name: the object's address, or that of the DBC file.
        can_id: Identifier of the frame, with the flags of SocketCAN.
        bytes: Bytes that a frame must have for it.
        numbers: The numbers of frames that are long enough; shape (n,).
    """

    name: str
    can_id: int
    bytes: int
    numbers: Callable[[Stream], Real]


class FrameFile:
    """A log of frames, whose signals have stamps of their own."""

    def __init__(self, path: Path, description: Path | None, node_id: int | None) -> None:
        """Read the description.

        Raises:
            RecordingFileError: There is no description, or it maps nothing.
            MissingPackageError: The description needs a package that is not installed.
        """
        self.path = path
        if description is None:
            raise RecordingFileError(path, "frames need a description; give --description drive.eds --node 2, or a DBC file")
        if description.suffix.lower() == ".dbc":
            self._signals = _of_dbc(path, description)
        else:
            self._signals = list(_of_device(path, load(description, node_id=node_id)))
        if not self._signals:
            words = "maps no object into a TPDO" if description.suffix.lower() != ".dbc" else "has no signal"
            raise RecordingFileError(path, f"{description} {words}; give a DCF file of the drive as it was set up")
        self.names = (STAMPS, *dict.fromkeys(signal.name for signal in self._signals))

    def columns(self, names: Sequence[str]) -> dict[str, Real]:
        """Return signals by name at the stamps of the first one.

        All of shape (n,).

        Raises:
            RecordingFileError: The log cannot be read whole, or lacks the frames of a signal.
        """
        log = self._log()
        wanted = [name for name in names if name != STAMPS]
        stamps: dict[str, Real] = {}
        values: dict[str, Real] = {}
        for name in wanted:
            signal = next(signal for signal in self._signals if signal.name == name)
            stream = log.of(signal.can_id)
            stream = stream.only(stream.length >= signal.bytes)
            if not 2 <= len(stream) <= MOST_ROWS:
                raise RecordingFileError(
                    self.path,
                    f"{len(stream)} frames with the identifier 0x{signal.can_id & CAN_EFF_MASK:X} hold {name!r}: is it the right "
                    "node?",
                )
            if log.damage.furthest_back_ns > np.median(np.diff(stream.stamp_ns)):
                raise RecordingFileError(
                    self.path,
                    f"stamps go back by {log.damage.furthest_back_ns * 1e-9:.3g} s: are these two recordings in one file?",
                )
            numbers = signal.numbers(stream)
            is_there = np.isfinite(numbers)
            stamps[name] = np.asarray(log.began_s + stream.stamp_ns * 1e-9, np.float64)[is_there]
            values[name] = numbers[is_there]
        first = stamps[wanted[0]]
        found = {name: at_stamps(self.path, name, first, stamps[name], values[name]) for name in wanted}
        return {STAMPS: first, **found} if STAMPS in names else found

    def _log(self) -> Log:
        """Return the frames of an undamaged log.

        A damaged log is refused: it is not a basis for a measurement.
        """
        if self.path.suffix.lower() == ".blf":
            self._refuse_cut_off()
        try:
            log = open_log(self.path)
        except LogError as error:
            raise RecordingFileError(self.path, f"not a log of frames: {error.problem}") from error
        damage = log.damage
        if damage.ended:
            raise RecordingFileError(self.path, f"not a log of frames, or cut off: {damage.ended}")
        if damage.unreadable:
            raise RecordingFileError(
                self.path,
                f"not a log of frames: lines without a frame: {damage.unreadable}, the first is line {damage.first_unreadable}",
            )
        if damage.elsewhere:
            raise RecordingFileError(self.path, f"{damage.elsewhere} frames are of another interface; keep only those of one")
        return log

    def _refuse_cut_off(self) -> None:
        """Refuse a BLF file without its header, or cut off.

        A writer that was killed leaves the size 0 in the header.
        """
        with self.path.open("rb") as file:
            head = file.read(BLF_SIZE.stop)
        if not head.startswith(b"LOGG"):
            raise RecordingFileError(self.path, "not a log of frames: a BLF file begins with LOGG")
        said, size = int.from_bytes(head[BLF_SIZE], "little"), self.path.stat().st_size
        if size < said:
            raise RecordingFileError(self.path, f"cut off: the file has {size} bytes, but its header says {said}; copy it again")


def _of_device(path: Path, description: Description) -> Iterator[FrameSignal]:
    """Signals that a device maps into its TPDOs."""
    if description.node_id is None:
        raise RecordingFileError(path, f"{description.path} has no node-ID; give --node")
    for pdo in described_node(description.node_id, description).pdos:
        for entry in pdo.entries if pdo.direction == "tpdo" else ():
            yield FrameSignal(name_of(entry), pdo.can_id, entry.bytes, entry.numbers)


def name_of(entry: MappedNumber) -> str:
    """Name of a mapped object: `6064h`, or `60E4h:01`."""
    index, subindex = entry.address
    return f"{index:04X}h" if subindex == 0 else f"{index:04X}h:{subindex:02X}"


def _of_dbc(path: Path, description: Path) -> list[FrameSignal]:
    """Signals of a DBC file, each as `MESSAGE.SIGNAL`."""
    try:
        import cantools  # noqa: PLC0415 - an extra
    except ImportError:
        raise MissingPackageError(path, "cantools", "dbc") from None
    try:
        database = cantools.database.load_file(str(description))
    except Exception as error:  # the package raises whatever its parser meets
        raise RecordingFileError(path, f"{description} is not a DBC file: {error}") from error

    if not isinstance(database, cantools.database.Database):  # a list of diagnostics has no frames
        raise RecordingFileError(path, f"{description} is not a DBC file: it describes no frames")

    def decoder(message: Any, name: str) -> Callable[[Stream], Real]:
        def numbers(stream: Stream) -> Real:
            rows = (message.decode(stream.bytes_of(row), decode_choices=False).get(name) for row in range(len(stream)))
            return np.array([np.nan if value is None else float(value) for value in rows])

        return numbers

    return [
        FrameSignal(
            f"{message.name}.{signal.name}",
            message.frame_id | CAN_EFF_FLAG * message.is_extended_frame,
            message.length,
            decoder(message, signal.name),
        )
        for message in database.messages
        for signal in message.signals
    ]
