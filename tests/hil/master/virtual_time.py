"""A clock that a test owns, and a bus on which time is this clock's: the real nodes and the real plant, no lock-step."""

from collections import deque
from collections.abc import Sequence

from drive_profiles.address import Address
from hil.can.frame import Frame
from plant_emulator.world import World

NS = 1_000_000_000
STEP_S = 0.0005


class VirtualClock:
    """Time that passes only where somebody waits.

    Attributes:
        pauses: When the process is frozen, and for how long; each happens once, as soon as time reaches it.
    """

    def __init__(self, *pauses: tuple[float, float]) -> None:
        self.time_s = 1000.0
        self.pauses = list(pauses)

    def now(self) -> float:
        return self.time_s

    def sleep_until(self, deadline_s: float) -> None:
        self.time_s = max(self.time_s, deadline_s)
        for pause in [pause for pause in self.pauses if pause[0] <= self.time_s]:
            self.pauses.remove(pause)
            self.time_s = max(self.time_s, pause[0] + pause[1])


class VirtualBus:
    """A bus of its own time with one client.

    Attributes:
        sent: What the master has sent, with the time.
        latency_s: After which an answer is with the master.
        send_s: How long the master takes to send a frame.
    """

    is_lock_step = False
    waits = True

    def __init__(self, world: World, clock: VirtualClock, *, latency_s: float = 0.0, bitrate: int | None = None) -> None:
        self.address = Address("virtual", "world", bitrate)
        self.overflows: int | None = 0
        self.world, self.clock, self.latency_s, self.send_s = world, clock, latency_s, 0.0
        self.sent: list[tuple[float, Frame]] = []
        self._epoch_s = clock.now()
        self._queue: deque[tuple[float, Frame]] = deque()
        self._arrive(world.power_on())

    def _arrive(self, frames: list[Frame]) -> None:
        self._queue.extend((self.clock.now() + self.latency_s, frame) for frame in frames)

    def follow(self) -> None:
        """Let the world catch up."""
        self._arrive(self.world.free_step(round((self.clock.now() - self._epoch_s) * NS)))

    def send(self, frame: Frame) -> None:
        self.follow()
        self.clock.sleep_until(self.clock.now() + self.send_s)
        self.sent.append((self.clock.now(), frame))
        self._arrive([answer for _, answer in self.world.hear(frame)])

    def receive(self, timeout_s: float) -> Frame | None:
        deadline = self.clock.now() + timeout_s
        while True:
            self.follow()
            if self._queue and self._queue[0][0] <= self.clock.now() + 1e-9:
                return self._queue.popleft()[1]
            if self.clock.now() >= deadline:
                return None
            wanted = min(deadline, self.clock.now() + STEP_S)
            if self._queue:
                wanted = min(wanted, self._queue[0][0])
            self.clock.sleep_until(wanted)

    def send_all(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            self.send(frame)

    def receive_all(self, timeout_s: float) -> list[Frame]:
        frame = self.receive(timeout_s)
        return [] if frame is None else [frame]

    def close(self) -> None:
        pass
