"""A bus as the suite needs it: frames out, frames in with their time; real in wall time, emulated in virtual time."""

import time
from abc import ABC, abstractmethod
from typing import NamedTuple

import can

from drive_profiles.address import LOCAL, parse_address
from hil.can.frame import CAN_RTR_FLAG, Frame

SECOND = 1_000_000_000
SYNC, LSS_MASTER = 0x080, 0x7E5


class Heard(NamedTuple):
    """A frame that came, and when."""

    at_s: float
    can_id: int
    data: bytes


class Port(ABC):
    """One client of a bus; single-threaded.

    Attributes:
        seen: Every data frame with an 11-bit identifier since the last `clear`, in order.
    """

    is_emulated = False

    def __init__(self):
        self.seen = []

    def clear(self):
        """Forget what came."""
        self.pump(0.0)
        self.seen.clear()

    @property
    @abstractmethod
    def now_s(self):
        """The time that `Heard.at_s` counts in."""

    @abstractmethod
    def send(self, can_id, data=b"", *, remote=False):
        """Put a frame on the bus."""

    @abstractmethod
    def pump(self, seconds):
        """Wait until at least one frame has come, at most so long; tell whether one has."""

    def expect(self, can_id, seconds, since=None, data=None):
        """The first frame of an identifier, and of these bytes, from a place in `seen` on; None where none comes in time."""
        place = len(self.seen) if since is None else since
        deadline = self.now_s + seconds
        while True:
            for heard in self.seen[place:]:
                if heard.can_id == can_id and data in {None, heard.data}:
                    return heard
            place = len(self.seen)
            left = deadline - self.now_s
            if left <= 0.0 or not self.pump(left):
                return None

    def during(self, seconds):
        """All frames of a span of time."""
        place, deadline = len(self.seen), self.now_s + seconds
        while (left := deadline - self.now_s) > 1e-9:
            self.pump(left)
        return self.seen[place:]

    def close(self):  # noqa: B027 - an emulated bus needs nothing
        """Leave the bus."""


class CanPort(Port):
    """Any bus that python-can knows, by the address that all our tools take."""

    def __init__(self, address):
        super().__init__()
        parsed = parse_address(address)
        settings = {} if parsed.bitrate is None else {"bitrate": parsed.bitrate}
        interface = "hil_local" if parsed.interface == LOCAL else parsed.interface
        self._bus = can.Bus(interface=interface, channel=parsed.channel, **settings)

    @property
    def now_s(self):
        return time.monotonic()

    def send(self, can_id, data=b"", *, remote=False):
        message = can.Message(
            arbitration_id=can_id, data=None if remote else data, dlc=len(data), is_remote_frame=remote, is_extended_id=False
        )
        self._bus.send(message, timeout=1.0)

    def pump(self, seconds):
        deadline, count = time.monotonic() + seconds, len(self.seen)
        while True:
            message = self._bus.recv(max(0.0, deadline - time.monotonic()))
            if message is None:
                return len(self.seen) > count
            if not (message.is_extended_id or message.is_error_frame or message.is_remote_frame):
                self.seen.append(Heard(time.monotonic(), message.arbitration_id, bytes(message.data)))
                if seconds > 0.0:
                    return True

    def close(self):
        self._bus.shutdown()


class EmulatedPort(Port):
    """A world in this process: time-outs cost no time. LSS reaches the node under test only, as if it were alone on the bus."""

    is_emulated = True
    STEP_NS = 1_000_000

    def __init__(self, world, node):
        super().__init__()
        self.world, self.node = world, node
        self._hear(world.power_on())

    @property
    def now_s(self):
        return self.world.now / SECOND

    def send(self, can_id, data=b"", *, remote=False):
        frame = Frame(can_id | (CAN_RTR_FLAG if remote else 0), bytes(data))
        self._hear(self.node.slave.receive(frame, self.world.now) if can_id == LSS_MASTER else self.world.receive(frame))
        if can_id == SYNC:
            self._hear(self.world.finish_period())

    def pump(self, seconds):
        world, count = self.world, len(self.seen)
        end = world.now + round(seconds * SECOND)
        while len(self.seen) == count and world.now < end:
            due = world.due
            stop = min(end, world.now + self.STEP_NS)
            self._hear(world.advance(stop if due is None else max(world.now, min(stop, due))))
        return len(self.seen) > count

    def _hear(self, frames):
        self.seen += [Heard(self.now_s, frame.can_id, bytes(frame.data)) for frame in frames]
