"""Error control by heartbeats or node guarding (CiA 301, 7.2.8.2.2)."""

from collections.abc import Callable
from functools import partial

from drive_profiles.standard.cia301 import BROADCAST, EmergencyCode, ErrorRegister, FunctionCode, NmtState
from hil.can.frame import CAN_RTR_FLAG, Frame
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.emergency import EmergencyProducer
from plant_emulator.slave.guarding import NodeGuarding
from plant_emulator.slave.nmt import HeartbeatConsumer, HeartbeatProducer

MASTER = BROADCAST
"""Instead of a node-ID: the NMT master that guards this node."""
LIFE_GUARDING = "life guarding"


class ErrorControl:
    """Error control services of a node.

    A node that sends heartbeats is not guarded.

    Args:
        dictionary: Must have 100Ch, 100Dh, 1016h and 1017h.
        emergency: Producer that reports lost and found nodes.
        lost: Called with the number of a watched node, or `MASTER`.
        rerouted: Called when `routes` has become another.
        rescheduled: Called when `due` has become another by a frame.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        emergency: EmergencyProducer,
        *,
        send: Callable[[Frame], None],
        clock: Callable[[], int],
        state: Callable[[], NmtState],
        lost: Callable[[int], None],
        rerouted: Callable[[], None],
        rescheduled: Callable[[], None],
    ) -> None:
        self._emergency, self._send, self._state, self._lost, self._rerouted = emergency, send, state, lost, rerouted
        self._rescheduled = rescheduled
        self._node_id = 0
        self._is_guarded = True
        self._guarding = NodeGuarding(dictionary, partial(self._on_lost, MASTER), partial(self._on_found, MASTER))
        self._producer = HeartbeatProducer(dictionary, clock, self._choose)
        self._consumer = HeartbeatConsumer(dictionary, self._on_lost, self._on_found, rerouted)

    def load(self, node_id: int) -> None:
        """Read the parameters from the dictionary after a reset."""
        self._node_id = node_id
        self._guarding.load()
        self._producer.load()
        self._consumer.load()

    @property
    def due(self) -> int | None:
        """Instant at which `advance` must be called, or None."""
        times = (self._producer.due, self._consumer.due, self._guarding.due)
        return min((time for time in times if time is not None), default=None)

    @property
    def routes(self) -> dict[int, Callable[[bytes, int], None]]:
        """Receiver of the frame of each identifier that concerns error control."""
        routes: dict[int, Callable[[bytes, int], None]] = {
            FunctionCode.HEARTBEAT + node_id: partial(self._on_heartbeat, node_id) for node_id in self._consumer.nodes
        }
        if self._is_guarded:
            routes[CAN_RTR_FLAG | FunctionCode.HEARTBEAT + self._node_id] = self._on_guarding
        return routes

    def advance(self, now: int) -> None:
        """Report lost nodes, and send a due heartbeat."""
        self._consumer.advance(now)
        self._guarding.advance(now)
        if self._producer.is_due(now):
            self._say(bytes((self._state(),)))

    def boot_up(self) -> Frame:
        """Return the boot-up message."""
        return Frame(FunctionCode.HEARTBEAT + self._node_id, bytes((NmtState.INITIALISING,)))

    def _say(self, data: bytes) -> None:
        self._send(Frame(FunctionCode.HEARTBEAT + self._node_id, data))

    def _on_heartbeat(self, node_id: int, data: bytes, now: int) -> None:
        self._consumer.receive(node_id, data, now)
        self._rescheduled()

    def _on_guarding(self, _data: bytes, now: int) -> None:
        self._say(self._guarding.answer(self._state(), now))
        self._rescheduled()

    def _choose(self) -> None:
        if self._is_guarded is (self._producer.due is None):
            return
        self._is_guarded = not self._is_guarded
        self._guarding.stop()
        self._rerouted()

    def _on_lost(self, node_id: int) -> None:
        self._emergency.raise_cause(_cause(node_id), EmergencyCode.HEARTBEAT, ErrorRegister.COMMUNICATION)
        self._lost(node_id)

    def _on_found(self, node_id: int) -> None:
        self._emergency.clear_cause(_cause(node_id))


def _cause(node_id: int) -> str:
    return LIFE_GUARDING if node_id == MASTER else f"heartbeat {node_id}"
