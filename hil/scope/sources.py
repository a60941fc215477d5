"""Sources of rows: a bus, or the recordings of runs."""

from collections import deque
from pathlib import Path

import numpy as np

from hil.can.errors import BusLostError
from hil.can.listening import Listener
from hil.control.arrays import Real
from hil.errors import NotPossibleError
from hil.recording import TIP, Recording
from hil.scope.decoder import HeardEvent, SignalDecoder
from hil.scope.past import Past
from hil.scope.signals import Signal, SignalQuantity

MOST_EVENTS = 500
TWO_PI = 2.0 * np.pi


class BusSource:
    """Rows of a bus, for a page.

    Attributes:
        is_live: True if rows are still to come.
        events: Events, the oldest first.
        ended: Why no more rows come; "" while they do.
    """

    is_live = True

    def __init__(self, listener: Listener, decoder: SignalDecoder, title: str) -> None:
        self.title, self.past = title, Past()
        self.signals: tuple[Signal, ...] = ()
        self.events: deque[HeardEvent] = deque(maxlen=MOST_EVENTS)
        self.event_count = 0
        self.ended = ""
        self._listener, self._decoder = listener, decoder

    @property
    def lost(self) -> int:
        """Messages of the bus that were not taken in time."""
        return self._listener.lost

    def poll(self) -> None:
        """Take new rows; a lost bus ends them."""
        if self.ended:
            return
        try:
            heard = self._listener.take()
        except BusLostError as error:
            self.ended = str(error)
            return
        rows = self._decoder.feed(heard)
        self.signals = rows.signals
        self.past.add(rows.time_s, rows.values)
        self.events.extend(rows.events)
        self.event_count += len(rows.events)


class RecordedSource:
    """Rows of one recorded run, with the attributes of `BusSource`."""

    is_live = False

    def __init__(self, path: Path) -> None:
        """Read a recording.

        Raises:
            NotPossibleError: It is none, or is empty.
        """
        try:
            recording = Recording.load(path)
        except ValueError as error:
            raise NotPossibleError(str(error)) from error
        columns = signals_of(recording)
        self.title, self.ended = path.stem, "recording"
        self.signals = tuple(columns)
        self.events: deque[HeardEvent] = deque()
        self.event_count = 0
        self.past = Past(kept_s=np.inf)
        self.past.add(recording.time_s, np.column_stack(list(columns.values())))

    def poll(self) -> None:
        """Nothing comes any more."""


PageSource = BusSource | RecordedSource


def signals_of(recording: Recording) -> dict[Signal, Real]:
    """Signals of a recording, with their columns."""
    found: dict[Signal, Real] = {}
    for number in recording.axes:
        name = f"axis {number}"
        position = recording.axis(number, "position_rad") / TWO_PI
        reference = recording.axis(number, "reference_rad") / TWO_PI
        found[Signal(name, SignalQuantity.POSITION, "rev")] = position
        found[Signal(name, SignalQuantity.SPEED, "rev/s")] = np.gradient(position, recording.time_s)
        # the row of SYNC n has the set-point that was sent before it, which is reached at SYNC n + 1
        found[Signal(name, SignalQuantity.FOLLOWING_ERROR, "rev")] = np.concatenate([[np.nan], reference[:-1] - position[1:]])
        found[Signal(name, SignalQuantity.TORQUE, "N·m")] = recording.axis(number, "torque_nm")
        if f"axis{number}_notch_hz" in recording.columns:
            found[Signal(name, SignalQuantity.NOTCH, "Hz")] = recording.axis(number, "notch_hz")
    for direction, column in zip("xyz", TIP, strict=True):
        if column in recording.columns:
            found[Signal(f"tip {direction}", SignalQuantity.TIP, "m/s²")] = recording.columns[column]
    if "missing" in recording.columns:
        found[Signal("bus", SignalQuantity.MISSES, "")] = recording.columns["missing"]
    return found


def recordings_in(directory: Path) -> dict[str, Path]:
    """Return the recordings of a directory by name.

    Raises:
        NotPossibleError: There is none.
    """
    found = {path.stem: path for path in sorted([*directory.glob("*.csv"), *directory.glob("runs/**/*.csv")])}
    if not found:
        raise NotPossibleError(f"{directory} contains no recording; expected *.csv or runs/*.csv")
    return found
