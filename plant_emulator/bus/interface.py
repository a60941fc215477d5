"""The local bus for python-can: `interface="hil_local"`."""

import select
import time
from typing import Any

import can

from drive_profiles.address import LOCAL, Address
from hil.can import clock
from hil.can.adapter import frame_of, message_of
from hil.can.errors import BusUnavailableError
from hil.can.frame import RECORD, pack, unpack
from hil.can.local import connect_local

SEND_PATIENCE_S = 10.0
"""Longest wait for room of a message without a time-out: a cyclic task of python-can ends with the first that finds none."""


class LocalBus(can.BusABC):
    """A python-can bus on the emulator's socket.

    Args:
        channel: Path of the socket.
        can_filters: Filters as python-can takes them; applied in Python.

    Raises:
        can.CanInitializationError: No server runs at the path.
    """

    def __init__(self, channel: str, can_filters: can.typechecking.CanFilters | None = None, **kwargs: Any) -> None:
        try:
            self._socket = connect_local(Address(LOCAL, str(channel)))
        except BusUnavailableError as error:
            raise can.CanInitializationError(str(error)) from error
        self._socket.setblocking(False)
        self._socket.send(pack(clock.question(stamps=True)))
        self._end_ns: int | None = None
        self._buffer = b""
        self.channel = channel
        self.channel_info = f"local bus {channel}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def fileno(self) -> int:
        """Return the socket's descriptor, for `can.Notifier` with an event loop."""
        return self._socket.fileno()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a message on the bus.

        It waits for room up to the time-out, by default `SEND_PATIENCE_S`.
        """
        try:
            record = pack(frame_of(msg))
            try:
                self._socket.send(record)
            except BlockingIOError:
                if not select.select([], [self._socket], [], SEND_PATIENCE_S if timeout is None else timeout)[1]:
                    raise can.CanOperationError("the local bus accepts no more frames") from None
                self._socket.send(record)
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"cannot send on the local bus: {error}") from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Return the next message of the socket; python-can filters it."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while len(self._buffer) < RECORD.size:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            try:
                if not select.select([self._socket], [], [], left)[0]:
                    return None, False
                data = self._socket.recv(RECORD.size - len(self._buffer))
            except (OSError, ValueError) as error:
                raise can.CanOperationError(f"the local bus failed: {error}") from error
            if not data:
                raise can.CanOperationError("the local bus has closed")
            self._buffer += data
        frame = unpack(self._buffer)
        self._buffer = b""
        if frame is None or frame.can_id == clock.CLOCK_ID:
            self._end_ns = None if frame is None else clock.read_stamp(frame.data)
            return None, False
        stamp_s = time.time() if self._end_ns is None else 1e-9 * self._end_ns
        return message_of(frame, timestamp=stamp_s, channel=self.channel), False

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        self._socket.close()
