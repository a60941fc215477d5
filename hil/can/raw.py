"""What a channel on a raw socket does on either bus: it counts errors, and is lost after the first failure."""

import contextlib
import errno
import socket
from collections import deque
from collections.abc import Mapping
from typing import ClassVar

from drive_profiles.address import Address
from hil.can.errors import BusLostError
from hil.can.errors_frame import decode
from hil.can.frame import Frame

MAX_REPORTS = 64


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

    waits = True
    words: ClassVar[Mapping[int, str]] = {}
    """Words for error numbers, instead of the system's."""

    def __init__(self, address: Address, sock: socket.socket) -> None:
        self.address = address
        self.is_lock_step = False
        self.overflows = 0
        self.error_warnings = 0
        self.reports: deque[str] = deque(maxlen=MAX_REPORTS)
        self._socket = sock
        self._lost: BusLostError | None = None

    def _noted(self, frame: Frame) -> Frame:
        """Count the content of an error frame, and return the frame.

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

    def _bus_lost(self, error: Exception) -> BusLostError:
        number, words = getattr(error, "errno", None), getattr(error, "strerror", None)
        self._lost = BusLostError(self.address, self.words.get(number or 0) or words or str(error))
        return self._lost

    def close(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(OSError):
            self._socket.close()
