"""The local bus: a Unix socket whose records are those of SocketCAN, 16 bytes each."""

import contextlib
import errno
import os
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from drive_profiles.address import Address
from hil.can import clock
from hil.can.errors import BusUnavailableError
from hil.can.frame import CAN_ERR_FLAG, CAN_SFF_MASK, MAX_DATA_LENGTH, RECORD, Frame, pack, unpack
from hil.can.raw import RawChannel
from hil.core.library import CORE

_SENSIBLE_SEND_S = 1.0
_SYNC = 0x80
_ANSWER_S = 2.0
_CLOCK_HEAD = RECORD.pack(clock.CLOCK_ID, MAX_DATA_LENGTH, b"")[:-MAX_DATA_LENGTH]
_MESSAGE_BYTES = clock.MAX_RECORDS * RECORD.size
MAX_EARLY = 256
"""Frames that may arrive, and are kept, before the local bus has answered which clock it has."""
_TIMEVAL = _TIMESPEC = struct.Struct("@ll")
_SO_TIMESTAMPNS = 35  # Linux, asm-generic/socket.h; the control message has the same number
_PROCESSOR_FIELD = 36
"""Place of `processor` in /proc/self/stat, counted from behind the name (proc(5))."""


def connect_local(address: Address) -> socket.socket:
    """Return a connected socket of the local bus.

    Seqpacket if the system has it, else stream.

    Raises:
        BusUnavailableError: No server listens at the address.
    """
    reason = "no Unix sockets on this system"
    for kind in ("SOCK_SEQPACKET", "SOCK_STREAM"):
        if not hasattr(socket, "AF_UNIX") or not hasattr(socket, kind):
            continue
        try:
            sock = socket.socket(socket.AF_UNIX, getattr(socket, kind))
        except OSError as error:
            reason = error.strerror or str(error)
            continue
        try:
            sock.connect(address.channel)
        except OSError as error:
            sock.close()
            reason = error.strerror or str(error)
            if error.errno == errno.EPROTOTYPE:  # the server fell back to the other kind
                continue
            break
        return sock
    path = Path(address.channel)
    if path.exists() and not path.is_socket():
        found = "a folder" if path.is_dir() else "a file"
        raise BusUnavailableError(address, f"{path} is {found}; expected the socket of an emulator")
    raise BusUnavailableError(address, f"{reason}; start it with: plant-emulator serve --bus {address}")


def wait_at_most(sock: socket.socket, timeout_s: float) -> None:
    """Limit the time of every read of a blocking socket.

    The kernel keeps the limit, so that waiting costs no further system call.
    """
    microseconds = max(1, round(1e6 * timeout_s))  # 0 would mean for ever
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(*divmod(microseconds, 1_000_000)))


def stamp_arrivals(sock: socket.socket) -> None:
    """Let the kernel stamp each message of a socket.

    Raises:
        OSError: This system or this kind of socket has no stamps.
    """
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def arrival_ns(ancillary: Sequence[tuple[int, int, bytes]]) -> int | None:
    """Return the kernel's time of a message in ns since 1970, or None."""
    for level, kind, data in ancillary:
        if (level, kind, len(data)) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS, _TIMESPEC.size):
            seconds, nanoseconds = _TIMESPEC.unpack(data)
            return int(seconds) * 1_000_000_000 + int(nanoseconds)
    return None


def direct_line(carry: int, medium: int) -> Any:
    """Return a `struct line` to a medium of this process.

    Args:
        carry: Address of the function that carries a message.
        medium: Address of the record that it takes; the caller keeps it.
    """
    line = CORE.new("line")
    line.carry, line.medium = CORE.borrowed(carry, line.carry), CORE.borrowed(medium, line.medium)
    return line


@contextmanager
def one_core(sock: socket.socket) -> Iterator[None]:
    """Context in which both ends of a lock-step socket stay on one core.

    It is the core of this end. In lock-step the two ends never work at the same time, and waking a sleeping core costs more than
    their work; for the measurements see docs/realtime.md. Another system, or the emulator of another user, stays as it is.
    """
    before: dict[int, set[int]] = {}
    with contextlib.suppress(AttributeError, OSError, ValueError, IndexError):
        pid, _, _ = struct.unpack("3i", sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
        if pid not in {0, os.getpid()}:
            cores = {process: os.sched_getaffinity(process) for process in (pid, 0)}
            here = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[_PROCESSOR_FIELD])
            for process, its in cores.items():
                os.sched_setaffinity(process, {here})
                before[process] = its
    try:
        yield
    finally:
        for process, its in before.items():
            with contextlib.suppress(OSError):  # it may have gone
                os.sched_setaffinity(process, its)


