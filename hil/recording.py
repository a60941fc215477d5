"""Data that the master received: columns with units, as CSV, and every frame, as a candump log."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """The columns of one run, a row per SYNC.

    Names carry their units. `time_s`; for each axis n that moved `axis<n>_reference_rad`, `axis<n>_position_rad` (motor side),
    `axis<n>_torque_nm`, and where its drive sends it `axis<n>_notch_hz` (zero frequency of the first filter, 0 while it is out);
    `tip_x_m_s2`, `tip_y_m_s2`, `tip_z_m_s2`; `missing`, the number of expected answers that did not come in this cycle.

    Attributes:
        columns: Columns by name; all of shape (n,).
    """

    columns: dict[str, Real] = field(default_factory=dict)

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

    def save(self, path: Path) -> None:
        """Write a CSV file: one line of names with units, then the numbers."""
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(
            path,
            np.column_stack(list(self.columns.values())),
            delimiter=",",
            header=",".join(self.columns),
            comments="",
            fmt="%.9g",
        )

    @classmethod
    def load(cls, path: Path) -> "Recording":
        """Read a CSV file that `save` has written.

        Raises:
            ValueError: The file is not a recording; the message has its name.
        """
        with path.open(newline="", encoding="utf-8") as file:
            names = next(csv.reader(file), [])
            try:
                values = np.loadtxt(file, delimiter=",", ndmin=2)
            except ValueError as error:
                raise ValueError(f"{path}: {error}") from error
        if "time_s" not in names or values.shape[1] != len(names):
            raise ValueError(f"{path}: no recording: {len(names)} names, {values.shape[1]} columns")
        return cls({name: values[:, i] for i, name in enumerate(names)})


class LoggedFrame(NamedTuple):
    """A frame with the master's time."""

    time_s: float
    can_id: int
    data: bytes
    is_received: bool


class BusLog:
    """Log of every frame of the master; kept in memory while an axis moves, written between the motions."""

    def __init__(self, path: Path | None, channel: str = "can") -> None:
        """Log to a file, or nowhere; `channel` is the bus' name in the log."""
        self._path = path
        self._channel = channel
        self._frames: list[LoggedFrame] = []
        self._is_new = True

    @property
    def is_on(self) -> bool:
        """True where frames are logged."""
        return self._path is not None

    def add(self, frame: LoggedFrame) -> None:
        """Keep a frame for the next `write`."""
        self._frames.append(frame)

    def write(self) -> None:
        """Append the kept frames to the file, by python-can's candump writer."""
        frames, self._frames = self._frames, []
        if self._path is None or not frames:
            return
        import can  # noqa: PLC0415 - slow to load, and needed between motions only

        self._path.parent.mkdir(parents=True, exist_ok=True)
        with can.CanutilsLogWriter(str(self._path), append=not self._is_new) as writer:
            for message in _messages(frames, self._channel):
                writer.on_message_received(message)
        self._is_new = False


def _messages(frames: Iterable[LoggedFrame], channel: str) -> Iterable["can.Message"]:  # type: ignore[name-defined] # noqa: F821
    import can  # noqa: PLC0415

    for time_s, can_id, data, is_received in frames:
        yield can.Message(
            timestamp=time_s,
            arbitration_id=can_id & 0x1FFFFFFF,
            is_extended_id=bool(can_id & 0x80000000),
            is_remote_frame=bool(can_id & 0x40000000),
            is_error_frame=bool(can_id & 0x20000000),
            data=data,
            is_rx=is_received,
            channel=channel,
        )
