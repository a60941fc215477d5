"""What a test does to its bus: frames on their way between it and the master, and things that happen at an instant."""

import heapq
from collections.abc import Callable
from typing import NoReturn

from hil.can.frame import Frame
from plant_emulator.bus.faults import Event, Fault, Faults, Passage
from plant_emulator.pytest_plugin.artefacts import Trace


class LiveFaults:
    """Faults of frames that may be added at any time; a wire takes them as well."""

    events: tuple[Event, ...] = ()

    def __init__(self) -> None:
        """None so far."""
        self.faults: list[Faults] = []

    def add(self, fault: Fault) -> Faults:
        """One more, behind the others; it tells its `hits`."""
        added = Faults((fault,), seed=len(self.faults))
        self.faults.append(added)
        return added

    def apply(self, frame: Frame, port: int, at_ns: int) -> tuple[Passage, ...]:
        """What becomes of a frame: nothing, one frame or several."""
        passages: tuple[Passage, ...] = (Passage(frame),)
        for fault in self.faults:
            passages = tuple(
                passage._replace(delay_ns=before.delay_ns + passage.delay_ns, destroyed=before.destroyed + passage.destroyed)
                for before in passages
                for passage in fault.apply(before.frame, port, at_ns)
            )
        return passages


def _nowhere(*_: object) -> NoReturn:
    raise RuntimeError("the bus has not been opened")


class Interference:
    """Faults of frames, and a list of what is due; it belongs to one bus, which says how each thing is done there.

    Attributes:
        trace: What has been heard.
        frames: What happens to frames between bus and master.
        wire: What happens to them on the wire; None where no bit times are emulated.
        now_ns: The bench's time.
        put: Puts a frame on the bus as a stranger would.
        pull: Makes the bus fail.
        push: Gives it back.
        is_used: Whether a test has interfered.
        power_cycle: Switches a node off and on.
        switch_bus_off: Puts a node's controller bus-off (True), or brings it back.
    """

    def __init__(self, trace: Trace) -> None:
        """Nothing is planned."""
        self.trace = trace
        self.frames = LiveFaults()
        self.wire: LiveFaults | None = None
        self.now_ns: Callable[[], int] = _nowhere
        self.put: Callable[[Frame], None] = _nowhere
        self.pull: Callable[[], None] = _nowhere
        self.power_cycle: Callable[[int], None] = _nowhere
        self.switch_bus_off: Callable[[int, bool], None] = _nowhere
        self.push: Callable[[], None] = lambda: None
        self.is_used = False
        self._planned: list[tuple[int, int, Callable[[], None]]] = []
        self._ends: list[Callable[[], None]] = []
        self._order = 0

    @property
    def due_ns(self) -> int | None:
        """When something is to happen next."""
        return self._planned[0][0] if self._planned else None

    def at(self, instant_ns: int, action: Callable[[], None]) -> None:
        """Plan something; what is due at once happens at the next SYNC."""
        self._order += 1
        heapq.heappush(self._planned, (instant_ns, self._order, action))

    def between(self, begin_ns: int, end_ns: int | None, begin: Callable[[], None], end: Callable[[], None]) -> None:
        """Plan something that lasts; where no end is given it ends with the test, and once more does no harm."""
        self.at(begin_ns, begin)
        if end_ns is not None:
            self.at(end_ns, end)
        self._ends.append(end)

    def run_due(self) -> None:
        """Let happen what is due."""
        while self._planned and self._planned[0][0] <= self.now_ns():
            heapq.heappop(self._planned)[2]()

    def end(self) -> None:
        """No more faults, and the bus is back: what a drive needs to be disabled and left as it was found."""
        self.frames.faults.clear()
        if self.wire is not None:
            self.wire.faults.clear()
        self._planned.clear()
        while self._ends:
            self._ends.pop()()
        self.push()
