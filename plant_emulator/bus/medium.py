"""What lies between the clients of the local bus and its world: nothing but order, or a wire with bit times."""

from collections.abc import Iterator
from typing import Protocol

from hil.can import clock
from hil.can.frame import Frame
from plant_emulator.bus.faults import Faults
from plant_emulator.bus.timed import Heard, TimedBus
from plant_emulator.bus.wire import Wire
from plant_emulator.world import SECOND, World

_PDOS, _HEARTBEATS = (0x180, 0x580), (0x700, 0x780)
"""Identifiers in the predefined connection set (CiA 301, 7.3.3), the last one excluded: nobody answers these."""
NODES = 0
"""Port of all nodes together, where nobody counts bits."""


class Medium(Protocol):
    """How a frame reaches the others, and how time passes.

    Attributes:
        clock: `hil.can.clock.LOCK_STEP` or `WALL`.
        bitrate: In bit/s; None: no bit times.
    """

    clock: int
    bitrate: int | None

    @property
    def lag_ns(self) -> int:
        """How long the oldest SYNC of the client that holds the clock waits for a bus that is too full."""
        ...

    def join(self, port: int) -> None:
        """A client comes."""
        ...

    def leave(self, port: int) -> None:
        """A client goes."""
        ...

    @property
    def due(self) -> int | None:
        """The next instant at which a frame ends, or a node wakes."""
        ...

    def free(self, until: int) -> list[Heard]:
        """Time passes by itself."""
        ...

    def begin_cycles(self) -> list[Heard]:
        """A client takes the clock: on to the next whole second, so that every run finds the clock's phase the same."""
        ...

    def frame(self, port: int, frame: Frame) -> list[Heard]:
        """A client sends a frame that does not move the clock."""
        ...

    def idle(self) -> list[Heard]:
        """The client that holds the clock waits: what has been put off until its next SYNC is heard now."""
        ...

    def cycle(self, port: int, sync: Frame) -> Iterator[list[Heard]]:
        """The SYNC of the client that holds the clock: what is heard until the next beat, in parts that can go early."""
        ...


class Instant:
    """No bit times, lock-step: a frame is heard at once, and a SYNC is worth a period."""

    clock = clock.LOCK_STEP
    bitrate: int | None = None
    lag_ns = 0

    def __init__(self, world: World) -> None:
        """Put it before a world."""
        self._world = world

    def join(self, port: int) -> None:
        """Nothing to do."""

    def leave(self, port: int) -> None:
        """Nothing to do."""

    @property
    def due(self) -> int | None:
        """The next instant at which a node wakes."""
        return self._world.due

    def free(self, until: int) -> list[Heard]:
        """Time passes by itself."""
        return self._heard(self._world.free_step(until))

    def begin_cycles(self) -> list[Heard]:
        """On to the next whole second."""
        return self._heard(self._world.begin_lock_step())

    def frame(self, port: int, frame: Frame) -> list[Heard]:
        """It is heard, and answered, at once; a SYNC that does not move the clock is worth no time."""
        answered = self._world.hear(frame)
        heard = Heard(frame, port, self._world.now)
        if not answered:
            return [heard]
        answers = sorted((answer for _, answer in answered), key=lambda answer: answer.can_id)
        return [heard, *self._heard(answers)]

    def idle(self) -> list[Heard]:
        """Nothing is put off."""
        return []

    def cycle(self, port: int, sync: Frame) -> Iterator[list[Heard]]:
        """The answers leave before the world moves on, so that the master computes while the emulator does."""
        yield [Heard(sync, port, self._world.now), *self._heard(self._world.receive(sync))]
        yield self._heard(self._world.settle())

    def _heard(self, frames: list[Frame]) -> list[Heard]:
        now = self._world.now
        return [Heard(frame, NODES, now) for frame in frames] if frames else []


class Timed:
    """A wire, with bit times or without, in lock-step or by the wall clock."""

    def __init__(self, bus: TimedBus, *, wall: bool) -> None:
        """Put it before a world.

        Args:
            bus: World and wire.
            wall: Time follows the wall clock, whoever sends SYNC.
        """
        self._bus = bus
        self.clock = clock.WALL if wall else clock.LOCK_STEP
        self.bitrate = bus.wire.bitrate
        self._is_idle = True

    @property
    def lag_ns(self) -> int:
        """How long the client's oldest SYNC has been waiting for the bus at the last beat."""
        return self._bus.lag_ns

    def join(self, port: int) -> None:
        """Attach a controller."""
        self._bus.wire.attach(port)

    def leave(self, port: int) -> None:
        """Detach it; what it has queued is lost."""
        self._bus.wire.detach(port)

    @property
    def due(self) -> int | None:
        """The next instant at which a frame ends, or a node wakes."""
        return self._bus.due

    def free(self, until: int) -> list[Heard]:
        """Time passes by itself."""
        return self._bus.free(until)

    def begin_cycles(self) -> list[Heard]:
        """On to the next whole second."""
        heard = self._bus.free(-(-self._bus.world.now // SECOND) * SECOND)
        self._bus.begin_cycles()
        return heard

    def frame(self, port: int, frame: Frame) -> list[Heard]:
        """It is queued; in lock-step time passes until it, and what it causes, has ended.

        What is not answered, process data and heartbeats, waits for the SYNC behind it: all leave at the same beat, one after the
        other, and the beats stay where they are.
        """
        mark = self._bus.wire.mark
        self._bus.offer(port, frame)
        self._is_idle = False
        can_id = frame[0]
        is_answered = not (_PDOS[0] <= can_id < _PDOS[1] or _HEARTBEATS[0] <= can_id < _HEARTBEATS[1])
        return self._settled(mark) if is_answered else []

    def idle(self) -> list[Heard]:
        """Time passes until everything that waits has been sent, answers included."""
        return self._settled(self._bus.wire.mark)

    def _settled(self, mark: int) -> list[Heard]:
        if self._is_idle or self.clock == clock.WALL:
            return []
        self._is_idle = True
        return self._bus.settle(mark)

    def cycle(self, port: int, sync: Frame) -> Iterator[list[Heard]]:
        """Up to the next beat."""
        self._is_idle = True
        yield self._bus.cycle(port, sync, self._bus.world.period_ns)


def medium_for(
    world: World,
    bitrate: int | None,
    data_bitrate: int | None = None,
    *,
    wall: bool = False,
    host_latency_s: float = 0.0,
    faults: Faults | None = None,
) -> Medium:
    """The simplest medium that does what is asked for.

    Args:
        world: What is behind it.
        bitrate: In bit/s; None: no bit times.
        data_bitrate: In bit/s; given, every data frame goes as a CAN FD frame of the same contents, these at this rate. That
            is what CAN FD brings to PDOs of up to 8 bytes; larger ones, which `hil plan` counts, are another matter.
        wall: Time follows the wall clock; else SYNC.
        host_latency_s: How long a client's frame takes from its program to its controller, in the time of the bus.
        faults: What goes wrong on the wire.

    Raises:
        ValueError: No bit rate, or a data bit rate below it or alone.
    """
    if bitrate is None and data_bitrate is None and not wall and faults is None and not host_latency_s:
        return Instant(world)
    wire = Wire(bitrate, data_bitrate, faults=faults, now_ns=world.now)
    return Timed(TimedBus(world, wire, round(1e9 * host_latency_s)), wall=wall)
