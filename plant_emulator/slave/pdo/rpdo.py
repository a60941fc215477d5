"""One PDO that a node receives (CiA 301, 7.2.2 and 7.5.2.35)."""

from collections.abc import Callable

from drive_profiles.standard.cia301 import EmergencyCode, ErrorRegister
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.emergency import EmergencyProducer
from plant_emulator.slave.pdo.setup import PdoSetup
from plant_emulator.slave.sync import SyncConsumer


class Deadline:
    """The event timer of an RPDO.

    After a first frame each must arrive within the period.

    A frame only records its arrival time, which costs little; `check` moves the deadline.

    Args:
        number: 1 for the first RPDO.
        emergency: Hears of frames that fail to come.
        on_started: Called when the deadline starts, so that `due` is another than before.

    Attributes:
        due: Time of the next `check`, at the latest when the deadline is over; None if none runs.
    """

    def __init__(self, number: int, emergency: EmergencyProducer, on_started: Callable[[], None]) -> None:
        self.due: int | None = None
        self._emergency, self._on_started = emergency, on_started
        self._cause = f"RPDO {number} time-out"
        self._is_missing = False
        self._heard_at = self._period_ns = 0

    def restart(self) -> None:
        """Wait for a first frame; clear the time-out error."""
        self.due = None
        self._clear()

    def take(self, now: int, period_ns: int) -> None:
        """Note a frame, and the time within which the next is due."""
        self._heard_at, self._period_ns = now, period_ns
        self._clear()
        if self.due is None:
            self.due = now + period_ns
            self._on_started()

    def check(self, now: int) -> bool:
        """Return True if the deadline, postponed by frames, has just passed."""
        if self.due is None or now < self.due:
            return False
        deadline = self._heard_at + self._period_ns
        self.due = deadline if now < deadline else None
        if self.due is not None:
            return False
        self._is_missing = True
        self._emergency.raise_cause(self._cause, EmergencyCode.RPDO_TIME_OUT, ErrorRegister.COMMUNICATION)
        return True

    def _clear(self) -> None:
        if self._is_missing:
            self._is_missing = False
            self._emergency.clear_cause(self._cause)


class Rpdo(PdoSetup):
    """A PDO that the node receives.

    Its event timer, sub-index 5, is a deadline: it starts with the first frame after the node became operational or the
    timer was written, and begins anew with each frame that is processed; one that is too short, or comes after the window
    of SYNC, is not. What comes too late is reported as emergency 8250h, one cause for each PDO. Leaving operational, and
    any change of the PDO, withdraw its emergencies and wait for a first frame again.

    Attributes:
        number: 1 for the first PDO.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        number: int,
        *,
        emergency: EmergencyProducer,
        sync: SyncConsumer,
        changed: Callable[[], None],
        on_started: Callable[[], None],
    ) -> None:
        super().__init__(dictionary, number, is_transmit=False, changed=changed)
        self.number = number + 1
        self.deadline = Deadline(self.number, emergency, on_started)
        self._emergency, self._sync = emergency, sync
        self._cause = f"RPDO {self.number} length"
        self._pending: bytes | None = None
        self._has_wrong_length = False

    @property
    def entrance(self) -> Callable[[bytes, int], None]:
        """Receiver of a frame.

        It is the plain one if neither window nor deadline applies to the PDO.
        """
        is_watched = self.event_timer_ns or (self.is_synchronous and self._sync.window_ns)
        return self.receive_watched if is_watched else self.receive

    @property
    def is_plain(self) -> bool:
        """True if the PDO acts at SYNC, and has no deadline or window."""
        return self.is_synchronous and not (self.event_timer_ns or self._sync.window_ns)

    @property
    def is_settled(self) -> bool:
        """True if no data wait for a SYNC, and the last frame had the right length."""
        return self._pending is None and not self._has_wrong_length

    def start(self) -> None:
        """Start without pending data, deadline or error."""
        self._pending = None
        if self._has_wrong_length:
            self._has_wrong_length = False
            self._emergency.clear_cause(self._cause)
        self.restart_timer()

    def restart_timer(self) -> None:
        """Wait for a first frame before the deadline counts."""
        self.deadline.restart()

    def receive(self, data: bytes, _now: int) -> None:
        """Process a frame, now or at the next SYNC."""
        if len(data) != self.packer.size or self._has_wrong_length:
            self._report_length(len(data))
            if len(data) < self.packer.size:
                return
        if self.is_synchronous:
            self._pending = data
        else:
            self._put_in_force(data)

    def receive_watched(self, data: bytes, now: int) -> None:
        """Process a frame within SYNC's window; restart the deadline."""
        if self.is_synchronous and now > self._sync.closes_at:
            return
        if self.event_timer_ns and len(data) >= self.packer.size:
            self.deadline.take(now, self.event_timer_ns)
        self.receive(data, now)

    def synchronise(self) -> None:
        """Apply the data that arrived since the last SYNC."""
        if self._pending is not None:
            data, self._pending = self._pending, None
            self._put_in_force(data)

    def _put_in_force(self, data: bytes) -> None:
        for cell, value in zip(self.cells, self.packer.unpack_from(data)):  # noqa: B905 - both follow from one mapping
            if cell.write_hook is None and not cell.is_guarded:
                cell.value = value
            else:
                cell.assign(value)  # a value that the entry or its owner refuses is not written

    def _report_length(self, length: int) -> None:
        # CiA 301, 7.2.7.1: too few bytes are not processed, of too many the first. Gone with the next right frame.
        self._has_wrong_length = length != self.packer.size
        if not self._has_wrong_length:
            self._emergency.clear_cause(self._cause)
            return
        code = EmergencyCode.PDO_TOO_SHORT if length < self.packer.size else EmergencyCode.PDO_TOO_LONG
        self._emergency.raise_cause(self._cause, code, ErrorRegister.COMMUNICATION)
