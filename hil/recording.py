"""Recordings of the master: columns as CSV, frames as candump log."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drive_profiles.files.safefile import naming
from hil.can.frame import CAN_SFF_MASK, RECORD, Frame
from hil.control.arrays import Real

TIP = ("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2")
"""Acceleration of the tip; on a bench with an arm in the base frame."""
SENSED = ("sensor_x_m_s2", "sensor_y_m_s2", "sensor_z_m_s2")
"""What a mounted sensor feels along its own axes."""
ALONG = "tip_along_m_s2"
"""Acceleration of the tip along the lever of the one axis that moves, on a bench with an arm."""

ROWS_AT_A_TIME = 1000
"""Rows of a file that are formatted together, which takes half as long as one by one."""


@dataclass(frozen=True)
class Recording:
    """The columns of one run, a row per SYNC.

    Names carry their units. `time_s`; for each axis n that moved `axis<n>_reference_rad`, `axis<n>_position_rad` (motor side),
    `axis<n>_torque_nm`, `axis<n>_load_rad` by its second encoder (joint side), and if its drive sends it `axis<n>_notch_hz`
    (zero frequency of the first filter, 0 while it is off); `tip_x_m_s2`, `tip_y_m_s2`, `tip_z_m_s2`, by the joints' encoders
    without a sensor; `missing`, the number of missing answers in this cycle. On a bench with an arm also `tip_along_m_s2`, along
    the lever of an axis that moves alone, and the signals of a mounted sensor along its own axes: `sensor_x_m_s2`,
    `sensor_y_m_s2`, `sensor_z_m_s2`.

    Attributes:
        columns: Columns by name; all of shape (n,).
        doubt: Reason not to trust the sensor, or None; it is not saved.
    """

    columns: dict[str, Real] = field(default_factory=dict)
    doubt: str | None = None

    @property
    def time_s(self) -> Real:
        """Time of each row; shape (n,)."""
        return self.columns["time_s"]

    @property
    def period_s(self) -> float:
        """The SYNC period."""
        time = self.time_s
        return float((time[-1] - time[0]) / (len(time) - 1))

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the recorded axes."""
        suffix = "_position_rad"
        return tuple(int(name[4 : -len(suffix)]) for name in self.columns if name.startswith("axis") and name.endswith(suffix))

    def axis(self, number: int, quantity: str) -> Real:
        """One column of one axis, e.g. `axis(2, "position_rad")`; shape (n,)."""
        return self.columns[f"axis{number}_{quantity}"]

    @property
    def felt_m_s2(self) -> Real:
        """Acceleration by which a motion is judged; shape (n,).

        Along the lever of an axis that moves alone, on a bench with an arm; else the vertical one.
        """
        return self.columns.get(ALONG, self.columns["tip_z_m_s2"])

    def save(self, path: Path) -> None:
        """Write a CSV file."""
        save_columns(path, self.columns, digits=9)

    @classmethod
    def load(cls, path: Path) -> "Recording":
        """Read a CSV file that `save` has written.

        Raises:
            ValueError: The file is not a recording; the message has its name.
        """
        columns = load_columns(path)
        if "time_s" not in columns:
            raise ValueError(f"{path}: not a recording: {len(columns)} columns, none of them time_s")
        return cls(columns)


