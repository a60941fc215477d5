"""The bus in one process, without socket or thread.

The channel leads straight into a medium, so its user controls every cycle.
"""

from collections import deque
from collections.abc import Callable, Sequence

from drive_profiles.address import LOCAL, Address
from drive_profiles.standard.cia301 import FunctionCode
from hil.can.errors import BusLostError
from hil.can.frame import Frame
from plant_emulator.bus.heard import FIRST_CLIENT, HeardFrame
from plant_emulator.bus.medium import Instant, Medium
from plant_emulator.world import World

STRANGER = FIRST_CLIENT + 1
"""Port from which frames are injected."""


class InProcessChannel:
    """A lock-step bus with one client.

    It is a `hil.can.channel.Channel`, and bit-identical for equal seeds.

    Attributes:
        world: The world behind the bus.
        medium: The medium between world and client.
        syncs: Number of SYNCs so far.
        sent: Frames that the client has sent, the latest `MAX_SENT`.
        heard: Called with each frame of the bus and the time of its end, the client's own included.
        on_sync: Called with the number of each SYNC before the world receives it; a test interferes here.
        passes: Frames to the client for which it is false are lost.
        lost: Set it to make the bus fail.
    """

    MAX_SENT = 1 << 16
    is_lock_step = True
    overflows = 0

    def __init__(self, world: World, medium: Medium | None = None) -> None:
        """Join the bus and power the nodes on.

        Their boot-up messages wait to be read.
        """
        self.world = world
        self.medium: Medium = Instant(world) if medium is None else medium
        self.medium.join(FIRST_CLIENT)
        self.address = Address(LOCAL, "in-process", self.medium.bitrate)
        self.syncs = 0
        self.sent: deque[Frame] = deque(maxlen=self.MAX_SENT)
        self.heard: Callable[[Frame, int], None] = lambda frame, end_ns: None
        self.on_sync: Callable[[int], None] = lambda number: None
        self.passes: Callable[[Frame], bool] = lambda frame: True
        self.lost = False
        self._queue: deque[Frame] = deque(world.power_on())
        self._has_clock = False
        self._has_stranger = False

    def inject(self, frame: Frame) -> None:
        """Put a frame on the bus as another participant.

        The nodes and the client both receive it.

        The other participant stays on the bus: on a bus with bit times a frame without an answer waits in its queue for the
        next SYNC.
        """
        if not self._has_stranger:
            self._has_stranger = True
            self.medium.join(STRANGER)
        self._deliver(self.medium.frame(STRANGER, frame))

    def hand_over(self, *frames: Frame) -> None:
        """Pass frames to the client alone.

        They may be late or doubled answers; the nodes do not receive them.
        """
        self._queue.extend(frames)

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus.

        A SYNC advances the world by its period.

        Raises:
            BusLostError: `lost` is set.
        """
        self._check()
        self.sent.append(frame)
        if frame.can_id != FunctionCode.SYNC:
            self._deliver(self.medium.frame(FIRST_CLIENT, frame))
            return
        self.syncs += 1
        self.on_sync(self.syncs)
        self._check()
        if not self._has_clock:
            self._has_clock = True
            self._deliver(self.medium.begin_cycles())
        for heard in self.medium.cycle(FIRST_CLIENT, frame):
            self._deliver(heard)

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next frame, or None.

        None means that nothing more arrives before the client sends again.

        Raises:
            BusLostError: `lost` is set.
        """
        self._check()
        if not self._queue:
            self._deliver(self.medium.idle())
        return self._queue.popleft() if self._queue else None

    def send_all(self, frames: Sequence[Frame]) -> None:
        """Put frames on the bus, one after the other."""
        for frame in frames:
            self.send(frame)

    def receive_all(self, timeout_s: float) -> list[Frame]:
        """Return all frames that wait to be read."""
        frame = self.receive(timeout_s)
        if frame is None:
            return []
        frames = [frame, *self._queue]
        self._queue.clear()
        return frames

    def close(self) -> None:
        """Leave; the next SYNC takes the clock again.

        Calling it again is allowed.
        """
        self._has_clock = False

    def _check(self) -> None:
        if self.lost:
            raise BusLostError(self.address, "pulled")

    def _deliver(self, heard: list[HeardFrame]) -> None:
        for frame, port, end_ns in heard:
            self.heard(frame, end_ns)
            if port != FIRST_CLIENT and self.passes(frame):
                self._queue.append(frame)
