"""Raw socket for AF_CAN and for the local bus.

The local bus is a Unix socket with the same 16-byte records.
"""

import contextlib
import errno
import os
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drive_profiles.address import LOCAL, Address
from hil.can import clock
from hil.can.errors import BusLostError, BusUnavailableError
from hil.can.errors_frame import ALL_CLASSES, decode
from hil.can.frame import CAN_ERR_FLAG, CAN_SFF_MASK, MAX_DATA_LENGTH, RECORD, Frame, pack, unpack

# <linux/can/raw.h> and <asm/socket.h>; the socket module does not give them everywhere
_SOL_CAN_RAW, _CAN_RAW_FILTER, _CAN_RAW_ERR_FILTER = 101, 1, 2
_SO_RCVBUFFORCE, _SO_RXQ_OVFL = 33, 40
_FILTER, _DROPPED = struct.Struct("=II"), struct.Struct("=I")
_ANCILLARY_BYTES = 64
CAN_BUFFER_BYTES = 2 << 20
"""Room for received frames: 2 800 of them, a third of a second at full load and 1 Mbit/s; the kernel's own default keeps 278."""
MAX_REPORTS = 64
_LOST_WORDS = {
    errno.ENETDOWN: "the interface is down",
    errno.ENODEV: "the interface is gone",
    errno.ENXIO: "the interface is gone",
    errno.ENOBUFS: "the transmit queue does not drain",
}
_SENSIBLE_SEND_S = 1.0
_SYNC = 0x80
_ANSWER_S = 2.0
_CLOCK_HEAD = RECORD.pack(clock.CLOCK_ID, MAX_DATA_LENGTH, b"")[:-MAX_DATA_LENGTH]
_MESSAGE_BYTES = clock.MAX_RECORDS * RECORD.size
MAX_EARLY = 256
"""Frames that may arrive, and are kept, before the local bus has answered which clock it has."""
_TIMEVAL = struct.Struct("@ll")
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
    raise BusUnavailableError(address, f"{reason}; start it with: plant-emulator serve --bus {address}")


def wait_at_most(sock: socket.socket, timeout_s: float) -> None:
    """Limit the time of every read of a blocking socket.

    The kernel keeps the limit, so that waiting costs no further system call.
    """
    microseconds = max(1, round(1e6 * timeout_s))  # 0 would mean for ever
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(*divmod(microseconds, 1_000_000)))


def bind_to_one_core(sock: socket.socket) -> set[int] | None:
    """Bind both ends of a lock-step socket to one core.

    It is the core of this end; return the former cores, or None. In lock-step the two ends never work at the same time, and
    waking a sleeping core costs more than their work; for the measurements see docs/realtime.md.
    """
    try:
        pid, _, _ = struct.unpack("3i", sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
        before = os.sched_getaffinity(0)
        if pid in {0, os.getpid()} or len(before) == 1:
            return None
        here = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[_PROCESSOR_FIELD])
        os.sched_setaffinity(pid, {here})
        os.sched_setaffinity(0, {here})
    except (AttributeError, OSError, ValueError, IndexError):
        return None  # another system, or another user's emulator: slower, and as right
    return before


def bind_can(address: Address, filters: Sequence[tuple[int, int]] = ()) -> socket.socket:
    """A socket on a CAN interface that reports errors and lost frames.

    Args:
        address: The CAN interface.
        filters: Identifier and mask of each group of frames to receive; empty: all frames.

    Raises:
        BusUnavailableError: The interface does not exist, or is down.
    """
    if not hasattr(socket, "AF_CAN"):
        raise BusUnavailableError(address, "this system has no SocketCAN")
    try:
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        raise BusUnavailableError(address, f"no SocketCAN in this kernel ({error.strerror})") from error
    try:
        sock.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, ALL_CLASSES)
        sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        if filters:
            packed = b"".join(_FILTER.pack(can_id, mask) for can_id, mask in filters)
            sock.setsockopt(_SOL_CAN_RAW, _CAN_RAW_FILTER, packed)
        _widen(sock)
        sock.bind((address.channel,))
        _check_up(address)
    except OSError as error:
        sock.close()
        raise BusUnavailableError(address, error.strerror or str(error)) from error
    except BusUnavailableError:
        sock.close()
        raise
    return sock


