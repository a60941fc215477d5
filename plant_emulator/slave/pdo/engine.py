"""Process data of a node (CiA 301, 7.2.2)."""

from collections.abc import Callable, Sequence
from functools import partial

from hil.can.frame import CAN_RTR_FLAG, Frame
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.emergency import EmergencyProducer
from plant_emulator.slave.pdo.rpdo import Rpdo
from plant_emulator.slave.pdo.setup import RPDO_COMMUNICATION, TPDO_COMMUNICATION
from plant_emulator.slave.pdo.tpdo import Tpdo
from plant_emulator.slave.sync import SyncConsumer

PDO_COUNT = 4

_Listener = Callable[[bytes, int], None]


class PdoEngine:
    """All PDOs of a node by trigger; SYNC touches only its own.

    Args:
        dictionary: Must have the records 1400h to 1403h and 1800h to 1803h, as many as there are.
        emergency: Hears of frames that have the wrong length or fail to come.
        sync: Whose counter and window count.
        changed: Called when the identifiers to listen to have changed.
        send: Takes the answers to remote requests.
        on_started: Called when the deadline of an RPDO starts, so that `due` is another than before.
        on_missing: Called with the number of an RPDO, 1 for the first, whose deadline has passed.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        *,
        emergency: EmergencyProducer,
        sync: SyncConsumer,
        changed: Callable[[], None],
        send: Callable[[Frame], None],
        on_started: Callable[[], None],
        on_missing: Callable[[int], None],
    ) -> None:
        self._sync, self._changed, self._on_missing = sync, changed, on_missing
        self._is_running = self._is_loading = False
        self.rpdos = [
            Rpdo(dictionary, n, emergency=emergency, sync=sync, changed=self.sort, on_started=on_started)
            for n in range(PDO_COUNT)
            if (RPDO_COMMUNICATION + n, 1) in dictionary
        ]
        self.tpdos = [Tpdo(dictionary, n, self.sort, send) for n in range(PDO_COUNT) if (TPDO_COMMUNICATION + n, 1) in dictionary]
        self._listening: list[Rpdo] = []
        self._watched: list[Rpdo] = []
        self._asked: list[Tpdo] = []
        self.event_driven: list[Tpdo] = []
        self._synchronous_rpdos: list[Rpdo] = []
        self._synchronous_tpdos: list[Tpdo] = []
        self._goes_by_counter = False

    def load(self) -> None:
        """Read all parameters from the dictionary, after a reset."""
        self._is_loading = True
        for rpdo in self.rpdos:
            rpdo.load()
        for tpdo in self.tpdos:
            tpdo.load()
        self._is_loading = False
        self.sort()

    def start(self) -> None:
        """Begin anew, the node being operational."""
        self._is_running = True
        self._begin_anew()

    def stop(self) -> None:
        """Stop sending and receiving; clear earlier errors of the PDOs."""
        self._is_running = False
        self._begin_anew()

    @property
    def listeners(self) -> dict[int, _Listener]:
        """Receivers of PDO frames by identifier, remote requests with the RTR flag."""
        by_id: dict[int, list[_Listener]] = {}
        for rpdo in self._listening:
            by_id.setdefault(rpdo.can_id, []).append(rpdo.entrance)
        for tpdo in self._asked:
            by_id.setdefault(tpdo.can_id | CAN_RTR_FLAG, []).append(tpdo.answer)
        return {i: takers[0] if len(takers) == 1 else partial(_hand_to_all, takers) for i, takers in by_id.items()}

    @property
    def due(self) -> int | None:
        """Instant of the next check of TPDO events and RPDO deadlines."""
        first = min((tpdo.due for tpdo in self.event_driven if tpdo.due is not None), default=None)
        if self._watched:
            deadlines = [due for rpdo in self._watched if (due := rpdo.deadline.due) is not None]
            first = min(deadlines if first is None else [first, *deadlines], default=None)
        return first

    @property
    def plain(self) -> tuple[list[Rpdo], list[Tpdo]] | None:
        """RPDOs and TPDOs that act at every SYNC, and at nothing else.

        The result is None if a PDO acts on arrival, on change, at some SYNCs only or by a timer.
        """
        if self.event_driven or self._goes_by_counter or not all(rpdo.is_plain for rpdo in self._listening):
            return None
        if any(tpdo.transmission_type != 1 for tpdo in self._synchronous_tpdos):
            return None
        return self._listening, self._synchronous_tpdos

    @property
    def is_settled(self) -> bool:
        """True if no RPDO waits for a SYNC or had the wrong length."""
        return all(rpdo.is_settled for rpdo in self._listening)

    def synchronise(self, out: list[Frame]) -> None:
        """Process a SYNC (CiA 301, 7.2.2.2).

        The TPDOs are sampled, then the received RPDOs take effect.
        """
        tpdos = self._synchronous_tpdos
        if self._goes_by_counter:
            counter = self._sync.counter
            tpdos = [tpdo for tpdo in tpdos if tpdo.counts(counter)]
        for tpdo in tpdos:
            tpdo.synchronise(out)
        for rpdo in self._synchronous_rpdos:
            rpdo.synchronise()

    def poll(self, now: int, out: list[Frame]) -> None:
        """Send the event-driven TPDOs whose event has occurred."""
        for tpdo in self.event_driven:
            tpdo.poll(now, out)

    def check_deadlines(self, now: int) -> None:
        """Report the RPDOs that are overdue."""
        for rpdo in self._watched:
            if rpdo.deadline.check(now):
                self._on_missing(rpdo.number)

    def sort(self) -> None:
        """Sort the PDOs by their triggers again."""
        if self._is_loading:
            return
        tpdos = [tpdo for tpdo in self.tpdos if self._is_running and tpdo.is_active]
        self._listening = [rpdo for rpdo in self.rpdos if self._is_running and rpdo.is_active]
        self._watched = [rpdo for rpdo in self._listening if rpdo.event_timer_ns]
        self._asked = [tpdo for tpdo in tpdos if tpdo.allows_requests]
        self.event_driven = [tpdo for tpdo in tpdos if tpdo.is_event_driven]
        self._synchronous_tpdos = [tpdo for tpdo in tpdos if tpdo.heeds_sync]
        self._synchronous_rpdos = [rpdo for rpdo in self._listening if rpdo.is_synchronous]
        self._goes_by_counter = self._sync.overflow > 0 and any(tpdo.waits_for_counter for tpdo in tpdos)
        self._changed()

    def _begin_anew(self) -> None:
        for pdo in (*self.rpdos, *self.tpdos):
            pdo.start()
        self.sort()


def _hand_to_all(takers: Sequence[_Listener], data: bytes, now: int) -> None:
    for take in takers:
        take(data, now)
