"""One raw socket for two buses: AF_CAN, and the local bus' Unix socket, which carries the same 16-byte records."""

import contextlib
import errno
import select
import socket
import time

from hil.can.address import LOCAL, Address
from hil.can.channel import BusLostError, BusUnavailableError
from hil.can.frame import CAN_ERR_FLAG, RECORD, Frame, pack, unpack

SPIN_S = 150e-6
"""How long a receiver polls before it sleeps.

Waking a sleeping process costs tens of microseconds, more than all the packing of a cycle; in lock-step the answer is there
sooner than that.
"""

# <linux/can/raw.h>; the socket module does not give the error filter everywhere
_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER = 101, 2
_ERROR_CLASSES = 0x1FFF_FFFF
_SENSIBLE_SEND_S = 1.0


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
        self._socket.setblocking(False)
        self._is_stream = self._socket.type == socket.SOCK_STREAM
        self._buffer = b""
        self._lost: BusLostError | None = None

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus; waits a moment where the local bus is busy, never on a real one."""
        if self._lost is not None:
            raise self._lost
        record = pack(frame)
        try:
            self._socket.send(record)
        except BlockingIOError:
            self._send_when_free(record)
        except OSError as error:
            raise self._lose(error) from error

    def _send_when_free(self, record: bytes) -> None:
        try:
            if not self.is_lock_step or not select.select([], [self._socket], [], _SENSIBLE_SEND_S)[1]:
                raise OSError(errno.ENOBUFS, "the transmit queue does not drain")
            self._socket.send(record)
        except OSError as error:
            raise self._lose(error) from error

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came in time; polls for a moment before it sleeps."""
        if self._lost is not None:
            raise self._lost
        deadline = 0.0
        spun_until = 0.0
        while True:
            frame = self._read()
            if frame is not None:
                return frame
            now = time.monotonic()
            if not deadline:
                deadline, spun_until = now + timeout_s, now + min(timeout_s, SPIN_S)
            if now >= deadline:
                return None
            if now >= spun_until:
                select.select([self._socket], [], [], deadline - now)

    def _read(self) -> Frame | None:
        """A frame that is there already."""
        try:
            if self._is_stream and len(self._buffer) >= RECORD.size:
                return self._from_stream(b"")
            record = self._socket.recv(4096 if self._is_stream else RECORD.size)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._lose(error) from error
        if not record:
            raise self._lose(OSError(errno.ECONNRESET, "the other end has closed it"))
        if self._is_stream:
            return self._from_stream(record)
        frame = unpack(record)
        if frame is not None and frame.can_id & CAN_ERR_FLAG and frame.can_id & 0x40:
            raise self._lose(OSError(errno.ENETDOWN, "the controller is bus-off"))
        return frame

    def _from_stream(self, more: bytes) -> Frame | None:
        self._buffer += more
        if len(self._buffer) < RECORD.size:
            return None
        record, self._buffer = self._buffer[: RECORD.size], self._buffer[RECORD.size :]
        return unpack(record)

    def _lose(self, error: OSError) -> BusLostError:
        self._lost = BusLostError(self.address, error.strerror or str(error))
        return self._lost

    def close(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(OSError):
            self._socket.close()