def _widen(sock: socket.socket) -> None:
    """Reserve room for `CAN_BUFFER_BYTES` of received frames.

    Without the right to force it, as much as the system allows.
    """
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, CAN_BUFFER_BYTES)
    except OSError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, CAN_BUFFER_BYTES)


def _check_up(address: Address) -> None:
    """Refuse an interface that is down.

    A socket can be bound to it, but would never receive a frame.

    Raises:
        BusUnavailableError: The interface is down.
    """
    try:
        flags = int(Path("/sys/class/net", address.channel, "flags").read_text(), 16)
    except (OSError, ValueError):
        return  # no /sys here; the first frame that is sent will tell
    if not flags & 1:  # IFF_UP
        raise BusUnavailableError(address, f"the interface is down; ip link set {address.channel} up")


def _dropped(ancillary: list[tuple[int, int, bytes]]) -> int | None:
    """Return the number of frames that the kernel has dropped.

    For this socket since it was opened; None if the kernel gave no count.
    """
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL and len(data) == _DROPPED.size:
            return int(_DROPPED.unpack(data)[0])
    return None


class RawChannel:
    """A channel on a raw socket.

    After the first failure every call fails: a bus that comes back needs a new channel.

    Attributes:
        address: Address of the bus; the local bus adds its bit rate.
        is_lock_step: True if time is counted in SYNCs, as the local bus reports.
        overflows: Received frames that were lost before they could be read: by the kernel, or (each time, not each frame) by the
            controller.
        error_warnings: Number of error frames in which the controller was error-warning or error-passive.
        reports: Contents of the error frames in words; the latest `MAX_REPORTS`.
    """

    def __init__(self, address: Address, filters: Sequence[tuple[int, int]] = ()) -> None:
        """Open the socket.

        Args:
            address: Address of the bus.
            filters: Identifier and mask of the kernel's filters, on AF_CAN.

        Raises:
            BusUnavailableError: The socket cannot be opened.
        """
        self.address = address
        self._is_local = address.interface == LOCAL
        self.is_lock_step = self._is_local
        self._syncs = 0
        self._takes_several = False
        self._early: deque[Frame] = deque()  # bounded by a message
        self._is_over = False
        self.overflows = 0
        self.error_warnings = 0
        self.reports: deque[str] = deque(maxlen=MAX_REPORTS)
        self._kernel_dropped = 0
        self._socket = connect_local(address) if self._is_local else bind_can(address, filters)
        self._timeout_s = -1.0
        self._is_stream = self._socket.type == socket.SOCK_STREAM
        self._buffer = b""
        self._lost: BusLostError | None = None
        if self._is_local:
            self._ask_for_the_clock()
        self._cores = bind_to_one_core(self._socket) if self.is_lock_step else None

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus.

        If a lock-step bus is busy, this waits a moment; otherwise it never waits.
        """
        if self._lost is not None:
            raise self._lost
        record = pack(frame)
        self._is_over = False
        if frame[0] == _SYNC:
            self._syncs += 1
        self._transmit(record)

    def send_all(self, frames: Sequence[Frame]) -> None:
        """Put frames on the bus, in one message if possible.

        Only the local bus may accept such messages.
        """
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
        self._is_over = False
        self._syncs += sum([frame[0] == _SYNC for frame in frames])
        self._transmit(records)

    def receive_all(self, timeout_s: float) -> list[Frame]:
        """Receive the frames of the next message.

        Empty if none comes in time.
        """
        frame = self.receive(timeout_s)
        if frame is None:
            return []
        frames = [frame, *self._early]
        self._early.clear()
        return frames

    @property
    def takes_messages(self) -> bool:
        """True if a cycle may be one message each way.

        No frame of an earlier message may still be unread.
        """
        return self._takes_several and self.is_lock_step and not self._early

    def send_message(self, records: bytes) -> None:
        """Send the records of a cycle in one message.

        The last is SYNC; only if `takes_messages` is true.

        Raises:
            BusLostError: The bus is gone.
        """
        if self._lost is not None:
            raise self._lost
        self._is_over = False
        self._syncs += 1
        self._transmit(records)

    def receive_message(self, timeout_s: float) -> bytes:
        """Receive the records of the next message; empty if none comes.

        Without the record of the bus' clock at its end.

        Raises:
            BusLostError: The bus is gone.
        """
        if timeout_s != self._timeout_s:
            wait_at_most(self._socket, timeout_s)
            self._timeout_s = timeout_s
        try:
            message = self._socket.recv(_MESSAGE_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._bus_lost(error) from error
        if not message:
            raise self._bus_lost(OSError(errno.ECONNRESET, "the other end has closed the connection"))
        if message[-RECORD.size :].startswith(_CLOCK_HEAD) and self._is_period_over(message[-MAX_DATA_LENGTH:]):
            self._is_over = True
            return message[: -RECORD.size]
        return message

    def put_back(self, message: bytes) -> None:
        """Let a message that `receive_message` has given be read frame by frame."""
        self._take_message(message)

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
        if self._is_over:
            self._is_over = False
            return None
        if not self._is_local:
            return self._read_can(timeout_s)
        if not self.is_lock_step and timeout_s > 0.0:  # a socket's own time-out is counted in jiffies, up to 10 ms each
            ready = bool(self._buffer) or bool(select.select([self._socket], [], [], timeout_s)[0])
            return self._read(socket.MSG_DONTWAIT) if ready else None
        if timeout_s <= 0.0:
            return self._read(socket.MSG_DONTWAIT)
        if timeout_s != self._timeout_s:
            wait_at_most(self._socket, timeout_s)
            self._timeout_s = timeout_s
        return self._read(0)

    def _read(self, flags: int) -> Frame | None:
        """Return the next frame, or None; skip other records.

        None if none comes within the socket's time-out.
        """
        frame = self._from_stream(b"") if self._buffer else None
        while frame is None:
            try:
                record = self._socket.recv(_MESSAGE_BYTES if self._is_local else RECORD.size, flags)
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
                if self._is_over:
                    self._is_over = False
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
                self._is_over = True

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
        """True if the period of our last SYNC is over.

        No more frames will come in it.
        """
        return clock.read_period_over(data) == self._syncs & 0xFFFF_FFFF

    def _read_can(self, timeout_s: float) -> Frame | None:
        """Return the next frame of a CAN interface, or None.

        None if none comes in time. Frames lost before it are counted.
        """
        while True:
            try:
                # the kernel counts a socket's own time-out in jiffies, up to 10 ms each
                if timeout_s > 0.0 and not select.select([self._socket], [], [], timeout_s)[0]:
                    return None
                record, ancillary, _, _ = self._socket.recvmsg(RECORD.size, _ANCILLARY_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return None
            except (OSError, ValueError) as error:
                raise self._bus_lost(error) from error
            if ancillary:
                dropped = _dropped(ancillary)
                if dropped is not None:
                    self.overflows += (dropped - self._kernel_dropped) & 0xFFFF_FFFF
                    self._kernel_dropped = dropped
            frame = unpack(record)
            if frame is not None:
                return self._noted(frame) if frame.can_id & CAN_ERR_FLAG else frame

    def _noted(self, frame: Frame) -> Frame:
        """Count the content of an error frame, and return the frame.

        A log can then contain it.

        Raises:
            BusLostError: The controller is bus-off, or has been and has recovered.
        """
        event = decode(frame)
        if event is not None:
            self.reports.append(event.words)
            self.error_warnings += event.is_warning
            self.overflows += event.is_overflow
            if event.is_lost:
                raise self._bus_lost(OSError(errno.EIO, event.words))
        return frame

    def _from_stream(self, more: bytes) -> Frame | None:
        """Return the first frame of the bytes received so far.

        Records that are not frames are skipped.
        """
        self._buffer += more
        while len(self._buffer) >= RECORD.size:
            record, self._buffer = self._buffer[: RECORD.size], self._buffer[RECORD.size :]
            frame = unpack(record)
            if frame is not None:
                return frame
        return None

    def _bus_lost(self, error: Exception) -> BusLostError:
        number, words = getattr(error, "errno", None), getattr(error, "strerror", None)
        plain = None if self.is_lock_step else _LOST_WORDS.get(number or 0)
        self._lost = BusLostError(self.address, plain or words or str(error))
        return self._lost

    def close(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(OSError):
            self._socket.close()
        if self._cores is not None:
            os.sched_setaffinity(0, self._cores)
            self._cores = None
