"""The emulated robot on a bus that others keep: SocketCAN, or any python-can interface. Its time is the wall clock's."""

import os
import select
import sys
import time
from collections.abc import Callable, Iterable

from hil.can.channel import Channel
from hil.can.frame import CAN_ERR_FLAG, Frame
from plant_emulator.world import FREE_STEP_NS, World

POLL_S = 1e-9 * FREE_STEP_NS
"""Longest wait for a frame before the world is served again, in s."""
TURN_FRAMES = 64
"""Frames that are answered before time passes by itself again."""
BEHIND_NS = 50_000_000
"""Largest lag of the world behind the wall clock. A longer stall is not made up for: the robot stood still, and says so.

Otherwise a stalled process would let its drives' deadlines pass in one leap, before it has read the frames that kept them.
"""
SAY_AGAIN_NS = 1_000_000_000


class Attachment:
    """A world joined to a bus by a channel.

    Each loop lets the world follow the clock, in steps of at most 1 ms, then hears what has come at the instant at which it is
    read: set-points, SYNC, requests. What the nodes send leaves at once.

    Attributes:
        frames: Heard so far.
        stalls: Number of times that the world was left behind.
        stalled_ns: Time that it has lost in all.
    """

    def __init__(
        self,
        world: World,
        channel: Channel,
        *,
        say: Callable[[str], None] = lambda words: print(words, file=sys.stderr, flush=True),  # noqa: T201 - the default
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Join them; `run` starts the nodes.

        Args:
            world: The robot.
            channel: The bus, closed by `close`.
            say: Called with each complaint.
            clock: Monotonic, in ns.
        """
        self.world, self.channel = world, channel
        self.frames = self.stalls = self.stalled_ns = 0
        self._say, self._clock = say, clock
        self._epoch_ns = clock() - world.now
        self._said_ns: int | None = None
        self._unsaid_ns = 0
        self._parent: int | None = None
        self._stop = False

    def watch(self, descriptor: int) -> None:
        """Stop when this descriptor is closed at its other end."""
        self._parent = descriptor

    def stop(self) -> None:
        """End `run` soon; may be called from a signal handler."""
        self._stop = True

    def run(self) -> None:
        """Start the nodes and serve until `stop`.

        Raises:
            BusLostError: The bus has gone; it is not joined again.
        """
        self._epoch_ns = self._clock() - self.world.now
        self._send(self.world.power_on())
        while not self._stop:
            self.turn(POLL_S)
            if self._parent is not None and self._has_gone(self._parent):
                return

    def turn(self, timeout_s: float) -> None:
        """Follow the clock, and answer what comes within the time; of many frames the first `TURN_FRAMES`."""
        self._follow()
        for _ in range(TURN_FRAMES):
            frame = self.channel.receive(timeout_s)
            if frame is None:
                return
            timeout_s = 0.0
            if not frame.can_id & CAN_ERR_FLAG:
                self.frames += 1
                self._follow()
                answers = [answer for _, answer in self.world.hear(frame)]
                self._send(sorted(answers, key=lambda answer: answer.can_id))  # as a bus would let them pass

    def _follow(self) -> None:
        """Let the world's time pass up to the clock's."""
        now = self._clock()
        behind = now - self._epoch_ns - self.world.now
        if behind > BEHIND_NS:
            self._epoch_ns += behind
            self._note(now, behind)
        elif behind > 0:
            self._send(self.world.free_step(self.world.now + behind))

    def _note(self, now: int, lost_ns: int) -> None:
        """Count a stall; it is said, but not more than once a second."""
        self.stalls += 1
        self.stalled_ns += lost_ns
        self._unsaid_ns += lost_ns
        if self._said_ns is None or now - self._said_ns >= SAY_AGAIN_NS:
            self._said_ns = now
            self._say(f"the emulated robot has fallen behind the wall clock: {1e-6 * self._unsaid_ns:.0f} ms are lost")
            self._unsaid_ns = 0

    def _send(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            self.channel.send(frame)

    def close(self) -> None:
        """Leave the bus."""
        self.channel.close()

    @staticmethod
    def _has_gone(descriptor: int) -> bool:
        try:
            if not select.select([descriptor], [], [], 0)[0]:
                return False
            return not os.read(descriptor, 4096)
        except (OSError, ValueError):
            return True
