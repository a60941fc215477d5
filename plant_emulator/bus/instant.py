"""The bus without bit times, and frames as the participants of any bus send and hear them."""

from collections.abc import Iterator
from typing import NamedTuple

from hil.can import clock
from hil.can.frame import Frame
from plant_emulator.world import World, by_priority

NODES = 0
"""Port of all nodes together, where no bits are counted."""
FIRST_CLIENT = 1000
"""Ports of clients count from here; a node's port is its node-ID."""


class HeardFrame(NamedTuple):
    """A frame that has ended on the wire.

    Attributes:
        frame: The frame that every participant but the sender has received.
        port: Port of the sender.
    """

    frame: Frame
    port: int
    end_ns: int


class Instant:
    """Medium without bit times, in lock-step.

    A frame is delivered at once, and a SYNC is worth a period.
    """

    clock = clock.LOCK_STEP
    bitrate: int | None = None

    def __init__(self, world: World) -> None:
        self._world = world

    def join(self, port: int) -> None:
        """Do nothing: without a wire there is no controller."""

    def leave(self, port: int) -> None:
        """Do nothing: without a wire there is no controller."""

    @property
    def due(self) -> int | None:
        """Next instant at which a node wakes."""
        return self._world.due

    def free(self, until: int) -> list[HeardFrame]:
        """Let time pass; return the delivered frames."""
        return self._heard(self._world.free_step(until))

    def begin_cycles(self) -> list[HeardFrame]:
        """Advance to the next whole second."""
        return self._heard(self._world.begin_lock_step())

    def frame(self, port: int, frame: Frame) -> list[HeardFrame]:
        """Deliver the frame and its answers at once.

        A SYNC that does not move the clock is worth no time.
        """
        answered = self._world.hear(frame)
        heard = HeardFrame(frame, port, self._world.now)
        if not answered:
            return [heard]
        return [heard, *self._heard(by_priority(answer for _, answer in answered))]

    def idle(self) -> list[HeardFrame]:
        """Return nothing: no frame is held."""
        return []

    def cycle(self, port: int, sync: Frame) -> Iterator[list[HeardFrame]]:
        """Yield the answers before the world advances.

        The master and the emulator then compute at the same time.
        """
        yield [HeardFrame(sync, port, self._world.now), *self._heard(self._world.receive(sync))]
        yield self.finish_cycle()

    def exchange(self, port: int, message: bytes) -> bytes | None:
        """Answer at once if every node only follows: see `World.exchange`."""
        return self._world.exchange(message)

    def finish_cycle(self) -> list[HeardFrame]:
        """Let the period pass."""
        return self._heard(self._world.finish_period())

    def _heard(self, frames: list[Frame]) -> list[HeardFrame]:
        now = self._world.now
        return [HeardFrame(frame, NODES, now) for frame in frames] if frames else []
