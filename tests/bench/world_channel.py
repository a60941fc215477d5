"""A channel straight into a world: the real nodes and the real plant, without the socket, so that a test owns every cycle."""

from collections import deque
from collections.abc import Callable

from drive_profiles.address import Address
from hil.can.channel import BusLostError
from hil.can.frame import Frame
from plant_emulator.world import World

SYNC_ID = 0x80


class WorldChannel:
    """A lock-step bus with one client.

    Attributes:
        world: What is behind it.
        syncs: SYNCs so far.
        sent: Frames that the master has sent.
        on_sync: Called with the number of each SYNC before the world sees it; a test's place to interfere.
        filter: Frames from the world for which it is false are lost.
        lost: Set it to make the bus fail.
    """

    is_lock_step = True

    def __init__(self, world: World) -> None:
        self.address = Address("local", "in-process")
        self.world = world
        self.syncs = 0
        self.sent: list[Frame] = []
        self.on_sync: Callable[[int], None] = lambda number: None
        self.filter: Callable[[Frame], bool] = lambda frame: True
        self.lost = False
        self._queue: deque[Frame] = deque(world.power_on())
        self._locked = False

    def inject(self, frame: Frame) -> None:
        """Put a frame on the bus as a stranger would: the nodes and the master both see it."""
        self._deliver([frame, *self.world.receive(frame)])

    def _deliver(self, frames: list[Frame]) -> None:
        self._queue.extend(frame for frame in frames if self.filter(frame))

    def send(self, frame: Frame) -> None:
        if self.lost:
            raise BusLostError(self.address, "pulled")
        self.sent.append(frame)
        if frame.can_id == SYNC_ID:
            self.syncs += 1
            self.on_sync(self.syncs)
            if not self._locked:
                self._locked = True
                self._deliver(self.world.begin_lock_step())
        self._deliver(self.world.receive(frame))
        if frame.can_id == SYNC_ID:
            self._deliver(self.world.settle())

    def receive(self, timeout_s: float) -> Frame | None:
        if self.lost:
            raise BusLostError(self.address, "pulled")
        return self._queue.popleft() if self._queue else None

    def close(self) -> None:
        self._locked = False
