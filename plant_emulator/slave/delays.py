"""A slave that sends frames late, as real drives do, in order."""

from collections import deque
from typing import Any

import numpy as np

from drive_profiles.standard.cia301 import FunctionCode, NmtState
from drive_profiles.standard.cia305 import LSS_RESPONSE
from hil.can.frame import CAN_SFF_MASK, Frame
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.slave.emergency import COB_ID as EMERGENCY_COB_ID
from plant_emulator.slave.nmt import SERVICES, NmtService
from plant_emulator.slave.node import Slave
from plant_emulator.slave.pdo.rpdo import Rpdo
from plant_emulator.slave.pdo.tpdo import Tpdo

MOST_HELD = 1024
"""Frames of one kind that a node holds at most; what comes then is lost, as in a drive whose buffer is full."""


class _Queue:
    """Queue of frames of one kind, with release times that never decrease."""

    __slots__ = ("delay_ns", "frames", "jitter_ns")

    def __init__(self, delay_ns: int, jitter_ns: int = 0) -> None:
        self.delay_ns, self.jitter_ns = delay_ns, jitter_ns
        self.frames: deque[tuple[int, Frame]] = deque()

    def put(self, frame: Frame, now: int, dice: np.random.Generator) -> None:
        if len(self.frames) >= MOST_HELD:
            return
        due = now + self.delay_ns + (int(dice.integers(self.jitter_ns, endpoint=True)) if self.jitter_ns else 0)
        if self.frames:
            due = max(due, self.frames[-1][0])
        self.frames.append((due, frame))


class DelayedSlave(Slave):
    """A slave that delays its TPDOs and SDO answers.

    Boot-up, heartbeats, emergencies and LSS answers are not delayed.

    The identifiers in force tell the frames apart: those of each existing SDO channel, and 1014h.

    If the NMT state ends a service, its held frames are lost: a node that has been stopped or reset sends no earlier PDO and
    no earlier SDO answer (CiA 301, 7.3.2.2.5).
    """

    def __init__(self, behaviour: Behaviour, seed: int, *arguments: Any, **options: Any) -> None:
        self._dice = np.random.default_rng(seed)
        self._tpdos = _Queue(round(1e3 * behaviour.tpdo_delay_us), round(1e3 * behaviour.tpdo_jitter_us))
        self._answers = _Queue(round(1e6 * behaviour.sdo_delay_ms))
        self._answer_ids: frozenset[int] = frozenset()
        super().__init__(*arguments, **options)

    @property
    def due(self) -> int | None:
        """Next instant at which `advance` must be called."""
        first = super().due
        for frames in (self._tpdos.frames, self._answers.frames):
            if frames and (first is None or frames[0][0] < first):
                first = frames[0][0]
        return first

    @property
    def plain_pdos(self) -> tuple[list[Rpdo], list[Tpdo]] | None:
        """Those of `Slave`; None if each TPDO has a delay of its own."""
        return None if self._tpdos.jitter_ns else super().plain_pdos

    @property
    def tpdo_delay_ns(self) -> int:
        """Time by which a TPDO leaves later than its SYNC."""
        return self._tpdos.delay_ns

    @property
    def is_settled(self) -> bool:
        """True if the node is settled as any other, and holds no TPDO."""
        return super().is_settled and not self._tpdos.frames

    def power_on(self, now: int) -> list[Frame]:
        """Start, or restart; held frames are lost."""
        self._tpdos.frames.clear()
        self._answers.frames.clear()
        return super().power_on(now)

    def receive(self, frame: Frame, now: int) -> list[Frame]:
        """Return the frames that are due, and hold the answers."""
        return self._pass(super().receive(frame, now), now)

    def take_frames(self) -> list[Frame]:
        """Return the held frames that are due."""
        return self._pass(super().take_frames(), self._now or 0)

    def _change(self, new: NmtState) -> None:
        super()._change(new)
        for service, queue in ((NmtService.SDO, self._answers), (NmtService.PDO, self._tpdos)):
            if service not in SERVICES[new]:
                queue.frames.clear()

    def _pass(self, frames: list[Frame], now: int) -> list[Frame]:
        released: list[Frame] = []
        if frames:
            self._sort(frames, now, released)
        for queue in (self._answers, self._tpdos):
            while queue.frames and queue.frames[0][0] <= now:
                released.append(queue.frames.popleft()[1])
        self.on_due()
        return released

    def _sort(self, frames: list[Frame], now: int, released: list[Frame]) -> None:
        """Hold the frames that have to wait, and release the others."""
        present = frozenset([server.response_id for server in self._sdo.servers.values()])
        answers, self._answer_ids = self._answer_ids | present, present  # the answer that closes its channel is one, too
        at_once = FunctionCode.HEARTBEAT + self.node_id, LSS_RESPONSE, self.dictionary.get_int(EMERGENCY_COB_ID) & CAN_SFF_MASK
        for frame in frames:
            can_id = frame.can_id
            if can_id in at_once:
                released.append(frame)
            elif can_id in answers:
                self._answers.put(frame, now, self._dice)
            else:
                self._tpdos.put(frame, now, self._dice)


def slave_with(behaviour: Behaviour, seed: int, *arguments: Any, **options: Any) -> Slave:
    """Make a slave with a behaviour's delays; without any, a plain `Slave`."""
    if behaviour.delays_frames:
        return DelayedSlave(behaviour, seed, *arguments, **options)
    return Slave(*arguments, **options)
