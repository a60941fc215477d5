"""Interference of a test with its bus."""

import heapq
from collections.abc import Callable
from functools import partial
from typing import NoReturn

from hil.can.frame import Frame
from plant_emulator.bus.faults import BusFaults, Fault, Passage
from plant_emulator.pytest_plugin.artefacts import FrameLog


class LiveFaults(BusFaults):
    """Faults of frames that may be added at any time."""

    def __init__(self) -> None:
        super().__init__(())
        self.added: list[BusFaults] = []

    def add(self, fault: Fault) -> BusFaults:
        """Add a fault after the others; the result counts its `hits`."""
        self.added.append(BusFaults((fault,), seed=len(self.added)))
        return self.added[-1]

    def apply(self, frame: Frame, port: int, at_ns: int) -> tuple[Passage, ...]:
        """Return the frames that replace one: none, one or several."""
        passages: tuple[Passage, ...] = (Passage(frame),)
        for fault in self.added:
            passages = tuple(
                passage._replace(delay_ns=before.delay_ns + passage.delay_ns, destroyed=before.destroyed + passage.destroyed)
                for before in passages
                for passage in fault.apply(before.frame, port, at_ns)
            )
        return passages


def _nowhere(*_: object) -> NoReturn:
    raise RuntimeError("the bus has not been opened")


class Interference:
    """Faults of frames, and planned actions, of one bus.

    Attributes:
        frames: Faults of frames between bus and master.
        wire: Faults of frames on the wire; None if no bit times are emulated.
        put: Puts a frame on the bus as a stranger would.
        pull: Makes the bus fail.
        push: Gives it back.
        is_used: True once a test has interfered.
        switch_bus_off: Puts a node's controller bus-off (True), or brings it back.
    """

    def __init__(self, trace: FrameLog) -> None:
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

    def join(self, now_ns: Callable[[], int], put: Callable[[Frame], None], bus: object) -> None:
        """Interfere with a bus, which fails while its `lost` is True."""
        self.now_ns, self.put = now_ns, put
        self.pull, self.push = partial(setattr, bus, "lost", True), partial(setattr, bus, "lost", False)

    @property
    def due_ns(self) -> int | None:
        """Time of the next planned action in ns, or None."""
        return self._planned[0][0] if self._planned else None

    def at(self, instant_ns: int, action: Callable[[], None]) -> None:
        """Plan an action.

        An action that is due at once happens at the next SYNC.
        """
        self._order += 1
        heapq.heappush(self._planned, (instant_ns, self._order, action))

    def between(
        self, begin_ns: int, end_ns: int | None, begin: Callable[[], None], end: Callable[[], None] | None = None
    ) -> None:
        """Plan a temporary condition; without an end it lasts all the test.

        Args:
            end_ns: End, in the same time; None: the end of the test.
            end: Called at the end, and once more at the end of the test; None: there is nothing to end.
        """
        self.at(begin_ns, begin)
        if end is None:
            return
        if end_ns is not None:
            self.at(end_ns, end)
        self._ends.append(end)

    def run_due(self) -> None:
        """Perform the actions that are due."""
        while self._planned and self._planned[0][0] <= self.now_ns():
            heapq.heappop(self._planned)[2]()

    def end(self) -> None:
        """End all faults and restore the bus."""
        self.frames.added.clear()
        if self.wire is not None:
            self.wire.added.clear()
        self._planned.clear()
        while self._ends:
            self._ends.pop()()
        self.push()
