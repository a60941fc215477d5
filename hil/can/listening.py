"""Listener on a bus: every frame with its time, as arrays.

A thread reads the frames; nothing is ever sent.
A local bus gives the time on its own clock, SocketCAN that of the kernel, python-can that of its adapter.
"""

import contextlib
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from drive_profiles.address import LOCAL, SOCKETCAN, Address
from hil.can import clock
from hil.can.errors import BusLostError
from hil.can.frame import MAX_DATA_LENGTH, RECORD, pack
from hil.can.local import arrival_ns, connect_local, stamp_arrivals, wait_at_most
from hil.can.socketcan import bind_can

T = TypeVar("T")
ReceivedFrames = NDArray[np.void]
FRAME_RECORD = np.dtype([("stamp_ns", "<i8"), ("can_id", "<u4"), ("length", "u1"), ("data", "<u8")])
"""A frame that was heard: time in ns, identifier with SocketCAN's flags, length, and data with the first byte lowest."""
_WIRE = np.dtype({"names": ["can_id", "length", "data"], "formats": ["=u4", "u1", "<u8"], "offsets": [0, 4, 8], "itemsize": 16})
_MOMENT_S = 0.2
_GATHERING_S = 0.004
"""Time in which messages may gather: a system call takes one of them, and to wake up for each costs several times as much."""
_JOIN_S = 2.0
_HEARD_BYTES = clock.MAX_RECORDS * RECORD.size
_CONTROL_BYTES = 128
MOST_WAITING = 200_000
"""Messages that may wait to be taken; those beyond are lost, and counted."""


class Listener(ABC):
    """One bus, listened to by a thread that keeps its messages.

    Attributes:
        address: Address of the bus; a local bus adds its bit rate.
        lost: Messages that were not taken in time.
    """

    def __init__(self, address: Address) -> None:
        self.address = address
        self.lost = 0
        self._waiting: deque[Any] = deque()
        self._failure: BusLostError | None = None
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name=f"listening on {address}", daemon=True)

    @abstractmethod
    def take(self) -> ReceivedFrames:
        """The frames that have come since; shape (n,).

        Raises:
            BusLostError: The bus is gone, and everything that came before has been taken.
        """

    def close(self) -> None:
        """Leave the bus; a second call does nothing."""
        self._is_closed = True
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)

    @abstractmethod
    def _read(self) -> Any:
        """Return the next message; None if none comes within a moment.

        Raises:
            OSError: The bus is gone.
        """

    @staticmethod
    def _gathered(read: Callable[[int], T]) -> T | None:
        """Next message of a socket; None if none comes within a moment."""
        with contextlib.suppress(BlockingIOError):
            return read(socket.MSG_DONTWAIT)
        time.sleep(_GATHERING_S)
        try:
            return read(0)
        except BlockingIOError:
            return None

    def _run(self) -> None:
        while not self._is_closed:
            try:
                message = self._read()
            except (OSError, ValueError) as error:
                self._failure = BusLostError(self.address, getattr(error, "strerror", None) or str(error))
                return
            if message is None:
                continue
            if len(self._waiting) >= MOST_WAITING:
                self.lost += 1
            else:
                self._waiting.append(message)

    def _taken(self) -> list[Any]:
        failure = self._failure
        messages = [self._waiting.popleft() for _ in range(len(self._waiting))]
        if failure is not None and not messages and not self._is_closed:
            raise failure
        return messages


