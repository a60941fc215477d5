"""The emulated robot on SocketCAN or python-can, by the wall clock."""

import os
import select
import time
from collections.abc import Callable, Iterable

from hil.can.channel import Channel
from hil.can.frame import CAN_ERR_FLAG, Frame
from plant_emulator.bus.stalls import LATE_NS, WallTime, spread, to_stderr
from plant_emulator.world import FREE_STEP_NS, World, by_priority

POLL_S = 1e-9 * FREE_STEP_NS
"""Longest wait for a frame before the world is served again, in s."""
TURN_FRAMES = 64
"""Frames that are answered before time passes by itself again."""


class Attachment:
    """World joined to a bus by a channel.

    Each loop lets the world follow the clock, in steps of at most 1 ms, then processes received frames (set-points, SYNC,
    requests) at the instant at which they are read. The nodes' frames are sent at once. A world that has fallen behind first
    processes the waiting frames, before its time passes; see `bus.stalls`.

    Attributes:
        time: The wall clock, as the world follows it.
    """

    def __init__(
        self,
        world: World,
        channel: Channel,
        *,
        say: Callable[[str], None] = to_stderr,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.world, self.channel = world, channel
        self.frames = 0
        self.time = WallTime(clock, world.now, say)
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
        self.time.begin(self.world.now)
        self._send(self.world.power_on())
        while not self._stop:
            self.turn(POLL_S)
            if self._parent is not None and self._has_gone(self._parent):
                return

    def turn(self, timeout_s: float) -> None:
        """Follow the clock; answer at most `TURN_FRAMES` frames arriving in time."""
        if not self._follow():
            self._catch_up(None)
        for _ in range(TURN_FRAMES):
            frame = self.channel.receive(timeout_s)
            if frame is None:
                return
            timeout_s = 0.0
            if not self._follow():
                self._catch_up(frame)
                return
            self._hear(frame)

    def _follow(self) -> bool:
        behind = self.time() - self.world.now
        if behind > LATE_NS:
            return False
        if behind > 0:
            self._send(self.world.free_step(self.world.now + behind))
        return True

    def _catch_up(self, first: Frame | None) -> None:
        """Process frames that arrived during a stall, then pass the rest."""
        waiting = [] if first is None else [first]
        while len(waiting) < TURN_FRAMES and (frame := self.channel.receive(0.0)) is not None:
            waiting.append(frame)
        begin, end = self.world.now, self.time()
        instants, reached = self.time.catch_up(begin, end, spread(begin, end, len(waiting)))
        for instant, frame in zip(instants, waiting, strict=True):
            self._send(self.world.free_step(instant))
            self._hear(frame)
        self._send(self.world.free_step(reached))

    def _hear(self, frame: Frame) -> None:
        """Pass a frame to the nodes now, and send their answers."""
        if not frame.can_id & CAN_ERR_FLAG:
            self.frames += 1
            self._send(by_priority(answer for _, answer in self.world.hear(frame)))

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
