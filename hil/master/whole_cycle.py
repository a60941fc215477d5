"""A cycle in two messages: set-points with SYNC, and answers.

On a local bus in lock-step, the frames of a cycle cross in one message each way, packed at fixed places. Frame by frame, a master
in Python spends more time on short-lived objects than on the rest of its cycle.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Protocol

from hil.can.frame import MAX_DATA_LENGTH, RECORD, Frame, pack
from hil.master.sensor import FrameHandler

_DATA = RECORD.size - MAX_DATA_LENGTH
_LENGTH = 4
"""Places of data and length in a record."""


class Commanded(Protocol):
    """An axis as this module needs it; `hil.master.cyclic.Slot` is one."""

    feedback_id: int
    status_word: int
    position_counts: int
    torque_per_mille: int

    def command(self) -> Frame:
        """The RPDO of this cycle."""
        ...

    def command_into(self, buffer: bytearray, place: int) -> None:
        """Write the RPDO's data of this cycle."""
        ...


class WholeCycle:
    """Layout of a cycle's two messages.

    Attributes:
        count: Number of answers.
    """

    def __init__(
        self, slots: Sequence[Commanded], handlers: Mapping[int, FrameHandler], feedback: struct.Struct, sync: Frame
    ) -> None:
        """Lay the messages out.

        Args:
            slots: The axes, with their commands and their first TPDO.
            handlers: Who takes an answer, by its identifier; the answers come in the order of the identifiers.
            feedback: Content of the first TPDO: status word, position, torque.
            sync: The last frame of the command.
        """
        self._slots = [(slot, n * RECORD.size + _DATA) for n, slot in enumerate(slots)]
        self._command = bytearray(b"".join(pack(frame) for frame in (*(slot.command() for slot in slots), sync)))
        order, own = sorted(handlers), {slot.feedback_id: slot for slot in slots}
        self.count = len(order)
        heads = "".join("IB11x" if can_id in own else "I12x" for can_id in order)
        self._size, self._heads, self._unpack = self.count * RECORD.size, struct.Struct(f"={heads}"), feedback.unpack_from
        lengths = {can_id: (can_id, feedback.size) if can_id in own else (can_id,) for can_id in order}
        self._expected = tuple(value for can_id in order for value in lengths[can_id])
        self._feedbacks = [(own[can_id], n * RECORD.size + _DATA) for n, can_id in enumerate(order) if can_id in own]
        self._others = [(can_id, handlers[can_id], n * RECORD.size) for n, can_id in enumerate(order) if can_id not in own]

    def command(self) -> bytes:
        """All set-points of this cycle, and SYNC behind them."""
        command = self._command
        for slot, place in self._slots:
            slot.command_into(command, place)
        return bytes(command)

    def take(self, message: bytes) -> set[int] | None:
        """Take all answers of a message.

        Returns:
            Identifiers whose length was wrong, which count as missing; None if these are not all answers in their order, and
            then nothing has been taken.
        """
        if len(message) != self._size or self._heads.unpack(message) != self._expected:
            return None
        unpack = self._unpack
        for slot, place in self._feedbacks:
            slot.status_word, slot.position_counts, slot.torque_per_mille = unpack(message, place)
        wrong: set[int] = set()
        for can_id, taker, place in self._others:
            length = message[place + _LENGTH]
            if length > MAX_DATA_LENGTH or not taker(message[place + _DATA : place + _DATA + length]):
                wrong.add(can_id)
        return wrong