class LocalListener(Listener):
    """Listener on a local bus.

    Its times are those of the bus, which in lock-step are counted in SYNCs.
    """

    def __init__(self, address: Address) -> None:
        """Join the bus and ask for time stamps.

        Raises:
            BusUnavailableError: No server listens at the address.
        """
        super().__init__(address)
        self._socket = connect_local(address)
        self._last_ns = 0
        self._rest = b""
        self._socket.send(pack(clock.question(stamps=True, follows=True, several=True)))
        wait_at_most(self._socket, _JOIN_S)
        with contextlib.suppress(BlockingIOError):
            self._waiting.append(self._socket.recv(_HEARD_BYTES))
        wait_at_most(self._socket, _MOMENT_S)
        for can_id, _, data in RECORD.iter_unpack(b"".join(self._waiting)):
            said = clock.read_answer(data) if can_id == clock.CLOCK_ID else None
            if said is not None:
                self.address = Address(address.interface, address.channel, said.bitrate)
        self._thread.start()

    def _read(self) -> bytes | None:
        message = self._gathered(lambda flags: self._socket.recv(_HEARD_BYTES, flags))
        if message == b"":
            raise OSError("the other end has closed the connection")
        return message

    def take(self) -> ReceivedFrames:
        """The frames that have come since; shape (n,)."""
        octets = self._rest + b"".join(self._taken())
        whole = len(octets) - len(octets) % RECORD.size
        self._rest = octets[whole:]
        records = np.frombuffer(octets[:whole], _WIRE)
        of_clock = records["can_id"] == clock.CLOCK_ID
        is_stamp = of_clock & (records["data"] & np.uint64(0xFF) == clock.STAMP)
        stamps = np.where(is_stamp, (records["data"] >> np.uint64(8)).astype(np.int64), -1)
        place = np.maximum.accumulate(np.where(is_stamp, np.arange(len(records)), -1))
        told = np.where(place >= 0, stamps[np.maximum(place, 0)], self._last_ns)
        if len(told):
            self._last_ns = int(told[-1])
        frames = ~of_clock & (records["length"] <= MAX_DATA_LENGTH)
        return _heard(told[frames], records["can_id"][frames], records["length"][frames], records["data"][frames])

    def close(self) -> None:
        """Leave the bus."""
        self._is_closed = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        super().close()
        self._socket.close()


class CanListener(Listener):
    """Listener on a CAN interface; times are the kernel's."""

    def __init__(self, address: Address) -> None:
        """Open the socket; `BusUnavailableError` if that fails."""
        super().__init__(address)
        self._socket = bind_can(address)
        stamp_arrivals(self._socket)
        wait_at_most(self._socket, _MOMENT_S)
        self._thread.start()

    def _read(self) -> tuple[bytes, int] | None:
        message = self._gathered(lambda flags: self._socket.recvmsg(RECORD.size, _CONTROL_BYTES, flags))
        if message is None:
            return None
        record, ancillary, _, _ = message
        stamp_ns = arrival_ns(ancillary)
        return record, -1 if stamp_ns is None else stamp_ns

    def take(self) -> ReceivedFrames:
        """The frames that have come since; shape (n,)."""
        messages = [each for each in self._taken() if len(each[0]) == RECORD.size and each[1] >= 0]
        records = np.frombuffer(b"".join(record for record, _ in messages), _WIRE)
        return _heard(
            np.array([stamp_ns for _, stamp_ns in messages], np.int64), records["can_id"], records["length"], records["data"]
        )

    def close(self) -> None:
        """Leave the bus."""
        super().close()
        self._socket.close()


class AdapterListener(Listener):
    """Listener on any python-can bus; times are python-can's."""

    def __init__(self, address: Address) -> None:
        """Open the bus; `BusUnavailableError` if python-can cannot."""
        super().__init__(address)
        import can  # noqa: PLC0415 - slow to load

        from hil.can.adapter import open_adapter  # noqa: PLC0415 - as above

        self._bus, self._errors = open_adapter(address), can.CanError
        self._thread.start()

    def _read(self) -> Any:
        try:
            return self._bus.recv(_MOMENT_S)
        except self._errors as error:
            raise OSError(str(error)) from error

    def take(self) -> ReceivedFrames:
        """Return the frames since the last call, without CAN FD; shape (n,)."""
        from hil.can.adapter import frame_of  # noqa: PLC0415 - python-can is slow to load

        messages = [each for each in self._taken() if not each.is_fd]
        frames = [frame_of(each) for each in messages]
        return _heard(
            np.array([round(1e9 * each.timestamp) for each in messages], np.int64),
            np.array([frame.can_id for frame in frames], np.uint32),
            np.array([len(frame.data) for frame in frames], np.uint8),
            np.array([int.from_bytes(frame.data, "little") for frame in frames], np.uint64),
        )

    def close(self) -> None:
        """Leave the bus, and ignore the error of a lost port."""
        super().close()
        with contextlib.suppress(self._errors, OSError):
            self._bus.shutdown()


def open_listener(address: Address) -> Listener:
    """Listen at an address.

    Raises:
        BusUnavailableError: The bus does not exist, or cannot be used.
    """
    if address.interface == LOCAL:
        return LocalListener(address)
    return CanListener(address) if address.interface == SOCKETCAN else AdapterListener(address)


def _heard(
    stamp_ns: NDArray[np.int64], can_id: NDArray[np.uint32], length: NDArray[np.uint8], data: NDArray[np.uint64]
) -> ReceivedFrames:
    found = np.empty(len(stamp_ns), FRAME_RECORD)
    found["stamp_ns"], found["can_id"], found["length"], found["data"] = stamp_ns, can_id, length, data
    return found
