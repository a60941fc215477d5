"""Faults of a bus, as data.

A fault states its frames or ports, its time and its frequency. Equal seeds give equal faults.

    seed = 1

    [[fault]]
    kind = "drop"          # every third TPDO1 of node 1, from 2 s to 3 s
    can_id = 0x181
    every = 3
    from_s = 2.0
    to_s = 3.0

Some faults affect frames: drop, delay, duplicate, reorder, corrupt. Whether a frame is hit is decided when it is offered, fault
by fault in the order of the file, so the result does not depend on when the bus is advanced. The others affect a port or the
bus for a time: mute, babble, stuck, bus_off. Times count in the time of the wire.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from drive_profiles.files.toml import Table
from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_RTR_FLAG, CAN_SFF_MASK, MAX_DATA_LENGTH, Frame

FaultKind = Literal["drop", "delay", "duplicate", "reorder", "corrupt", "mute", "babble", "stuck", "bus_off"]
OF_A_FRAME = frozenset({"drop", "delay", "duplicate", "reorder", "corrupt"})
MAX_DELAY_NS = 10_000_000_000
_ONLY_FOR = {
    "every": OF_A_FRAME,
    "probability": OF_A_FRAME,
    "count": OF_A_FRAME,
    "mask": OF_A_FRAME,
    "can_id": OF_A_FRAME | {"babble"},
    "port": OF_A_FRAME | {"mute", "babble", "bus_off"},
    "delay_ns": {"delay", "reorder"},
    "copies": {"duplicate"},
    "bits": {"corrupt"},
    "crc": {"corrupt"},
    "attempts": {"corrupt"},
    "data": {"babble"},
}
_NEEDS = {
    "delay": ("delay_ns",),
    "reorder": ("delay_ns",),
    "mute": ("port",),
    "babble": ("port", "can_id"),
    "stuck": ("to_s",),
    "bus_off": ("port",),
}


class Passage(NamedTuple):
    """A frame between its sender's software and its queue.

    Attributes:
        frame: The frame that the receivers will see.
        delay_ns: Time between the offer and the queue.
        destroyed: Number of attempts to send it that end in an error.
        overtaken: Let the sender's next frame pass before, if that is offered within the delay.
    """

    frame: Frame
    delay_ns: int = 0
    destroyed: int = 0
    overtaken: bool = False


class BusEvent(NamedTuple):
    """An event at a port or on the bus.

    Attributes:
        kind: "mute", "babble", "stuck" or "bus_off" and, at its end, "unmute", "quiet" or "restart".
        port: The port concerned; without meaning for "stuck".
        until_ns: End of "stuck".
        frame: The frame that "babble" sends.
    """

    at_ns: int
    kind: str
    port: int = 0
    until_ns: int | None = None
    frame: Frame | None = None


class Fault(Table):
    """One fault, a ``[[fault]]`` of a file.

    Attributes:
        kind: drop; delay (later frames pass); duplicate; reorder (the port's next frame passes, if it comes within the delay);
            corrupt; mute (a port sends and acknowledges nothing); babble (a port sends one frame without end); stuck (the bus is
            dominant: all see errors); bus_off (a port; it comes back at `to_s`, if given).
        can_id: Identifier of the frames; above 7FFh a 29-bit one. None: all frames.
        mask: Bits of the identifier that count.
        port: Port of the sender; None: all senders.
        from_s: Begin of the fault, in s of the wire's time.
        to_s: End of the fault, in s of the wire's time; None: never.
        every: n, so that every n-th matching frame is hit.
        probability: Chance that such an n-th frame is hit.
        count: Largest number of hits; None: no limit.
        delay_ns: Time by which "delay" delays, or for which "reorder" waits for the next frame.
        copies: Number of additional frames by "duplicate".
        bits: Bits of the payload that "corrupt" inverts; bit 0 is the lowest of the first byte. None given: one by chance.
        crc: True if the receivers notice "corrupt" by the CRC, so that the frame is sent again; else it passes.
        attempts: Number of attempts in a row that are destroyed, with `crc`.
        data: Payload of the frame that "babble" sends, in hexadecimal.
    """

    kind: FaultKind
    can_id: Annotated[int, Field(ge=0, le=CAN_EFF_MASK)] | None = None
    mask: Annotated[int, Field(ge=0, le=CAN_EFF_MASK)] = CAN_EFF_MASK
    port: Annotated[int, Field(ge=0)] | None = None
    from_s: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    to_s: Annotated[float, Field(gt=0.0, le=1e9)] | None = None
    every: Annotated[int, Field(ge=1)] = 1
    probability: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    count: Annotated[int, Field(ge=1)] | None = None
    delay_ns: Annotated[int, Field(gt=0, le=MAX_DELAY_NS)] | None = None
    copies: Annotated[int, Field(ge=1, le=10)] = 1
    bits: tuple[Annotated[int, Field(ge=0, lt=8 * MAX_DATA_LENGTH)], ...] = ()
    crc: bool = True
    attempts: Annotated[int, Field(ge=1, le=1000)] = 1
    data: Annotated[str, Field(pattern=r"^([0-9A-Fa-f]{2}){0,8}$")] = ""

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        for key in sorted(self.model_fields_set):
            if self.kind not in _ONLY_FOR.get(key, {self.kind}):
                raise ValueError(f"{key} has no effect on a fault of kind {self.kind}; leave it out")
        for key in _NEEDS.get(self.kind, ()):
            if getattr(self, key) is None:
                raise ValueError(f"a fault of kind {self.kind} needs {key}")
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError(f"to_s = {self.to_s} is not after from_s = {self.from_s}")
        if self.bits and self.crc:
            raise ValueError("flipped bits fail the CRC and reach no node; set crc = false to let them pass")
        return self

    @property
    def from_ns(self) -> int:
        """Begin of the fault in ns."""
        return round(1e9 * self.from_s)

    @property
    def to_ns(self) -> int | None:
        """End of the fault in ns; None for never."""
        return None if self.to_s is None else round(1e9 * self.to_s)

    @property
    def flagged_id(self) -> int:
        """The identifier as SocketCAN writes it."""
        can_id = self.can_id or 0
        return can_id | CAN_EFF_FLAG if can_id > CAN_SFF_MASK else can_id

    def matches(self, frame: Frame, port: int, at_ns: int) -> bool:
        """Return True if the fault applies to a frame."""
        if self.port is not None and port != self.port:
            return False
        if at_ns < self.from_ns or (self.to_ns is not None and at_ns >= self.to_ns):
            return False
        return self.can_id is None or not (frame.can_id ^ self.flagged_id) & (self.mask | CAN_EFF_FLAG)

    def events(self) -> tuple[BusEvent, ...]:
        """Return the events of a port or bus fault, with instants."""
        if self.kind in OF_A_FRAME:
            return ()
        frame = Frame(self.flagged_id, bytes.fromhex(self.data)) if self.kind == "babble" else None
        begin = BusEvent(self.from_ns, self.kind, self.port or 0, self.to_ns, frame)
        ends = {"mute": "unmute", "babble": "quiet", "bus_off": "restart"}
        if self.to_ns is None or self.kind not in ends:
            return (begin,)
        return begin, BusEvent(self.to_ns, ends[self.kind], begin.port)


class FaultsFile(Table):
    """A file of faults."""

    seed: Annotated[int, Field(ge=0)] = 0
    fault: tuple[Fault, ...] = ()

    def faults(self) -> "BusFaults":
        """Return the fault source for a new wire."""
        return BusFaults(self.fault, self.seed)

    def check_ports(self, nodes: Sequence[int], first_client: int) -> None:
        """Refuse a fault at the port of a node that the robot does not have: it would never come.

        A stranger may babble; ports from `first_client` on are those of clients.

        Raises:
            ValueError: The message names the fault and the nodes.
        """
        for index, fault in enumerate(self.fault):
            if fault.port is not None and fault.port < first_client and fault.port not in nodes and fault.kind != "babble":
                there = ", ".join(map(str, nodes))
                raise ValueError(f"fault[{index}]: port {fault.port} is of no node; the robot has nodes {there}")


class BusFaults:
    """State of the faults on one wire.

    Attributes:
        events: Events that no frame causes, in order of time.
        hits: Number of frames that each fault has hit.
    """

    def __init__(self, faults: Iterable[Fault], seed: int = 0) -> None:
        """Start with no hits.

        Args:
            faults: In the order in which they affect a frame.
            seed: Seed of all that is left to chance; each fault has a generator of its own.
        """
        self.faults = tuple(faults)
        self.events = tuple(sorted((e for fault in self.faults for e in fault.events()), key=lambda event: event.at_ns))
        self.hits = [0] * len(self.faults)
        self._met = [0] * len(self.faults)
        self._chance = [np.random.default_rng((seed, index)) for index in range(len(self.faults))]
        self._of_a_frame = [(index, fault) for index, fault in enumerate(self.faults) if fault.kind in OF_A_FRAME]

    def apply(self, frame: Frame, port: int, at_ns: int) -> tuple[Passage, ...]:
        """Return the passages of an offered frame: none, one or several."""
        passages: tuple[Passage, ...] = (Passage(frame),)
        for index, fault in self._of_a_frame:
            if fault.matches(frame, port, at_ns) and self._hits(index, fault):
                passages = self._apply(index, fault, passages)
        return passages

    def _hits(self, index: int, fault: Fault) -> bool:
        """Decide whether a matching frame is hit."""
        self._met[index] += 1
        if self._met[index] % fault.every or (fault.count is not None and self.hits[index] >= fault.count):
            return False
        if fault.probability < 1.0 and self._chance[index].random() >= fault.probability:
            return False
        self.hits[index] += 1
        return True

    def _apply(self, index: int, fault: Fault, passages: tuple[Passage, ...]) -> tuple[Passage, ...]:
        match fault.kind:
            case "drop":
                return ()
            case "delay":
                return tuple(p._replace(delay_ns=p.delay_ns + (fault.delay_ns or 0)) for p in passages)
            case "duplicate":
                return passages * (1 + fault.copies)
            case "reorder":
                return tuple(p._replace(delay_ns=p.delay_ns + (fault.delay_ns or 0), overtaken=True) for p in passages)
            case _ if fault.crc:
                return tuple(p._replace(destroyed=p.destroyed + fault.attempts) for p in passages)
            case _:
                return tuple(p._replace(frame=self._flipped(index, fault, p.frame)) for p in passages)

    def _flipped(self, index: int, fault: Fault, frame: Frame) -> Frame:
        """Return the frame with some bits of its payload inverted."""
        size = 8 * len(frame.data)
        if not size or frame.can_id & CAN_RTR_FLAG:
            return frame
        bits = fault.bits or (math.floor(size * self._chance[index].random()),)
        number = int.from_bytes(frame.data, "little")
        for bit in bits:
            number ^= 1 << bit if bit < size else 0
        return Frame(frame.can_id, number.to_bytes(len(frame.data), "little"))
