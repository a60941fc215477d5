"""Fault confinement of all controllers of a bus.

Source: ISO 11898-1:2015, 12.1.4 (CAN 2.0 specification, part B, clause 8); the counters themselves are `controller`'s.
"""

from collections import deque

from plant_emulator.bus.attempt import FLAG_BITS, Attempt, Port
from plant_emulator.bus.controller import ErrorState
from plant_emulator.bus.queues import Queues
from plant_emulator.bus.rates import Rates
from plant_emulator.bus.traffic import Statistics

MAX_SWITCHED = 1024
SUSPEND_BITS = 8
"""Bits that an error-passive controller waits after a frame of its own, in addition to the intermission."""
STUCK_TOLERANCE_BITS, STUCK_STEP_BITS = 14, 8
RECOVERY_BITS = 128 * 11
"""Bits of an idle bus that a restarted controller waits for before it takes part again."""


class Confinement:
    """Fault confinement: counts the errors of a bus.

    Attributes:
        switched: Ports that went bus-off (True) or came back (False), in order; the oldest are forgotten.
        has_switched: True when a port has switched since this was last cleared.
        is_troubled: True while an error counter may be above 0.
    """

    def __init__(self, ports: dict[int, Port], rates: Rates, counts: Statistics, queues: Queues) -> None:
        self._ports, self._rates, self._counts, self._queues = ports, rates, counts, queues
        self.switched: deque[tuple[int, bool]] = deque(maxlen=MAX_SWITCHED)
        self.has_switched = self.is_troubled = False

    def judge(self, attempt: Attempt) -> None:
        """Count the errors of an attempt, and requeue failed frames."""
        counts = self._counts
        counts.collisions += attempt.collided
        counts.merged += max(len(attempt.winners) - 1, 0)
        counts.errors += not attempt.winners
        for entry in attempt.failed:
            self._note(entry.port, is_off=entry.port.controller.transmit_failed())
        senders = {entry.port for entry in attempt.senders}
        for port in self._listeners(senders):
            if attempt.winners:
                port.controller.received()
            else:
                port.controller.receive_failed()
        for entry in attempt.senders:
            if entry in attempt.winners:
                entry.port.controller.transmitted()
            else:
                self._queues.put_back(entry)
            if entry.port.controller.is_passive:
                entry.port.not_before = attempt.idle + self._rates.ns(SUSPEND_BITS + attempt.drop_out_bits(entry))
        self.is_troubled = any(port.controller.tec or port.controller.rec for port in self._ports.values())

    def stick(self, attempt: Attempt | None, at: int, until: int, idle: int) -> None:
        """Count the errors while the bus is stuck dominant.

        The attempt fails, and counters rise with every eight bits (rule f).

        Args:
            at: Beginning of the dominant level, in ns.
            until: End of the dominant level, in ns.
            idle: Time from which the bus is idle again, in ns.
        """
        bits = self._rates.bits_in(until - at)
        senders: set[Port] = set()
        self._counts.errors += 1
        self.is_troubled = True
        for entry in attempt.senders if attempt is not None else ():
            senders.add(entry.port)
            self._note(entry.port, is_off=entry.port.controller.transmit_failed(1 + stuck_steps(bits - 1)))
            self._queues.put_back(entry)
            if entry.port.controller.is_passive:
                entry.port.not_before = idle + self._rates.ns(SUSPEND_BITS)
        if bits >= FLAG_BITS:  # the sixth is an error to those who listen
            for port in self._listeners(senders):
                port.controller.receive_failed(1 + 8 * stuck_steps(bits - FLAG_BITS))

    def switch_off(self, port: Port) -> None:
        """Put a port bus-off."""
        self._note(port, is_off=port.controller.switch_off())

    def restart(self, port: Port, at: int) -> None:
        """Restart a port that is bus-off; ignore others."""
        if port.controller.state is ErrorState.OFF:
            port.controller.restart()
            self._switch(port, is_off=False)
            port.not_before = at + self._rates.ns(RECOVERY_BITS)

    def _listeners(self, senders: set[Port]) -> list[Port]:
        return [port for port in self._ports.values() if port.controller.state is not ErrorState.OFF and port not in senders]

    def _note(self, port: Port, *, is_off: bool) -> None:
        if is_off:
            self._queues.clear(port)
            self._switch(port, is_off=True)

    def _switch(self, port: Port, *, is_off: bool) -> None:
        self.switched.append((port.number, is_off))
        self.has_switched = True


def stuck_steps(bits: int) -> int:
    """Return how often a counter rises on a stuck bus.

    The bus stays dominant for `bits` bits from the beginning of an error flag.

    After the 14th dominant bit, and after every eight more (rule f).
    """
    return 0 if bits < STUCK_TOLERANCE_BITS else 1 + (bits - STUCK_TOLERANCE_BITS) // STUCK_STEP_BITS
