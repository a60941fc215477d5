"""Process data: what RPDOs and TPDOs do at SYNC, on arrival and on change (CiA 301, 7.2.2)."""

import struct
from collections.abc import Callable, Sequence
from functools import partial

from drive_profiles.cia301 import EmergencyCode, ErrorRegister
from hil.can.frame import Frame
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.emergency import EmergencyProducer
from plant_emulator.slave.pdo_setup import RPDO_COMMUNICATION, TPDO_COMMUNICATION, PdoSetup

PDO_COUNT = 4

_frame = tuple.__new__
"""`Frame` in half the time: its own `__new__` is a call more."""


class Rpdo(PdoSetup):
    """A PDO that the node receives.

    Attributes:
        rejected: Values that were not written, being out of their object's range or refused by the owner.
    """

    def __init__(self, dictionary: Dictionary, number: int, emergency: EmergencyProducer, changed: Callable[[], None]) -> None:
        super().__init__(dictionary, number, is_transmit=False, changed=changed)
        self.rejected = 0
        self._emergency = emergency
        self._cause = f"RPDO {number + 1} length"
        self._pending: bytes | None = None
        self._has_wrong_length = False

    def start(self) -> None:
        """Begin anew, without data waiting for SYNC."""
        self._pending = None

    def receive(self, data: bytes, _now: int) -> None:
        """Take a frame; put it in force at once, or at the next SYNC."""
        if len(data) != self.packer.size or self._has_wrong_length:
            self._report_length(len(data))
            if len(data) < self.packer.size:
                return
        if self.is_synchronous:
            self._pending = data
        else:
            self._put_in_force(data)

    def synchronise(self) -> None:
        """Put in force what arrived since the last SYNC."""
        if self._pending is not None:
            data, self._pending = self._pending, None
            self._put_in_force(data)

    def _put_in_force(self, data: bytes) -> None:
        for cell, value in zip(self.cells, self.packer.unpack_from(data)):  # noqa: B905 - both follow from one mapping
            if cell.write_hook is None and not cell.is_guarded:
                cell.value = value
            elif cell.assign(value) is not None:
                self.rejected += 1

    def _report_length(self, length: int) -> None:
        # CiA 301, 7.2.7.1: too few bytes are not processed, of too many the first. Gone with the next right frame.
        self._has_wrong_length = length != self.packer.size
        if not self._has_wrong_length:
            self._emergency.clear_cause(self._cause)
            return
        code = EmergencyCode.PDO_TOO_SHORT if length < self.packer.size else EmergencyCode.PDO_TOO_LONG
        self._emergency.raise_cause(self._cause, code, ErrorRegister.COMMUNICATION)


class Tpdo(PdoSetup):
    """A PDO that the node sends.

    Attributes:
        due: For an event-driven one, when its timer or its inhibit time will let it go; None where only a change can.
    """

    def __init__(self, dictionary: Dictionary, number: int, changed: Callable[[], None]) -> None:
        super().__init__(dictionary, number, is_transmit=True, changed=changed)
        self.due: int | None = None
        self.start()

    def start(self) -> None:
        """Begin anew: nothing sent yet, no SYNC counted."""
        self._sent: bytes | None = None
        self._sent_at = 0
        self._syncs = 0
        self.due = None

    def synchronise(self, out: list[Frame]) -> None:
        """Send at SYNC: each n-th time, or where the transmission type is 0 only what is not as it was sent last."""
        every = self.transmission_type
        if every > 1:
            self._syncs += 1
            if self._syncs < every:
                return
            self._syncs = 0
        data = self._sample()
        if every == 0:
            if data == self._sent:
                return
            self._sent = data
        out.append(_frame(Frame, (self.can_id, data)))

    def poll(self, now: int, out: list[Frame]) -> None:
        """Send what has changed since it was sent, or when the event timer asks, but not within the inhibit time."""
        data = self._sample()
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

    def _sample(self) -> bytes:
        try:
            return self.packer.pack(*[c.value if (hook := c.read_hook) is None else hook() for c in self.cells])
        except struct.error as error:
            names = ", ".join(cell.entry.name for cell in self.cells)
            raise ValueError(f"the owner gave a value that its object cannot hold ({names}): {error}") from error


