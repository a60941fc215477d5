"""A channel on any python-can bus."""

import contextlib
import time
from typing import Any

import can

from drive_profiles.address import Address
from hil.can.channel import OneByOne
from hil.can.errors import BusLostError, BusUnavailableError
from hil.can.errors_frame import decode
from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame


class AdapterChannel(OneByOne):
    """python-can's `Bus` as a channel; time on it is the wall clock's."""

    is_lock_step = False
    waits = True
    overflows: int | None = None
    """None: python-can does not count lost frames."""

    def __init__(self, address: Address) -> None:
        """Open the bus; `BusUnavailableError` if python-can cannot."""
        self.address = address
        self._lost: BusLostError | None = None
        self._bus = open_adapter(address)

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus."""
        if self._lost is not None:
            raise self._lost
        try:
            self._bus.send(message_of(frame))
        except (can.CanError, OSError) as error:
            raise self._bus_lost(error) from error

    def receive(self, timeout_s: float) -> Frame | None:
        """Receive the next classic frame, or None if none comes in time."""
        if self._lost is not None:
            raise self._lost
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                message = self._bus.recv(max(0.0, deadline - time.monotonic()))
            except (can.CanError, OSError) as error:
                raise self._bus_lost(error) from error
            if message is None:
                return None
            if message.is_fd:
                continue
            frame = frame_of(message)
            event = decode(frame)
            if event is not None and event.is_lost:
                raise self._bus_lost(OSError(event.words))
            return frame

    def _bus_lost(self, error: Exception) -> BusLostError:
        self._lost = BusLostError(self.address, str(error))
        return self._lost

    def close(self) -> None:
        """Leave the bus, and ignore the error of a lost port."""
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()


def open_adapter(address: Address) -> can.BusABC:
    """Open python-can's bus.

    Raises:
        BusUnavailableError: python-can cannot.
    """
    settings: dict[str, Any] = {} if address.bitrate is None else {"bitrate": address.bitrate}
    try:
        return can.Bus(interface=address.interface, channel=address.channel, **settings)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise BusUnavailableError(address, str(error)) from error


def frame_of(message: can.Message) -> Frame:
    """The frame of a message of python-can."""
    # of a remote request the length is all there is
    return Frame(identifier_of(message), bytes(message.dlc if message.is_remote_frame else message.data))


def message_of(frame: Frame, **details: Any) -> can.Message:
    """The message of python-can of a frame."""
    is_remote = bool(frame.can_id & CAN_RTR_FLAG)
    return can.Message(
        arbitration_id=frame.can_id & CAN_EFF_MASK,
        is_extended_id=bool(frame.can_id & CAN_EFF_FLAG),
        is_remote_frame=is_remote,
        is_error_frame=bool(frame.can_id & CAN_ERR_FLAG),
        dlc=len(frame.data),
        data=None if is_remote else frame.data,
        **details,
    )


def identifier_of(message: can.Message) -> int:
    """Identifier and flags of a message of python-can, as in a frame."""
    return (
        message.arbitration_id
        | CAN_EFF_FLAG * message.is_extended_id
        | CAN_RTR_FLAG * message.is_remote_frame
        | CAN_ERR_FLAG * message.is_error_frame
    )
