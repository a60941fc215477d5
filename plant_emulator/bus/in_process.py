"""The bus in one process, without socket or thread.

The channel leads straight into a medium, so its user controls every cycle.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

from drive_profiles.address import LOCAL, Address
from drive_profiles.standard.cia301 import FunctionCode
from hil.can.channel import OneByOne
from hil.can.errors import BusLostError
from hil.can.frame import Frame, frames_of, pack
from hil.can.local import direct_line
from plant_emulator.bus.instant import FIRST_CLIENT, NODES, HeardFrame, Instant
from plant_emulator.bus.medium import Medium
from plant_emulator.core import CORE
from plant_emulator.world import World


def _nobody(_frame: Frame, _end_ns: int) -> None:
    """Stand in for a listener."""


def _nothing(_number: int) -> None:
    """Stand in for a test that interferes."""


def _all(_frame: Frame) -> bool:
    """Let every frame pass."""
    return True


STRANGER = FIRST_CLIENT + 1
"""Port from which frames are injected."""


class InProcessChannel(OneByOne):
    """A lock-step bus with one client.

    It is a `hil.can.channel.Channel`, and bit-identical for equal seeds.

    Attributes:
        is_logged: True if a measurement on it writes a log of its frames.
        line: The core's record of the medium, by which cycles need no Python; None where frames are logged, or a medium is given.
        heard: Called with each frame of the bus and the time of its end, the client's own included.
        on_sync: Called with the number of each SYNC before the world receives it; a test interferes here.
        passes: Frames to the client for which it is false are lost.
        lost: Set it to make the bus fail.
    """

    MAX_SENT = 1 << 16
    is_lock_step = True
    waits = False
    overflows = 0

    def __init__(self, world: World, medium: Medium | None = None, *, bitrate: int | None = None, is_logged: bool = True) -> None:
        """Join the bus and power the nodes on.

        Their boot-up messages wait to be read.

        Args:
            medium: The medium between world and client; left out, frames arrive at once and in order.
            bitrate: Bit rate by which a run checks the load of the bus, although the medium has none.
            is_logged: Set it to False for runs whose frames nobody reads.
        """
        self.world, self.is_logged = world, is_logged
        self.medium: Medium = Instant(world) if medium is None else medium
        self.medium.join(FIRST_CLIENT)
        self.address = Address(LOCAL, "in-process", self.medium.bitrate or bitrate)
        self.syncs = 0
        has_line = medium is None and not is_logged
        self.line: Any = direct_line(CORE.address(CORE.call.run_course), CORE.address(world.course)) if has_line else None
        self.heard: Callable[[Frame, int], None] = _nobody
        self.on_sync: Callable[[int], None] = _nothing
        self.passes: Callable[[Frame], bool] = _all
        self._sent: deque[Frame | bytes] = deque(maxlen=self.MAX_SENT)
        self._answers = b""
        self.lost = False
        self._queue: deque[Frame] = deque(world.power_on())
        self._has_clock = False
        self._has_stranger = False

    @property
    def sent(self) -> list[Frame]:
        """Frames that the client has sent, the latest `MAX_SENT` of them and of the messages; not those on the `line`."""
        return [frame for each in self._sent for frame in (frames_of(each) if isinstance(each, bytes) else (each,))]

    def open_line(self) -> None:
        """Prepare the line for cycles that the core exchanges by itself.

        Raises:
            BusLostError: `lost` is set.
        """
        self._check()
        if self.line is not None:
            self.line.syncs = self.syncs
            self.world.open_course()

    def close_line(self) -> None:
        """Take over what has happened on the line since."""
        if self.line is not None:
            self.syncs = int(self.line.syncs)
            self._deliver([HeardFrame(frame, NODES, self.world.now) for _, frame in self.world.close_course()])

    @property
    def takes_messages(self) -> bool:
        """True if a cycle may be one message each way.

        The clock is the client's, nobody looks at single frames, and none waits to be read.
        """
        has_listener = self.heard is not _nobody or self.passes is not _all or self.on_sync is not _nothing
        return self._has_clock and not self._queue and not has_listener

    def send_message(self, records: bytes) -> None:
        """Put the records of a cycle on the bus; the last is SYNC.

        Raises:
            BusLostError: `lost` is set.
        """
        self._check()
        answers = self.medium.exchange(FIRST_CLIENT, records) if self.takes_messages else None
        if answers is None:
            self.send_all(frames_of(records))
            return
        self.syncs += 1
        self._sent.append(records)
        self._answers = answers
        self._deliver(self.medium.finish_cycle())

    def receive_message(self, timeout_s: float) -> bytes:
        """Return the records of the next message; empty if none comes.

        What nodes have sent by themselves in the cycle stands behind its answers, as on the local bus.

        Raises:
            BusLostError: `lost` is set.
        """
        answers, self._answers = self._answers, b""
        frames = self.receive_all(timeout_s) if self._queue or not answers else []
        return answers + b"".join(map(pack, frames))

    def put_back(self, message: bytes) -> None:
        """Let a message that `receive_message` has given be read frame by frame."""
        self._queue.extendleft(reversed(frames_of(message)))

    def inject(self, frame: Frame) -> None:
        """Put a frame on the bus as another participant.

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
        self._sent.append(frame)
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

    def receive_all(self, timeout_s: float) -> list[Frame]:
        """Return all frames that wait to be read."""
        frame = self.receive(timeout_s)
        if frame is None:
            return []
        frames = [frame, *self._queue]
        self._queue.clear()
        return frames

    def close(self) -> None:
        """Leave; the next SYNC takes the clock again."""
        self._has_clock = False

    def _check(self) -> None:
        if self.lost:
            raise BusLostError(self.address, "pulled")

    def _deliver(self, heard: list[HeardFrame]) -> None:
        for frame, port, end_ns in heard:
            self.heard(frame, end_ns)
            if port != FIRST_CLIENT and self.passes(frame):
                self._queue.append(frame)