class PdoEngine:
    """All PDOs of a node, sorted by what drives them, so that a SYNC touches only those it concerns.

    Args:
        dictionary: Brings the records 1400h to 1403h and 1800h to 1803h, as many as there are.
        emergency: Hears of frames of the wrong length.
        changed: Called when the identifiers to listen to have changed.
    """

    def __init__(self, dictionary: Dictionary, emergency: EmergencyProducer, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._is_running = self._is_loading = False
        numbers = range(PDO_COUNT)
        self.rpdos = [Rpdo(dictionary, n, emergency, self._sort) for n in numbers if (RPDO_COMMUNICATION + n, 1) in dictionary]
        self.tpdos = [Tpdo(dictionary, n, self._sort) for n in numbers if (TPDO_COMMUNICATION + n, 1) in dictionary]
        self._listening: list[Rpdo] = []
        self.event_driven: list[Tpdo] = []
        self._synchronous_rpdos: list[Rpdo] = []
        self._synchronous_tpdos: list[Tpdo] = []

    def load(self) -> None:
        """Take all parameters from the dictionary, after a reset."""
        self._is_loading = True
        for rpdo in self.rpdos:
            rpdo.load()
        for tpdo in self.tpdos:
            tpdo.load()
        self._is_loading = False
        self._sort()

    def start(self) -> None:
        """Begin anew, the node being operational."""
        self._is_running = True
        for rpdo in self.rpdos:
            rpdo.start()
        for tpdo in self.tpdos:
            tpdo.start()
        self._sort()

    def stop(self) -> None:
        """Neither send nor listen."""
        self._is_running = False
        self._sort()

    @property
    def listeners(self) -> dict[int, Callable[[bytes, int], None]]:
        """What takes the frame of each identifier that concerns an RPDO."""
        by_id: dict[int, list[Rpdo]] = {}
        for rpdo in self._listening:
            by_id.setdefault(rpdo.can_id, []).append(rpdo)
        return {i: rpdos[0].receive if len(rpdos) == 1 else partial(_share, rpdos) for i, rpdos in by_id.items()}

    @property
    def due(self) -> int | None:
        """When the first event-driven TPDO is to be looked at again."""
        return min((tpdo.due for tpdo in self.event_driven if tpdo.due is not None), default=None)

    @property
    def rejected(self) -> int:
        """Values of all RPDOs that were not written."""
        return sum(rpdo.rejected for rpdo in self.rpdos)

    def synchronise(self, out: list[Frame]) -> None:
        """Do what a SYNC asks for: sample what is sent, then put in force what was received (CiA 301, 7.2.2.2)."""
        for tpdo in self._synchronous_tpdos:
            tpdo.synchronise(out)
        for rpdo in self._synchronous_rpdos:
            rpdo.synchronise()

    def poll(self, now: int, out: list[Frame]) -> None:
        """Send the event-driven TPDOs whose event has come."""
        for tpdo in self.event_driven:
            tpdo.poll(now, out)

    def _sort(self) -> None:
        if self._is_loading:
            return
        tpdos = [tpdo for tpdo in self.tpdos if self._is_running and tpdo.is_active]
        self._listening = [rpdo for rpdo in self.rpdos if self._is_running and rpdo.is_active]
        self.event_driven = [tpdo for tpdo in tpdos if not tpdo.is_synchronous]
        self._synchronous_tpdos = [tpdo for tpdo in tpdos if tpdo.is_synchronous]
        self._synchronous_rpdos = [rpdo for rpdo in self._listening if rpdo.is_synchronous]
        self._changed()


def _share(rpdos: Sequence[Rpdo], data: bytes, now: int) -> None:
    for rpdo in rpdos:
        rpdo.receive(data, now)
