"""One PDO that a node sends (CiA 301, 7.2.2, 7.5.2.37)."""

import struct
from collections.abc import Callable

from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.pdo.setup import EVENT_DRIVEN, MAX_SYNCHRONOUS, SYNCHRONOUS_ON_REQUEST, PdoSetup

_frame = tuple.__new__
"""`Frame` in half the time: its own `__new__` is a call more."""

_ASKED_FOR = b""
"""Instead of the last data sent: no frame of a PDO equals it, so the next one goes as soon as it may."""


class Tpdo(PdoSetup):
    """A PDO that the node sends.

    While bit 30 of its COB-ID is clear, a remote request is answered whatever the transmission type: 252 with what was
    sampled at the last SYNC, and not at all before the first; 253, and the synchronous types beside their own frames, with
    the values of this instant; 254 and 255 too, after the inhibit time where that still runs. The length that a request
    announces is not looked at. With bit 30 set, 252 and 253 send nothing.

    Attributes:
        due: For an event-driven one, when its timer or its inhibit time will let it go; None if only a change can.
    """

    def __init__(self, dictionary: Dictionary, number: int, changed: Callable[[], None], send: Callable[[Frame], None]) -> None:
        super().__init__(dictionary, number, is_transmit=True, changed=changed)
        self.due: int | None = None
        self._send = send
        self.start()

    @property
    def is_event_driven(self) -> bool:
        """True if a change triggers the PDO."""
        return self.transmission_type in EVENT_DRIVEN

    @property
    def heeds_sync(self) -> bool:
        """True if SYNC makes the PDO sample its objects."""
        return self.is_synchronous or self.transmission_type == SYNCHRONOUS_ON_REQUEST

    @property
    def waits_for_counter(self) -> bool:
        """True if SYNC's counter selects the first SYNC (sub-index 6).

        This applies to types 1 to 240 only.
        """
        return self.start_value > 0 and 1 <= self.transmission_type <= MAX_SYNCHRONOUS

    def start(self) -> None:
        """Start with nothing sent and no SYNC counted."""
        self._sent: bytes | None = None
        self._sent_at = 0
        self._syncs = 0
        self._has_first_sync = False
        self.due = None

    def counts(self, counter: int | None) -> bool:
        """Return True if the PDO counts a SYNC with this counter.

        The first one has the start value, later ones any. A SYNC that lacks its counter is ignored by a PDO with a start
        value.
        """
        if not self.waits_for_counter:
            return True
        self._has_first_sync |= counter == self.start_value
        return self._has_first_sync and counter is not None

    def synchronise(self, out: list[Frame]) -> None:
        """Send at SYNC according to the transmission type.

        Type n sends at each n-th SYNC; type 0 sends only if the data have changed.
        """
        every = self.transmission_type
        if every > 1:
            if every == SYNCHRONOUS_ON_REQUEST:
                self._sent = self.sample()
                return
            self._syncs += 1
            if self._syncs < every:
                return
            self._syncs = 0
        data = self.sample()
        if every == 0:
            if data == self._sent:
                return
            self._sent = data
        out.append(_frame(Frame, (self.can_id, data)))

    def poll(self, now: int, out: list[Frame]) -> None:
        """Send changed data, or by event timer, within the inhibit time."""
        data = self.sample()
        earliest = now if self._sent is None else self._sent_at + self.inhibit_ns
        latest = self._sent_at + self.event_timer_ns if self.event_timer_ns else None
        if data == self._sent and (latest is None or now < latest):
            self.due = latest
        elif now < earliest:
            self.due = earliest
        else:
            out.append(Frame(self.can_id, data))
            self._sent, self._sent_at = data, now
            self.due = now + self.event_timer_ns if self.event_timer_ns else None

    def answer(self, _data: bytes, _now: int) -> None:
        """Process a remote request; `poll` answers for an event-driven PDO."""
        if self.is_event_driven:
            self._sent = _ASKED_FOR
        elif self.transmission_type != SYNCHRONOUS_ON_REQUEST:
            self._send(Frame(self.can_id, self.sample()))
        elif self._sent is not None:
            self._send(Frame(self.can_id, self._sent))

    def sample(self) -> bytes:
        """Return the data of this instant.

        Raises:
            ValueError: A mapped object has a value that it cannot hold.
        """
        try:
            return self.packer.pack(*[c.value if (hook := c.read_hook) is None else hook() for c in self.cells])
        except (struct.error, ValueError) as error:
            names = ", ".join(cell.entry.name for cell in self.cells)
            raise ValueError(f"a mapped object ({names}) has a value that it cannot hold: {error}") from error