class LocalChannel(RawChannel):
    """A client's end of the local bus.

    Attributes:
        line: The core's record of the socket and its clock.
    """

    def __init__(self, address: Address) -> None:
        """Open the socket, and ask the bus for its clock.

        Raises:
            BusUnavailableError: The socket cannot be opened.
        """
        super().__init__(address, connect_local(address))
        self.is_lock_step = True
        self.line: Any = CORE.new("line")
        self.line.socket, self.line.timeout_s = self._socket.fileno(), -1.0
        self.line.period_over = pack(clock.period_over(0))
        self._takes_several = False
        self._early: deque[Frame] = deque()  # bounded by a message
        self._is_stream = self._socket.type == socket.SOCK_STREAM
        self._buffer = b""
        self._ask_for_the_clock()

    @contextmanager
    def on_one_core(self) -> Iterator[None]:
        """Context in which both ends of a bus in lock-step stay on one core; on any other nothing changes."""
        with one_core(self._socket) if self.is_lock_step else contextlib.nullcontext():
            yield

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus.

        If a lock-step bus is busy, this waits a moment; otherwise it never waits.
        """
        if self._lost is not None:
            raise self._lost
        record = pack(frame)
        self.line.is_over = False
        if frame[0] == _SYNC:
            self.line.syncs += 1
        self._transmit(record)

    def send_all(self, frames: Sequence[Frame]) -> None:
        """Put frames on the bus, in one message if the bus takes that."""
        if not self._takes_several or len(frames) > clock.MAX_RECORDS:
            for frame in frames:
                self.send(frame)
            return
        if self._lost is not None:
            raise self._lost
        record = RECORD.pack
        records = b"".join(
            [
                record(can_id, len(data), data)
                if 0 <= can_id <= CAN_SFF_MASK and len(data) <= MAX_DATA_LENGTH
                else pack(Frame(can_id, data))
                for can_id, data in frames
            ]
        )
        self.line.is_over = False
        self.line.syncs += sum([frame[0] == _SYNC for frame in frames])
        self._transmit(records)

    def receive_all(self, timeout_s: float) -> list[Frame]:
        """Receive the frames of the next message; none if it is late."""
        frame = self.receive(timeout_s)
        if frame is None:
            return []
        frames = [frame, *self._early]
        self._early.clear()
        return frames

    def open_line(self) -> None:
        """Do nothing: the line is the socket."""

    def close_line(self) -> None:
        """Do nothing: the bus itself knows what has happened."""

    @property
    def takes_messages(self) -> bool:
        """True if a cycle may be one message each way.

        No frame of an earlier message may still be unread, and the bus not be lost.
        """
        return self._takes_several and self.is_lock_step and not self._early and self._lost is None

    def send_message(self, records: bytes) -> None:
        """Send the records of a cycle in one message.

        The last is SYNC; only if `takes_messages` is true.

        Raises:
            BusLostError: The bus is gone.
        """
        if self._lost is not None:
            raise self._lost
        self.line.is_over = False
        self.line.syncs += 1
        self._transmit(records)

    def receive_message(self, timeout_s: float) -> bytes:
        """Receive the records of the next message; empty if none comes.

        Without the record of the bus' clock at its end.

        Raises:
            BusLostError: The bus is gone.
        """
        self._wait_at_most(timeout_s)
        try:
            message = self._socket.recv(_MESSAGE_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._bus_lost(error) from error
        if not message:
            raise self._bus_lost(OSError(errno.ECONNRESET, "the other end has closed the connection"))
        if message[-RECORD.size :].startswith(_CLOCK_HEAD) and self._is_period_over(message[-MAX_DATA_LENGTH:]):
            self.line.is_over = True
            return message[: -RECORD.size]
        return message

    def put_back(self, message: bytes) -> None:
        """Let a message that `receive_message` has given be read frame by frame."""
        self._take_message(message)

    def close(self) -> None:
        """Leave the bus; the core forgets the socket, whose number may become that of another file."""
        self.line.socket = -1
        super().close()

    def _transmit(self, records: bytes) -> None:
        try:
            self._socket.send(records, socket.MSG_DONTWAIT)
        except BlockingIOError:
            self._send_when_free(records)
        except OSError as error:
            raise self._bus_lost(error) from error

    def _send_when_free(self, record: bytes) -> None:
        try:
            if not self.is_lock_step or not select.select([], [self._socket], [], _SENSIBLE_SEND_S)[1]:
                raise OSError(errno.ENOBUFS, "the transmit queue does not drain")
            self._socket.send(record, socket.MSG_DONTWAIT)
        except OSError as error:
            raise self._bus_lost(error) from error

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came in time.

        In lock-step the time-out is the socket's own, so that a frame costs one system call.
        """
        if self._lost is not None:
            raise self._lost
        if self._early:
            return self._early.popleft()
        if self.line.is_over:
            self.line.is_over = False
            return None
        if not self.is_lock_step and timeout_s > 0.0:  # a socket's own time-out is counted in jiffies, up to 10 ms each
            ready = bool(self._buffer) or bool(select.select([self._socket], [], [], timeout_s)[0])
            return self._read(socket.MSG_DONTWAIT) if ready else None
        if timeout_s <= 0.0:
            return self._read(socket.MSG_DONTWAIT)
        self._wait_at_most(timeout_s)
        return self._read(0)

    def _wait_at_most(self, timeout_s: float) -> None:
        if timeout_s != self.line.timeout_s:
            wait_at_most(self._socket, timeout_s)
            self.line.timeout_s = timeout_s

    def _read(self, flags: int) -> Frame | None:
        """Return the next frame, or None; skip other records."""
        frame = self._from_stream(b"") if self._buffer else None
        while frame is None:
            try:
                record = self._socket.recv(_MESSAGE_BYTES, flags)
            except BlockingIOError:
                return None
            except OSError as error:
                raise self._bus_lost(error) from error
            if not record:
                raise self._bus_lost(OSError(errno.ECONNRESET, "the other end has closed the connection"))
            if self._takes_several:
                self._take_message(record)
                if self._early:
                    return self._early.popleft()
                if self.line.is_over:
                    self.line.is_over = False
                    return None
                continue
            frame = self._from_stream(record) if self._is_stream else unpack(record)
            if frame is not None and frame.can_id == clock.CLOCK_ID:
                if self._is_period_over(frame.data):
                    return None
                frame = None
        return self._noted(frame) if frame.can_id & CAN_ERR_FLAG else frame

    def _take_message(self, message: bytes) -> None:
        """Take the records of a message, and skip those without a frame."""
        if len(message) % RECORD.size:
            return
        keep = self._early.append
        for can_id, length, data in RECORD.iter_unpack(message):
            if length > MAX_DATA_LENGTH:
                continue
            if not can_id & CAN_ERR_FLAG:
                keep(Frame(can_id, data[:length]))
            elif can_id != clock.CLOCK_ID:
                keep(self._noted(Frame(can_id, data[:length])))
            elif self._is_period_over(data[:length]):
                self.line.is_over = True

    def _ask_for_the_clock(self) -> None:
        """Ask the local bus for its clock and bit rate.

        A bus that does not answer is in lock-step and has no bit rate.
        """
        self._socket.send(pack(clock.question(several=not self._is_stream)))
        deadline = time.monotonic() + _ANSWER_S
        while (left := deadline - time.monotonic()) > 0.0:
            if not self._buffer and not select.select([self._socket], [], [], left)[0]:
                return
            record = b"" if self._is_stream and len(self._buffer) >= RECORD.size else self._socket.recv(_MESSAGE_BYTES)
            frame = self._from_stream(record) if self._is_stream else unpack(record)
            if frame is None:
                continue
            said = clock.read_answer(frame.data) if frame.can_id == clock.CLOCK_ID else None
            if said is not None:
                self.is_lock_step = said.clock == clock.LOCK_STEP
                self.address = replace(self.address, bitrate=said.bitrate)
                self._takes_several = said.several and not self._is_stream
                return
            if len(self._early) < MAX_EARLY:
                self._early.append(frame)

    def _is_period_over(self, data: bytes) -> bool:
        """True if our last SYNC's period is over: no more frames follow."""
        return clock.read_period_over(data) == int(self.line.syncs) & 0xFFFF_FFFF

    def _from_stream(self, more: bytes) -> Frame | None:
        """Return the first frame of the bytes received so far."""
        self._buffer += more
        while len(self._buffer) >= RECORD.size:
            record, self._buffer = self._buffer[: RECORD.size], self._buffer[RECORD.size :]
            frame = unpack(record)
            if frame is not None:
                return frame
        return None
