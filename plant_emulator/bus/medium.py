"""Medium between clients and world: instantaneous, or a wire with bit times."""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Protocol

from hil.can import clock
from hil.can.frame import Frame
from plant_emulator.bus.heard import HeardFrame
from plant_emulator.world import World

if TYPE_CHECKING:  # a bus without bit times does not load them
    from plant_emulator.bus.faults import BusFaults

NODES = 0
"""Port of all nodes together, where no bits are counted."""


class Medium(Protocol):
    """Protocol of a medium: delivery of frames, and passing of time.

    Attributes:
        clock: `hil.can.clock.LOCK_STEP` or `WALL`.
        bitrate: In bit/s; None: no bit times.
    """

    clock: int
    bitrate: int | None

    def join(self, port: int) -> None:
        """Add a client."""
        ...

    def leave(self, port: int) -> None:
        """Remove a client."""
        ...

    @property
    def due(self) -> int | None:
        """Next instant at which a frame ends, or a node wakes."""
        ...

    def free(self, until: int) -> list[HeardFrame]:
        """Let time pass; return the delivered frames."""
        ...

    def begin_cycles(self) -> list[HeardFrame]:
        """Advance to the next whole second when a client takes the clock.

        Every run then begins with the same phase of the clock.
        """
        ...

    def frame(self, port: int, frame: Frame) -> list[HeardFrame]:
        """Send a client's frame that does not move the clock."""
        ...

    def idle(self) -> list[HeardFrame]:
        """Deliver the frames that were held until the next SYNC.

        The client that holds the clock is waiting.
        """
        ...

    def cycle(self, port: int, sync: Frame) -> Iterable[list[HeardFrame]]:
        """Send the SYNC of the client that holds the clock.

        Gives the frames until the next cycle, in parts that can be sent early.
        """
        ...

    def exchange(self, port: int, message: bytes) -> bytes | None:
        """Send RPDOs and SYNC of the client that holds the clock, as records.

        Returns the records of the answers, after which `finish_cycle` comes; None, with nothing sent, if they must go frame by
        frame.
        """
        ...

    def finish_cycle(self) -> list[HeardFrame]:
        """Let the rest of a cycle pass that `exchange` has begun."""
        ...


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
        answers = sorted((answer for _, answer in answered), key=lambda answer: answer.can_id)
        return [heard, *self._heard(answers)]

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


def medium_for(
    world: World,
    bitrate: int | None,
    data_bitrate: int | None = None,
    *,
    wall: bool = False,
    host_latency_s: float = 0.0,
    faults: "BusFaults | None" = None,
) -> Medium:
    """Choose the simplest medium that has the required properties.

    Args:
        world: The world behind the medium.
        bitrate: In bit/s; None: no bit times.
        data_bitrate: In bit/s; given, every data frame goes as a CAN FD frame of the same contents, these at this rate. That
            is what CAN FD brings to PDOs of up to 8 bytes; larger ones, which `hil plan` counts, are another matter.
        wall: Time follows the wall clock; else SYNC.
        host_latency_s: Time that a client's frame takes from its program to its controller, in the time of the bus.
        faults: Faults of the wire.

    Raises:
        ValueError: No bit rate, or a data bit rate below it or alone.
    """
    if bitrate is None and data_bitrate is None and not wall and faults is None and not host_latency_s:
        return Instant(world)

    from plant_emulator.bus.timed import TimedBus  # noqa: PLC0415
    from plant_emulator.bus.wire import EmulatedWire  # noqa: PLC0415

    wire = EmulatedWire(bitrate, data_bitrate, faults=faults, now_ns=world.now)
    return TimedBus(world, wire, round(1e9 * host_latency_s), wall=wall)
