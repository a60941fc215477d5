"""Supervision of the nodes while axes move."""

import math
from collections.abc import Iterable

from drive_profiles.standard.cia301 import FunctionCode, NmtState
from hil.bench.bench import Bus
from hil.can.frame import Frame
from hil.master.cyclic import CyclicExchange
from hil.master.guard import heartbeat_fault
from hil.master.network import Network


class Supervisor:
    """Heartbeat of the master, and reasons to stop.

    Attributes:
        bus: The same table; a new one counts from the next `begin` on.
        interrupted_by: The signal that asked for an end, or None.
        is_silent: True while the master's heartbeat is held back, to check that drives stop by themselves.
    """

    def __init__(self, network: Network, bus: Bus) -> None:
        self.network, self.bus = network, bus
        self.interrupted_by: str | None = None
        self.is_silent = False
        self._nodes: frozenset[int] = frozenset()
        self._heartbeat_due_s = -math.inf
        self._since_s = 0.0
        self._silent_until_s = -math.inf

    def begin(self, nodes: Iterable[int]) -> None:
        """Watch these nodes from now on, and forget former reports."""
        self._nodes = frozenset(nodes)
        self.network.emergencies.clear()
        self.network.boots.clear()
        self._since_s = self.network.now()
        self._silent_until_s, self.is_silent = -math.inf, False

    def send_heartbeat(self) -> Frame:
        """Send the master's heartbeat; return the frame."""
        self._heartbeat_due_s = self.network.now() + self.bus.heartbeat_s - 1e-9
        frame = Frame(FunctionCode.HEARTBEAT + self.bus.master_node_id, bytes((NmtState.OPERATIONAL,)))
        self.network.send(frame)
        return frame

    def cycle(self, exchange: CyclicExchange) -> int | None:
        """Run the exchange's next cycles, after the master's heartbeat if it is due; return what the exchange does.

        They end where the heartbeat is due again, or those of the nodes must be looked at.
        """
        if self.network.now() >= self._heartbeat_due_s and not self.is_silent:
            exchange.saw(self.send_heartbeat())
        due_s, silent_s = self._heartbeat_due_s, self._silent_until_s
        exchange.stretch.until_s = silent_s if self.is_silent or silent_s < due_s else due_s
        return exchange.exchange()

    def fault(self) -> str | None:
        """Return the reason to stop from nodes or user, or None."""
        network = self.network
        if not network.emergencies and not network.boots and network.now() <= self._silent_until_s:
            return self.interrupted_by
        while network.emergencies:
            emergency = network.emergencies.popleft()
            if emergency.code:
                return str(emergency)
        for node in network.boots & self._nodes:
            return f"node {node} has been reset"
        return self._lost_heartbeat() or self.interrupted_by

    def _lost_heartbeat(self) -> str | None:
        """Return the node without heartbeat for too long, in words."""
        heartbeats, now, period, since = self.network.heartbeats, self.network.now(), self.bus.heartbeat_s, self._since_s
        heard = {node: heartbeats[node][0] if node in heartbeats else None for node in self._nodes}
        for node, last in heard.items():
            fault = heartbeat_fault(node, last, now, since, period)
            if fault is not None:
                return fault
        # what has been heard by now keeps until then, and what will be heard longer
        known = ((since if last is None else max(last, since)) for last in heard.values())
        self._silent_until_s = min(known, default=now) + 3.0 * period
        return None
