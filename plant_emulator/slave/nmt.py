"""NMT state machine as tables, and heartbeats (CiA 301, 7.2.8 and 7.3.2)."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Flag, auto
from functools import partial

from drive_profiles.standard.cia301 import MAX_NODE_ID, NmtCommand, NmtState, SdoAbortCode
from plant_emulator.slave.dictionary import Dictionary, ResetKind

CONSUMER_TIME = 0x1016
PRODUCER_TIME = 0x1017
_NS_PER_MS = 1_000_000


class NmtService(Flag):
    """Communication services that the NMT state switches."""

    SDO = auto()
    SYNC = auto()
    EMERGENCY = auto()
    PDO = auto()
    TIME = auto()
    LSS = auto()


SERVICES = {
    NmtState.INITIALISING: NmtService.LSS,
    NmtState.PRE_OPERATIONAL: NmtService.SDO | NmtService.SYNC | NmtService.TIME | NmtService.EMERGENCY | NmtService.LSS,
    NmtState.OPERATIONAL: NmtService.SDO | NmtService.SYNC | NmtService.TIME | NmtService.EMERGENCY | NmtService.PDO,
    NmtState.STOPPED: NmtService.LSS,
}
"""CiA 301, 7.3.2.2.5; node control and error control (heartbeat, node guarding) work in every state but initialisation.

LSS is not among the standard's services of a state. Here it works in every state but operational: an LSS master finds nodes that
have just booted as well as stopped ones, and cannot take the bit rate or the name from a node that is at work. Initialising, only
a node without a node-ID waits for it.
"""

_LISTENING = (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED)
_TARGETS = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.INITIALISING,
    NmtCommand.RESET_COMMUNICATION: NmtState.INITIALISING,
}
TRANSITIONS = {(state, command): target for state in _LISTENING for command, target in _TARGETS.items()}
"""CiA 301, 7.3.2.2: an initialising node ignores commands; afterwards each leads to one state from all three."""

RESETS = {NmtCommand.RESET_NODE: ResetKind.NODE, NmtCommand.RESET_COMMUNICATION: ResetKind.COMMUNICATION}

ERROR_BEHAVIOUR = {
    (NmtState.OPERATIONAL, 0): NmtState.PRE_OPERATIONAL,
    (NmtState.OPERATIONAL, 2): NmtState.STOPPED,
    (NmtState.PRE_OPERATIONAL, 2): NmtState.STOPPED,
}
"""State after a communication error, by state and value of 1029h:01h; else the state stays (CiA 301, 7.5.2.32)."""


class HeartbeatProducer:
    """Timer of the node's own heartbeat.

    Heartbeats are due at whole multiples of 1017h in the node's time, so that runs repeat.

    Args:
        dictionary: Must have 1017h.
        changed: Called when heartbeats may begin or end.
    """

    def __init__(self, dictionary: Dictionary, clock: Callable[[], int], changed: Callable[[], None]) -> None:
        self.due: int | None = None
        self._changed, self._clock, self._dictionary = changed, clock, dictionary
        dictionary.on_write(PRODUCER_TIME, 0, self._set_period)

    def load(self) -> None:
        """Read the period from the dictionary."""
        self._set_period(self._dictionary.get_int(PRODUCER_TIME))

    def is_due(self, now: int) -> bool:
        """Return True if a heartbeat is due now; a late caller gets one, not a burst."""
        if self.due is None or now < self.due:
            return False
        self.due = self._next(now)
        return True

    def _set_period(self, period_ms: int) -> SdoAbortCode | None:
        self._period = period_ms * _NS_PER_MS
        self.due = self._next(self._clock()) if self._period else None
        self._changed()
        return None

    def _next(self, now: int) -> int:
        return (now // self._period + 1) * self._period


@dataclass(slots=True)
class _Watch:
    node_id: int
    period: int
    deadline: int | None = None
    is_lost: bool = False


class HeartbeatConsumer:
    """Monitor of other nodes' heartbeats by 1016h.

    A watch starts with the first heartbeat (CiA 301, 7.2.8.2.2.3): a node that never came up is not lost. A boot-up
    message is not a heartbeat: a node that restarts and then stays silent must be noticed.

    Args:
        dictionary: Must have 1016h.
        on_lost: Called with the node-ID once when its heartbeat has failed to come.
        on_found: Called with the node-ID when it comes again, or is no longer to be watched.
        changed: Called when other nodes are to be watched.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        on_lost: Callable[[int], None],
        on_found: Callable[[int], None],
        changed: Callable[[], None],
    ) -> None:
        self._dictionary, self._on_lost, self._on_found, self._changed = dictionary, on_lost, on_found, changed
        self._watches: dict[int, _Watch] = {}
        self._subindices = [e.subindex for e in dictionary if e.index == CONSUMER_TIME and e.subindex > 0]
        for subindex in self._subindices:
            dictionary.on_write(CONSUMER_TIME, subindex, partial(self._configure, subindex))

    def load(self) -> None:
        """Read the watches, all of which wait for a first heartbeat."""
        self._watches = {}
        for subindex in self._subindices:
            self._dictionary.load(CONSUMER_TIME, subindex)

    @property
    def nodes(self) -> Iterable[int]:
        """The nodes that are watched."""
        return [watch.node_id for watch in self._watches.values()]

    @property
    def due(self) -> int | None:
        """Instant at which the first watch runs out."""
        return min((w.deadline for w in self._watches.values() if w.deadline is not None), default=None)

    def receive(self, node_id: int, data: bytes, now: int) -> None:
        """Process the error control message of a node."""
        if len(data) != 1 or data[0] & 0x7F == NmtState.INITIALISING:
            return
        for watch in self._watches.values():
            if watch.node_id == node_id:
                watch.deadline = now + watch.period
                if watch.is_lost:
                    watch.is_lost = False
                    self._on_found(node_id)

    def advance(self, now: int) -> None:
        """Report the nodes whose heartbeat is overdue."""
        for watch in list(self._watches.values()):
            if watch.deadline is not None and now >= watch.deadline:
                watch.deadline = None
                watch.is_lost = True
                self._on_lost(watch.node_id)

    def _configure(self, subindex: int, value: int) -> SdoAbortCode | None:
        # CiA 301, 7.5.2.19: 0000h | node-ID | time in ms; without a time or a node the entry is not used.
        period, node_id = (value & 0xFFFF) * _NS_PER_MS, value >> 16 & 0xFF
        if value >> 24:
            return SdoAbortCode.INVALID_VALUE
        is_used = period > 0 and 0 < node_id <= MAX_NODE_ID
        if is_used and any(w.node_id == node_id for s, w in self._watches.items() if s != subindex):
            return SdoAbortCode.PARAMETER_INCOMPATIBLE
        old = self._watches.pop(subindex, None)
        if is_used:
            self._watches[subindex] = _Watch(node_id, period)
        self._changed()
        if old is not None and old.is_lost:
            self._on_found(old.node_id)
        return None
