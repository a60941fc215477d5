"""One raw socket for two buses: AF_CAN, and the local bus' Unix socket, which carries the same 16-byte records."""

import contextlib
import errno
import os
import select
import socket
import struct
from pathlib import Path

from drive_profiles.address import LOCAL, Address
from hil.can.channel import BusLostError, BusUnavailableError
from hil.can.frame import CAN_ERR_FLAG, RECORD, Frame, pack, unpack

# <linux/can/raw.h>; the socket module does not give the error filter everywhere
_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER = 101, 2
_ERROR_CLASSES = 0x1FFF_FFFF
_SENSIBLE_SEND_S = 1.0
_TIMEVAL = struct.Struct("@ll")
_PROCESSOR_FIELD = 36
"""Place of `processor` in /proc/self/stat, counted from behind the name (proc(5))."""


def connect_local(address: Address) -> socket.socket:
    """A connected socket of the local bus: seqpacket where the system has it, else stream.

    Raises:
        BusUnavailableError: Nobody serves there.
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
    """Let every read of a blocking socket end after so long, in the kernel: waiting then costs no system call of its own."""
    microseconds = max(1, round(1e6 * timeout_s))  # 0 would mean for ever
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(*divmod(microseconds, 1_000_000)))


def share_core(sock: socket.socket) -> set[int] | None:
    """Keep both ends of a lock-step socket on the core on which this one runs; the cores of before, or None.

    In lock-step the two never have anything to do at the same time, and waking a core that sleeps costs more than their work:
    with the loop closed over the bus at 250 µs a cycle took 305 µs on two idle cores and 125 µs on one, the same on a busy
    machine. (Polling instead of sleeping: 93 µs on idle cores, 430 µs where another process wanted one of them.)
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


def _bind_can(address: Address) -> socket.socket:
    if not hasattr(socket, "AF_CAN"):
        raise BusUnavailableError(address, "this system has no SocketCAN")
    try:
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        raise BusUnavailableError(address, f"no SocketCAN in this kernel ({error.strerror})") from error
    try:
        sock.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ERROR_CLASSES)
        sock.bind((address.channel,))
    except OSError as error:
        sock.close()
        raise BusUnavailableError(address, error.strerror or str(error)) from error
    return sock


class RawChannel:
    """A channel on a raw socket. The first failure is latched: a bus that comes back needs a new channel."""

    def __init__(self, address: Address) -> None:
        """Open the socket; `BusUnavailableError` where that fails."""
        self.address = address
        self.is_lock_step = address.interface == LOCAL
        self._socket = connect_local(address) if self.is_lock_step else _bind_can(address)
        self._cores = share_core(self._socket) if self.is_lock_step else None
        self._timeout_s = -1.0
        self._is_stream = self._socket.type == socket.SOCK_STREAM
        self._buffer = b""
        self._lost: BusLostError | None = None

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus; waits a moment where the local bus is busy, never on a real one."""
        if self._lost is not None:
            raise self._lost
        record = pack(frame)
        try:
            self._socket.send(record, socket.MSG_DONTWAIT)
        except BlockingIOError:
            self._send_when_free(record)
        except OSError as error:
            raise self._lose(error) from error

    def _send_when_free(self, record: bytes) -> None:
        try:
            if not self.is_lock_step or not select.select([], [self._socket], [], _SENSIBLE_SEND_S)[1]:
                raise OSError(errno.ENOBUFS, "the transmit queue does not drain")
            self._socket.send(record, socket.MSG_DONTWAIT)
        except OSError as error:
            raise self._lose(error) from error

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came in time.

        In lock-step the time-out is the socket's own, so that a frame costs one system call.
        """
        if self._lost is not None:
            raise self._lost
        if timeout_s <= 0.0:
            return self._read(socket.MSG_DONTWAIT)
        if not self.is_lock_step:  # the kernel counts a socket's own time-out in jiffies, up to 10 ms each
            ready = bool(self._buffer) or bool(select.select([self._socket], [], [], timeout_s)[0])
            return self._read(socket.MSG_DONTWAIT) if ready else None
        if timeout_s != self._timeout_s:
            wait_at_most(self._socket, timeout_s)
            self._timeout_s = timeout_s
        return self._read(0)

    def _read(self, flags: int) -> Frame | None:
        """The next frame, records that are none passed over; None where nothing comes within the socket's time-out."""
        frame = self._from_stream(b"") if self._buffer else None
        while frame is None:
            try:
                record = self._socket.recv(4096 if self._is_stream else RECORD.size, flags)
            except BlockingIOError:
                return None
            except OSError as error:
                raise self._lose(error) from error
            if not record:
                raise self._lose(OSError(errno.ECONNRESET, "the other end has closed it"))
            frame = self._from_stream(record) if self._is_stream else unpack(record)
        if frame.can_id & CAN_ERR_FLAG and frame.can_id & 0x40:
            raise self._lose(OSError(errno.ENETDOWN, "the controller is bus-off"))
        return frame

    def _from_stream(self, more: bytes) -> Frame | None:
        """The first frame of what has come so far; records that are no frame are passed over."""
        self._buffer += more
        while len(self._buffer) >= RECORD.size:
            record, self._buffer = self._buffer[: RECORD.size], self._buffer[RECORD.size :]
            frame = unpack(record)
            if frame is not None:
                return frame
        return None

    def _lose(self, error: OSError) -> BusLostError:
        self._lost = BusLostError(self.address, error.strerror or str(error))
        return self._lost

    def close(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(OSError):
            self._socket.close()
        if self._cores is not None:
            os.sched_setaffinity(0, self._cores)
            self._cores = None
