"""SocketCAN: a raw socket on a CAN interface."""

import errno
import select
import socket
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from drive_profiles.address import Address
from hil.can.channel import OneByOne
from hil.can.errors import BusUnavailableError
from hil.can.errors_frame import ALL_CLASSES
from hil.can.frame import CAN_ERR_FLAG, RECORD, Frame, pack, unpack
from hil.can.raw import RawChannel

# <linux/can/raw.h> and <asm/socket.h>; the socket module does not give them everywhere
_SOL_CAN_RAW, _CAN_RAW_FILTER, _CAN_RAW_ERR_FILTER = 101, 1, 2
_SO_RCVBUFFORCE, _SO_RXQ_OVFL = 33, 40
_FILTER, _DROPPED = struct.Struct("=II"), struct.Struct("=I")
_ANCILLARY_BYTES = 64
CAN_BUFFER_BYTES = 2 << 20
"""Room for received frames: 2 800 of them, a third of a second at full load and 1 Mbit/s; the kernel's own default keeps 278."""


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
    """
    try:
        flags = int(Path("/sys/class/net", address.channel, "flags").read_text(), 16)
    except (OSError, ValueError):
        return  # no /sys here; the first frame that is sent will tell
    if not flags & 1:  # IFF_UP
        raise BusUnavailableError(address, f"the interface is down; run: ip link set {address.channel} up")


def _dropped(ancillary: list[tuple[int, int, bytes]]) -> int | None:
    """Return the number of frames that the kernel has dropped.

    For this socket since it was opened; None if the kernel gave no count.
    """
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL and len(data) == _DROPPED.size:
            return int(_DROPPED.unpack(data)[0])
    return None


class SocketCanChannel(RawChannel, OneByOne):
    """A CAN interface; its frames are sent at once or not at all."""

    words: ClassVar[Mapping[int, str]] = {
        errno.ENETDOWN: "the interface is down",
        errno.ENODEV: "the interface is gone",
        errno.ENXIO: "the interface is gone",
        errno.ENOBUFS: "the transmit queue does not drain",
        errno.EAGAIN: "the transmit queue does not drain",
    }

    def __init__(self, address: Address, filters: Sequence[tuple[int, int]] = ()) -> None:
        """Open the socket.

        Raises:
            BusUnavailableError: The socket cannot be opened.
        """
        super().__init__(address, bind_can(address, filters))
        self._kernel_dropped = 0

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus, without waiting."""
        if self._lost is not None:
            raise self._lost
        try:
            self._socket.send(pack(frame), socket.MSG_DONTWAIT)
        except OSError as error:
            raise self._bus_lost(error) from error

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came in time."""
        if self._lost is not None:
            raise self._lost
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