def save_columns(path: Path, columns: Mapping[str, Real], digits: int = 7) -> None:
    """Write columns of the same length as CSV, with one line of names."""
    path.parent.mkdir(parents=True, exist_ok=True)
    numbers, row = np.column_stack(list(columns.values())), ",".join([f"%.{digits}g"] * len(columns)) + "\n"
    with naming(path), path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(columns) + "\n")
        for part in np.array_split(numbers, len(numbers) // ROWS_AT_A_TIME + 1):
            file.write(row * len(part) % tuple(part.ravel().tolist()))


def load_columns(path: Path) -> dict[str, Real]:
    """Read columns that `save_columns` has written.

    Raises:
        OSError: The file cannot be read.
        ValueError: It holds something else; the message has its name.
    """
    with path.open(newline="", encoding="utf-8") as file:
        try:
            names = next(csv.reader([file.readline()]), [])
            begin = file.tell()
            if not file.read(1):
                raise ValueError("no row of numbers; a run that is stopped at once leaves none")
            file.seek(begin)
            values = np.loadtxt(file, delimiter=",", ndmin=2)
        except UnicodeDecodeError as error:
            raise ValueError(f"{path}: not a recording: not text in UTF-8") from error
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    if values.shape[1] != len(names):
        raise ValueError(f"{path}: {len(names)} names for {values.shape[1]} columns; expected a name for each")
    return {name: values[:, place] for place, name in enumerate(names)}


class LoggedFrame(NamedTuple):
    """A frame with the master's time."""

    time_s: float
    can_id: int
    data: bytes
    is_received: bool


class LoggedMessage(NamedTuple):
    """Records of frames that crossed in one message, all with one time."""

    time_s: float
    records: bytes
    is_received: bool


class LoggedCycles(NamedTuple):
    """Records of cycles with one message each way.

    Attributes:
        time_s: Time at which the first was sent.
        period_s: Time from a cycle's first message to its second, and to the next cycle's first.
        records: Those of all cycles.
        sent_bytes: Bytes of a cycle's first message.
        cycle_bytes: Bytes of both.
    """

    time_s: float
    period_s: float
    records: bytes
    sent_bytes: int
    cycle_bytes: int

    def messages(self) -> Iterator[LoggedMessage]:
        """Yield the messages."""
        time_s = self.time_s
        for sent in range(0, len(self.records), self.cycle_bytes):
            received = sent + self.sent_bytes
            yield LoggedMessage(time_s, self.records[sent:received], is_received=False)
            time_s += self.period_s
            yield LoggedMessage(time_s, self.records[received : sent + self.cycle_bytes], is_received=True)


Logged = LoggedFrame | LoggedMessage | LoggedCycles


class BusLog:
    """Log of every frame of the master."""

    def __init__(self, path: Path | None, channel: str = "can") -> None:
        self.is_on = path is not None
        self._path = path
        self._channel = channel
        self._kept: list[Logged] = []
        self._is_new = True

    def add(self, logged: Logged) -> None:
        """Keep frames for the next `write`."""
        self._kept.append(logged)

    def write(self) -> None:
        """Append the kept frames to the file."""
        kept, self._kept = self._kept, []
        if self._path is None or not kept:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with naming(self._path), self._path.open("w" if self._is_new else "a", encoding="utf-8", newline="") as file:
            file.writelines(_lines(frames_in(kept), self._channel))
        self._is_new = False


def frames_in(kept: Iterable[Logged]) -> Iterator[tuple[float, int, bytes, bool]]:
    """Yield time, identifier, data and direction of each frame, as a `LoggedFrame` has them.

    To make a `LoggedFrame` takes as long as its line.
    """
    for each in kept:
        if isinstance(each, LoggedFrame):
            yield each
            continue
        for time_s, records, is_received in each.messages() if isinstance(each, LoggedCycles) else (each,):
            for can_id, length, data in RECORD.iter_unpack(records):
                yield time_s, can_id, data[:length], is_received


def _lines(frames: Iterable[tuple[float, int, bytes, bool]], channel: str) -> Iterator[str]:
    """Return lines of frames, none with a stamp before the first's.

    Almost all are data frames with 11-bit identifiers, and a run has a million of them.
    """
    interface = f"can{channel}" if channel.isdigit() else channel
    heads: dict[int, str] = {}
    first_s = last_s = None
    stamp = ""
    for time_s, can_id, data, is_received in frames:
        if time_s != last_s:
            first_s, last_s = time_s if first_s is None else first_s, time_s
            stamp = f"({max(first_s, time_s):f})"
        if can_id > CAN_SFF_MASK:
            yield _line(LoggedFrame(max(first_s or 0.0, time_s), can_id, data, is_received), channel)
            continue
        head = heads.get(can_id)
        if head is None:
            head = heads[can_id] = f" {interface} {can_id:03X}#"
        yield f"{stamp}{head}{data.hex().upper()} {'R' if is_received else 'T'}\n"


def _line(frame: LoggedFrame, channel: str) -> str:
    """Line of a frame of any kind, by python-can's candump writer."""
    import can  # noqa: PLC0415 - slow to load, and hardly ever needed

    from hil.can.adapter import message_of  # noqa: PLC0415 - as above

    time_s, can_id, data, is_received = frame
    text, message = io.StringIO(), message_of(Frame(can_id, data), timestamp=time_s, is_rx=is_received, channel=channel)
    can.CanutilsLogWriter(text).on_message_received(message)
    return text.getvalue()
